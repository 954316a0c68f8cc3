//! Messages of a few topics from the recordings of a folder: newest file first, through each file's index, within a time
//! limit. For looking back, not for replay: a file that cannot be read is skipped.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Instant, SystemTime};

use mcap::sans_io::indexed_reader::{IndexedReadEvent, IndexedReader, IndexedReaderOptions, ReadOrder};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::{McapError, Summary};

use super::columns;
use super::mcap_index::MAX_RECORD;
use super::mcap_read::RecordingReader;
use super::run::FilePlace;
use stiction::core::record::{Sample, Signal};
use stiction_engine::codec::encode_recorded;
use stiction_engine::codec::topic::{self, Kind, Leaf, Topic};
use stiction_engine::engine::StateDocument;

/// Most time ranges cached by file and topic; when full, the cache is emptied.
const REMEMBERED: usize = 100_000;
/// Messages between checks of the clock.
const LOOK_EVERY: usize = 256;

/// Cached time ranges by file and topic.
type Ranges = HashMap<(PathBuf, String), Option<[i64; 2]>>;
/// Cached stamps by file and loop.
type Stamps = HashMap<(PathBuf, String), Option<i64>>;

/// Reads a folder of recordings.
#[derive(Debug)]
pub struct Archive {
    dir: PathBuf,
    prefix: String,
    /// First and last source time of a topic in a finished file, ns; `None` if the file has no such messages.
    ranges: Mutex<Ranges>,
    /// Greatest stamp of a loop before a file began, ns; `None` where the file does not say.
    before: Mutex<Stamps>,
}

/// One recorded message.
#[derive(Debug, Clone, Copy)]
pub struct RecordedMessage<'a> {
    /// Its topic.
    pub topic: &'a str,
    /// Its payload.
    pub data: &'a [u8],
    /// Source time, ns since 1970.
    pub t_ns: i64,
    /// Encoding of the payload, from the channel.
    pub encoding: &'a str,
}

/// A query.
#[derive(Debug, Clone)]
pub struct Wanted {
    /// Topics.
    pub topics: BTreeSet<String>,
    /// First and last source time, ns since 1970.
    pub range_ns: [i64; 2],
    /// When to give up.
    pub until: Instant,
}

/// Outcome of a query.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reach {
    /// The whole range was searched.
    All,
    /// The time limit was reached; the oldest messages are missing.
    Part,
}

