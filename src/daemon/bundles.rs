//! Payloads that hold several signals: assigns each of their values to a loop and a signal.
//!
//! `KEY#NAME` in `[[loop]]` assigns them; where loops are discovered, the endings of the names do, as in exports. Where several
//! sources could feed a signal, [`super::feeds`] chooses.

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};

use zenoh::key_expr::{KeyExpr, keyexpr};

use stiction::core::record::{Sample, Signal};
use stiction::core::units::loop_name_from;
use stiction_engine::codec::topic::{Leaf, Topic};
use stiction_engine::codec::{Bundle, CodecError, ConfiguredCodec, Field, Memory, decode_fields};
use stiction_engine::config::{Config, NAME_MARK};
use stiction_engine::short_hash;
use stiction_files::export::names::role;

/// Limits on the remembered keys that carry signals: their number and total bytes. Further keys are read too, but get no
/// separate share of the queue.
const MAX_KEYS: usize = 100_000;
const MAX_KEY_BYTES: usize = 16 << 20;
/// Longest key of a bundle, and longest name in one, that can be assigned to a signal, bytes.
const MAX_NAME_BYTES: usize = 512;
/// Longest text that names a source, bytes; a longer one is kept only as a hash.
const MAX_SOURCE_BYTES: usize = 256;

/// First chunk of a Sparkplug B key.
const SPARKPLUG: &str = "spBv1.0/";

/// A value that was assigned to a signal.
#[derive(Debug, Clone, PartialEq)]
pub struct Meant {
    /// The loop.
    pub loop_name: String,
    /// The value as a sample of its signal.
    pub sample: Sample,
    /// Key and name under which it arrived.
    pub source: String,
}

/// Loop and signal by key, then by the name in the payload.
type Mapped = HashMap<String, HashMap<String, (String, Signal)>>;

/// The names in payloads that the configuration maps.
fn mapped(config: &Config) -> Mapped {
    let mut mapped = Mapped::new();
    for one in &config.loops {
        for (signal, key) in &one.keys {
            if let Some((key, name)) = key.split_once(NAME_MARK) {
                mapped.entry(key.to_owned()).or_default().insert(name.to_owned(), (one.name.clone(), *signal));
            }
        }
    }
    mapped
}

/// Assigns the values of bundles to signals.
#[derive(Debug)]
pub struct Bundles {
    prefix: String,
    discover: bool,
    keys: Vec<(KeyExpr<'static>, ConfiguredCodec)>,
    mapped: Mapped,
    carriers: HashSet<Box<str>>,
    carrier_bytes: usize,
    memory: Memory,
}

impl Bundles {
    /// Reads which keys carry bundles, and which names are mapped.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let keys = config.bundles.iter().filter_map(|b| Some((KeyExpr::new(b.key.clone()).ok()?, b.codec)));
        Self {
            prefix: config.site.prefix.clone(),
            discover: config.input.discover,
            keys: keys.collect(),
            mapped: mapped(config),
            carriers: HashSet::new(),
            carrier_bytes: 0,
            memory: Memory::default(),
        }
    }

    /// Adopts new mappings; what was learnt from payloads is kept.
    pub fn reconfigure(&mut self, config: &Config) {
        self.mapped = mapped(config);
    }

    /// The codec of a key whose payloads are bundles. A key below the prefix that names a signal by itself carries no bundle,
    /// unless names in its payloads are mapped.
    #[must_use]
    pub fn codec_of(&self, key: &str) -> Option<ConfiguredCodec> {
        if self.keys.is_empty() && self.mapped.is_empty() {
            return None;
        }
        let matching = || {
            let key = keyexpr::new(key).ok()?;
            self.keys.iter().find(|(expression, _)| expression.intersects(key)).map(|(_, codec)| *codec)
        };
        if self.mapped.contains_key(key) {
            return Some(matching().unwrap_or_default());
        }
        let raw = || Topic::parse(Some(&self.prefix), key).is_some_and(|t| matches!(t.leaf, Leaf::Raw(_)));
        if key.len() > MAX_NAME_BYTES || raw() { None } else { matching() }
    }

