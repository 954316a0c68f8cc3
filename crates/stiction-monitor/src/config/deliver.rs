//! `[[deliver]]`: receivers of documents outside the bus.

use serde::Serialize;
use toml::de::DeTable;

use super::Summary;
use super::reader::{Fault, Lines, TableReader, subtables};
use crate::codec::topic::Kind;

/// Default of `queue`, documents: months of alarms.
const QUEUE: u64 = 10_000;
/// Documents that can be delivered.
const DOCUMENTS: [&str; 4] = ["alarm", "estimate", "gap", "data_health"];

/// Protocol of delivery.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Protocol {
    /// HTTP POST of a CloudEvent.
    Webhook,
    /// MQTT 5.
    Mqtt,
    /// Syslog (RFC 5424) over UDP.
    SyslogUdp,
    /// Syslog over TCP, framed as in RFC 6587.
    SyslogTcp,
}

/// Parsed address of a receiver.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Address {
    /// Protocol.
    pub protocol: Protocol,
    /// Whether TLS is used.
    pub tls: bool,
    /// Host name or address, without brackets.
    pub host: String,
    /// Port.
    pub port: u16,
    /// Part after the port without its slash: of a webhook the URL path, for MQTT the prefix of every topic.
    pub path: String,
}

/// One receiver.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Deliver {
    /// Name in faults, metrics and the store of waiting documents.
    pub name: String,
    /// Address as written.
    pub to: String,
    /// Parsed address.
    pub address: Address,
    /// Documents to deliver: `alarm`, `estimate`, `gap`, `data_health`.
    pub documents: Vec<String>,
    /// MQTT: user name.
    pub user: String,
    /// File with the user's password, or with a webhook's bearer token.
    pub secret_file: String,
    /// CA certificates (PEM) to trust; empty: public authorities.
    pub ca_file: String,
    /// Client certificate (PEM).
    pub cert_file: String,
    /// Private key of the client certificate (PEM).
    pub key_file: String,
    /// Most documents waiting; beyond it the oldest are dropped.
    pub queue: usize,
}

impl Address {
    /// Parses `scheme://host[:port][/path]`.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (scheme, rest) = text.split_once("://").ok_or("it has no scheme")?;
        let (protocol, tls, default_port) = match scheme {
            "http" => (Protocol::Webhook, false, 80),
            "https" => (Protocol::Webhook, true, 443),
            "mqtt" => (Protocol::Mqtt, false, 1883),
            "mqtts" => (Protocol::Mqtt, true, 8883),
            "syslog+udp" => (Protocol::SyslogUdp, false, 514),
            "syslog+tcp" => (Protocol::SyslogTcp, false, 514),
            other => return Err(format!("{other:?} is not a known scheme")),
        };
        if text.chars().any(|c| c.is_control() || c.is_whitespace()) || rest.contains('@') {
            return Err("spaces, control characters and user names are not allowed".to_owned());
        }
        let (place, path) = rest.split_once('/').unwrap_or((rest, ""));
        let (host, port) = match place.strip_prefix('[').and_then(|v6| v6.split_once(']')) {
            Some((host, port)) => (host, port.strip_prefix(':')),
            None => place.split_once(':').map_or((place, None), |(host, port)| (host, Some(port))),
        };
        let port = match port {
            None => default_port,
            Some(digits) => {
                digits.parse().ok().filter(|port| *port > 0).ok_or_else(|| format!("{digits:?} is not a port"))?
            }
        };
        if host.is_empty() {
            return Err("it names no host".to_owned());
        }
        Ok(Self { protocol, tls, host: host.to_owned(), port, path: path.trim_end_matches('/').to_owned() })
    }
}

