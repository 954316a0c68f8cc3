//! The recorder: writes raw samples and results to MCAP files, in the order in which the engine took them.
//!
//! Its thread reads a queue that is bounded in bytes. When the queue is full the engine waits a little, because a recording
//! with a gap cannot be replayed, but only while this thread takes items. It never waits for a disk that hangs: that costs
//! recordings, which are counted, but never alarms or estimates. Loops are distributed over parallel files, [`LOOPS_PER_FILE`]
//! to each; each such *segment* is a separate recording.

mod channels;
mod progress;
mod run;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender};

use crate::runtime::blocks::{self, BlockReceiver, BlockSender, Received};
use crate::runtime::clock::Clock;
use crate::runtime::cores::share;
use crate::runtime::faults::Faults;
use crate::runtime::metrics::Metrics;
use crate::runtime::queue::{Budget, Room};
use channels::Channels;
pub use progress::Progress;
pub use run::{Continued, RecordedConfig, RunInfo};
use stiction::core::record::{Sample, Signal};
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::config::Recording;
use stiction_engine::engine::LoopId;
use stiction_files::disk::Disk;
use stiction_files::{MAX_CHANNELS, RecordingFile, WriteError};

/// Bytes that may wait for the disk: what 100,000 loops send in a minute at one sample every 10 s.
pub const QUEUE_BYTES: usize = 256 << 20;
/// Number of messages that fit into that if they are samples.
pub const QUEUE: usize = QUEUE_BYTES / size_of::<(Item, Room)>();
/// Pause between checks for room.
const LOOK_AGAIN: Duration = Duration::from_millis(5);
/// Loops in one file: with at most ten channels a loop this stays within what a file may hold.
pub const LOOPS_PER_FILE: usize = 1000;
/// How long the engine waits for a place in the queue before it goes on without recording the item.
const PATIENCE: Duration = Duration::from_secs(2);
/// If items wait but none was taken for this long, the disk is reported as hanging.
const HANGS: Duration = Duration::from_secs(10);
/// If no item was taken for this long, the engine stops waiting for the thread.
const STANDS: Duration = Duration::from_millis(20);
/// Pause after a disk error before the next file is tried.
const RETRY: Duration = Duration::from_secs(5);

/// Memory of an open file's index at which the next file is begun: with a thousand loops at 1 Hz, after a quarter of an hour.
/// Without this limit an open file's memory grew by some 200 MB an hour.
const MAX_INDEX_BYTES: u64 = 64 << 20;

/// Channels in an open file at which the next one is begun, since the channels of loops that leave remain. The rest is a
/// reserve until the next file is open.
const MANY_CHANNELS: usize = MAX_CHANNELS / 5 * 4;
/// The same limit by the file's own count, in case the engine's count missed it.
const MOST_CHANNELS: usize = MAX_CHANNELS / 10 * 9;

/// An order from the engine to the recorder.
#[derive(Debug)]
pub enum Item {
    /// Close the segment's file, if one is open, and open the next one, which starts with these states.
    Open {
        /// The segment.
        segment: usize,
        /// Loop names and state documents.
        states: Vec<(Arc<str>, Vec<u8>)>,
    },
    /// Finish the segment's file: its loops have left, and no new file follows yet.
    Close {
        /// The segment.
        segment: usize,
    },
    /// Another configuration for the next files, with the limits of a file.
    Configuration {
        /// The configuration as the files record it.
        config: Box<RecordedConfig>,
        /// Size at which a file is closed.
        max_bytes: u64,
        /// Age at which it is closed.
        max_age: Duration,
    },
    /// A sample that the engine took.
    Raw {
        /// Its loop.
        id: LoopId,
        /// The loop's name.
        name: Arc<str>,
        /// The sample.
        sample: Sample,
        /// When it arrived, ns.
        arrival_ns: i64,
    },
    /// A document.
    Document {
        /// Its loop.
        id: LoopId,
        /// The loop's name.
        name: Arc<str>,
        /// Its kind.
        kind: Kind,
        /// Its JSON.
        json: Vec<u8>,
        /// Event time, ns.
        event_ns: i64,
    },
}

