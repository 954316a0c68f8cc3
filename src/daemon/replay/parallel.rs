//! Replays a file on all cores. A loop's answers depend on its channel alone, so the loops are distributed over lanes, each
//! with a separate engine. One thread reads ahead, the lanes process a block of messages in parallel, and their outputs are
//! then put into the order of the messages. The bytes are therefore those of a single engine that takes one message after the
//! other.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use anyhow::{Context, anyhow, bail};

use crate::daemon::received;
use crate::daemon::replay::plant::ReplayPlant;
use crate::daemon::replay::{Output, PlantEvent, Replay};
use crate::runtime::cores::share;
use stiction::core::record::Sample;
use stiction::core::verdict::EstimateDocument;
use stiction_engine::codec::topic::{Kind, Leaf, Topic};
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, EngineSettings, Origins};
use stiction_engine::shard::stable_hash;
use stiction_files::run::{ORIGINS, RunMetadata};
use stiction_files::{Channel, End, Item, RecordingReader};

/// Number of lanes, many more than cores so that one busy loop holds up few others. Results do not depend on it.
const LANES: usize = 64;
/// Messages in a block: with the block read ahead, some hundred megabytes.
const BLOCK: usize = 400_000;
/// Bytes of documents in a block.
const BLOCK_BYTES: usize = 64 << 20;

/// Parallel engines fed with recorded messages.
pub struct ParallelReplay {
    lanes: Vec<Mutex<Replay>>,
    settings: EngineSettings,
    /// Whether to judge files again from their samples and commands alone.
    judging: bool,
    /// Whether to keep the settings whatever the files were recorded under.
    fixed: bool,
    /// Arrival time of each loop's last sample, ns.
    heard_ns: BTreeMap<String, i64>,
    /// When the caller stops waiting.
    until: Option<Instant>,
    plant: ReplayPlant,
}

/// Last sign of life of a loop.
#[derive(Debug, Default)]
pub struct LastSeen {
    /// Its newest recorded answer.
    pub estimate: Option<Box<EstimateDocument>>,
    /// When a sample of it arrived last, ns.
    pub heard_ns: Option<i64>,
}

/// Result of replaying one file.
#[derive(Debug, Default)]
pub struct FileReport {
    /// Documents produced from its messages.
    pub outputs: Vec<Output>,
    /// Number of documents compared with recorded ones.
    pub compared: usize,
    /// Groups not compared, since they include loops of other files or windows from before the first file.
    pub unchecked: usize,
    /// The first difference.
    pub difference: Option<String>,
    /// Why the file is incomplete, if it is.
    pub cut: Option<String>,
}

/// Content of a message.
enum Held {
    Sample(Sample),
    /// Range in the block's bytes.
    Bytes(std::ops::Range<usize>),
}

/// One message on its way to its lane.
struct Step {
    /// `None` if it concerns several loops.
    lane: Option<usize>,
    /// Index of its topic in the file's list of topics.
    topic: usize,
    held: Held,
}

/// Messages processed together.
#[derive(Default)]
struct Block {
    steps: Vec<Step>,
    bytes: Vec<u8>,
    /// Topics that are new since the previous block.
    topics: Vec<String>,
}

/// A lane's output for a block: documents, each with the index of the message that caused it.
#[derive(Default)]
struct Made {
    outputs: Vec<(usize, Output)>,
    for_plant: Vec<(usize, PlantEvent)>,
    failed: Option<(usize, anyhow::Error)>,
}

/// The comparison of one file so far.
struct Comparing<'a> {
    verify: bool,
    plant: &'a mut ReplayPlant,
    made: HashMap<(String, Kind), VecDeque<Vec<u8>>>,
    report: FileReport,
}

