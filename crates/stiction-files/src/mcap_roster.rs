//! A channel list outside the chunks, so that a damaged chunk does not lose its channels.

use std::collections::BTreeMap;

use mcap::records::Metadata;

use super::columns;
use stiction_engine::codec::topic::Kind;
use stiction_engine::short_hash;

/// Name of the metadata records with the list.
pub(super) const NAME: &str = "stictiond.channels";
/// Entry with the checksum of all others; metadata records have no checksum of their own.
const CHECK: &str = "check";

/// Word for columns in place of a kind's name.
const COLUMNS: &str = "columns";

/// What a listed channel contains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Listed {
    /// Messages of one kind, as JSON.
    Json(Kind),
    /// Samples of other channels.
    Columns,
}

impl Listed {
    /// The kind of a channel's messages; `None` for foreign channels, which are not listed.
    pub fn of(kind: Option<Kind>, encoding: &str) -> Option<Self> {
        kind.map(Self::Json).or_else(|| (encoding == columns::ENCODING).then_some(Self::Columns))
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Json(kind) => kind.name(),
            Self::Columns => COLUMNS,
        }
    }

    fn named(name: &str) -> Option<Self> {
        let kind = Kind::ALL.into_iter().find(|kind| kind.name() == name).map(Self::Json);
        kind.or_else(|| (name == COLUMNS).then_some(Self::Columns))
    }

    /// Kind and encoding of its messages.
    pub const fn parts(self) -> (Option<Kind>, &'static str) {
        match self {
            Self::Json(kind) => (Some(kind), "json"),
            Self::Columns => (None, columns::ENCODING),
        }
    }
}

/// Channels by number, with kind and topic.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub(super) struct Roster(BTreeMap<String, String>);

impl Roster {
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub fn add(&mut self, id: u16, holds: Listed, topic: &str) {
        self.0.insert(id.to_string(), format!("{} {topic}", holds.name()));
    }

    /// The record to write.
    pub fn metadata(&self) -> Metadata {
        let mut metadata = self.0.clone();
        metadata.insert(CHECK.to_owned(), check_of(&self.0));
        Metadata { name: NAME.to_owned(), metadata }
    }

    /// Reads a record; `None` if it was altered.
    pub fn of(metadata: &BTreeMap<String, String>) -> Option<Self> {
        let mut entries = metadata.clone();
        let check = entries.remove(CHECK)?;
        (check == check_of(&entries)).then_some(Self(entries))
    }

    /// Every channel: number, kind, topic.
    pub fn channels(&self) -> impl Iterator<Item = (u16, Listed, &str)> {
        self.0.iter().filter_map(|(id, text)| {
            let (name, topic) = text.split_once(' ')?;
            Some((id.parse().ok()?, Listed::named(name)?, topic))
        })
    }
}

fn check_of(entries: &BTreeMap<String, String>) -> String {
    let text: String = entries.iter().map(|(id, text)| format!("{id} {text}\n")).collect();
    short_hash(text.as_bytes())
}