pub(super) fn read_delivers(lines: &Lines, root: &DeTable<'_>, faults: &mut Vec<Fault>) -> Vec<Deliver> {
    let mut all: Vec<Deliver> = Vec::new();
    if !root.iter().any(|(key, _)| key.get_ref() == "deliver") {
        return all;
    }
    for (index, (table, line)) in subtables(lines, root, "deliver", faults).into_iter().enumerate() {
        let mut r = TableReader::new(lines, &format!("deliver[{index}]"), line, Some(table), faults);
        let entry = read_deliver(&mut r);
        if let Some(entry) = entry {
            if all.iter().any(|other| other.name == entry.name) {
                r.refuse(line, "name", format!("{:?} occurs twice", entry.name), "give each receiver its own name");
            }
            all.push(entry);
        }
        r.close();
    }
    all
}

/// A receiver waits for a document that `[summary]` switches off.
pub(super) fn never_made(lines: &Lines, root: &DeTable<'_>, summary: &Summary, receivers: &[Deliver]) -> Option<Fault> {
    let word = Kind::DataHealth.name();
    let waiting =
        receivers.iter().find(|d| summary.every_s == 0.0 && d.documents.iter().any(|wanted| wanted == word))?;
    let head = root.iter().find(|(key, _)| key.get_ref() == "summary").map_or(0, |(key, _)| key.span().start);
    Some(Fault {
        line: lines.of(head),
        key: "summary.every_s".to_owned(),
        message: format!("0 switches the summary off, but the receiver {:?} is to get {word}", waiting.name),
        remedy: format!("write every_s = 86400, or remove {word} from its documents"),
    })
}

