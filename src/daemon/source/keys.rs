//! The keys that a daemon subscribes to, and which of their messages belong to its shard.

use std::collections::{BTreeSet, HashSet};

use zenoh::key_expr::keyexpr;

use stiction_engine::codec::topic::{Leaf, Topic};
use stiction_engine::config::{Config, NAME_MARK};
use stiction_engine::shard::Shard;

/// The keys that a daemon subscribes to. If loops are discovered: everything below its prefix, and each mapped key outside it.
/// For a shard with only configured loops: the keys of its loops, and those whose payloads carry several loops.
#[must_use]
pub fn subscriptions(config: &Config) -> Vec<String> {
    let everything = (config.input.discover || config.shard.is_whole()).then(|| format!("{}/**", config.site.prefix));
    let mut wide: Vec<String> = everything.into_iter().collect();
    for key in carriers(config) {
        if !covers(&wide, &key) {
            wide.retain(|known| !covers(std::slice::from_ref(&key), known));
            wide.push(key);
        }
    }
    let own = config.loops.iter().filter(|l| config.shard.owns(&l.name));
    let below = |name: &str| format!("{}/{name}/*", config.site.prefix);
    let keys = own.flat_map(|l| l.keys.iter().map(|(_, key)| key.clone()).chain([below(&l.name)]));
    let single: BTreeSet<String> = keys.filter(|key| !key.contains(NAME_MARK) && !covers(&wide, key)).collect();
    wide.into_iter().chain(single).collect()
}

/// Whether one of these key expressions includes a key: a second subscription would receive its messages twice.
fn covers(keys: &[String], key: &str) -> bool {
    let includes = |wide: &String| keyexpr::new(wide).is_ok_and(|w| keyexpr::new(key).is_ok_and(|k| w.includes(k)));
    keys.iter().any(includes)
}

/// Keys whose payloads carry several loops: every shard takes them.
fn carriers(config: &Config) -> Vec<String> {
    let mapped = config.loops.iter().flat_map(|l| l.keys.iter()).filter(|(_, key)| key.contains(NAME_MARK));
    let mapped: BTreeSet<&str> = mapped.filter_map(|(_, key)| key.split(NAME_MARK).next()).collect();
    config.bundles.iter().map(|bundle| bundle.key.as_str()).chain(mapped).map(str::to_owned).collect()
}

/// Separates a shard's messages from those of other shards before they take up the engine's queue.
#[derive(Debug)]
pub struct ShardFilter {
    shard: Shard,
    prefix: String,
    carriers: Vec<String>,
    mapped: HashSet<String>,
}

impl ShardFilter {
    /// The filter for a configuration; `None` if this daemon serves all loops.
    #[must_use]
    pub fn new(config: &Config) -> Option<Self> {
        let mapped = config.loops.iter().flat_map(|l| l.keys.iter().map(|(_, key)| key.clone())).collect();
        let (shard, prefix) = (config.shard, config.site.prefix.clone());
        (!shard.is_whole()).then(|| Self { shard, prefix, carriers: carriers(config), mapped })
    }

    /// Whether a key may carry a loop of this shard.
    #[must_use]
    pub fn admits(&self, key: &str) -> bool {
        match Topic::parse(Some(&self.prefix), key) {
            Some(Topic { loop_name, leaf: Leaf::Raw(_), .. }) => {
                self.shard.owns(loop_name) || self.mapped.contains(key) || covers(&self.carriers, key)
            }
            _ => true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(text: &str) -> Config {
        Config::parse(&format!("[site]\nprefix = \"p\"\n{text}")).unwrap()
    }

    #[test]
    fn nothing_is_subscribed_to_twice() {
        let text = "[[bundle]]\nkey = \"gw/a/**\"\n[[bundle]]\nkey = \"gw/**\"\n[[bundle]]\nkey = \"p/x\"\n\
                    [[loop]]\nname = \"A\"\nop = \"plc#A.OP\"\npv = \"plc#A.PV\"\nsp = \"gw/sp\"\nposition = \"y/mv\"\n";
        assert_eq!(subscriptions(&config(text)), ["p/**", "gw/**", "plc", "y/mv"]);
    }

    #[test]
    fn a_shard_of_named_loops_subscribes_to_its_own_and_one_that_discovers_to_all() {
        let loops = "[[bundle]]\nkey = \"gw/a/**\"\n[[loop]]\nname = \"A\"\nop = \"plc#A.OP\"\npv = \"gw/a/pv\"\n\
                     sp = \"x/A\"\n[[loop]]\nname = \"B\"\nop = \"plc#B.OP\"\npv = \"x/B\"\n";
        let of = |index: u32, discover: bool| {
            let config =
                config(&format!("[input]\ndiscover = {discover}\n[shard]\nindex = {index}\ncount = 2\n{loops}"));
            (subscriptions(&config), config.shard.owns("A"))
        };
        for index in [0, 1] {
            let (keys, owns_a) = of(index, false);
            let own = if owns_a { ["p/A/*", "x/A"] } else { ["p/B/*", "x/B"] };
            assert_eq!(keys, [&["gw/a/**", "plc"][..], &own].concat());
            assert_eq!(of(index, true).0[..3], ["p/**", "gw/a/**", "plc"]);
        }
    }

    #[test]
    fn a_filter_keeps_a_shards_loops_and_what_may_carry_them() {
        let text = "[[bundle]]\nkey = \"p/gw/*/pv\"\n[[loop]]\nname = \"A\"\nop = \"p/B/op\"\npv = \"p/C/pv\"\n";
        assert!(ShardFilter::new(&config(text)).is_none());
        let filter =
            |index: u32| ShardFilter::new(&config(&format!("[shard]\nindex = {index}\ncount = 2\n{text}"))).unwrap();
        let (zero, one) = (filter(0), filter(1));
        for name in ["L1", "L2", "L3", "u1/L4"] {
            let key = format!("p/{name}/pv");
            assert!(zero.admits(&key) != one.admits(&key), "{key}");
        }
        // Mapped keys, bundles, and keys below the prefix that are not raw signals pass to both.
        for key in ["p/B/op", "p/C/pv", "p/gw/L1/pv", "p/L1/other", "elsewhere/L1/pv"] {
            assert!(zero.admits(key) && one.admits(key), "{key}");
        }
    }
}
