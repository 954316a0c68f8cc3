//! Named values of payloads with several signals.

use std::collections::{BTreeMap, HashMap};

use stiction::core::record::{Mode, Sample, Signal, Value};

use super::CodecError;

/// A received payload that may have several signals.
#[derive(Debug, Clone, Copy)]
pub struct Bundle<'a> {
    /// Its key, which names the sender for Sparkplug B.
    pub key: &'a str,
    /// Its bytes.
    pub payload: &'a [u8],
    /// Time for values without their own, ns since 1970.
    pub fallback_t_ns: i64,
}

/// Longest name of a metric, node or device that is kept, bytes.
const MAX_NAME_BYTES: usize = 512;
/// Most that all names take, and those of one node, bytes.
const MAX_BYTES: usize = 128 << 20;
const NODE_BYTES: usize = MAX_BYTES / 4;
/// Estimated memory of a node, a device and a metric without their names, bytes.
const PER_NODE: usize = 320;
const PER_DEVICE: usize = 160;
const PER_METRIC: usize = 96;

/// State kept between payloads: the names of Sparkplug B's aliases, by node and device. Its size is bounded in bytes: names
/// beyond a node's share are left out, and the node that was heard longest ago goes first.
#[derive(Debug, Default)]
pub struct Memory {
    nodes: HashMap<Box<str>, Node>,
    /// Nodes by when they were last heard.
    order: BTreeMap<u64, Box<str>>,
    heard: u64,
    bytes: usize,
    lost: u64,
}

#[derive(Debug, Default)]
struct Node {
    devices: HashMap<Box<str>, HashMap<u64, AliasedMetric>>,
    bytes: usize,
    heard: u64,
}

/// Meaning of an alias, from a birth message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct AliasedMetric {
    /// The metric's name.
    pub name: String,
    /// Its data type, which later messages may omit.
    pub kind: u32,
}

/// `GROUP/NODE` of `GROUP/NODE[/DEVICE]`.
fn node_of(device: &str) -> &str {
    let end = device.match_indices('/').nth(1).map_or(device.len(), |(end, _)| end);
    &device[..end]
}

impl Memory {
    /// Number of names left out or forgotten since the last call.
    pub fn take_lost(&mut self) -> u64 {
        std::mem::take(&mut self.lost)
    }

    /// Notes that a node or one of its devices was heard.
    pub(super) fn hear(&mut self, device: &str) {
        let Some(node) = self.nodes.get_mut(node_of(device)) else { return };
        self.heard += 1;
        let before = std::mem::replace(&mut node.heard, self.heard);
        if let Some(name) = self.order.remove(&before) {
            self.order.insert(self.heard, name);
        }
    }

    /// Stores a name, if there is room.
    pub(super) fn learn(&mut self, device: &str, alias: u64, named: AliasedMetric) {
        let name = node_of(device);
        if named.name.len() > MAX_NAME_BYTES || device.len() > MAX_NAME_BYTES {
            self.lost += 1;
            return;
        }
        if !self.nodes.contains_key(name) {
            self.heard += 1;
            self.order.insert(self.heard, name.into());
            let bytes = PER_NODE + 2 * name.len();
            self.bytes += bytes;
            self.nodes.insert(name.into(), Node { devices: HashMap::new(), bytes, heard: self.heard });
        }
        let Some(node) = self.nodes.get_mut(name) else { return };
        let table = node.devices.get(device);
        let fresh = if table.is_none() { PER_DEVICE + device.len() } else { 0 };
        let more = fresh + PER_METRIC + named.name.len();
        let less = table.and_then(|table| table.get(&alias)).map_or(0, |known| PER_METRIC + known.name.len());
        if node.bytes + more - less > NODE_BYTES {
            self.lost += 1;
            return;
        }
        node.devices.entry(device.into()).or_default().insert(alias, named);
        node.bytes = node.bytes + more - less;
        self.bytes = self.bytes + more - less;
        self.make_room(name);
    }