    /// The signals in a payload, the codec that read them, and the number of values that belong to no signal.
    ///
    /// # Errors
    /// The payload cannot be read.
    pub fn read(
        &mut self,
        bundle: &Bundle<'_>,
        encoding: Option<&str>,
        codec: ConfiguredCodec,
    ) -> Result<(Vec<Meant>, &'static str, u64), CodecError> {
        let mut fields = Vec::new();
        let name = decode_fields(bundle, encoding, codec, &mut self.memory, &mut fields)?;
        let ranked: Vec<Option<(String, Signal, usize)>> =
            fields.iter().map(|field| self.meaning(bundle.key, field)).collect();
        // If several names in a payload mean the same signal, the one with the best rank is used: OP before OUT.
        let mut best: HashMap<(&str, Signal), usize> = HashMap::new();
        for (loop_name, signal, rank) in ranked.iter().flatten() {
            let least = best.entry((loop_name, *signal)).or_insert(*rank);
            *least = (*least).min(*rank);
        }
        let mut meant = Vec::with_capacity(fields.len());
        for (field, found) in fields.iter().zip(&ranked) {
            let Some((loop_name, signal, rank)) = found else { continue };
            if best.get(&(loop_name.as_str(), *signal)) == Some(rank) {
                let source = source_of(&sender_of(bundle.key), &field.name);
                meant.push(Meant { loop_name: loop_name.clone(), sample: field.sample(*signal), source });
            }
        }
        let left = (fields.len() - meant.len()) as u64;
        Ok((meant, name, left))
    }

    /// Loop, signal and rank of a value, from the mapping if there is one, else from its name.
    fn meaning(&self, key: &str, field: &Field) -> Option<(String, Signal, usize)> {
        if field.name.len() > MAX_NAME_BYTES {
            return None;
        }
        if let Some(names) = self.mapped.get(key)
            && let Some((loop_name, signal)) = names.get(&field.name).or_else(|| names.get(field.own_name()))
        {
            return Some((loop_name.clone(), *signal, 0));
        }
        if !self.discover {
            return None;
        }
        let found = role(field.own_name())?;
        let loop_name = match (found.loop_name.is_empty(), field.of.is_empty()) {
            (false, _) => found.loop_name,
            (true, false) => loop_name_from(&field.of),
            (true, true) => {
                let below = key.strip_prefix(&self.prefix).and_then(|rest| rest.strip_prefix('/'));
                below.or_else(|| key.rsplit('/').next()).unwrap_or(key).to_owned()
            }
        };
        Some((loop_name, found.signal, found.rank + 1))
    }

    /// Whether this is the first time that the key is seen to carry signals.
    pub fn is_new_carrier(&mut self, key: &str) -> bool {
        let is_new = !self.carriers.contains(key)
            && self.carriers.len() < MAX_KEYS
            && self.carrier_bytes + key.len() <= MAX_KEY_BYTES
            && self.carriers.insert(key.into());
        self.carrier_bytes += if is_new { key.len() } else { 0 };
        is_new
    }

    /// Number of names in birth messages that were not kept since the last call.
    pub fn take_names_lost(&mut self) -> u64 {
        self.memory.take_lost()
    }
}

/// Sender and name of a value, in the form that [`super::feeds`] keeps.
fn source_of(sender: &str, name: &str) -> String {
    if sender.len() + name.len() < MAX_SOURCE_BYTES {
        return format!("{sender}{NAME_MARK}{name}");
    }
    format!("{}{NAME_MARK}{}", short_hash(sender.as_bytes()), short_hash(name.as_bytes()))
}

