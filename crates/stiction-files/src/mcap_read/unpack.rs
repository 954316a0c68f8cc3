//! Messages in file order; samples stored in columns come as if each were a message of its own.

use std::sync::Arc;

use super::super::columns::{self, Row};
use super::{Channel, Message, ReadError, RecordingReader};
use stiction::core::record::{Sample, Signal};
use stiction_engine::codec::{encode_recorded, topic};

/// One sample from a message of columns.
#[derive(Debug, Clone, Copy)]
pub struct RawSample<'a> {
    /// Channel number in this file.
    pub channel_id: u16,
    /// Description of the channel.
    pub channel: &'a Channel,
    /// The sample.
    pub sample: Sample,
    /// Arrival time, ns since 1970, to the millisecond.
    pub log_time_ns: i64,
}

/// The next item of a file.
#[derive(Debug, Clone, Copy)]
pub enum Item<'a> {
    /// A message.
    Message(Message<'a>),
    /// A sample from columns.
    Sample(RawSample<'a>),
}

impl<'a> Item<'a> {
    /// Channel number and description.
    #[must_use]
    pub const fn channel(&self) -> (u16, &'a Channel) {
        match self {
            Self::Message(message) => (message.channel_id, message.channel),
            Self::Sample(sample) => (sample.channel_id, sample.channel),
        }
    }
}

/// An unpacked message of columns.
#[derive(Default)]
pub(super) struct Unpacked {
    rows: Vec<Row>,
    next: usize,
    /// Channels named by rows, by number.
    series: Vec<Option<(Arc<Channel>, Signal)>>,
    /// The current sample as a message.
    json: Vec<u8>,
}

/// Where the next item is.
enum NextItem {
    Row(usize),
    Entry(usize),
}

impl RecordingReader {
    /// The next item in file order; `None` after the last. Faster for samples than [`RecordingReader::next_message`].
    ///
    /// # Errors
    /// [`ReadError::Io`] if the file cannot be read. Damage is not an error, see [`RecordingReader::end`].
    pub fn next_item(&mut self) -> Result<Option<Item<'_>>, ReadError> {
        let Some(place) = self.next_place()? else { return Ok(None) };
        Ok(match place {
            NextItem::Row(at) => self.sample_at(at).map(Item::Sample),
            NextItem::Entry(at) => self.message_at(at).map(Item::Message),
        })
    }

    /// The next message in file order; `None` after the last. Samples from columns come exactly as if each had been recorded
    /// as JSON.
    ///
    /// # Errors
    /// As [`RecordingReader::next_item`].
    pub fn next_message(&mut self) -> Result<Option<Message<'_>>, ReadError> {
        let Some(place) = self.next_place()? else { return Ok(None) };
        let at = match place {
            NextItem::Entry(at) => return Ok(self.message_at(at)),
            NextItem::Row(at) => at,
        };
        let mut json = std::mem::take(&mut self.unpacked.json);
        json.clear();
        self.sample_at(at).iter().for_each(|raw| encode_recorded(&raw.sample, &mut json));
        self.unpacked.json = json;
        Ok(self.sample_at(at).map(|RawSample { channel_id, channel, sample, log_time_ns }| Message {
            channel_id,
            channel,
            sequence: 0,
            log_time_ns: log_time_ns.max(0),
            publish_time_ns: sample.t_ns.max(0),
            data: &self.unpacked.json,
        }))
    }

    fn next_place(&mut self) -> Result<Option<NextItem>, ReadError> {
        loop {
            // A row without a channel has been taken out by `unpack`.
            if self.unpacked.next < self.unpacked.rows.len() {
                self.unpacked.next += 1;
                return Ok(Some(NextItem::Row(self.unpacked.next - 1)));
            }
            if self.next >= self.contents.entries.len() {
                self.fill()?;
            }
            let at = self.next;
            let Some(entry) = self.contents.entries.get(at) else { return Ok(None) };
            self.next += 1;
            if entry.channel.as_ref().is_none_or(|channel| channel.encoding != columns::ENCODING) {
                return Ok(Some(NextItem::Entry(at)));
            }
            self.unpack(at);
        }
    }

    fn message_at(&self, at: usize) -> Option<Message<'_>> {
        let entry = self.contents.entries.get(at)?;
        Some(Message {
            channel_id: entry.channel_id,
            channel: entry.channel.as_deref()?,
            sequence: entry.sequence,
            log_time_ns: super::signed(entry.log_time),
            publish_time_ns: super::signed(entry.publish_time),
            data: &self.contents.buffer[entry.start..entry.end],
        })
    }

    fn sample_at(&self, at: usize) -> Option<RawSample<'_>> {
        let Row { channel: channel_id, t_ns, arrival_ns, value, quality } = *self.unpacked.rows.get(at)?;
        let (channel, signal) = self.unpacked.series.get(usize::from(channel_id))?.as_ref()?;
        let sample = Sample { signal: *signal, t_ns, value, quality };
        Some(RawSample { channel_id, channel, sample, log_time_ns: arrival_ns })
    }

    /// Unpacks a message of columns. Rows of unknown channels are skipped and counted.
    fn unpack(&mut self, at: usize) {
        let mut rows = std::mem::take(&mut self.unpacked.rows);
        let entry = &self.contents.entries[at];
        let decoded = columns::decode(&self.contents.buffer[entry.start..entry.end], &mut rows);
        if let Err(error) = decoded {
            self.note(format!("damaged message of columns: {error}"));
        }
        rows.retain(|row| {
            let known = self.knows(row.channel);
            self.contents.orphans += u64::from(!known);
            known
        });
        (self.unpacked.rows, self.unpacked.next) = (rows, 0);
    }

    /// Whether a channel is known and carries a signal.
    fn knows(&mut self, id: u16) -> bool {
        let place = usize::from(id);
        if self.unpacked.series.get(place).is_some_and(Option::is_some) {
            return true;
        }
        if !self.contents.channels.contains_key(&id) {
            // Its record may have stood in a damaged chunk.
            self.use_index(0);
        }
        let signal = |channel: &Channel| Signal::from_name(topic::leaf(&channel.topic));
        let found = self.contents.channels.get(&id).and_then(|channel| Some((channel.clone(), signal(channel)?)));
        let known = found.is_some();
        if self.unpacked.series.len() <= place {
            self.unpacked.series.resize(place + 1, None);
        }
        self.unpacked.series[place] = found;
        known
    }
}