impl ParallelReplay {
    /// A replay under this configuration until a file has another one, with this daemon id. `at_once` is for recordings without
    /// results.
    #[must_use]
    pub fn new(config: &Config, daemon: Option<&str>, at_once: bool) -> Self {
        let settings = EngineSettings { daemon: daemon.map(Into::into), ..config.engine() };
        let lane = |_| Mutex::new(Replay::new(settings.clone(), at_once));
        let lanes = (0..LANES).map(lane).collect();
        let plant = ReplayPlant::new(settings.daemon.as_deref());
        Self { lanes, settings, judging: false, fixed: false, heard_ns: BTreeMap::new(), until: None, plant }
    }

    /// A replay of the streams alone, up to this moment: after it [`ParallelReplay::file`] fails.
    #[must_use]
    pub fn of_streams(config: &Config, until: Instant) -> Self {
        let mut rerun = Self { until: Some(until), ..Self::new(config, None, false) };
        rerun.each(|replay| replay.set_streams_alone(true));
        rerun
    }

    /// Judges files again from their samples and commands alone, starting with empty windows: under this configuration if
    /// `fixed`, else under the ones that the files were recorded under.
    #[must_use]
    pub fn judging(config: &Config, fixed: bool) -> Self {
        let mut rerun = Self { judging: true, fixed, ..Self::new(config, None, true) };
        rerun.each(|replay| {
            replay.set_judging(true);
            replay.set_diagnose(false);
        });
        rerun
    }

    /// Last sign of life of each loop, if only streams are replayed.
    pub fn take_last(&mut self) -> BTreeMap<String, LastSeen> {
        let mut last: BTreeMap<String, LastSeen> = BTreeMap::new();
        for (name, heard_ns) in std::mem::take(&mut self.heard_ns) {
            last.entry(name).or_default().heard_ns = Some(heard_ns);
        }
        self.each(|replay| {
            for (name, json) in replay.take_newest() {
                let read = serde_json::from_slice(&json).ok().and_then(|document| received::estimate(&document));
                last.entry(name).or_default().estimate = read.map(Box::new);
            }
        });
        last
    }

    /// The engines in their current state.
    pub fn into_engines(self) -> impl Iterator<Item = Engine> {
        self.lanes.into_iter().map(|lane| lane.into_inner().unwrap_or_else(PoisonError::into_inner).into_engine())
    }

    fn each(&mut self, mut change: impl FnMut(&mut Replay)) {
        self.lanes.iter_mut().for_each(|lane| change(lane.get_mut().unwrap_or_else(PoisonError::into_inner)));
    }

    /// Whether to compute the gap diagnoses of the following files again, or only to keep track of their places.
    pub fn set_diagnose(&mut self, diagnose: bool) {
        self.each(|replay| replay.set_diagnose(diagnose));
    }

    /// Processes a whole file. With `verify`, every estimate, alarm and gap is compared with the recorded one.
    ///
    /// # Errors
    /// The file cannot be read, or a message does not match its topic.
    pub fn file(&mut self, path: &Path, prefix: &str, first: bool, verify: bool) -> anyhow::Result<FileReport> {
        let mut reader = RecordingReader::open(path)?;
        let begins_run = reader.metadata().get("file_index").is_some_and(|index| index == "0");
        self.follow(reader.metadata(), path, first, begins_run)?;
        let (everything, until) = (first || begins_run, self.until);
        let Self { lanes, plant, heard_ns, .. } = self;
        let lanes = &lanes[..];
        let mut comparing = Comparing { verify, plant, made: HashMap::new(), report: FileReport::default() };
        std::thread::scope(|scope| {
            let (send, blocks) = crossbeam_channel::bounded(1);
            let reading = scope.spawn(move || read(&mut reader, prefix, heard_ns, &send).map(|()| reader));
            let mut topics: Vec<String> = Vec::new();
            for mut block in &blocks {
                topics.append(&mut block.topics);
                let made = run_block(lanes, &block, (&topics, prefix), everything);
                comparing.take(made, &block, (&topics, prefix), path)?;
                if until.is_some_and(|until| Instant::now() >= until) {
                    bail!("{}: reading it took too long", path.display());
                }
            }
            let reader = reading.join().map_err(|_| anyhow!("{}: internal error while reading", path.display()))??;
            Ok(comparing.close(reader.end()))
        })
    }
}

