//! A list of channels that stands outside the chunks, so that a damaged chunk does not take its channels along.

use std::collections::BTreeMap;

use mcap::records::Metadata;

use stiction_monitor::codec::topic::Kind;
use stiction_monitor::short_hash;

/// Name of the metadata records that hold it.
pub(super) const NAME: &str = "stictiond.channels";
/// Entry with the checksum of all others; metadata records have none of their own.
const CHECK: &str = "check";

/// Channels by number: kind and topic.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub(super) struct Roster(BTreeMap<String, String>);

impl Roster {
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub fn add(&mut self, id: u16, kind: Kind, topic: &str) {
        self.0.insert(id.to_string(), format!("{} {topic}", kind.name()));
    }

    /// The record to write.
    pub fn metadata(&self) -> Metadata {
        let mut metadata = self.0.clone();
        metadata.insert(CHECK.to_owned(), check_of(&self.0));
        Metadata { name: NAME.to_owned(), metadata }
    }

    /// Reads a record; `None` if it was changed.
    pub fn of(metadata: &BTreeMap<String, String>) -> Option<Self> {
        let mut entries = metadata.clone();
        let check = entries.remove(CHECK)?;
        (check == check_of(&entries)).then_some(Self(entries))
    }

    /// Every channel: number, kind, topic.
    pub fn channels(&self) -> impl Iterator<Item = (u16, Kind, &str)> {
        self.0.iter().filter_map(|(id, text)| {
            let (kind, topic) = text.split_once(' ')?;
            let kind = Kind::ALL.into_iter().find(|k| k.name() == kind)?;
            Some((id.parse().ok()?, kind, topic))
        })
    }
}

fn check_of(entries: &BTreeMap<String, String>) -> String {
    let text: String = entries.iter().map(|(id, text)| format!("{id} {text}\n")).collect();
    short_hash(text.as_bytes())
}