    /// Forgets the nodes that were heard longest ago, except `but`, until the names fit.
    fn make_room(&mut self, but: &str) {
        while self.bytes > MAX_BYTES {
            let Some((heard, name)) = self.order.pop_first() else { return };
            if &*name == but {
                self.order.insert(heard, name);
                return;
            }
            if let Some(node) = self.nodes.remove(&name) {
                self.bytes -= node.bytes;
                self.lost += node.devices.values().map(|table| table.len() as u64).sum::<u64>();
            }
        }
    }

    /// Meaning of an alias of a device.
    pub(super) fn named(&self, device: &str, alias: u64) -> Option<&AliasedMetric> {
        self.nodes.get(node_of(device))?.devices.get(device)?.get(&alias)
    }

    /// Forgets a device; for a node also its devices.
    pub(super) fn forget(&mut self, device: &str) {
        let name = node_of(device);
        let Some(node) = self.nodes.get_mut(name) else { return };
        if name != device {
            let Some(table) = node.devices.remove(device) else { return };
            let names: usize = table.values().map(|known| PER_METRIC + known.name.len()).sum();
            let bytes = PER_DEVICE + device.len() + names;
            node.bytes -= bytes;
            self.bytes -= bytes;
        } else if let Some(node) = self.nodes.remove(name) {
            self.order.remove(&node.heard);
            self.bytes -= node.bytes;
        }
    }
}

/// The code of an OPC UA status, such that `[input] quality` reads it correctly under either convention: none for good, else
/// the upper half, whose lower bits never equal a good classic code.
pub(super) const fn ua_quality(status: u32) -> Option<u32> {
    if status >> 30 == 0 { None } else { Some(status & 0xFFFF_0000) }
}

/// The same for Sparkplug B's quality, where 192 is good, 0 bad and 500 stale.
pub(super) fn sparkplug_quality(code: u32) -> Option<u32> {
    const BAD: u32 = 0x8000_0000;
    (!(192..256).contains(&code)).then_some(BAD)
}

/// A value whose signal is not yet known.
#[derive(Debug, Clone, PartialEq)]
pub enum Scalar {
    /// A number; not finite if the sender has no value.
    Number(f64),
    /// A text, which may be a mode.
    Text(String),
    /// An explicit null.
    Missing,
}

/// One named value of a payload.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// Full name: the sender's prefix, a dot, and its own name.
    pub name: String,
    /// Start of its own name in the full name.
    pub own: usize,
    /// Its owner if its own name only names a signal: device, writer or measurement. Empty: the key names the owner.
    pub of: String,
    /// Source time, ns since 1970.
    pub t_ns: i64,
    /// The value.
    pub value: Scalar,
    /// Quality code.
    pub quality: Option<u32>,
}

impl Field {
    /// A value with a name; `head` is its owner's name and may be empty.
    #[must_use]
    pub fn new(head: &str, own: &str, t_ns: i64, value: Scalar, quality: Option<u32>) -> Self {
        let (name, start) =
            if head.is_empty() { (own.to_owned(), 0) } else { (format!("{head}.{own}"), head.len() + 1) };
        Self { name, own: start, of: head.to_owned(), t_ns, value, quality }
    }

    /// Its own name without prefix.
    #[must_use]
    pub fn own_name(&self) -> &str {
        self.name.get(self.own..).unwrap_or(&self.name)
    }

    /// As a sample of a signal. A text that is not a mode is a missing value.
    #[must_use]
    pub fn sample(&self, signal: Signal) -> Sample {
        let value = match &self.value {
            Scalar::Number(number) => Value::number(*number),
            Scalar::Text(word) if signal == Signal::Mode => Value::Mode(Mode::from_word(word)),
            Scalar::Text(_) | Scalar::Missing => Value::Missing,
        };
        Sample { signal, t_ns: self.t_ns, value, quality: self.quality }
    }
}

/// The samples of a payload on the key of one signal; all values must have the same name.
pub(super) fn as_one_signal(fields: &[Field], signal: Signal, out: &mut Vec<Sample>) -> Result<(), CodecError> {
    if let (Some(first), Some(other)) = (fields.first(), fields.iter().find(|f| f.name != fields[0].name)) {
        return Err(CodecError::Several { first: short(&first.name), other: short(&other.name) });
    }
    out.extend(fields.iter().map(|field| field.sample(signal)));
    Ok(())
}