impl Item {
    /// Bytes that it occupies while it waits.
    fn bytes(&self) -> usize {
        let held = match self {
            Self::Open { states, .. } => states.iter().map(|(_, json)| json.len()).sum(),
            Self::Configuration { config, .. } => config.text.len() + config.loop_map.len() + config.origins.len(),
            Self::Raw { .. } | Self::Close { .. } => 0,
            Self::Document { json, .. } => json.len(),
        };
        size_of::<(Self, Room)>() + held
    }
}

/// The segment in which a loop is recorded.
#[must_use]
pub const fn segment_of(id: LoopId) -> usize {
    id.index() / LOOPS_PER_FILE
}

/// The engine's end of the recorder.
pub struct Recorder {
    queue: BlockSender<(Item, Room)>,
    budget: Budget,
    /// Segments that need a new file.
    pub rotations: Receiver<usize>,
    wanted: Sender<usize>,
    channels: Channels,
    metrics: Arc<Metrics>,
    clock: Clock,
    /// The queue was full for too long: nothing waits until half of it is free.
    overrun: bool,
    progress: Arc<Progress>,
    /// Number of items taken by the thread at the last look, and since when it has not changed.
    seen: (u64, Instant),
}

impl Recorder {
    /// Starts the thread, which finishes its files when the `Recorder` is dropped.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn start(
        run: RunInfo,
        settings: Recording,
        disk: Arc<dyn Disk>,
        metrics: Arc<Metrics>,
        faults: Arc<Faults>,
    ) -> std::io::Result<(Self, JoinHandle<()>)> {
        let (recorder, mut writer) = Self::pair(run, settings, (disk, Clock::system()), metrics, faults);
        let thread = std::thread::Builder::new().name("record".into()).spawn(move || writer.run_until_closed())?;
        Ok((recorder, thread))
    }

    /// Both ends without a thread: the caller decides when the other end works.
    #[must_use]
    pub fn pair(
        run: RunInfo,
        settings: Recording,
        (disk, clock): (Arc<dyn Disk>, Clock),
        metrics: Arc<Metrics>,
        faults: Arc<Faults>,
    ) -> (Self, Writer) {
        let (queue, items) = blocks::queue();
        let progress = Arc::<Progress>::default();
        let seen = (0, clock.now());
        let (wanted, rotations) = crossbeam_channel::unbounded();
        let writer = Writer {
            items,
            flush: Duration::from_secs_f64(settings.flush_s),
            flushed: clock.now(),
            disk,
            clock: clock.clone(),
            run,
            dir: PathBuf::from(&settings.dir),
            max_bytes: settings.max_bytes,
            max_age: Duration::from_secs_f64(settings.max_s),
            segments: Vec::new(),
            wanted: wanted.clone(),
            metrics: metrics.clone(),
            faults,
            lost: 0,
            last_arrival_ns: 0,
            progress: progress.clone(),
        };
        let budget = Budget::new(QUEUE_BYTES);
        let (channels, overrun) = (Channels::default(), false);
        (Self { queue, budget, rotations, wanted, channels, metrics, clock, overrun, progress, seen }, writer)
    }

    /// Hands one item over, waiting briefly for a place.
    pub fn record(&mut self, item: Item) {
        if let Some(segment) = self.channels.count(&item) {
            let _ = self.wanted.send(segment);
        }
        let mut left = self.put(item);
        if left.is_some() && !self.overrun {
            let until = self.clock.now() + PATIENCE;
            let ([mut taken, _], mut moved) = (self.progress.steps(), self.clock.now());
            while let Some(item) = left.take_if(|_| self.clock.now() < until && self.clock.since(moved) < STANDS) {
                self.clock.sleep(LOOK_AGAIN);
                let [now_taken, _] = self.progress.steps();
                if now_taken != taken {
                    (taken, moved) = (now_taken, self.clock.now());
                }
                left = self.put(item);
            }
        }
        if left.is_some() {
            if !self.overrun {
                tracing::error!("the recorder cannot keep up: recordings miss data until the disk answers again");
            }
            self.overrun = true;
            self.metrics.recording_lost.inc();
        } else if self.overrun && self.budget.used() < self.budget.limit() / 2 {
            self.overrun = false;
        }
    }

    /// Queues the item, or returns it if there is no room.
    fn put(&self, item: Item) -> Option<Item> {
        let Some(room) = self.budget.take(item.bytes()) else { return Some(item) };
        self.queue.put((item, room)).err().map(|(item, _)| item)
    }

    /// Progress of the writing end.
    #[must_use]
    pub fn progress(&self) -> Arc<Progress> {
        self.progress.clone()
    }

    /// Why the disk takes too little or nothing; `None` while it keeps up. Call it with each report of the daemon's health.
    pub fn stall(&mut self) -> Option<String> {
        let ([taken, _], now, waiting) = (self.progress.steps(), self.clock.now(), self.waiting());
        if waiting == 0 || taken != self.seen.0 {
            self.seen = (taken, now);
        }
        let hangs = self.clock.since(self.seen.1);
        if hangs >= HANGS {
            let s = hangs.as_secs();
            return Some(format!("the recording disk has not answered for {s} s; {waiting} messages wait for it"));
        }
        self.overrun
            .then(|| "the recorder cannot keep up: recordings miss data until the disk answers again".to_owned())
    }

    /// Number of waiting items.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.queue.waiting()
    }

    /// Bytes waiting, and their limit.
    #[must_use]
    pub fn bytes(&self) -> [usize; 2] {
        [self.budget.used(), self.budget.limit()]
    }
}

