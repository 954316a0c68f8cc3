//! Names of signals, on a bus or in an address space, paired to loops, and these as `[[loop]]` entries.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write as _;

use anyhow::bail;
use serde_json::json;

use crate::export::names::role;
use stiction::core::record::Signal;
use stiction::core::units::{is_loop_name, loop_name_from};
use stiction_engine::codec::{self, Bundle, Memory};
use stiction_engine::config::{NAME_MARK, setting_of};

/// Most keys and names examined.
const MAX_NAMES: usize = 1_000_000;
/// Most names of one kind listed.
const TOLD: usize = 50;

/// What was seen: signals of loops by source, and names without a recognised signal.
#[derive(Debug, Default)]
pub struct Seen {
    loops: BTreeMap<String, BTreeMap<&'static str, (usize, String)>>,
    unknown: BTreeSet<String>,
    names: usize,
    memory: Memory,
    /// How often each key was decoded: once its names are known, its payloads add nothing.
    looked: HashMap<String, u8>,
}

impl Seen {
    /// Takes one name. If its ending names a signal, it becomes the source of that loop's signal unless a better one exists.
    pub fn take(&mut self, loop_name: &str, signal: Signal, rank: usize, source: &str) {
        self.names += 1;
        let signals = self.loops.entry(loop_name.to_owned()).or_default();
        let stronger = signals.get(signal.name()).is_none_or(|(known, _)| rank < *known);
        if stronger && let Some((_, weaker)) = signals.insert(signal.name(), (rank, source.to_owned())) {
            self.unknown.insert(weaker);
        } else if !stronger && signals.get(signal.name()).is_some_and(|(_, known)| known != source) {
            self.unknown.insert(source.to_owned());
        }
    }

    /// Takes a single-signal name; `own` is the part below the fixed prefix.
    pub fn name(&mut self, own: &str, source: String) -> bool {
        match role(own).filter(|found| !found.loop_name.is_empty()) {
            Some(found) => self.take(&found.loop_name, found.signal, found.rank, &source),
            None => return false,
        }
        true
    }

    /// Takes a bus message; `fixed` is the common start of all keys.
    pub fn message(&mut self, key: &str, fixed: &str, encoding: Option<&str>, payload: &[u8]) {
        let times = self.looked.get(key).copied().unwrap_or(0);
        if times >= 3 || self.looked.len() >= MAX_NAMES || self.names >= MAX_NAMES {
            return;
        }
        self.looked.insert(key.to_owned(), times + 1);
        let own = key.strip_prefix(fixed).unwrap_or(key);
        if self.name(own, key.to_owned()) {
            return;
        }
        let (mut fields, bundle) = (Vec::new(), Bundle { key, payload, fallback_t_ns: 0 });
        if codec::decode_fields(&bundle, encoding, None, &mut self.memory, &mut fields).is_err() || fields.is_empty() {
            self.unknown.insert(key.to_owned());
            return;
        }
        for field in fields {
            let source = format!("{key}{NAME_MARK}{}", field.name);
            match role(field.own_name()) {
                None => drop(self.unknown.insert(source)),
                Some(found) => {
                    let of = if field.of.is_empty() { own } else { &field.of };
                    let name = if found.loop_name.is_empty() { loop_name_from(of) } else { found.loop_name };
                    self.take(&name, found.signal, found.rank, &source);
                }
            }
        }
    }

    /// Takes a name that shows no signal.
    pub fn unrecognised(&mut self, source: String) {
        self.unknown.insert(source);
    }

    /// Whether any message came.
    #[must_use]
    pub fn has_data(&self) -> bool {
        !self.looked.is_empty()
    }

    /// The sources of a loop's signals.
    pub fn sources(&self, loop_name: &str) -> impl Iterator<Item = &str> {
        self.loops.get(loop_name).into_iter().flat_map(|signals| signals.values().map(|(_, source)| source.as_str()))
    }

    /// Loops that have an OP and a PV, and those that lack one.
    #[must_use]
    pub fn paired(&self) -> (Vec<&str>, Vec<&str>) {
        let whole = |name: &&str| {
            let signals = &self.loops[*name];
            is_loop_name(name) && signals.contains_key("op") && signals.contains_key("pv")
        };
        self.loops.keys().map(String::as_str).partition(whole)
    }
}

/// What was seen, as it is written.
#[derive(Debug, Clone, Copy)]
pub struct Listing<'a> {
    /// What was seen.
    pub seen: &'a Seen,
    /// Whether entries name their sources.
    pub keyed: bool,
    /// Where it was seen.
    pub what: &'a str,
}

