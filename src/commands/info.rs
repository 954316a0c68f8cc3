//! `info FILE`: contents and integrity of a table, recording or compact store.

use crate::cli::reading::ReadArgs;
use crate::cli::{Format, Outcome};
use serde::Serialize;
use serde::de::IgnoredAny;
use std::collections::{BTreeMap, HashMap};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use stiction::core::record::{Sample, Signal, Value};
use stiction::core::units::{format_rfc3339, s_from_ns};
use stiction_engine::analysis::{repeated_timestamps, repeated_values};
use stiction_engine::codec;
use stiction_engine::codec::topic::{Leaf, Topic};
use stiction_files::inputs::Unit;
use stiction_files::{End, InputKind, Item, METADATA_PREFIX, Message, ReadError, RecordingReader, foreign};

/// Most timestamps used to find the sampling time.
const STAMPS: usize = 4096;

/// Most columns listed.
const COLUMNS: usize = 20;

/// Show the contents and integrity of tables, exports, recordings and compact stores
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond info recordings/sticking.mcap
  stictiond info store.mat
  stictiond info june.csv --tz Europe/Berlin
  stictiond info plant.mcap --verify --format json")]
pub struct InfoArgs {
    /// Files (.csv, .txt, .xlsx, .parquet, .arrow, .mcap, .mat), folders or patterns
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// Options for reading exports
    #[command(flatten)]
    pub reading: ReadArgs,
    /// Also check every payload and the file's SHA-256; exit code 3 if anything is damaged
    #[arg(long)]
    pub verify: bool,
}

#[derive(Debug, Default, Serialize)]
struct SignalInfo {
    samples: u64,
    missing: u64,
}

#[derive(Debug, Default, Serialize)]
struct LoopInfo {
    #[serde(rename = "loop")]
    name: String,
    start_ns: Option<i64>,
    end_ns: Option<i64>,
    span_s: Option<f64>,
    ts_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    tags: Option<[String; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    comment: Option<String>,
    signals: BTreeMap<&'static str, SignalInfo>,
    results: BTreeMap<&'static str, u64>,
    /// First and last row as interpreted.
    rows: Vec<String>,
    #[serde(skip)]
    stamps: BTreeMap<&'static str, Vec<i64>>,
}

#[derive(Debug, Serialize)]
struct Info {
    schema: &'static str,
    file: String,
    kind: &'static str,
    /// Format recognised in an export.
    recognised: Option<String>,
    /// Role assigned to each of its columns or tags.
    columns: Vec<String>,
    bytes: u64,
    /// Bytes per raw sample of a recording, results and index included.
    bytes_per_sample: Option<f64>,
    state: &'static str,
    reason: Option<String>,
    verified: bool,
    /// SHA-256 of the file up to its seal; `sha256_holds` is the result of checking it, if requested.
    sha256: Option<String>,
    sha256_holds: Option<bool>,
    library: Option<String>,
    metadata: BTreeMap<String, String>,
    start_ns: Option<i64>,
    end_ns: Option<i64>,
    messages: u64,
    other_messages: u64,
    unreadable: u64,
    first_unreadable: Option<String>,
    results: BTreeMap<&'static str, u64>,
    loops: Vec<LoopInfo>,
}

/// Runs the command.
///
/// # Errors
/// A file that cannot be read at all, with its place.
pub fn run(args: &InfoArgs, format: Format) -> anyhow::Result<Outcome> {
    let units = args.reading.units(&args.files)?;
    let alone = units.len() == 1;
    let (mut damaged, mut first_fault, mut shown) = (false, None, 0);
    for unit in &units {
        match show(args, unit, format) {
            Ok(outcome) => {
                damaged |= outcome == Outcome::DataLoss;
                shown += 1;
            }
            Err(error) if alone => return Err(error),
            Err(error) => {
                crate::cli::warn(format_args!("{error:#}"));
                first_fault.get_or_insert(error);
            }
        }
    }
    match first_fault {
        Some(error) if shown == 0 => Err(error),
        _ => Ok(if damaged { Outcome::DataLoss } else { Outcome::Done }),
    }
}

fn show(args: &InfoArgs, unit: &Unit, format: Format) -> anyhow::Result<Outcome> {
    let path = unit.paths.first().map_or(Path::new(""), PathBuf::as_path);
    let kind = InputKind::detect(path)?;
    let mut info = match kind {
        InputKind::Mcap => of_recording(path, args.verify)?,
        _ => of_table(args, unit, kind)?,
    };
    info.verified = args.verify;
    if let Some(reason) = &info.reason {
        crate::cli::warn(format_args!("{}: the file is {}: {reason}", path.display(), info.state));
    }
    let text = match format {
        Format::Json => serde_json::to_string(&info)? + "\n",
        Format::Text => as_text(&info),
    };
    crate::cli::print(&text)?;
    let damaged = info.state != End::Clean.word() || (args.verify && info.unreadable > 0);
    Ok(if damaged { Outcome::DataLoss } else { Outcome::Done })
}

impl Info {
    fn new(path: &Path, kind: InputKind, bytes: u64) -> Self {
        Self {
            schema: "stictiond.info.v1",
            file: path.display().to_string(),
            kind: kind.name(),
            recognised: None,
            columns: Vec::new(),
            bytes,
            bytes_per_sample: None,
            state: End::Clean.word(),
            reason: None,
            verified: false,
            sha256: None,
            sha256_holds: None,
            library: None,
            metadata: BTreeMap::new(),
            start_ns: None,
            end_ns: None,
            messages: 0,
            other_messages: 0,
            unreadable: 0,
            first_unreadable: None,
            results: BTreeMap::new(),
            loops: Vec::new(),
        }
    }

