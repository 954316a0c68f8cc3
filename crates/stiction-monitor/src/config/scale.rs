//! Several daemons on one plant: the identity of this one, and which loops it watches. Not part of the hash, because every
//! daemon gives the same answer for a window.

use toml::de::DeTable;

use super::reader::{Fault, Lines, TableReader};
use crate::ownership::Shard;

/// `[daemon]`.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct Daemon {
    /// Name in documents and topics; empty: the id of its Zenoh session, new at each start.
    pub id: String,
}

/// `[shard]`: a fixed part of all loops.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct ShardKeys {
    /// Index of this part, from 0.
    pub index: u32,
    /// Number of parts; 1: this daemon watches all loops.
    pub count: u32,
}

impl Default for ShardKeys {
    fn default() -> Self {
        Self { index: 0, count: 1 }
    }
}

impl ShardKeys {
    /// The part, where there is more than one.
    #[must_use]
    pub fn shard(self) -> Option<Shard> {
        Shard::new(self.index, self.count).filter(|_| self.count > 1)
    }
}

/// `[cluster]`: daemons that know of each other and share the loops out among those that are alive.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Cluster {
    /// What its members have in common; empty: there is none.
    pub name: String,
    /// How long a member may be silent before it counts as gone, s.
    pub lease_s: f64,
    /// How long the list of members is to be still before loops move, s.
    pub debounce_s: f64,
    /// How much of a loop's past is asked for when it is taken, s; 0: none.
    pub refill_s: f64,
    /// How long the answer may take, s.
    pub refill_within_s: f64,
    /// How often new loops are looked for under the prefix, s.
    pub discover_every_s: f64,
    /// How long each look takes, s.
    pub discover_for_s: f64,
}

impl Default for Cluster {
    fn default() -> Self {
        Self {
            name: String::new(),
            lease_s: 2.0,
            debounce_s: 1.0,
            refill_s: 3600.0,
            refill_within_s: 2.0,
            discover_every_s: 600.0,
            discover_for_s: 10.0,
        }
    }
}

impl Cluster {
    /// Whether there is one.
    #[must_use]
    pub fn is_on(&self) -> bool {
        !self.name.is_empty()
    }
}

/// Whether a text may be a daemon's id, or empty: one chunk of a key.
#[must_use]
pub fn is_id(text: &str) -> bool {
    text.len() <= 64 && text.chars().all(|c| c.is_ascii_alphanumeric() || "._-".contains(c))
}

fn read_chunk(r: &mut TableReader<'_, '_>, key: &'static str) -> String {
    let Some((text, line)) = r.text(key) else { return String::new() };
    if !is_id(&text) {
        r.refuse(line, key, format!("{text:?} is not a valid name"), "use up to 64 letters, digits and . _ -");
    }
    text
}

pub(super) fn read_daemon(r: &mut TableReader<'_, '_>) -> Daemon {
    Daemon { id: read_chunk(r, "id") }
}

pub(super) fn read_shard(r: &mut TableReader<'_, '_>) -> ShardKeys {
    let d = ShardKeys::default();
    let most = u64::from(Shard::MOST);
    let index = r.integer("index", d.index.into(), 0, most - 1) as u32;
    let count = r.integer("count", d.count.into(), 1, most) as u32;
    if index >= count {
        let line = r.line();
        r.refuse(line, "index", format!("{index} must be less than count {count}"), "count parts from 0");
        return d;
    }
    ShardKeys { index, count }
}

pub(super) fn read_cluster(r: &mut TableReader<'_, '_>) -> Cluster {
    let d = Cluster::default();
    let hour_s = 3600.0;
    Cluster {
        name: read_chunk(r, "name"),
        lease_s: r.number("lease_s", d.lease_s, 0.5, hour_s),
        debounce_s: r.number("debounce_s", d.debounce_s, 0.0, hour_s),
        refill_s: r.number("refill_s", d.refill_s, 0.0, 31_622_400.0),
        refill_within_s: r.number("refill_within_s", d.refill_within_s, 0.1, hour_s),
        discover_every_s: r.number("discover_every_s", d.discover_every_s, 1.0, 31_622_400.0),
        discover_for_s: r.number("discover_for_s", d.discover_for_s, 1.0, 31_622_400.0),
    }
}

/// A fault where loops are both shared out by hand and among the living.
pub(super) fn both_ways(lines: &Lines, root: &DeTable<'_>, shard: &ShardKeys, cluster: &Cluster) -> Option<Fault> {
    let head = root.iter().find(|(key, _)| key.get_ref() == "shard").map_or(0, |(key, _)| key.span().start);
    (shard.count > 1 && cluster.is_on()).then(|| Fault {
        line: lines.of(head),
        key: "shard.count".to_owned(),
        message: "loops are shared out by [shard] and by [cluster]".to_owned(),
        remedy: "leave one of the two out".to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use crate::config::Config;

    #[test]
    fn faults_are_told_and_neither_shard_nor_cluster_changes_the_hash() {
        let of = |text: &str| Config::parse(&format!("[site]\nprefix = \"p\"\n{text}"));
        let text = "[daemon]\nid = \"a-1\"\n[shard]\nindex = 2\ncount = 3\n[cluster]\nname = \"c\"\n";
        let faults = of(text).unwrap_err();
        assert!(faults.len() == 1 && faults[0].key == "shard.count", "{faults:?}");
        let shard = of("[daemon]\nid = \"a-1\"\n[shard]\nindex = 2\ncount = 3\n").unwrap();
        let cluster = of("[cluster]\nname = \"c\"\nlease_s = 5\n").unwrap();
        assert_eq!(shard.shard.shard().map(|s| s.parts()), Some([2, 3]));
        assert!(cluster.cluster.is_on() && !shard.cluster.is_on() && of("").unwrap().shard.shard().is_none());
        assert_eq!([shard.hash(), cluster.hash()], [of("").unwrap().hash(), of("").unwrap().hash()]);
        for (wrong, key) in [
            ("[daemon]\nid = \"a/b\"\n", "daemon.id"),
            ("[shard]\nindex = 3\ncount = 3\n", "shard.index"),
            ("[cluster]\nname = \"*\"\n", "cluster.name"),
        ] {
            assert_eq!(of(wrong).unwrap_err()[0].key, key);
        }
    }
}