impl Listing<'_> {
    /// The entries for a configuration; what lacks something as comments.
    #[must_use]
    pub fn toml(&self) -> String {
        let Self { seen, keyed, what } = *self;
        let (whole, lacking) = seen.paired();
        let mut text = format!("# {} loops, by stictiond discover from {}\n", whole.len(), what.escape_debug());
        // Writing into a String cannot fail.
        for name in &whole {
            let _ = write!(text, "\n[[loop]]\nname = {}\n", quoted(name));
            for (signal, (_, source)) in seen.loops[*name].iter().filter(|_| keyed) {
                let key = Signal::from_name(signal).map_or(*signal, setting_of);
                let _ = writeln!(text, "{key} = {}", quoted(source));
            }
        }
        if !lacking.is_empty() {
            let _ = writeln!(text, "\n# Lack OP or PV:");
        }
        for name in lacking.iter().take(TOLD) {
            let signals: Vec<String> =
                seen.loops[*name].iter().map(|(s, (_, source))| format!("{s} {source}")).collect();
            let _ = writeln!(text, "# {}", format!("{name}: {}", signals.join(", ")).escape_debug());
        }
        rest(&mut text, lacking.len());
        if !seen.unknown.is_empty() {
            let _ =
                writeln!(text, "\n# Names without a recognised signal, or with one that another name matches better:");
        }
        for name in seen.unknown.iter().take(TOLD) {
            let _ = writeln!(text, "# {}", name.escape_debug());
        }
        rest(&mut text, seen.unknown.len());
        text
    }

    /// All names as one document.
    #[must_use]
    pub fn json(&self) -> String {
        let seen = self.seen;
        let (whole, lacking) = seen.paired();
        let entry = |name: &&str| {
            let signals: BTreeMap<_, _> = seen.loops[*name].iter().map(|(s, (_, source))| (*s, source)).collect();
            json!({"name": name, "signals": signals})
        };
        let of = |names: &[&str]| names.iter().map(entry).collect::<Vec<_>>();
        json!({"schema": "stictiond.discover.v1", "loops": of(&whole), "unpaired": of(&lacking), "unknown": seen.unknown})
            .to_string()
            + "\n"
    }

    /// The numbers in a sentence.
    #[must_use]
    pub fn summary(&self) -> String {
        let (whole, lacking) = self.seen.paired();
        let (what, unknown) = (self.what, self.seen.unknown.len());
        format!(
            "{what}: found {} loops; {} lack OP or PV; {unknown} names have no recognised signal",
            whole.len(),
            lacking.len()
        )
    }

    /// Refuses a listing without a loop.
    ///
    /// # Errors
    /// There is none.
    pub fn check(&self) -> anyhow::Result<()> {
        if self.seen.paired().0.is_empty() {
            bail!(
                "no loop with both OP and PV found; names must end like FIC101.OP and FIC101.PV: check --key or --map"
            );
        }
        Ok(())
    }
}

/// A text as TOML quotes it.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

fn rest(text: &mut String, count: usize) {
    if count > TOLD {
        let _ = writeln!(text, "# and {} more; --format json lists all", count - TOLD);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction_engine::config::Config;

    #[test]
    fn loops_of_a_bus_are_paired_and_the_rest_is_said() {
        let mut seen = Seen::default();
        for key in ["gw/u1/FIC101.OP", "gw/u1/FIC101.PV", "gw/u1/FIC101.SP", "gw/u1/LIC7.PV", "gw/u1/FIC101.OUT"] {
            seen.message(key, "gw/", None, b"1.5");
        }
        seen.message("gw/plc", "gw/", None, br#"{"TIC3": {"op": 1, "pv": 2}, "PIC4.PV": 3, "noise": 4}"#);
        seen.message("gw/odd", "gw/", None, b"\xff\xfe");
        let (whole, lacking) = seen.paired();
        assert_eq!(
            (whole.as_slice(), lacking.as_slice()),
            (["TIC3", "u1_FIC101"].as_slice(), ["PIC4", "u1_LIC7"].as_slice())
        );
        let unknown: Vec<&str> = seen.unknown.iter().map(String::as_str).collect();
        assert_eq!(unknown, ["gw/odd", "gw/plc#noise", "gw/u1/FIC101.OUT"]);
        let text = Listing { seen: &seen, keyed: true, what: "a test" }.toml();
        let config = Config::parse(&format!("[site]\nprefix = \"p\"\n{text}")).unwrap();
        assert_eq!(config.loops.len(), 2);
        assert!(config.loops[0].keys.contains(&(Signal::Op, "gw/plc#TIC3.op".to_owned())), "{text}");
        assert!(text.contains("# u1_LIC7: pv gw/u1/LIC7.PV"), "{text}");
    }
}