/// A file cannot be read further. What it gave until then is kept.
#[derive(Debug, thiserror::Error)]
enum Broken {
    #[error(transparent)]
    Mcap(#[from] McapError),
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

impl Archive {
    /// The recordings of a folder whose topics have a prefix.
    #[must_use]
    pub fn new(dir: &Path, prefix: &str) -> Self {
        Self { dir: dir.to_owned(), prefix: prefix.to_owned(), ranges: Mutex::default(), before: Mutex::default() }
    }

    /// Prefix of every topic.
    #[must_use]
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Passes every matching message to `take`, newest file first and in file order within a file. Of a run it reads no file
    /// that began after all of the loop's stamps so far were before the range: older data may come later, newer never earlier.
    pub fn read(&self, wanted: &Wanted, take: &mut dyn FnMut(RecordedMessage<'_>)) -> Reach {
        let mut done = HashSet::new();
        for (path, open) in self.files() {
            if Instant::now() >= wanted.until {
                return Reach::Part;
            }
            let run = FilePlace::of(&path).map(|place| place.run_id);
            if run.as_ref().is_some_and(|run| done.contains(run)) {
                continue;
            }
            let is_before = |[_, last]: [i64; 2]| last < wanted.range_ns[0];
            match self.known(&path, wanted) {
                Some(None) => continue,
                Some(Some(range)) if is_before(range) => {
                    done.extend(run.filter(|_| self.begins_before(&path, wanted)));
                    continue;
                }
                Some(Some([first, _])) if first > wanted.range_ns[1] => continue,
                _ => {}
            }
            let mut seen = Seen::default();
            let read = if open {
                read_open(&path, wanted, &mut seen, take)
            } else {
                read_indexed(&path, wanted, &mut seen, take)
            };
            match read {
                Ok(Reach::Part) => return Reach::Part,
                Ok(Reach::All) if !open => self.remember(&path, wanted, &seen),
                Ok(Reach::All) => {}
                Err(error) => tracing::debug!(path = %path.display(), %error, "skipped a recording"),
            }
            if seen.range.is_some_and(is_before) {
                done.extend(run.filter(|_| self.begins_before(&path, wanted)));
            }
        }
        Reach::All
    }

    /// Whether every stamp of the loops in question was before the range when a file began, as far as the file tells.
    fn begins_before(&self, path: &Path, wanted: &Wanted) -> bool {
        let names = wanted.topics.iter().map(|topic| Topic::parse(Some(&self.prefix), topic).map(|t| t.loop_name));
        let Some(names) = names.collect::<Option<BTreeSet<&str>>>() else { return false };
        names.into_iter().all(|name| {
            let key = (path.to_owned(), name.to_owned());
            let known = self.before.lock().unwrap_or_else(PoisonError::into_inner).get(&key).copied();
            let greatest = known.unwrap_or_else(|| {
                let read = greatest_before(path, &self.prefix, name);
                let mut before = self.before.lock().unwrap_or_else(PoisonError::into_inner);
                if before.len() >= REMEMBERED {
                    before.clear();
                }
                before.insert(key, read);
                read
            });
            greatest.is_some_and(|t_ns| t_ns < wanted.range_ns[0])
        })
    }

    /// Recordings, newest first, and whether each is still being written.
    fn files(&self) -> Vec<(PathBuf, bool)> {
        let entries = fs::read_dir(&self.dir).into_iter().flatten().flatten();
        let mut files: Vec<(SystemTime, PathBuf, bool)> = entries
            .filter_map(|entry| {
                let name = entry.file_name().to_string_lossy().into_owned();
                let open = name.ends_with(".mcap.part");
                if !open && !name.ends_with(".mcap") {
                    return None;
                }
                // Whoever opens a pipe waits for its other end.
                let there = fs::metadata(entry.path()).ok().filter(fs::Metadata::is_file)?;
                Some((there.modified().ok()?, entry.path(), open))
            })
            .collect();
        files.sort_by(|a, b| b.cmp(a));
        files.into_iter().map(|(_, path, open)| (path, open)).collect()
    }

    /// The range over all topics, if every one is known.
    fn known(&self, path: &Path, wanted: &Wanted) -> Option<Option<[i64; 2]>> {
        let ranges = self.ranges.lock().unwrap_or_else(PoisonError::into_inner);
        let each = wanted.topics.iter().map(|topic| ranges.get(&(path.to_owned(), topic.clone())).copied());
        each.collect::<Option<Vec<_>>>().map(|all| all.into_iter().flatten().reduce(joined))
    }

    fn remember(&self, path: &Path, wanted: &Wanted, seen: &Seen) {
        let mut ranges = self.ranges.lock().unwrap_or_else(PoisonError::into_inner);
        if ranges.len() + wanted.topics.len() > REMEMBERED {
            ranges.clear();
        }
        for topic in &wanted.topics {
            ranges.insert((path.to_owned(), topic.clone()), seen.by_topic.get(topic).copied());
        }
    }
}

fn joined([a, b]: [i64; 2], [c, d]: [i64; 2]) -> [i64; 2] {
    [a.min(c), b.max(d)]
}

/// Source times seen in a file.
#[derive(Debug, Default)]
struct Seen {
    range: Option<[i64; 2]>,
    by_topic: HashMap<String, [i64; 2]>,
}

impl Seen {
    fn note(&mut self, topic: &str, t_ns: i64) {
        let at = [t_ns; 2];
        self.range = Some(self.range.map_or(at, |range| joined(range, at)));
        match self.by_topic.get_mut(topic) {
            Some(range) => *range = joined(*range, at),
            None => drop(self.by_topic.insert(topic.to_owned(), at)),
        }
    }

    fn take(&mut self, wanted: &Wanted, found: RecordedMessage<'_>, take: &mut dyn FnMut(RecordedMessage<'_>)) {
        self.note(found.topic, found.t_ns);
        let [from_ns, to_ns] = wanted.range_ns;
        if (from_ns..=to_ns).contains(&found.t_ns) {
            take(found);
        }
    }
}

/// The greatest stamp of a loop when a file began, from the states at its head.
fn greatest_before(path: &Path, prefix: &str, name: &str) -> Option<i64> {
    let mut reader = RecordingReader::open(path).ok()?;
    while let Some(message) = reader.next_message().ok()? {
        let Some(topic) = Topic::parse(Some(prefix), message.topic()) else { continue };
        if topic.leaf != Leaf::Document(Kind::State) {
            return None;
        }
        if topic.loop_name == name {
            let state: StateDocument = serde_json::from_slice(message.data).ok()?;
            return state.checkpoint.stream?.greatest_ns();
        }
    }
    None
}

/// A timestamp as the recorder writes it: 0 means none, then the arrival time counts.
fn stamp(publish: u64, log: u64) -> i64 {
    i64::try_from(if publish == 0 { log } else { publish }).unwrap_or(i64::MAX)
}

fn summary_of(file: &mut File) -> Result<Option<Summary>, Broken> {
    let mut reader =
        SummaryReader::new_with_options(SummaryReaderOptions::default().with_record_length_limit(MAX_RECORD));
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(need) => {
                let read = file.read(reader.insert(need))?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
        }
    }
    Ok(reader.finish())
}

fn read_indexed(
    path: &Path,
    wanted: &Wanted,
    seen: &mut Seen,
    take: &mut dyn FnMut(RecordedMessage<'_>),
) -> Result<Reach, Broken> {
    let mut file = File::open(path)?;
    let Some(summary) = summary_of(&mut file)? else { return read_open(path, wanted, seen, take) };
    // Without a topic of ours the reader would give every message.
    let ours = |channel: &mcap::Channel<'_>| wanted.topics.contains(&channel.topic);
    if !summary.channels.values().any(|channel| ours(channel)) {
        return Ok(Reach::All);
    }
    let sampled = |channel: &mcap::Channel<'_>| ours(channel) && channel.message_encoding == "json";
    let signal =
        |channel: &mcap::Channel<'_>| Signal::from_name(topic::leaf(&channel.topic)).filter(|_| sampled(channel));
    let signals: HashMap<u16, (&str, Signal)> =
        summary.channels.iter().filter_map(|(id, c)| Some((*id, (c.topic.as_str(), signal(c)?)))).collect();
    let columns = summary.channels.values().filter(|c| !signals.is_empty() && c.message_encoding == columns::ENCODING);
    let options = IndexedReaderOptions::new()
        .with_order(ReadOrder::File)
        .include_topics(wanted.topics.iter().cloned().chain(columns.map(|c| c.topic.clone())))
        .with_record_length_limit(MAX_RECORD);
    let mut reader = IndexedReader::new_with_options(&summary, options)?;
    let (mut chunk, mut rows, mut json) = (Vec::new(), Vec::new(), Vec::new());
    while let Some(event) = reader.next_event() {
        match event? {
            IndexedReadEvent::ReadChunkRequest { offset, length } => {
                if Instant::now() >= wanted.until {
                    return Ok(Reach::Part);
                }
                file.seek(SeekFrom::Start(offset))?;
                chunk.resize(length, 0);
                file.read_exact(&mut chunk)?;
                reader.insert_chunk_record_data(offset, &chunk)?;
            }
            IndexedReadEvent::Message { header, data } => {
                let Some(channel) = summary.channels.get(&header.channel_id) else { continue };
                if channel.message_encoding == columns::ENCODING {
                    // What cannot be read is left out, as where the file is read from its start.
                    let _ = columns::decode(data, &mut rows);
                    for row in &rows {
                        let Some((topic, signal)) = signals.get(&row.channel) else { continue };
                        let (t_ns, value, quality) = (row.t_ns, row.value, row.quality);
                        json.clear();
                        encode_recorded(&Sample { signal: *signal, t_ns, value, quality }, &mut json);
                        // As where each has a message: none stands before 1970.
                        let t_ns = if t_ns > 0 { t_ns } else { row.arrival_ns };
                        seen.take(wanted, RecordedMessage { topic, data: &json, t_ns, encoding: "json" }, take);
                    }
                    continue;
                }
                let (t_ns, encoding) = (stamp(header.publish_time, header.log_time), &*channel.message_encoding);
                seen.take(wanted, RecordedMessage { topic: &channel.topic, data, t_ns, encoding }, take);
            }
        }
    }
    Ok(Reach::All)
}

/// Reads a file without an index, such as the one being written, message by message.
fn read_open(
    path: &Path,
    wanted: &Wanted,
    seen: &mut Seen,
    take: &mut dyn FnMut(RecordedMessage<'_>),
) -> Result<Reach, Broken> {
    let failed = |error: super::ReadError| Broken::Io(std::io::Error::other(error.to_string()));
    let mut reader = RecordingReader::open(path).map_err(failed)?;
    let mut count = 0_usize;
    while let Some(message) = reader.next_message().map_err(failed)? {
        count += 1;
        if count.is_multiple_of(LOOK_EVERY) && Instant::now() >= wanted.until {
            return Ok(Reach::Part);
        }
        if wanted.topics.contains(message.topic()) {
            let t_ns = if message.publish_time_ns == 0 { message.log_time_ns } else { message.publish_time_ns };
            let found = RecordedMessage {
                topic: message.topic(),
                data: message.data,
                t_ns,
                encoding: &message.channel.encoding,
            };
            seen.take(wanted, found, take);
        }
    }
    Ok(Reach::All)
}

/// An archive shared by several users.
pub type SharedArchive = Arc<Archive>;

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn recordings() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../recordings")
    }

    fn topics(of: &[&str]) -> BTreeSet<String> {
        of.iter().map(|t| (*t).to_owned()).collect()
    }

    fn all(archive: &Archive, topic: &str, range_ns: [i64; 2]) -> (Reach, Vec<(i64, Vec<u8>)>) {
        let until = Instant::now() + Duration::from_secs(60);
        let wanted = Wanted { topics: topics(&[topic]), range_ns, until };
        let mut found = Vec::new();
        let reach = archive.read(&wanted, &mut |f| found.push((f.t_ns, f.data.to_vec())));
        (reach, found)
    }

    #[test]
    fn the_index_gives_what_reading_message_by_message_gives() {
        let file = recordings().join("sticking.mcap");
        let mut reader = RecordingReader::open(&file).unwrap();
        let prefix = reader.metadata().get("prefix").unwrap().clone();
        let mut plain: HashMap<String, Vec<(i64, Vec<u8>)>> = HashMap::new();
        while let Some(m) = reader.next_message().unwrap() {
            plain.entry(m.topic().to_owned()).or_default().push((m.publish_time_ns, m.data.to_vec()));
        }
        let dir = tempfile::tempdir().unwrap();
        fs::copy(&file, dir.path().join("a.mcap")).unwrap();
        let archive = Archive::new(dir.path(), &prefix);
        for (topic, messages) in &plain {
            assert_eq!(all(&archive, topic, [i64::MIN, i64::MAX]), (Reach::All, messages.clone()), "{topic}");
            // Asked again it knows where the topic lies, and gives the same.
            let (first, last) = (messages[0].0, messages[messages.len() - 1].0);
            let middle = [first + (last - first) / 4, first + (last - first) / 2];
            let part: Vec<_> = messages.iter().filter(|m| (middle[0]..=middle[1]).contains(&m.0)).cloned().collect();
            assert_eq!(all(&archive, topic, middle).1, part, "{topic}");
            assert!(all(&archive, topic, [last + 1, i64::MAX]).1.is_empty());
        }
        assert!(plain.len() > 2 && all(&archive, "no/such/topic", [0, i64::MAX]).1.is_empty());
    }

    #[test]
    fn a_file_that_is_cut_off_gives_what_it_holds_and_one_that_is_none_is_passed_over() {
        let bytes = fs::read(recordings().join("sticking.mcap")).unwrap();
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("cut.mcap.part"), &bytes[..bytes.len() / 2]).unwrap();
        fs::write(dir.path().join("torn.mcap"), &bytes[..bytes.len() / 3]).unwrap();
        fs::write(dir.path().join("none.mcap"), b"no recording at all").unwrap();
        let reader = RecordingReader::open(&dir.path().join("cut.mcap.part")).unwrap();
        let prefix = reader.metadata().get("prefix").unwrap().clone();
        let archive = Archive::new(dir.path(), &prefix);
        let loops = super::super::load_samples(&dir.path().join("cut.mcap.part")).unwrap().loops;
        let topic = stiction_engine::codec::topic::raw(&prefix, &loops[0].name, stiction::core::record::Signal::Pv);
        let (reach, found) = all(&archive, &topic, [i64::MIN, i64::MAX]);
        assert_eq!(reach, Reach::All);
        assert!(found.len() > 100, "{}", found.len());
    }