/// Name of a segment's fault.
fn fault_of(segment: usize) -> String {
    format!("recording s{segment}")
}

/// Topics by the loop's handle, with the name, since another loop may have had the handle before.
type Topics = BTreeMap<(u32, Kind, Option<Signal>), (Arc<str>, String)>;

/// One segment's open file.
struct Segment {
    file: Option<RecordingFile>,
    /// Messages in it.
    messages: u64,
    /// How many of them are not on disk yet.
    unflushed: u64,
    index: u32,
    previous: String,
    opened: Instant,
    /// When the engine was last asked for a new file.
    asked: Option<Instant>,
    retry_at: Option<Instant>,
    topics: Topics,
}

/// The end that writes, on the recorder's thread.
pub struct Writer {
    items: BlockReceiver<(Item, Room)>,
    flush: Duration,
    flushed: Instant,
    disk: Arc<dyn Disk>,
    clock: Clock,
    run: RunInfo,
    dir: PathBuf,
    max_bytes: u64,
    max_age: Duration,
    segments: Vec<Segment>,
    wanted: Sender<usize>,
    metrics: Arc<Metrics>,
    faults: Arc<Faults>,
    lost: u64,
    last_arrival_ns: i64,
    progress: Arc<Progress>,
}

impl Writer {
    fn run_until_closed(&mut self) {
        loop {
            let wait = self.flush.saturating_sub(self.clock.since(self.flushed));
            match self.items.take_within(wait) {
                Received::Item((item, room)) => {
                    self.take(item);
                    drop(room);
                }
                Received::Nothing => {}
                Received::End => break,
            }
            self.flush_in_time();
        }
        self.finish();
    }

    /// Writes what waits now, and flushes if it is time.
    pub fn turn(&mut self) {
        while let Received::Item((item, _room)) = self.items.take_within(Duration::ZERO) {
            self.take(item);
        }
        self.flush_in_time();
    }

    fn flush_in_time(&mut self) {
        if self.clock.since(self.flushed) >= self.flush {
            self.flush_and_rotate();
            self.flushed = self.clock.now();
        }
    }

    /// Finishes the open files on all cores: each needs its index written, and some disks serve several requests at once.
    pub fn finish(&mut self) {
        let files: Vec<_> = self.segments.iter_mut().map(|segment| Mutex::new((segment.file.take(), None))).collect();
        share(files.len(), &|index| {
            let mut place = files[index].lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(file) = place.0.take() {
                place.1 = Some(file.finish());
            }
            self.progress.finish_one();
        });
        for (index, place) in files.into_iter().enumerate() {
            match place.into_inner().unwrap_or_else(PoisonError::into_inner).1 {
                Some(Ok(_)) => self.closed(index),
                Some(Err(error)) => self.fail(index, &error.to_string()),
                None => {}
            }
        }
    }