impl ParallelReplay {
    /// Adopts the configuration that a file was recorded under. Within a run it changes after an edit.
    fn follow(
        &mut self,
        metadata: &BTreeMap<String, String>,
        path: &Path,
        first: bool,
        begins_run: bool,
    ) -> anyhow::Result<()> {
        if self.fixed {
            return Ok(());
        }
        let recorded: Option<Origins> = metadata.get(ORIGINS).and_then(|json| serde_json::from_str(json).ok());
        let is_same = metadata.get("config_hash").filter(|hash| !hash.is_empty()).is_none_or(|hash| {
            let origins = recorded.unwrap_or_else(|| Origins::new(hash));
            **hash == *self.settings.config_hash && origins == self.settings.origins
        });
        if !is_same {
            let daemon = self.settings.daemon.clone();
            self.settings = EngineSettings { daemon, ..RunMetadata::of(path, metadata)?.engine() };
        }
        let settings = self.settings.clone();
        if begins_run && !first && !self.judging {
            self.each(|replay| replay.begin_run(settings.clone()));
            self.plant = ReplayPlant::new(settings.daemon.as_deref());
        } else if first && !is_same {
            self.each(|replay| replay.begin(settings.clone()));
        } else if !is_same {
            self.each(|replay| replay.edit(settings.clone()));
        }
        Ok(())
    }
}

/// Reads a file to the end, block by block; ends early if the receiver is gone.
fn read(
    reader: &mut RecordingReader,
    prefix: &str,
    heard_ns: &mut BTreeMap<String, i64>,
    send: &crossbeam_channel::Sender<Block>,
) -> anyhow::Result<()> {
    // Lane and topic of each channel; `None` if the channel is not ours.
    let mut routes: HashMap<u16, Option<(Option<usize>, usize)>> = HashMap::new();
    let (mut block, mut topics) = (Block::default(), 0);
    // By channel, for raw signals only.
    let mut heard: HashMap<u16, (String, i64)> = HashMap::new();
    while let Some(item) = reader.next_item()? {
        let (id, channel) = item.channel();
        let route = *routes.entry(id).or_insert_with(|| {
            let topic = Topic::parse(Some(prefix), &channel.topic)?;
            if topic.is_of_plant() {
                block.topics.push(channel.topic.clone());
                topics += 1;
                return Some((None, topics - 1));
            }
            // By name, so that a loop stays in its lane when another run follows.
            let lane = Some(stable_hash(topic.loop_name) as usize % LANES);
            block.topics.push(channel.topic.clone());
            topics += 1;
            Some((lane, topics - 1))
        });
        let Some((lane, topic)) = route else { continue };
        let held = match item {
            Item::Sample(raw) => {
                note(&mut heard, prefix, (id, channel), raw.log_time_ns);
                Held::Sample(raw.sample)
            }
            Item::Message(message) => {
                if channel.kind.is_some_and(Kind::is_raw) {
                    note(&mut heard, prefix, (id, channel), message.log_time_ns);
                }
                let from = block.bytes.len();
                block.bytes.extend_from_slice(message.data);
                Held::Bytes(from..block.bytes.len())
            }
        };
        block.steps.push(Step { lane, topic, held });
        let is_full = block.steps.len() >= BLOCK || block.bytes.len() >= BLOCK_BYTES;
        if is_full && send.send(std::mem::take(&mut block)).is_err() {
            return Ok(());
        }
    }
    let _ = send.send(block);
    for (name, at_ns) in heard.into_values() {
        let newest = heard_ns.entry(name).or_insert(at_ns);
        *newest = at_ns.max(*newest);
    }
    Ok(())
}

