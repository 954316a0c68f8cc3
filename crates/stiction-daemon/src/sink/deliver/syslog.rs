//! Syslog as RFC 5424 says, by UDP (RFC 5426) or TCP with the length in front (RFC 6587).
//!
//! The protocol confirms nothing: by TCP a document counts as taken once the system has it, and a connection that the
//! receiver has closed is seen before the next one.

use std::fmt::Write as _;
use std::io::{ErrorKind, Write as _};
use std::net::{TcpStream, ToSocketAddrs, UdpSocket};

use super::{Failure, Item, SEND_WITHIN, Target};
use stiction_monitor::config::{Address, Protocol};

/// Facility `local0`.
const FACILITY: u8 = 16;
/// Largest datagram that every receiver must take is 2,048 bytes.
const UDP_BYTES: usize = 2048;
/// The number that stands for "no enterprise of its own" in names of structured data (RFC 5612).
const ENTERPRISE: u32 = 32_473;
/// Byte order mark in front of UTF-8.
const BOM: char = '\u{feff}';

pub(super) struct Syslog {
    host: String,
    port: u16,
    tcp: bool,
    hostname: String,
    stream: Option<TcpStream>,
}

impl Syslog {
    pub fn new(address: &Address) -> Self {
        let named = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        Self {
            host: address.host.clone(),
            port: address.port,
            tcp: address.protocol == Protocol::SyslogTcp,
            hostname: printable(named.trim(), 255),
            stream: None,
        }
    }

    fn connected(&mut self) -> std::io::Result<&mut TcpStream> {
        if self.stream.as_ref().is_some_and(is_closed) {
            self.stream = None;
        }
        if self.stream.is_none() {
            let mut error = std::io::Error::from(ErrorKind::AddrNotAvailable);
            for address in (self.host.as_str(), self.port).to_socket_addrs()? {
                match TcpStream::connect_timeout(&address, SEND_WITHIN) {
                    Ok(stream) => {
                        stream.set_write_timeout(Some(SEND_WITHIN))?;
                        self.stream = Some(stream);
                        break;
                    }
                    Err(e) => error = e,
                }
            }
            if self.stream.is_none() {
                return Err(error);
            }
        }
        self.stream.as_mut().ok_or_else(|| ErrorKind::NotConnected.into())
    }

    fn by_tcp(&mut self, message: &str) -> std::io::Result<()> {
        let framed = format!("{} {message}", message.len());
        self.connected()?.write_all(framed.as_bytes())
    }

    fn by_udp(&self, message: &str) -> std::io::Result<()> {
        let place = (self.host.as_str(), self.port);
        let address = place.to_socket_addrs()?.next().ok_or(ErrorKind::AddrNotAvailable)?;
        let socket = UdpSocket::bind(if address.is_ipv6() { "[::]:0" } else { "0.0.0.0:0" })?;
        let mut end = message.len().min(UDP_BYTES);
        while !message.is_char_boundary(end) {
            end -= 1;
        }
        socket.send_to(&message.as_bytes()[..end], address).map(drop)
    }
}

/// Whether the receiver has closed its side. Nothing is ever read from it.
fn is_closed(stream: &TcpStream) -> bool {
    let looked = stream.set_nonblocking(true).and_then(|()| stream.peek(&mut [0]));
    let open = matches!(&looked, Err(e) if e.kind() == ErrorKind::WouldBlock) || looked.is_ok_and(|n| n > 0);
    stream.set_nonblocking(false).is_err() || !open
}

impl Target for Syslog {
    fn send(&mut self, item: &Item) -> Result<(), Failure> {
        let message = message(item, &self.hostname);
        let sent = if self.tcp { self.by_tcp(&message) } else { self.by_udp(&message) };
        sent.map_err(|error| {
            self.stream = None;
            Failure::Unanswered(format!("{}:{}: {error}", self.host, self.port))
        })
    }
}

/// One message: `<PRI>1 TIME HOST APP PROCID MSGID [DATA] TEXT`.
fn message(item: &Item, hostname: &str) -> String {
    let priority = 8 * FACILITY + item.level;
    let mut data = String::new();
    for (name, value) in &item.fields {
        let _ = write!(data, " {name}=\"{}\"", escaped(value));
    }
    // It knows six digits of a second, the plant's stamps may have nine.
    let time = microseconds(&item.time);
    let host = if hostname.is_empty() { "-" } else { hostname };
    let (pid, kind) = (std::process::id(), printable(&item.kind, 32));
    let text: String = item.line.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    format!("<{priority}>1 {time} {host} stictiond {pid} {kind} [stiction@{ENTERPRISE}{data}] {BOM}{text}")
}

/// A value of structured data: `"`, `\` and `]` stand behind a backslash, control characters are blanks.
fn escaped(value: &str) -> String {
    let mut out = String::with_capacity(value.len());
    for c in value.chars() {
        if matches!(c, '"' | '\\' | ']') {
            out.push('\\');
        }
        out.push(if c.is_control() { ' ' } else { c });
    }
    out
}

/// A stamp with at most six digits of a second; `-` where it is none.
fn microseconds(rfc3339: &str) -> String {
    if !rfc3339.ends_with('Z') {
        return "-".to_owned();
    }
    match rfc3339.trim_end_matches('Z').split_once('.') {
        Some((seconds, digits)) => format!("{seconds}.{}Z", &digits[..digits.len().min(6)]),
        None => rfc3339.to_owned(),
    }
}

/// The printable ASCII of a text, at most so much of it.
fn printable(text: &str, limit: usize) -> String {
    text.chars().filter(char::is_ascii_graphic).take(limit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn item(line: &str, value: &str) -> Item {
        Item {
            id: "1".into(),
            kind: "alarm".into(),
            schema: "s".into(),
            loop_name: "L".into(),
            prefix: "p".into(),
            time: "2026-01-05T08:15:00.123456789Z".into(),
            level: 3,
            fields: vec![("area".into(), value.into())],
            line: line.into(),
            document: "{}".into(),
        }
    }

    #[test]
    fn a_message_is_what_the_standard_says() {
        let pid = std::process::id();
        assert_eq!(
            message(&item("FIC101: µ\n", "a\"b\\c]d"), "host"),
            format!(
                "<131>1 2026-01-05T08:15:00.123456Z host stictiond {pid} alarm [stiction@32473 area=\"a\\\"b\\\\c\\]d\"] \
                 \u{feff}FIC101: µ "
            )
        );
        assert!(message(&Item { time: "99 s".into(), ..item("", "") }, "").starts_with("<131>1 - - stictiond "));
    }

    proptest! {
        #[test]
        fn any_text_stays_inside_its_place(line in "\\PC{0,40}|[\\x00-\\x1f\\]\"\\\\]{0,9}", value in "(?s).{0,40}") {
            let said = message(&item(&line, &value), "h");
            prop_assert!(!said.chars().any(char::is_control));
            let divided = said.contains(&format!("\"] {BOM}"));
            prop_assert!(divided);
        }
    }
}
