//! Channels of the open files, counted at the engine's end: there the next file can begin between two messages, however many
//! wait for the disk.

use std::sync::Arc;

use super::{Item, MANY_CHANNELS, shard_of};

/// What a loop has in the open file of its shard.
#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    /// Where its name is: another loop may have had the handle before.
    name: usize,
    file: u32,
    /// Its channels, a bit each.
    seen: u32,
}

#[derive(Debug, Clone, Copy, Default)]
struct OpenFile {
    number: u32,
    channels: usize,
    is_full: bool,
}

/// The channels of all shards.
#[derive(Debug, Default)]
pub(super) struct Channels {
    slots: Vec<Slot>,
    files: Vec<OpenFile>,
}

impl Channels {
    /// Counts a message that is recorded; gives its shard where that needs its next file now.
    pub fn count(&mut self, item: &Item) -> Option<usize> {
        let (id, name, bit) = match item {
            Item::Open { shard, .. } => {
                let file = self.file(*shard);
                *file = OpenFile { number: file.number.wrapping_add(1), ..OpenFile::default() };
                return None;
            }
            Item::Raw { id, name, sample, .. } => (*id, name, sample.signal as u32),
            // Documents of many loops are few: the file itself knows.
            Item::Document { name, .. } if name.starts_with('@') => return None,
            Item::Document { id, name, kind, .. } => (*id, name, 8 + *kind as u32),
            Item::Close { .. } | Item::Configuration { .. } => return None,
        };
        let shard = shard_of(id);
        let number = self.file(shard).number;
        if self.slots.len() <= id.index() {
            self.slots.resize(id.index() + 1, Slot::default());
        }
        let slot = &mut self.slots[id.index()];
        let at = Arc::as_ptr(name).cast::<u8>().addr();
        if (slot.name, slot.file) != (at, number) {
            *slot = Slot { name: at, file: number, seen: 0 };
        }
        let seen = slot.seen | 1 << bit;
        if std::mem::replace(&mut slot.seen, seen) == seen {
            return None;
        }
        let file = self.file(shard);
        file.channels += 1;
        let is_full = file.channels >= MANY_CHANNELS;
        (is_full && !std::mem::replace(&mut file.is_full, is_full)).then_some(shard)
    }

    fn file(&mut self, shard: usize) -> &mut OpenFile {
        if self.files.len() <= shard {
            self.files.resize(shard + 1, OpenFile::default());
        }
        &mut self.files[shard]
    }
}