fn short(name: &str) -> String {
    name.chars().take(60).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statuses_read_the_same_under_both_conventions() {
        assert_eq!([0, 0x0040_0000, 0x0000_0400].map(ua_quality), [None; 3]);
        assert_eq!([0x808c_0000, 0x4090_00ff].map(ua_quality), [Some(0x808c_0000), Some(0x4090_0000)]);
        assert_eq!([192, 216].map(sparkplug_quality), [None; 2]);
        assert!([0, 24, 500].into_iter().all(|code| sparkplug_quality(code) == Some(0x8000_0000)));
    }

    fn named(name: &str) -> AliasedMetric {
        AliasedMetric { name: name.to_owned(), kind: 10 }
    }

    #[test]
    fn names_are_kept_by_device_and_forgotten_with_their_node() {
        let mut memory = Memory::default();
        for device in ["g/n", "g/n/d", "g/n/e", "g/n2"] {
            memory.learn(device, 1, named(device));
            memory.learn(device, 1, named(device));
        }
        memory.forget("g/n/e");
        assert_eq!((memory.named("g/n/d", 1), memory.named("g/n/e", 1)), (Some(&named("g/n/d")), None));
        memory.forget("g/n");
        assert_eq!((memory.named("g/n/d", 1), memory.named("g/n2", 1)), (None, Some(&named("g/n2"))));
        memory.forget("g/n2");
        assert_eq!((memory.bytes, memory.nodes.len(), memory.order.len(), memory.lost), (0, 0, 0, 0));
    }

    #[test]
    fn strangers_take_their_share_and_the_node_heard_longest_ago_goes_first() {
        let mut memory = Memory::default();
        memory.learn("g/plant", 1, named("FIC101/OP"));
        memory.learn("g/silent", 1, named("FIC102/OP"));
        memory.learn("g/long", 1, named(&"n".repeat(MAX_NAME_BYTES + 1)));
        assert!(memory.named("g/long", 1).is_none() && memory.take_lost() == 1);
        // One node alone cannot push others out.
        let long = "n".repeat(MAX_NAME_BYTES);
        (0..100_000).for_each(|alias| memory.learn("g/greedy", alias, named(&long)));
        assert!(memory.take_lost() > 0 && memory.nodes["g/greedy"].bytes <= NODE_BYTES);
        assert!(memory.named("g/silent", 1).is_some());
        // Many strangers can push nodes out, but not one that is still heard.
        for k in 0..400 {
            (0..1000).for_each(|alias| memory.learn(&format!("g/stranger{k}"), alias, named(&long)));
            memory.hear("g/plant");
            assert!(memory.bytes <= MAX_BYTES);
        }
        assert_eq!((memory.named("g/plant", 1), memory.named("g/silent", 1)), (Some(&named("FIC101/OP")), None));
        memory.learn("g/new", 1, named("LIC7/PV"));
        assert!(memory.named("g/new", 1).is_some() && memory.take_lost() > 0);
        assert_eq!(memory.order.len(), memory.nodes.len());
    }

    #[test]
    fn one_signal_takes_one_name() {
        let field = |head: &str, own: &str| Field::new(head, own, 5, Scalar::Text("AUTO".into()), None);
        let mut out = Vec::new();
        as_one_signal(&[field("a", "x"), field("a", "x")], Signal::Mode, &mut out).unwrap();
        assert_eq!(out.iter().map(|s| s.value).collect::<Vec<_>>(), [Value::Mode(Mode::Auto); 2]);
        assert_eq!((field("a", "x").own_name(), field("", "x").own_name()), ("x", "x"));
        let error = as_one_signal(&[field("a", "x"), field("a", "y")], Signal::Pv, &mut out).unwrap_err();
        assert!(error.to_string().contains("KEY#a.x"), "{error}");
    }
}