/// Notes that a sample of a channel's loop arrived.
fn note(heard: &mut HashMap<u16, (String, i64)>, prefix: &str, (id, channel): (u16, &Channel), at_ns: i64) {
    let name = || Topic::parse(Some(prefix), &channel.topic).map_or("", |topic| topic.loop_name).to_owned();
    heard.entry(id).or_insert_with(|| (name(), at_ns)).1 = at_ns;
}

/// Processes a block, all lanes in parallel.
fn run_block(
    lanes: &[Mutex<Replay>],
    block: &Block,
    (topics, prefix): (&[String], &str),
    everything: bool,
) -> Vec<Made> {
    let mut shares: Vec<Vec<usize>> = vec![Vec::new(); lanes.len()];
    for (at, step) in block.steps.iter().enumerate() {
        if let Some(lane) = step.lane {
            shares[lane].push(at);
        }
    }
    let parsed: Vec<Option<Topic<'_>>> = topics.iter().map(|topic| Topic::parse(Some(prefix), topic)).collect();
    let made: Vec<Mutex<Made>> = lanes.iter().map(|_| Mutex::default()).collect();
    share(lanes.len(), &|lane| {
        let mut replay = lanes[lane].lock().unwrap_or_else(PoisonError::into_inner);
        let mut made = made[lane].lock().unwrap_or_else(PoisonError::into_inner);
        let mut fresh = Vec::new();
        for at in &shares[lane] {
            let step = &block.steps[*at];
            let Some(topic) = &parsed[step.topic] else { continue };
            if let Err(error) = take(&mut replay, topic, block.held(step), everything, &mut fresh) {
                made.failed = Some((*at, error.context(topic.to_string())));
                return;
            }
            made.outputs.extend(fresh.drain(..).map(|output| (*at, output)));
            made.for_plant.extend(replay.drain_for_plant().map(|event| (*at, event)));
        }
    });
    made.into_iter().map(|made| made.into_inner().unwrap_or_else(PoisonError::into_inner)).collect()
}

/// A message in the form that its lane takes.
enum Taken<'a> {
    Sample(Sample),
    Bytes(&'a [u8]),
}

impl Block {
    fn held(&self, step: &Step) -> Taken<'_> {
        match &step.held {
            Held::Sample(sample) => Taken::Sample(*sample),
            Held::Bytes(range) => Taken::Bytes(&self.bytes[range.clone()]),
        }
    }
}

fn take(
    replay: &mut Replay,
    topic: &Topic<'_>,
    taken: Taken<'_>,
    everything: bool,
    out: &mut Vec<Output>,
) -> anyhow::Result<()> {
    let data = match taken {
        Taken::Sample(sample) => {
            replay.take_sample(topic.loop_name, sample, out);
            return Ok(());
        }
        Taken::Bytes(data) => data,
    };
    if topic.leaf != Leaf::Document(Kind::State) {
        return replay.take(topic, data, out);
    }
    if is_head(data) { replay.take_head(data, everything) } else { Ok(()) }
}

/// Whether a recorded state is the initial one of a file or of a loop in it.
fn is_head(state: &[u8]) -> bool {
    #[derive(serde::Deserialize)]
    struct After {
        window_end_ns: Option<i64>,
    }
    serde_json::from_slice::<After>(state).is_ok_and(|after| after.window_end_ns.is_none())
}

