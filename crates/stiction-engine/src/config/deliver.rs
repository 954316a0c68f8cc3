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

/// Replacements for the receiver types that were removed.
const INSTEAD: &str = "write http[s]://HOST/PATH, or let the receiver read the bus (Zenoh has an MQTT bridge of its own) or Alertmanager \
                       send the alarms (config/alerts.yml)";

/// Parsed address of another program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Address {
    /// Whether TLS is used.
    pub tls: bool,
    /// Host name or address, without brackets.
    pub host: String,
    /// Port.
    pub port: u16,
    /// Part after the port without its slash.
    pub path: String,
}

/// One receiver.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Deliver {
    /// Name in faults, metrics and the store of waiting documents.
    pub name: String,
    /// Address as written.
    pub to: String,
    /// Documents to deliver: `alarm`, `estimate`, `gap`, `data_health`.
    pub documents: Vec<String>,
    /// File with the bearer token.
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
    /// Parses `SCHEME://host[:port][/path]` of a scheme with its default ports without and with TLS, whose name is then
    /// `SCHEMEs`.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str, scheme: &str, default_ports: [u16; 2]) -> Result<Self, String> {
        let (found, rest) = text.split_once("://").ok_or("it has no scheme")?;
        let tls = found.strip_suffix('s').is_some_and(|plain| plain == scheme);
        if !tls && found != scheme {
            return Err(format!("{found:?} is not a known scheme"));
        }
        let default_port = default_ports[usize::from(tls)];
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
        Ok(Self { tls, host: host.to_owned(), port, path: path.trim_end_matches('/').to_owned() })
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
    let known = "write http[s]://HOST/PATH";
    let to = match r.text("to") {
        None => {
            r.refuse(line, "to", "is missing", known);
            None
        }
        Some((to, line)) => match Address::parse(&to, "http", [80, 443]) {
            Ok(_) => Some(to),
            Err(why) => {
                let gone = ["mqtt", "syslog"].iter().any(|scheme| to.starts_with(scheme));
                let remedy = if gone { INSTEAD } else { known };
                r.refuse(line, "to", format!("{to:?} is not the address of a webhook: {why}"), remedy);
                None
            }
        },
    };
    let documents = r.texts("documents");
    for (word, line) in documents.iter().filter(|(word, _)| !DOCUMENTS.contains(&word.as_str())) {
        let remedy = format!("write some of {}", DOCUMENTS.join(", "));
        r.refuse(*line, "documents", format!("{word:?} is not a deliverable document"), remedy);
    }
    let mut documents: Vec<String> = documents.into_iter().map(|(word, _)| word).collect();
    if documents.is_empty() {
        documents.push(DOCUMENTS[0].to_owned());
    }
    let [secret_file, ca_file, cert_file, key_file] = ["secret_file", "ca_file", "cert_file", "key_file"]
        .map(|key| r.text(key).map(|(text, _)| text).filter(|text| !text.is_empty()));
    let queue = r.integer("queue", QUEUE, 10, 1_000_000) as usize;
    if cert_file.is_some() != key_file.is_some() {
        r.refuse(line, "cert_file", "needs key_file", "write both or neither");
    }
    let [secret_file, ca_file, cert_file, key_file] =
        [secret_file, ca_file, cert_file, key_file].map(Option::unwrap_or_default);
    let (to, name) = (to?, name?);
    Some(Deliver { name, to, documents, secret_file, ca_file, cert_file, key_file, queue })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use proptest::prelude::*;

    #[test]
    fn addresses_come_apart() {
        let of = |text: &str, scheme: &str| {
            let a = Address::parse(text, scheme, [80, 443]).unwrap();
            (a.tls, a.host, a.port, a.path)
        };
        assert_eq!(of("https://cmms.plant/a/b?c=d", "http"), (true, "cmms.plant".into(), 443, "a/b?c=d".into()));
        assert_eq!(of("mqtt://10.0.0.1:1884/plant/", "mqtt"), (false, "10.0.0.1".into(), 1884, "plant".into()));
        assert_eq!(of("http://[::1]", "http"), (false, "::1".into(), 80, String::new()));
        assert_eq!(of("mqtts://[fe80::1]:6514", "mqtt"), (true, "fe80::1".into(), 6514, String::new()));
        for bad in
            ["cmms.plant", "ftp://h", "mqtt://h", "http://", "http://h:x", "http://h:0", "http://u:p@h/", "http://a b"]
        {
            assert!(Address::parse(bad, "http", [80, 443]).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_receiver_is_checked_and_changes_no_hash() {
        let parse = |entry: &str| Config::parse(&format!("[site]\nprefix = \"p\"\n[[deliver]]\n{entry}\n"));
        let config = parse("name = \"a\"\nto = \"http://h\"").unwrap();
        assert_eq!(config.hash(), Config::parse("[site]\nprefix = \"p\"\n").unwrap().hash());
        assert_eq!(
            (config.deliver[0].documents.as_slice(), config.deliver[0].queue),
            (&["alarm".to_owned()][..], 10_000)
        );
        for (entry, key) in [
            ("to = \"http://h\"", "deliver[0].name"),
            ("name = \"a b\"\nto = \"http://h\"", "deliver[0].name"),
            ("name = \"a\"", "deliver[0].to"),
            ("name = \"a\"\nto = \"h\"", "deliver[0].to"),
            ("name = \"a\"\nto = \"http://h\"\nuser = \"u\"", "deliver[0].user"),
            ("name = \"a\"\nto = \"syslog+udp://h\"", "deliver[0].to"),
            ("name = \"a\"\nto = \"https://h\"\ncert_file = \"c\"", "deliver[0].cert_file"),
            ("name = \"a\"\nto = \"http://h\"\ndocuments = [\"health\"]", "deliver[0].documents"),
            (
                "name = \"a\"\nto = \"http://h\"\ndocuments = [\"data_health\"]\n[summary]\nevery_s = 0",
                "summary.every_s",
            ),
            ("name = \"a\"\nto = \"http://h\"\n[summary]\nevery_s = 0.5", "summary.every_s"),
            ("name = \"a\"\nto = \"http://h\"\n[summary]\nat = \"24:00\"", "summary.at"),
            ("name = \"a\"\nto = \"http://h\"\n[summary]\nat = \"6:00\"", "summary.at"),
            ("name = \"a\"\nto = \"http://h\"\n[[deliver]]\nname = \"a\"\nto = \"http://h\"", "deliver[1].name"),
        ] {
            let faults = parse(entry).unwrap_err();
            assert!(faults.iter().any(|f| f.key == key && !f.remedy.is_empty()), "{entry}: {faults:?}");
        }
        let gone = parse("name = \"a\"\nto = \"mqtts://h/topics\"").unwrap_err();
        assert!(gone.len() == 1 && gone[0].remedy.contains("bus"), "{gone:?}");
    }

    proptest! {
        #[test]
        fn any_address_is_answered(text in "\\PC{0,40}", scheme in "https?://") {
            let _ = Address::parse(&text, "http", [80, 443]);
            if let Ok(a) = Address::parse(&format!("{scheme}{text}"), "http", [80, 443]) {
                prop_assert!(!a.host.is_empty() && a.port > 0);
            }
        }
    }
}
