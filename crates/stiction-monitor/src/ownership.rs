//! Which daemon watches which loop, where several share a plant. Pure: told who is alive and what time it is.
//!
//! Two ways. A [`Shard`] is fixed: the loop's hash modulo the number of daemons. [`Live`] daemons know of each other: a
//! loop belongs to the one with the highest hash of loop and daemon together (rendezvous hashing, Thaler and Ravishankar
//! 1998), so that a daemon that goes gives up its own loops alone, and one that comes takes its part from all the others.
//! Whoever computes it from the same list of names gets the same answer; nobody has to be asked.

use std::collections::{BTreeMap, BTreeSet};

use sha2::{Digest, Sha256};

/// A hash of a name that is the same on every machine, in every build and for ever: the first 8 bytes of SHA-256.
#[must_use]
pub fn stable_hash(name: &str) -> u64 {
    Sha256::digest(name.as_bytes()).iter().take(8).fold(0, |hash, byte| hash << 8 | u64::from(*byte))
}

/// Spreads two hashes over all 64 bits (the finaliser of splitmix64).
const fn mix(a: u64, b: u64) -> u64 {
    let z = a ^ b.rotate_left(32);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// One of a fixed number of parts of all loops.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: u32,
    count: u32,
}

impl Shard {
    /// Most parts.
    pub const MOST: u32 = 10_000;

    /// Part `index`, from 0, of `count`; none where there is no such part.
    #[must_use]
    pub const fn new(index: u32, count: u32) -> Option<Self> {
        if index < count && count <= Self::MOST { Some(Self { index, count }) } else { None }
    }

    /// Reads `I/N`.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let (index, count) = text.split_once('/')?;
        Self::new(index.trim().parse().ok()?, count.trim().parse().ok()?)
    }

    /// Its place, from 0, and how many parts there are.
    #[must_use]
    pub const fn parts(self) -> [u32; 2] {
        [self.index, self.count]
    }

    /// Whether a loop belongs to it.
    #[must_use]
    pub fn owns(self, loop_name: &str) -> bool {
        stable_hash(loop_name) % u64::from(self.count) == u64::from(self.index)
    }
}

/// The daemons that are alive, by id.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Live {
    hashes: BTreeMap<String, u64>,
}

impl<S: Into<String>> FromIterator<S> for Live {
    fn from_iter<T: IntoIterator<Item = S>>(ids: T) -> Self {
        let hashed = |id: String| {
            let hash = stable_hash(&id);
            (id, hash)
        };
        Self { hashes: ids.into_iter().map(|id| hashed(id.into())).collect() }
    }
}

impl Live {
    /// Their ids, in order.
    pub fn ids(&self) -> impl ExactSizeIterator<Item = &str> {
        self.hashes.keys().map(String::as_str)
    }

    /// Whose loop it is; none where nobody lives.
    #[must_use]
    pub fn owner(&self, loop_name: &str) -> Option<&str> {
        let hash = stable_hash(loop_name);
        let mut best: Option<(u64, &str)> = None;
        for (id, own) in &self.hashes {
            let score = mix(hash, *own);
            // Of two with the same score, which will not happen, the smaller id: the order of the map.
            if best.is_none_or(|(highest, _)| score > highest) {
                best = Some((score, id));
            }
        }
        best.map(|(_, id)| id)
    }

    /// Whether a loop is this daemon's.
    #[must_use]
    pub fn is_owner(&self, id: &str, loop_name: &str) -> bool {
        self.owner(loop_name) == Some(id)
    }

    /// Whether it would be this daemon's if up to `failures` others failed: whoever may inherit a loop keeps its state.
    #[must_use]
    pub fn may_inherit(&self, id: &str, loop_name: &str, failures: usize) -> bool {
        let Some(own) = self.hashes.get(id) else { return false };
        let hash = stable_hash(loop_name);
        let own = mix(hash, *own);
        self.hashes.values().filter(|other| mix(hash, **other) > own).count() <= failures
    }
}

/// Which of two documents of one loop and window counts, where a split made two daemons compute it: that of the smaller
/// id. Documents without an id are from before there were any, and give way.
#[must_use]
pub fn prevails(one: Option<&str>, other: Option<&str>) -> bool {
    match (one, other) {
        (Some(one), Some(other)) => one <= other,
        (one, other) => one.is_some() || other.is_none(),
    }
}

/// Waits until the list of the living has been still for a while: a token that comes and goes moves no loop.
#[derive(Debug)]
pub struct Debounce {
    for_s: f64,
    alive: BTreeSet<String>,
    settled: Option<BTreeSet<String>>,
    changed_s: f64,
}

impl Debounce {
    /// Still for so many seconds.
    #[must_use]
    pub const fn new(for_s: f64) -> Self {
        Self { for_s, alive: BTreeSet::new(), settled: None, changed_s: 0.0 }
    }

    /// A daemon has come or gone, at a time that never goes back.
    pub fn tell(&mut self, id: &str, alive: bool, now_s: f64) {
        let changed = if alive { self.alive.insert(id.to_owned()) } else { self.alive.remove(id) };
        if changed {
            self.changed_s = now_s;
        }
    }

    /// Counts as a change, though the list is the same: the bus came back, and more may follow.
    pub const fn touch(&mut self, now_s: f64) {
        self.changed_s = now_s;
    }

    /// The list, once it is still and another than the last one that was given.
    pub fn settle(&mut self, now_s: f64) -> Option<Live> {
        let still = now_s - self.changed_s >= self.for_s;
        if !still || self.settled.as_ref() == Some(&self.alive) {
            return None;
        }
        self.settled = Some(self.alive.clone());
        Some(self.alive.iter().cloned().collect())
    }