    /// Whole-file figures from those of the loops.
    fn close(&mut self) {
        for one in &mut self.loops {
            one.close();
        }
        self.start_ns = self.loops.iter().filter_map(|one| one.start_ns).min();
        self.end_ns = self.loops.iter().filter_map(|one| one.end_ns).max();
    }

    fn note_unreadable(&mut self, what: impl FnOnce() -> String) {
        self.unreadable += 1;
        self.first_unreadable.get_or_insert_with(what);
    }
}

impl LoopInfo {
    fn take(&mut self, sample: &Sample) {
        let name = sample.signal.name();
        let counts = self.signals.entry(name).or_default();
        counts.samples += 1;
        counts.missing += u64::from(sample.value == Value::Missing);
        self.start_ns = Some(self.start_ns.map_or(sample.t_ns, |t| t.min(sample.t_ns)));
        self.end_ns = Some(self.end_ns.map_or(sample.t_ns, |t| t.max(sample.t_ns)));
        let stamps = self.stamps.entry(name).or_default();
        if stamps.len() < STAMPS {
            stamps.push(sample.t_ns);
        }
    }

    /// Sampling time: the median step of PV, or else of OP, over the first timestamps.
    fn close(&mut self) {
        if let (Some(start), Some(end)) = (self.start_ns, self.end_ns) {
            self.span_s = Some(s_from_ns(end.saturating_sub(start)));
        }
        let stamps = [Signal::Pv, Signal::Op].iter().find_map(|s| self.stamps.remove(s.name()).filter(|t| t.len() > 1));
        let mut steps: Vec<i64> =
            stamps.unwrap_or_default().windows(2).map(|w| w[1].saturating_sub(w[0])).filter(|s| *s > 0).collect();
        if !steps.is_empty() {
            let middle = steps.len() / 2;
            self.ts_s = Some(s_from_ns(*steps.select_nth_unstable(middle).1));
        }
        self.stamps.clear();
    }
}

fn of_table(args: &InfoArgs, unit: &Unit, kind: InputKind) -> anyhow::Result<Info> {
    let name = unit.name();
    let sizes: Vec<u64> = unit.paths.iter().map(|p| Ok(std::fs::metadata(p)?.len())).collect::<anyhow::Result<_>>()?;
    let mut info = Info::new(Path::new(&name), kind, sizes.iter().sum());
    let loaded = args.reading.load(unit)?;
    for warning in &loaded.warnings {
        crate::cli::warn(format_args!("{name}: {warning}"));
    }
    info.recognised = loaded.recognised.as_ref().map(ToString::to_string);
    info.columns = loaded.recognised.map(|found| found.columns).unwrap_or_default();
    let mut sampling = Vec::new();
    for one in loaded.loops {
        let mut summary = LoopInfo { name: one.name, ..LoopInfo::default() };
        one.samples.iter().for_each(|sample| summary.take(sample));
        summary.rows = first_and_last(&one.samples);
        for note in repeated_timestamps(&one.samples).into_iter().chain(repeated_values(&one.samples)) {
            crate::cli::warn(format_args!("{name}: loop {}: {note}", summary.name));
        }
        info.messages += one.samples.len() as u64;
        sampling.push(one.about.as_ref().map(|about| about.ts_s));
        if let Some(about) = one.about {
            (summary.tags, summary.comment) = (Some(about.tags), Some(about.comment));
        }
        info.loops.push(summary);
    }
    info.close();
    for (one, ts_s) in info.loops.iter_mut().zip(sampling) {
        // In a compact store the sampling time is stated, not derived from timestamps.
        one.ts_s = ts_s.or(one.ts_s);
    }
    if loaded.data_loss {
        info.state = "damaged";
        info.reason = Some("some loops were left out".to_owned());
    }
    Ok(info)
}

/// The first and last row of a table as interpreted.
fn first_and_last(samples: &[Sample]) -> Vec<String> {
    let times = || samples.iter().map(|sample| sample.t_ns);
    let row = |t_ns: i64| {
        let cells = samples.iter().filter(|sample| sample.t_ns == t_ns).map(|sample| match sample.value {
            Value::Number(number) => format!(", {} {number}", sample.signal.name()),
            Value::Mode(mode) => format!(", {} {}", sample.signal.name(), mode.name()),
            Value::Missing => format!(", {} missing", sample.signal.name()),
        });
        format_rfc3339(t_ns) + &cells.collect::<String>()
    };
    times().min().into_iter().chain(times().max()).map(row).collect()
}

/// Where to count the messages of a channel.
#[derive(Clone, Copy)]
enum Counted {
    Raw(usize, Signal),
    Result(Option<usize>, &'static str),
    Other,
}

fn of_recording(path: &Path, verify: bool) -> anyhow::Result<Info> {
    let mut reader = RecordingReader::open(path)?;
    let mut info = Info::new(path, InputKind::Mcap, reader.file_bytes());
    let prefix = reader.metadata().get(METADATA_PREFIX).cloned();
    let mut places: HashMap<u16, Counted> = HashMap::new();
    let mut names = HashMap::new();
    let (mut samples, mut stranger) = (Vec::new(), None);
    while let Some(item) = reader.next_item()? {
        let (id, channel) = item.channel();
        let place =
            *places.entry(id).or_insert_with(|| place_of(prefix.as_deref(), &channel.topic, &mut info, &mut names));
        info.messages += 1;
        if info.loops.is_empty() && info.results.is_empty() {
            stranger = stranger.or_else(|| foreign(prefix.as_deref(), channel));
        }
        match (item, place) {
            (Item::Sample(raw), Counted::Raw(at, _)) => info.loops[at].take(&raw.sample),
            (Item::Sample(_), _) => info.other_messages += 1,
            (Item::Message(message), place) => count(&mut info, place, &message, verify, &mut samples),
        }
    }
    let end = reader.end().cloned().unwrap_or(End::Clean);
    info.state = end.word();
    info.reason = end.reason().map(str::to_owned);
    info.library = Some(reader.library().to_owned());
    if let Some(seal) = reader.seal() {
        info.sha256 = Some(seal.sha256.clone());
        info.sha256_holds = if verify { Some(seal.holds(path)?) } else { None };
        if info.sha256_holds == Some(false) && end.is_clean() {
            (info.state, info.reason) = ("damaged", Some("its SHA-256 does not match its content".to_owned()));
        }
    }
    info.metadata = reader.metadata().clone();
    info.close();
    let nothing = info.loops.iter().all(|one| one.signals.is_empty());
    let stranger = stranger.filter(|_| info.loops.is_empty() && info.results.is_empty());
    if let Some(first) = info.first_unreadable.clone().filter(|_| nothing).or(stranger) {
        return Err(ReadError::Nothing { path: path.to_owned(), first }.into());
    }
    let samples: u64 = info.loops.iter().flat_map(|one| one.signals.values()).map(|counts| counts.samples).sum();
    info.bytes_per_sample = (samples > 0).then(|| (info.bytes as f64 / samples as f64 * 10.0).round() / 10.0);
    Ok(info)
}

fn place_of(prefix: Option<&str>, topic: &str, info: &mut Info, names: &mut HashMap<String, usize>) -> Counted {
    let Some(parsed) = Topic::parse(prefix, topic) else { return Counted::Other };
    // The daemon's own documents belong to no loop.
    if let (Leaf::Document(kind), true) = (parsed.leaf, parsed.loop_name.starts_with('@')) {
        return Counted::Result(None, kind.name());
    }
    let at = *names.entry(parsed.loop_name.to_owned()).or_insert(info.loops.len());
    if at == info.loops.len() {
        info.loops.push(LoopInfo { name: parsed.loop_name.to_owned(), ..LoopInfo::default() });
    }
    match parsed.leaf {
        Leaf::Raw(signal) => Counted::Raw(at, signal),
        Leaf::Document(kind) => Counted::Result(Some(at), kind.name()),
    }
}

fn count(info: &mut Info, place: Counted, message: &Message<'_>, verify: bool, samples: &mut Vec<Sample>) {
    match place {
        Counted::Other => info.other_messages += 1,
        Counted::Result(at, kind) => {
            *info.results.entry(kind).or_default() += 1;
            if let Some(at) = at {
                *info.loops[at].results.entry(kind).or_default() += 1;
            }
            if verify && let Err(error) = serde_json::from_slice::<IgnoredAny>(message.data) {
                info.note_unreadable(|| format!("{}: {error}", message.topic()));
            }
        }
        Counted::Raw(at, signal) => {
            samples.clear();
            let encoding = Some(message.channel.encoding.as_str());
            match codec::decode(signal, message.data, encoding, None, message.publish_time_ns, samples) {
                Ok(_) => samples.iter().for_each(|sample| info.loops[at].take(sample)),
                Err(error) => info.note_unreadable(|| format!("{}: {error}", message.topic())),
            }
        }
    }
}

fn as_text(info: &Info) -> String {
    let mut text = String::new();
    // Writing into a String cannot fail.
    let _ = writeln!(text, "{}: {}, {} bytes, {}", info.file, info.kind, info.bytes, info.state);
    if let Some(reason) = &info.reason {
        let _ = writeln!(text, "  {reason}");
    }
    if let Some(library) = info.library.as_ref().filter(|l| !l.is_empty()) {
        let _ = writeln!(text, "  written by  {library}");
    }
    if let Some(sum) = &info.sha256 {
        let word =
            info.sha256_holds.map_or("not checked; use --verify", |holds| if holds { "matches" } else { "WRONG" });
        let _ = writeln!(text, "  sha256      {sum} ({word})");
    }
    let says_something = |value: &str| !value.is_empty() && value != "[]";
    for (key, value) in info.metadata.iter().filter(|(_, value)| says_something(value)) {
        let lines = value.lines().count();
        let shown = if lines > 1 || value.len() > 100 { format!("({lines} lines)") } else { value.clone() };
        let _ = writeln!(text, "  {key:<12}{shown}");
    }
    if let Some(found) = &info.recognised {
        let _ = writeln!(text, "  read as     {found}");
    }
    for column in info.columns.iter().take(COLUMNS) {
        let _ = writeln!(text, "  column      {column}");
    }
    if let Some(more) = info.columns.len().checked_sub(COLUMNS + 1) {
        let _ = writeln!(text, "  column      and {} more", more + 1);
    }
    if let (Some(start), Some(end)) = (info.start_ns, info.end_ns) {
        let _ = writeln!(text, "  time        {} to {}", format_rfc3339(start), format_rfc3339(end));
    }
    let _ = writeln!(text, "  messages    {}{}", info.messages, named(&info.results));
    if let Some(each) = info.bytes_per_sample {
        let _ = writeln!(text, "  per sample  {each} bytes, results and index included");
    }
    if info.other_messages > 0 {
        let _ = writeln!(text, "  other       {} messages on other topics", info.other_messages);
    }
    if let Some(first) = &info.first_unreadable {
        let _ = writeln!(text, "  unreadable  {} payloads, the first: {first}", info.unreadable);
    }
    for one in &info.loops {
        loop_text(&mut text, one);
    }
    text
}

fn loop_text(text: &mut String, one: &LoopInfo) {
    let signals: Vec<String> = one
        .signals
        .iter()
        .map(|(name, counts)| match counts.missing {
            0 => format!("{name} {}", counts.samples),
            missing => format!("{name} {} ({missing} missing)", counts.samples),
        })
        .collect();
    let _ = write!(text, "loop {}: {}", one.name, signals.join(", "));
    if let Some(span_s) = one.span_s {
        let _ = write!(text, "; {span_s} s");
    }
    if let Some(ts_s) = one.ts_s {
        let _ = write!(text, ", every {ts_s} s");
    }
    let _ = writeln!(text, "{}", named(&one.results));
    if let Some([op, pv]) = &one.tags {
        let _ = writeln!(text, "  tags        {op}, {pv}");
    }
    for (which, row) in ["first row", "last row"].iter().zip(&one.rows) {
        let _ = writeln!(text, "  {which:<12}{row}");
    }
    for line in one.comment.iter().flat_map(|comment| comment.lines()) {
        let _ = writeln!(text, "  comment     {line}");
    }
}

fn named(counts: &BTreeMap<&'static str, u64>) -> String {
    counts.iter().map(|(name, count)| format!("; {name} {count}")).collect()
}