    /// A file of a run, with the loop's greatest stamp so far at its head and a PV a second.
    fn write_file(dir: &Path, run: &str, index: u32, before_s: Option<i64>, stamps_s: std::ops::Range<i64>) {
        const S: i64 = 1_000_000_000;
        let metadata = [("prefix", "p"), ("run_id", run)].map(|(k, v)| (k.to_owned(), v.to_owned()));
        let stem = format!("p-20260101-{run}-s0-{index:05}");
        let mut file = crate::RecordingFile::create(dir, &stem, &metadata.into_iter().collect()).unwrap();
        if let Some(before_s) = before_s {
            let mut engine =
                stiction_engine::engine::Engine::new(stiction_engine::config::Config::with_prefix("p").engine());
            let id = engine.appear("A").unwrap();
            for signal in [Signal::Op, Signal::Pv] {
                let value = stiction::core::record::Value::Number(1.0);
                engine.push(id, Sample { signal, t_ns: before_s * S, value, quality: None }, &mut Vec::new());
            }
            let state = StateDocument::new("A", None, engine.checkpoint(id));
            let topic = topic::result("p", "A", Kind::State);
            file.write(&topic, Kind::State, 1, 1, &serde_json::to_vec(&state).unwrap()).unwrap();
        }
        for t_s in stamps_s {
            let value = stiction::core::record::Value::Number(t_s as f64);
            let sample = Sample { signal: Signal::Pv, t_ns: t_s * S, value, quality: None };
            file.sample(&topic::raw("p", "A", Signal::Pv), t_s * S, &sample).unwrap();
        }
        file.finish().unwrap();
        // Files of equal times would be sorted by name.
        let at = SystemTime::UNIX_EPOCH + Duration::from_secs(u64::from(index) + if run == "new" { 100 } else { 1 });
        File::options().write(true).open(dir.join(format!("{stem}.mcap"))).unwrap().set_modified(at).unwrap();
    }