    /// Seconds until it may be still; none where nothing has changed since the last list that was given.
    #[must_use]
    pub fn wait_s(&self, now_s: f64) -> Option<f64> {
        (self.settled.as_ref() != Some(&self.alive)).then(|| (self.changed_s + self.for_s - now_s).max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn names(n: usize) -> Vec<String> {
        (0..n).map(|k| format!("unit{}/FIC{k}", k % 7)).collect()
    }

    #[test]
    fn hashes_are_the_same_for_ever() {
        // printf FIC101 | sha256sum
        assert_eq!(stable_hash("FIC101"), 0x1ce1_dcce_f010_833b);
        assert_eq!(stable_hash(""), 0xe3b0_c442_98fc_1c14);
        assert_eq!(Shard::parse("2/3"), Shard::new(2, 3));
        for wrong in ["3/3", "0/0", "1", "a/2", "-1/2", "0/10001"] {
            assert_eq!(Shard::parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn every_loop_is_in_one_shard_and_shards_are_even() {
        let names = names(9000);
        for count in [1, 2, 3, 10] {
            let mut sizes = vec![0_usize; count as usize];
            for name in &names {
                let owners = (0..count).filter(|index| Shard::new(*index, count).unwrap().owns(name));
                let owners: Vec<u32> = owners.collect();
                assert_eq!(owners.len(), 1, "{name}");
                sizes[owners[0] as usize] += 1;
            }
            let even = 9000 / count as usize;
            assert!(sizes.iter().all(|size| size.abs_diff(even) < even / 5), "{sizes:?}");
        }
    }

    #[test]
    fn loops_are_spread_evenly_over_the_living() {
        let live: Live = ["a", "b", "c", "d", "e"].into_iter().collect();
        let names = names(10_000);
        let mut sizes = BTreeMap::new();
        names.iter().for_each(|name| *sizes.entry(live.owner(name).unwrap()).or_insert(0_usize) += 1);
        assert!(sizes.len() == 5 && sizes.values().all(|size| size.abs_diff(2000) < 200), "{sizes:?}");
        let heirs = |id| names.iter().filter(|name| live.may_inherit(id, name, 1)).count();
        assert!(heirs("a").abs_diff(4000) < 300, "{}", heirs("a"));
    }

    #[test]
    fn the_smaller_id_counts_and_a_known_one_before_none() {
        assert!(prevails(Some("a"), Some("b")) && !prevails(Some("b"), Some("a")) && prevails(Some("a"), Some("a")));
        assert!(prevails(Some("b"), None) && !prevails(None, Some("b")) && prevails(None, None));
    }

    #[test]
    fn a_token_that_flickers_moves_nothing() {
        let mut list = Debounce::new(1.0);
        list.tell("a", true, 0.0);
        assert_eq!((list.settle(0.5), list.wait_s(0.25)), (None, Some(0.75)));
        assert_eq!(list.settle(1.0).map(|live| live.ids().len()), Some(1));
        assert_eq!((list.settle(9.0), list.wait_s(9.0)), (None, None));
        list.tell("b", true, 10.0);
        list.tell("b", false, 10.9);
        assert_eq!(list.settle(12.0), None, "as it was");
        list.tell("b", true, 20.0);
        for k in 0..20 {
            list.tell("c", k % 2 == 0, 20.0 + 0.5 * f64::from(k));
        }
        assert_eq!(list.settle(29.9), None);
        assert_eq!(
            list.settle(30.6).map(|live| live.ids().map(str::to_owned).collect()),
            Some(vec!["a".to_owned(), "b".to_owned()])
        );
    }

    proptest! {
        #[test]
        fn each_loop_has_one_owner_and_only_a_lost_ones_loops_move(
            ids in proptest::collection::btree_set("[a-z0-9-]{1,12}", 1..9),
            loops in proptest::collection::btree_set("[A-Z]{2,4}[0-9]{1,5}(/[a-z]{1,3})?", 1..60),
            lost in any::<proptest::sample::Index>(),
        ) {
            let all: Live = ids.iter().cloned().collect();
            let lost = lost.get(&ids.iter().cloned().collect::<Vec<_>>()).clone();
            let rest: Live = ids.iter().filter(|id| **id != lost).cloned().collect();
            for name in &loops {
                let owners: Vec<&str> = all.ids().filter(|id| all.is_owner(id, name)).collect();
                prop_assert_eq!(owners.len(), 1);
                let (before, after) = (owners[0], rest.owner(name));
                // Read backwards: one that comes takes loops to itself and moves none between the others.
                if before == lost {
                    prop_assert_eq!(after.is_none(), rest.ids().len() == 0);
                    prop_assert!(after.is_none_or(|heir| all.may_inherit(heir, name, 1)));
                } else {
                    prop_assert_eq!(Some(before), after);
                }
            }
        }

        #[test]
        fn whoever_was_told_the_same_in_any_order_agrees(
            told in proptest::collection::vec(("[a-e]", any::<bool>()), 1..30),
        ) {
            let mut last = BTreeMap::new();
            let mut list = Debounce::new(2.0);
            for (k, (id, alive)) in told.iter().enumerate() {
                list.tell(id, *alive, k as f64);
                last.insert(id.clone(), *alive);
            }
            let alive: Live = last.into_iter().filter(|(_, alive)| *alive).map(|(id, _)| id).collect();
            prop_assert_eq!(list.settle(1000.0), Some(alive));
        }
    }
}
