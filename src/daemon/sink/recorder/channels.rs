//! Counts the channels of the open files at the engine's end, so that the next file can begin between two messages however many
//! wait for the disk.

use std::sync::Arc;

use super::{Item, MANY_CHANNELS, segment_of};

/// A loop's channels in the open file of its segment.
#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    /// Index of its name, since another loop may have had the handle before.
    name: usize,
    file: u32,
    /// The channels seen, as a bit set.
    seen: u32,
}

#[derive(Debug, Clone, Copy, Default)]
struct OpenFile {
    number: u32,
    channels: usize,
    is_full: bool,
}

/// The channels of all segments.
#[derive(Debug, Default)]
pub(super) struct Channels {
    slots: Vec<Slot>,
    files: Vec<OpenFile>,
}

impl Channels {
    /// Counts a message to be recorded; returns its segment if that now needs its next file.
    pub fn count(&mut self, item: &Item) -> Option<usize> {
        let (id, name, bit) = match item {
            Item::Open { segment, .. } => {
                let file = self.file(*segment);
                *file = OpenFile { number: file.number.wrapping_add(1), ..OpenFile::default() };
                return None;
            }
            Item::Raw { id, name, sample, .. } => (*id, name, sample.signal as u32),
            // Documents about several loops are few: the file's own count covers them.
            Item::Document { name, .. } if name.starts_with('@') => return None,
            Item::Document { id, name, kind, .. } => (*id, name, 8 + *kind as u32),
            Item::Close { .. } | Item::Configuration { .. } => return None,
        };
        let segment = segment_of(id);
        let number = self.file(segment).number;
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
        let file = self.file(segment);
        file.channels += 1;
        let is_full = file.channels >= MANY_CHANNELS;
        (is_full && !std::mem::replace(&mut file.is_full, is_full)).then_some(segment)
    }

    fn file(&mut self, segment: usize) -> &mut OpenFile {
        if self.files.len() <= segment {
            self.files.resize(segment + 1, OpenFile::default());
        }
        &mut self.files[segment]
    }
}
