//! Limits how much of the engine's queue each key may fill: [`SHARE`] times what is free at that moment (dynamic thresholds,
//! Choudhury and Hahne 1998). A single flooding key gets at most four fifths and leaves the rest to the others; several leave
//! each other less. All keys unknown to the engine count as one.

use std::collections::{HashMap, HashSet};
use std::hash::{BuildHasher, RandomState};
use std::sync::{Arc, Mutex, PoisonError, RwLock};

/// Multiple of the free room that one key may hold.
const SHARE: usize = 4;
/// The flow of all unknown keys.
const UNKNOWN: u64 = 0;

#[derive(Debug, Default)]
struct Inner {
    hasher: RandomState,
    known: RwLock<HashSet<u64>>,
    /// Waiting messages and bytes by flow, for flows with any.
    held: Mutex<HashMap<u64, [usize; 2]>>,
}

/// The flows of a queue; clones share them.
#[derive(Debug, Clone, Default)]
pub struct Shares(Arc<Inner>);

/// A message's part of its flow's share, which is returned on drop.
#[derive(Debug)]
pub struct Share {
    shares: Shares,
    flow: u64,
    bytes: usize,
}

impl Shares {
    fn hash(&self, key: &str) -> u64 {
        self.0.hasher.hash_one(key).max(UNKNOWN + 1)
    }

    /// Gives this key a separate share from now on.
    pub fn learn(&self, key: &str) {
        let hash = self.hash(key);
        self.0.known.write().unwrap_or_else(PoisonError::into_inner).insert(hash);
    }

    /// Counts this key among the unknown ones from now on.
    pub fn unlearn(&self, key: &str) {
        let hash = self.hash(key);
        self.0.known.write().unwrap_or_else(PoisonError::into_inner).remove(&hash);
    }

    /// A share for a message of this many bytes, given the free messages and bytes; `None` if its flow already holds its limit.
    #[must_use]
    pub fn take(&self, key: &str, bytes: usize, free: [usize; 2]) -> Option<Share> {
        let hash = self.hash(key);
        let known = self.0.known.read().unwrap_or_else(PoisonError::into_inner).contains(&hash);
        let flow = if known { hash } else { UNKNOWN };
        let mut held = self.0.held.lock().unwrap_or_else(PoisonError::into_inner);
        let of = held.get(&flow).copied().unwrap_or_default();
        if of.iter().zip(free).any(|(held, free)| *held > SHARE.saturating_mul(free)) {
            return None;
        }
        held.insert(flow, [of[0] + 1, of[1] + bytes]);
        Some(Share { shares: self.clone(), flow, bytes })
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        let mut held = self.shares.0.held.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(of) = held.get_mut(&self.flow) else { return };
        *of = [of[0] - 1, of[1] - self.bytes];
        if of[0] == 0 {
            held.remove(&self.flow);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fills a queue of 1,000 messages with these keys in turn; returns what each then holds.
    fn filled(shares: &Shares, keys: &[&str]) -> (Vec<usize>, Vec<Share>) {
        let mut held: Vec<Vec<Share>> = keys.iter().map(|_| Vec::new()).collect();
        for _ in 0..2000 {
            for (place, key) in keys.iter().enumerate() {
                let free = 1000 - held.iter().map(Vec::len).sum::<usize>();
                if free > 0 {
                    held[place].extend(shares.take(key, 10, [free, usize::MAX]));
                }
            }
        }
        (held.iter().map(Vec::len).collect(), held.into_iter().flatten().collect())
    }

    #[test]
    fn one_that_floods_leaves_room_and_strangers_are_one_flow() {
        let shares = Shares::default();
        shares.learn("a");
        let (held, waiting) = filled(&shares, &["a"]);
        assert!((790..=810).contains(&held[0]), "{held:?}");
        assert!(shares.take("b", 10, [200, 2000]).is_some());
        drop(waiting);
        assert!(shares.0.held.lock().unwrap().is_empty());
        let keys: Vec<String> = (0..500).map(|k| format!("x{k}")).collect();
        let (held, _waiting) = filled(&shares, &keys.iter().map(String::as_str).collect::<Vec<_>>());
        assert!((790..=810).contains(&held.iter().sum::<usize>()), "{held:?}");
        assert!(shares.take("x0", 10, [200, 2000]).is_none() && shares.take("a", 10, [200, 2000]).is_some());
    }

    #[test]
    fn bytes_count_as_messages_do() {
        let shares = Shares::default();
        shares.learn("a");
        let large = shares.take("a", 900, [1000, 1000]);
        assert!(
            large.is_some() && shares.take("a", 1, [999, 100]).is_none() && shares.take("b", 1, [999, 100]).is_some()
        );
    }
}