/// The sender of a key. A Sparkplug B key contains the message type, which does not identify the sender.
fn sender_of(key: &str) -> Cow<'_, str> {
    let sparkplug = || {
        let (head, rest) = key.split_once(SPARKPLUG)?;
        let (group, rest) = rest.split_once('/')?;
        let (_kind, node) = rest.split_once('/')?;
        Some(format!("{head}{SPARKPLUG}{group}/{node}"))
    };
    sparkplug().map_or(Cow::Borrowed(key), Cow::Owned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::record::Value;

    fn bundles(text: &str) -> Bundles {
        Bundles::new(&Config::parse(&format!("[site]\nprefix = \"p\"\n{text}")).unwrap())
    }

    fn read(bundles: &mut Bundles, key: &str, payload: &str) -> (Vec<(String, Signal, Value)>, u64) {
        let bundle = Bundle { key, payload: payload.as_bytes(), fallback_t_ns: 7 };
        let (meant, _, left) = bundles.read(&bundle, None, None).unwrap();
        (meant.into_iter().map(|m| (m.loop_name, m.sample.signal, m.sample.value)).collect(), left)
    }

    #[test]
    fn names_say_loop_and_signal() {
        let mut all = bundles("[[bundle]]\nkey = \"gw/**\"\n[[bundle]]\nkey = \"p/**\"\n");
        assert_eq!((all.codec_of("gw/x"), all.codec_of("p/A/op"), all.codec_of("other")), (Some(None), None, None));
        let n = Value::Number;
        let several = r#"{"FIC101.OP": 1, "FIC101.PV": 2, "LIC7": {"op": 3}, "temperature": 4}"#;
        let (found, left) = read(&mut all, "gw/x", several);
        let wanted = [
            ("FIC101".to_owned(), Signal::Op, n(1.0)),
            ("FIC101".to_owned(), Signal::Pv, n(2.0)),
            ("LIC7".to_owned(), Signal::Op, n(3.0)),
        ];
        assert_eq!((found.as_slice(), left), (wanted.as_slice(), 1));
        assert_eq!(read(&mut all, "p/u1/TIC3", r#"{"op": 5}"#).0, [("u1/TIC3".to_owned(), Signal::Op, n(5.0))]);
    }

    #[test]
    fn long_keys_and_names_of_strangers_leave_little_behind() {
        let mut all = bundles("[[bundle]]\nkey = \"gw/**\"\n");
        assert_eq!(all.codec_of(&format!("gw/{}", "k".repeat(MAX_NAME_BYTES))), None);
        let long = "n".repeat(10_000);
        assert_eq!(read(&mut all, "gw/x", &format!(r#"{{"{long}": {{"FIC101.op": 1}}}}"#)), (vec![], 1));
        let (sender, name) = ("gw/a".repeat(60), "u1.FIC101.OP".repeat(20));
        let source = source_of(&sender, &name);
        assert!(source.len() <= MAX_SOURCE_BYTES && source != source_of(&sender, &name[1..]));
        let carriers = (0..100_000).filter(|k| all.is_new_carrier(&format!("gw/{k:0500}"))).count();
        assert_eq!(carriers, MAX_KEY_BYTES / 503);
    }

    #[test]
    fn a_birth_and_the_data_after_it_are_of_one_sender() {
        assert_eq!(sender_of("p/spBv1.0/g/NBIRTH/n"), sender_of("p/spBv1.0/g/NDATA/n"));
        assert_eq!(sender_of("spBv1.0/g/DDATA/n/d"), "spBv1.0/g/n/d");
        assert_ne!(sender_of("p/spBv1.0/g/NDATA/n"), sender_of("p/spBv1.0/g/NDATA/m"));
        assert_eq!(sender_of("gw/a/b/c"), "gw/a/b/c");
    }

    #[test]
    fn what_is_mapped_goes_before_what_names_say() {
        let mut all = bundles(
            "[input]\ndiscover = false\n[[loop]]\nname = \"A\"\nop = \"gw/plc#x.y\"\npv = \"gw/plc#FIC101.OP\"\n",
        );
        assert_eq!(all.codec_of("gw/plc"), Some(None));
        let (found, left) = read(&mut all, "gw/plc", r#"{"x": {"y": 1}, "FIC101.OP": 2, "FIC101.PV": 3}"#);
        let mut signals: Vec<(Signal, Value)> = found.into_iter().map(|(_, signal, value)| (signal, value)).collect();
        signals.sort_by_key(|(signal, _)| signal.name());
        assert_eq!(
            (signals.as_slice(), left),
            ([(Signal::Op, Value::Number(1.0)), (Signal::Pv, Value::Number(2.0))].as_slice(), 1)
        );
    }

    #[test]
    fn two_names_of_one_signal_are_not_mixed() {
        let mut all = bundles("[[bundle]]\nkey = \"gw/**\"\n");
        let (found, left) = read(&mut all, "gw/x", r#"{"FIC101.MV": 1, "FIC101.OP": 2}"#);
        assert_eq!((found[0].2, found.len(), left), (Value::Number(2.0), 1, 1));
        assert!(all.is_new_carrier("gw/x") && !all.is_new_carrier("gw/x"));
    }
}
