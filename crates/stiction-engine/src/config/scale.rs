//! Several daemons on one plant: the identity of this one, and the loops that it watches. Not part of the hash, since every
//! daemon gives the same answer for a window.

use super::reader::TableReader;
use crate::shard::Shard;

/// `[daemon]`.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct Daemon {
    /// Name in documents and topics; empty: the id of its Zenoh session, new at each start.
    pub id: String,
}

/// Whether a text may be a daemon's id, or empty: one chunk of a key.
#[must_use]
pub fn is_id(text: &str) -> bool {
    text.len() <= 64 && text.chars().all(|c| c.is_ascii_alphanumeric() || "._-".contains(c))
}

pub(super) fn read_daemon(r: &mut TableReader<'_, '_>) -> Daemon {
    let Some((id, line)) = r.text("id") else { return Daemon::default() };
    if !is_id(&id) {
        r.refuse(line, "id", format!("{id:?} is not a valid name"), "use up to 64 letters, digits and . _ -");
    }
    Daemon { id }
}

pub(super) fn read_shard(r: &mut TableReader<'_, '_>) -> Shard {
    let most = u64::from(Shard::MOST);
    let index = r.integer("index", 0, 0, most - 1) as u32;
    let count = r.integer("count", 1, 1, most) as u32;
    Shard::new(index, count).unwrap_or_else(|| {
        let line = r.line();
        r.refuse(line, "index", format!("{index} must be less than count {count}"), "count parts from 0");
        Shard::WHOLE
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn faults_name_their_key_and_a_shard_does_not_change_the_hash() {
        let of = |text: &str| Config::parse(&format!("[site]\nprefix = \"p\"\n{text}"));
        let shard = of("[daemon]\nid = \"a-1\"\n[shard]\nindex = 2\ncount = 3\n").unwrap();
        assert_eq!((Some(shard.shard), of("").unwrap().shard), (Shard::new(2, 3), Shard::WHOLE));
        assert_eq!(shard.hash(), of("").unwrap().hash());
        for (wrong, key) in
            [("[daemon]\nid = \"a/b\"\n", "daemon.id"), ("[shard]\nindex = 3\ncount = 3\n", "shard.index")]
        {
            let faults = of(wrong).unwrap_err();
            assert_eq!(faults.iter().map(|fault| fault.key.as_str()).collect::<Vec<_>>(), [key]);
        }
    }
}