    #[test]
    fn older_data_that_came_later_hide_no_newer_ones_and_what_lies_before_them_is_not_read() {
        let dir = tempfile::tempdir().unwrap();
        write_file(dir.path(), "old", 0, None, 5000..5100);
        write_file(dir.path(), "new", 0, None, 1000..1100);
        write_file(dir.path(), "new", 1, Some(1099), 1100..1200);
        // What was kept back for a day came last.
        write_file(dir.path(), "new", 2, Some(1199), 100..200);
        let archive = Archive::new(dir.path(), "p");
        let count = |from_s: i64, to_s: i64| {
            let (reach, found) = all(&archive, "p/A/pv", [from_s, to_s].map(|s| s * 1_000_000_000));
            (reach, found.len())
        };
        for _ in 0..2 {
            assert_eq!(count(1150, 1199), (Reach::All, 50), "behind a file with older data");
            assert_eq!(count(150, 1150), (Reach::All, 50 + 100 + 51));
            assert_eq!(count(5050, 9999), (Reach::All, 50), "of a run whose clock was ahead");
        }
        // Before the file that begins with 1099 none of the run can hold later stamps: it is not read.
        let first = dir.path().join("p-20260101-new-s0-00000.mcap");
        std::fs::write(&first, b"no longer a recording").unwrap();
        let fresh = Archive::new(dir.path(), "p");
        assert_eq!(all(&fresh, "p/A/pv", [1_300_000_000_000, 1_400_000_000_000]), (Reach::All, Vec::new()));
        let read: BTreeSet<String> =
            fresh.ranges.lock().unwrap().keys().map(|(path, _)| path.display().to_string()).collect();
        assert_eq!(read.len(), 2, "{read:?}");
    }

    #[cfg(unix)]
    #[test]
    fn a_pipe_under_the_name_of_a_recording_is_passed_over() {
        let dir = tempfile::tempdir().unwrap();
        write_file(dir.path(), "new", 0, None, 1..11);
        let made = std::process::Command::new("mkfifo").arg(dir.path().join("b.mcap")).status().unwrap();
        assert!(made.success());
        fs::create_dir(dir.path().join("c.mcap")).unwrap();
        let archive = Archive::new(dir.path(), "p");
        assert_eq!(all(&archive, "p/A/pv", [i64::MIN, i64::MAX]).1.len(), 10);
    }

    #[test]
    fn time_that_is_over_ends_it() {
        let archive = Archive::new(&recordings(), "plant");
        let wanted = Wanted { topics: topics(&["x"]), range_ns: [0, 1], until: Instant::now() };
        assert_eq!(archive.read(&wanted, &mut |_| {}), Reach::Part);
    }
}
