//! A fixed part of all loops, for plants watched by several daemons: the loop's hash modulo the number of daemons.

use sha2::{Digest, Sha256};

/// A hash of a name that is the same on every machine and in every build, for ever: the first 8 bytes of SHA-256.
#[must_use]
pub fn stable_hash(name: &str) -> u64 {
    Sha256::digest(name.as_bytes()).iter().take(8).fold(0, |hash, byte| hash << 8 | u64::from(*byte))
}

/// One of a fixed number of parts of all loops.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Shard {
    index: u32,
    count: u32,
}

impl Default for Shard {
    fn default() -> Self {
        Self::WHOLE
    }
}

impl Shard {
    /// Most parts.
    pub const MOST: u32 = 10_000;
    /// The only part: all loops.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// Part `index`, from 0, of `count`; `None` if the index is out of range.
    #[must_use]
    pub const fn new(index: u32, count: u32) -> Option<Self> {
        if index < count && count <= Self::MOST { Some(Self { index, count }) } else { None }
    }

    /// Reads `INDEX/COUNT`.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let (index, count) = text.split_once('/')?;
        Self::new(index.trim().parse().ok()?, count.trim().parse().ok()?)
    }

    /// Its index, from 0.
    #[must_use]
    pub const fn index(self) -> u32 {
        self.index
    }

    /// Whether it contains all loops.
    #[must_use]
    pub const fn is_whole(self) -> bool {
        self.count == 1
    }

    /// Whether a loop belongs to it.
    #[must_use]
    pub fn owns(self, loop_name: &str) -> bool {
        self.is_whole() || stable_hash(loop_name) % u64::from(self.count) == u64::from(self.index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let names: Vec<String> = (0..9000).map(|n| format!("unit{}/FIC{n}", n % 7)).collect();
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
}