    fn take(&mut self, item: Item) {
        self.progress.take_one();
        match item {
            Item::Open { segment, states } => self.open(segment, &states),
            Item::Close { segment } => self.close(segment),
            Item::Configuration { config, max_bytes, max_age } => {
                self.run.config = *config;
                (self.max_bytes, self.max_age) = (max_bytes, max_age);
            }
            Item::Raw { id, name, sample, arrival_ns } => {
                self.last_arrival_ns = arrival_ns;
                let write = |file: &mut RecordingFile, topic: &str| file.sample(topic, arrival_ns, &sample);
                self.write(id, &name, (Kind::of_signal(sample.signal), Some(sample.signal)), write);
            }
            Item::Document { id, name, kind, json, event_ns } => {
                // Documents result from samples, so they get the newest sample's arrival time, and stamps stay in order.
                let arrival = self.last_arrival_ns;
                let write = |file: &mut RecordingFile, topic: &str| file.write(topic, kind, arrival, event_ns, &json);
                self.write(id, &name, (kind, None), write);
                if kind == Kind::Alarm {
                    self.log_alarm(segment_of(id), event_ns, &json);
                }
            }
        }
    }

    /// Repeats an alarm in a form for viewers; not counted as a message.
    fn log_alarm(&mut self, index: usize, event_ns: i64, json: &[u8]) {
        let Some(file) = self.segments.get_mut(index).and_then(|segment| segment.file.as_mut()) else { return };
        match file.log_alarm(self.last_arrival_ns, event_ns, json) {
            Ok(()) | Err(WriteError::Full { .. }) => {}
            Err(error) => self.fail(index, &error.to_string()),
        }
    }

    fn write(
        &mut self,
        id: LoopId,
        name: &Arc<str>,
        what: (Kind, Option<Signal>),
        write: impl FnOnce(&mut RecordingFile, &str) -> Result<(), WriteError>,
    ) {
        let index = segment_of(id);
        let prefix = &self.run.prefix;
        let Some(segment) = self.segments.get_mut(index) else { return self.lose(1) };
        let Some(file) = &mut segment.file else { return self.lose(1) };
        let topic_of = || match what.1 {
            Some(signal) => topic::raw(prefix, name, signal),
            None => topic::result(prefix, name, what.0),
        };
        let known =
            segment.topics.entry((id.index() as u32, what.0, what.1)).or_insert_with(|| (name.clone(), topic_of()));
        if !Arc::ptr_eq(&known.0, name) {
            *known = (name.clone(), topic_of());
        }
        let written = write(file, &known.1);
        let has_many = file.channels() >= MOST_CHANNELS;
        match written {
            Ok(()) => {
                segment.messages += 1;
                segment.unflushed += 1;
            }
            // The file continues with the channels it has.
            Err(WriteError::Full { .. }) => self.lose(1),
            Err(error) => {
                self.lose(1);
                return self.fail(index, &error.to_string());
            }
        }
        if has_many {
            self.ask_for_next(index);
        }
    }

    /// Asks the engine for the segment's next file, and again after a while, in case the queue had no place for the answer.
    fn ask_for_next(&mut self, index: usize) {
        let Some(segment) = self.segments.get_mut(index) else { return };
        if segment.asked.is_none_or(|at| self.clock.since(at) > RETRY) {
            segment.asked = Some(self.clock.now());
            let _ = self.wanted.send(index);
        }
    }

    fn lose(&mut self, n: u64) {
        self.lost += n;
        self.metrics.recording_lost.inc_by(n);
    }

    fn fail(&mut self, index: usize, why: &str) {
        self.metrics.recording_errors.inc();
        let retry_s = RETRY.as_secs();
        self.faults.raise(&fault_of(index), format!("recording has stopped, tried again every {retry_s} s: {why}"));
        self.progress.fail(index, why);
        let Some(segment) = self.segments.get_mut(index) else { return };
        segment.file = None;
        segment.retry_at = Some(self.clock.now() + RETRY);
        // The open chunk never reached the disk, so its messages are lost.
        let unflushed = std::mem::take(&mut segment.unflushed);
        self.lose(unflushed);
    }

    /// Counts everything written since the last call as recorded.
    fn flushed(&mut self, index: usize) {
        if let Some(segment) = self.segments.get_mut(index) {
            self.metrics.recorded.inc_by(std::mem::take(&mut segment.unflushed));
        }
    }