impl Comparing<'_> {
    /// Puts the lanes' outputs into the order of the messages, and compares.
    fn take(
        &mut self,
        made: Vec<Made>,
        block: &Block,
        (topics, prefix): (&[String], &str),
        path: &Path,
    ) -> anyhow::Result<()> {
        let (mut outputs, mut for_plant) = (Vec::new(), Vec::new());
        let mut failed: Option<(usize, anyhow::Error)> = None;
        for lane in made {
            outputs.extend(lane.outputs);
            for_plant.extend(lane.for_plant);
            failed = match (failed, lane.failed) {
                (Some(a), Some(b)) => Some(if a.0 < b.0 { a } else { b }),
                (a, b) => a.or(b),
            };
        }
        if let Some((_, error)) = failed {
            return Err(error).with_context(|| path.display().to_string());
        }
        // Each lane is sorted already, and only one lane has outputs of a given message, so a stable sort is enough.
        outputs.sort_by_key(|(at, _)| *at);
        for_plant.sort_by_key(|(at, _)| *at);
        let (mut outputs, mut for_plant) = (outputs.into_iter().peekable(), for_plant.into_iter().peekable());
        for (at, step) in block.steps.iter().enumerate() {
            while let Some((_, output)) = outputs.next_if(|(made_at, _)| *made_at <= at) {
                self.put_out(output);
            }
            while let Some((_, event)) = for_plant.next_if(|(made_at, _)| *made_at <= at) {
                self.plant.take(event);
            }
            let Held::Bytes(range) = &step.held else { continue };
            let (topic, data) = (Topic::parse(Some(prefix), &topics[step.topic]), &block.bytes[range.clone()]);
            if step.lane.is_none() {
                self.take_of_plant(topic, data).with_context(|| path.display().to_string())?;
            }
            if self.verify && self.report.difference.is_none() {
                self.compare(topic, data);
            }
        }
        Ok(())
    }

    fn put_out(&mut self, output: Output) {
        if self.verify {
            let of = (output.loop_name.clone(), output.kind);
            self.made.entry(of).or_default().push_back(output.json.clone());
        }
        if output.kind != Kind::State {
            self.report.outputs.push(output);
        }
    }

    /// Takes a message that concerns several loops: repeats the comparisons of the recording.
    fn take_of_plant(&mut self, topic: Option<Topic<'_>>, data: &[u8]) -> anyhow::Result<()> {
        if topic.is_some_and(|topic| topic.leaf == Leaf::Document(Kind::Input)) {
            let input = serde_json::from_slice(data).context("a recorded input")?;
            self.plant.handle(input).into_iter().for_each(|output| self.put_out(output));
        }
        Ok(())
    }

    fn compare(&mut self, topic: Option<Topic<'_>>, recorded: &[u8]) {
        let Some(topic) = topic else { return };
        let kind = match topic.leaf {
            Leaf::Document(kind @ (Kind::Estimate | Kind::Alarm | Kind::Gap | Kind::Group)) => kind,
            // The initial states of a file or a loop were not produced there.
            Leaf::Document(Kind::State) if !is_head(recorded) => Kind::State,
            _ => return,
        };
        if kind == Kind::Group && !self.plant.is_made() {
            self.report.unchecked += 1;
            return;
        }
        let again = self.made.get_mut(&(topic.loop_name.to_owned(), kind)).and_then(VecDeque::pop_front);
        self.report.compared += usize::from(kind != Kind::State);
        self.report.difference = difference(&topic, recorded, again.as_deref());
    }

    fn close(mut self, end: Option<&End>) -> FileReport {
        if let Some(End::Cut { reason } | End::Damaged { reason }) = end {
            self.report.cut = Some(reason.clone());
        }
        let left = self.made.iter().filter(|(_, documents)| !documents.is_empty()).min_by_key(|(of, _)| *of);
        if let (Some(((name, kind), documents)), None, None) = (left, &self.report.difference, &self.report.cut) {
            let text = String::from_utf8_lossy(&documents[0]).into_owned();
            let kind = kind.name();
            self.report.difference = Some(format!("{name} {kind}: made by replay but not recorded: {text}"));
        }
        self.report
    }
}

fn difference(topic: &Topic<'_>, recorded: &[u8], again: Option<&[u8]>) -> Option<String> {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    match again {
        Some(again) if again == recorded => None,
        Some(again) => Some(format!("{topic}: recorded\n  {}\nreplayed\n  {}", text(recorded), text(again))),
        None => Some(format!("{topic}: recorded but not made by replay:\n  {}", text(recorded))),
    }
}