fn read_deliver(r: &mut TableReader<'_, '_>) -> Option<Deliver> {
    let line = r.line();
    let plain = |name: &str| name.len() <= 64 && name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
    let name = match r.text("name") {
        Some((name, line)) if name.is_empty() || !plain(&name) => {
            r.refuse(
                line,
                "name",
                format!("{name:?} is not a valid name"),
                "use only letters, digits, - _ . such as cmms",
            );
            None
        }
        Some((name, _)) => Some(name),
        None => {
            r.refuse(line, "name", "is missing", "write name = \"cmms\"");
            None
        }
    };
    let known = "write http[s]://HOST/PATH, mqtt[s]://HOST:PORT, syslog+udp://HOST:PORT or syslog+tcp://HOST:PORT";
    let to = r.text("to").map_or_else(
        || {
            r.refuse(line, "to", "is missing", known);
            None
        },
        Some,
    );
    let address = to.as_ref().and_then(|(to, line)| match Address::parse(to) {
        Ok(address) => Some(address),
        Err(why) => {
            r.refuse(*line, "to", format!("{to:?} is not a valid address: {why}"), known);
            None
        }
    });
    let documents = r.texts("documents");
    for (word, line) in documents.iter().filter(|(word, _)| !DOCUMENTS.contains(&word.as_str())) {
        let remedy = format!("write some of {}", DOCUMENTS.join(", "));
        r.refuse(*line, "documents", format!("{word:?} is not a deliverable document"), remedy);
    }
    let mut documents: Vec<String> = documents.into_iter().map(|(word, _)| word).collect();
    if documents.is_empty() {
        documents.push(DOCUMENTS[0].to_owned());
    }
    let [user, secret_file, ca_file, cert_file, key_file] = ["user", "secret_file", "ca_file", "cert_file", "key_file"]
        .map(|key| r.text(key).map(|(text, _)| text).filter(|text| !text.is_empty()));
    let queue = r.integer("queue", QUEUE, 10, 1_000_000) as usize;
    if cert_file.is_some() != key_file.is_some() {
        r.refuse(line, "cert_file", "needs key_file", "write both or neither");
    }
    if let (Some(address), Some(_)) = (&address, &user)
        && address.protocol != Protocol::Mqtt
    {
        r.refuse(
            line,
            "user",
            "applies to MQTT only",
            "remove it; a webhook sends the content of secret_file as its token",
        );
    }
    let [user, secret_file, ca_file, cert_file, key_file] =
        [user, secret_file, ca_file, cert_file, key_file].map(Option::unwrap_or_default);
    let ((to, _), address, name) = (to?, address?, name?);
    Some(Deliver { name, to, address, documents, user, secret_file, ca_file, cert_file, key_file, queue })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use proptest::prelude::*;

    #[test]
    fn addresses_come_apart() {
        let of = |text: &str| {
            let a = Address::parse(text).unwrap();
            (a.protocol, a.tls, a.host, a.port, a.path)
        };
        let (webhook, mqtt, udp, tcp) = (Protocol::Webhook, Protocol::Mqtt, Protocol::SyslogUdp, Protocol::SyslogTcp);
        assert_eq!(of("https://cmms.plant/a/b?c=d"), (webhook, true, "cmms.plant".into(), 443, "a/b?c=d".into()));
        assert_eq!(of("mqtt://10.0.0.1:1884/plant/"), (mqtt, false, "10.0.0.1".into(), 1884, "plant".into()));
        assert_eq!(of("syslog+udp://[::1]"), (udp, false, "::1".into(), 514, String::new()));
        assert_eq!(of("syslog+tcp://[fe80::1]:6514"), (tcp, false, "fe80::1".into(), 6514, String::new()));
        for bad in ["cmms.plant", "ftp://h", "http://", "mqtt://h:x", "mqtt://h:0", "http://u:p@h/", "http://a b"] {
            assert!(Address::parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_receiver_is_checked_and_changes_no_hash() {
        let parse = |entry: &str| Config::parse(&format!("[site]\nprefix = \"p\"\n[[deliver]]\n{entry}\n"));
        let config = parse("name = \"a\"\nto = \"mqtt://h\"").unwrap();
        assert_eq!(config.hash(), Config::parse("[site]\nprefix = \"p\"\n").unwrap().hash());
        assert_eq!(
            (config.deliver[0].documents.as_slice(), config.deliver[0].queue),
            (&["alarm".to_owned()][..], 10_000)
        );
        for (entry, key) in [
            ("to = \"mqtt://h\"", "deliver[0].name"),
            ("name = \"a b\"\nto = \"mqtt://h\"", "deliver[0].name"),
            ("name = \"a\"", "deliver[0].to"),
            ("name = \"a\"\nto = \"h\"", "deliver[0].to"),
            ("name = \"a\"\nto = \"http://h\"\nuser = \"u\"", "deliver[0].user"),
            ("name = \"a\"\nto = \"mqtts://h\"\ncert_file = \"c\"", "deliver[0].cert_file"),
            ("name = \"a\"\nto = \"mqtt://h\"\ndocuments = [\"health\"]", "deliver[0].documents"),
            (
                "name = \"a\"\nto = \"mqtt://h\"\ndocuments = [\"data_health\"]\n[summary]\nevery_s = 0",
                "summary.every_s",
            ),
            ("name = \"a\"\nto = \"mqtt://h\"\n[summary]\nevery_s = 0.5", "summary.every_s"),
            ("name = \"a\"\nto = \"mqtt://h\"\n[summary]\nat = \"24:00\"", "summary.at"),
            ("name = \"a\"\nto = \"mqtt://h\"\n[summary]\nat = \"6:00\"", "summary.at"),
            ("name = \"a\"\nto = \"mqtt://h\"\n[[deliver]]\nname = \"a\"\nto = \"mqtt://h\"", "deliver[1].name"),
        ] {
            let faults = parse(entry).unwrap_err();
            assert!(faults.iter().any(|f| f.key == key && !f.remedy.is_empty()), "{entry}: {faults:?}");
        }
    }

    proptest! {
        #[test]
        fn any_address_is_answered(text in "\\PC{0,40}", scheme in "(http|mqtts|syslog\\+tcp)://") {
            let _ = Address::parse(&text);
            if let Ok(a) = Address::parse(&format!("{scheme}{text}")) {
                prop_assert!(!a.host.is_empty() && a.port > 0);
            }
        }
    }
}