    /// Notes that the segment's file is finished.
    fn closed(&mut self, index: usize) {
        self.flushed(index);
        self.progress.close(index);
    }

    fn open(&mut self, index: usize, states: &[(Arc<str>, Vec<u8>)]) {
        while self.segments.len() <= index {
            let before = self.run.continued.get(&self.segments.len());
            self.segments.push(Segment {
                file: None,
                messages: 0,
                unflushed: 0,
                index: 0,
                previous: before.map_or_else(String::new, |before| before.previous.clone()),
                opened: self.clock.now(),
                asked: None,
                retry_at: None,
                topics: BTreeMap::new(),
            });
        }
        self.close(index);
        let lost = self.metrics.recording_lost.get();
        let segment = &mut self.segments[index];
        let metadata = self.run.metadata(index, segment.index, &segment.previous, lost);
        let stem = self.run.stem(index, segment.index);
        self.progress.open(index, self.dir.join(format!("{stem}.mcap.part")));
        match RecordingFile::create_on(&self.disk, &self.dir, &stem, &metadata) {
            Ok(file) => {
                segment.file = Some(file);
                // The topics of loops that have left are not needed any more.
                segment.topics.clear();
                (segment.messages, segment.unflushed) = (0, 0);
                segment.previous = format!("{stem}.mcap");
                (segment.index, segment.opened) = (segment.index + 1, self.clock.now());
                (segment.asked, segment.retry_at) = (None, None);
                self.metrics.recording_files.inc();
            }
            Err(error) => return self.fail(index, &error.to_string()),
        }
        let at_ns = if self.last_arrival_ns == 0 { self.clock.now_ns() } else { self.last_arrival_ns };
        for (name, json) in states {
            let topic = topic::result(&self.run.prefix, name, Kind::State);
            let Some(file) = &mut self.segments[index].file else { return };
            if let Err(error) = file.write(&topic, Kind::State, at_ns, at_ns, json) {
                return self.fail(index, &error.to_string());
            }
        }
        // The states must survive a crash in the first second, or the next start would find none.
        let flushed = self.segments[index].file.as_mut().map_or(Ok(()), RecordingFile::flush);
        match flushed {
            Ok(()) => self.faults.clear(&fault_of(index)),
            Err(error) => self.fail(index, &error.to_string()),
        }
    }

    fn close(&mut self, index: usize) {
        let Some(file) = self.segments.get_mut(index).and_then(|s| s.file.take()) else { return };
        match file.finish() {
            Ok(_) => self.closed(index),
            Err(error) => self.fail(index, &error.to_string()),
        }
    }

    /// Flushes, and asks for a new file where one is full, too old or lost.
    fn flush_and_rotate(&mut self) {
        for index in 0..self.segments.len() {
            let segment = &mut self.segments[index];
            let retry = segment.retry_at.is_some_and(|at| self.clock.now() >= at);
            let (mut failure, mut gone, mut full) = (None, 0, false);
            if let Some(file) = &mut segment.file {
                // A file deleted while open still accepts bytes, which are then lost.
                if file.is_linked() {
                    match file.flush() {
                        Ok(()) => {
                            self.metrics.recorded.inc_by(std::mem::take(&mut segment.unflushed));
                        }
                        Err(error) => failure = Some(error.to_string()),
                    }
                } else {
                    // Messages already counted as recorded are lost with the file, so count them as lost.
                    gone = std::mem::take(&mut segment.messages) - segment.unflushed;
                    let all = gone + segment.unflushed;
                    failure = Some(format!("{}: was removed with {all} messages in it", file.part_path().display()));
                }
                let large = file.bytes_written() >= self.max_bytes || file.index_bytes() >= MAX_INDEX_BYTES;
                full = (large || self.clock.since(segment.opened) >= self.max_age) && failure.is_none();
            } else if retry {
                segment.retry_at = Some(self.clock.now() + RETRY);
                let _ = self.wanted.send(index);
            }
            if full {
                self.ask_for_next(index);
            }
            self.lose(gone);
            if let Some(why) = failure {
                self.fail(index, &why);
            }
            if gone > 0 {
                // The disk works: no need to wait.
                self.segments[index].retry_at = Some(self.clock.now());
            }
        }
    }
}

#[cfg(test)]
mod tests;
