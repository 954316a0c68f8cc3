//! `stictiond compact`: creates and shows the toolbox's compact data stores.

use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use clap::Subcommand;
use serde_json::json;

use crate::cli::reading::ReadArgs;
use crate::cli::refuse_existing;
use crate::cli::{Format, Outcome, UsageError, print, say};
use crate::commands::convert::{resample, write_store};
use stiction::core::units::{format_rfc3339, loop_name_from};
use stiction_files::compact::{CompactLoop, check_sampling_time, default_tags, read, rows_of};
use stiction_files::even::even;
use stiction_files::export::TimeFormat;
use stiction_files::export::moment;
use stiction_files::{FileError, InputKind, LoadedLoop, choose_loop};

/// Most loops and values asked for interactively.
const MOST_LOOPS: usize = 10_000;

/// Create or show compact data stores (.mat), in the form of the toolbox's gen_cmpct_Data_stiction.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond compact new                                     ask for everything, as the toolbox does
  stictiond compact new FIC101.csv TIC102.csv --out store.mat
  stictiond compact new op_pv.csv --ts 3 --start 2026-01-05T08:00:00Z --tag FIC101 --comment \"before the repair\"
  stictiond compact new june.csv plant.mcap --tz Europe/Berlin --resample 1 --out store.mat
  stictiond compact show store.mat
  stictiond analyze store.mat --loop 1")]
pub struct Args {
    #[command(subcommand)]
    command: CompactCommand,
}

#[derive(Debug, Subcommand)]
enum CompactCommand {
    New(Box<NewArgs>),
    Show(ShowArgs),
}

/// Create a store from files or by answering questions.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A file is a table t,op,pv (with --ts also op,pv), an export, or a recording. Without files the program asks
for the number of loops, then OP (numbers such as 1 3 5 or [1;3;5], or a file with the loop), PV, sampling
time and comment of each loop, then the name of the output. Repeat an option once per file, in the files'
order; a single --ts or --start applies to all. Without files, --tag, --ts, --start and --comment give the
answers in loop order."
)]
pub struct NewArgs {
    /// Tables t,op,pv, exports or recordings; all loops of each are stored.
    pub tables: Vec<PathBuf>,
    /// Store to write (.mat).
    #[arg(long, value_name = "FILE.mat")]
    pub out: Option<PathBuf>,
    /// Tags of a loop, once per file: OP's and PV's separated by a comma, or their common start.
    #[arg(long, value_name = "TAG")]
    pub tag: Vec<String>,
    /// Sampling time, s [default: from the timestamps].
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub ts: Vec<f64>,
    /// Comment on a loop, once per file.
    #[arg(long, value_name = "TEXT")]
    pub comment: Vec<String>,
    /// Time of the first sample: seconds since 1970 or RFC 3339, without a zone in that of --tz [default: from the
    /// timestamps, or 1970].
    #[arg(long, value_name = "TIME", allow_negative_numbers = true)]
    pub start: Vec<String>,
    /// Resample uneven data to one sample every SECONDS: OP held, PV interpolated linearly.
    #[arg(long, value_name = "SECONDS", value_parser = resample, allow_negative_numbers = true)]
    pub resample: Option<f64>,
    /// Options for reading exports.
    #[command(flatten)]
    pub reading: ReadArgs,
    /// Write without compression, as MATLAB's save -v6 does.
    #[arg(long)]
    pub uncompressed: bool,
    /// Replace an existing file.
    #[arg(long)]
    pub force: bool,
}

/// Show the loops of a store: tags, sampling time, length, comment.
#[derive(Debug, clap::Args)]
pub struct ShowArgs {
    /// Store to show (.mat).
    pub file: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// Input that cannot be read or output that cannot be written, with its place; [`UsageError`] for a wrong request.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    match &args.command {
        CompactCommand::New(args) => new(args, format),
        CompactCommand::Show(args) => show(&args.file, format),
    }
}

fn new(args: &NewArgs, format: Format) -> anyhow::Result<Outcome> {
    let (loops, out) = if args.tables.is_empty() {
        interview(&mut std::io::stdin().lock(), &mut std::io::stderr().lock(), args)?
    } else {
        let out =
            args.out.clone().ok_or_else(|| UsageError("name the store to write with --out FILE.mat".to_owned()))?;
        refuse_existing(&out, args.force)?;
        (from_tables(args)?, out)
    };
    if out.extension().is_none_or(|e| !e.eq_ignore_ascii_case("mat")) {
        return Err(UsageError(format!("{}: the name of a store must end in .mat", out.display())).into());
    }
    refuse_existing(&out, args.force)?;
    write_store(&loops, &out, !args.uncompressed)?;
    match format {
        Format::Json => say(document(&out, &loops))?,
        Format::Text => print(&described(&out, &loops))?,
    }
    Ok(Outcome::Done)
}

/// The `k`-th of several values; the only one, if `shared`; else none.
fn given<T: Clone>(values: &[T], k: usize, shared: bool) -> Option<T> {
    if shared && values.len() == 1 { values.first().cloned() } else { values.get(k).cloned() }
}

fn from_tables(args: &NewArgs) -> anyhow::Result<Vec<CompactLoop>> {
    let files = args.tables.len();
    for (name, count) in [
        ("--tag", args.tag.len()),
        ("--ts", args.ts.len()),
        ("--comment", args.comment.len()),
        ("--start", args.start.len()),
    ] {
        if count > files || (count > 1 && count < files) {
            let text = format!("{name} is given {count} times for {files} files; give it once per file, or once");
            return Err(UsageError(text).into());
        }
    }
    let mut loops = Vec::with_capacity(files);
    for (k, path) in args.tables.iter().enumerate() {
        let ts_s = given(&args.ts, k, true);
        if let Some(ts_s) = ts_s {
            check_sampling_time(ts_s).map_err(|fault| UsageError(format!("--ts: {fault}")))?;
        }
        let mut of_file = from_file(args, path, ts_s)?;
        let tag = given(&args.tag, k, files == 1);
        if let (Some(tag), true) = (&tag, of_file.len() > 1) {
            let count = of_file.len();
            let text =
                format!("--tag {tag}: {} has {count} loops; choose one with --map op=TAG,pv=TAG", path.display());
            return Err(UsageError(text).into());
        }
        for one in &mut of_file {
            said(args, k, files == 1, one)?;
        }
        loops.append(&mut of_file);
    }
    Ok(loops)
}

/// Applies the options for the `k`-th file or loop.
fn said(args: &NewArgs, k: usize, alone: bool, one: &mut CompactLoop) -> anyhow::Result<()> {
    if let Some(text) = given(&args.start, k, true) {
        let start_ns =
            moment(&text, &args.reading.options()).map_err(|fault| UsageError(format!("--start: {fault}")))?;
        one.start_ns = Some(start_ns);
    }
    if let Some(tag) = given(&args.tag, k, alone) {
        one.tags = match tag.split_once(',') {
            Some((op, pv)) => [op.trim().to_owned(), pv.trim().to_owned()],
            None => default_tags(&tag),
        };
    }
    if let Some(comment) = given(&args.comment, k, alone) {
        one.comment = comment;
    }
    Ok(())
}

/// The loops of a file.
fn from_file(args: &NewArgs, path: &Path, ts_s: Option<f64>) -> anyhow::Result<Vec<CompactLoop>> {
    let stem = path.file_stem().map_or_else(|| "loop".into(), |stem| stem.to_string_lossy());
    let name = loop_name_from(&stem);
    if InputKind::detect(path)? == InputKind::Csv && is_op_pv(path) {
        return match ts_s {
            Some(ts_s) => Ok(vec![columns(path, &name, ts_s)?]),
            None => bail!("{}: has no column t; give the sampling time with --ts", path.display()),
        };
    }
    let mut loaded = args.reading.load_file(path);
    if let (Err(FileError::Export { .. }), Some(_), None) = (&loaded, ts_s, &args.reading.time_format) {
        // With --ts the table's own times are ignored, so doubts about them do not matter.
        let reading = ReadArgs { time_format: TimeFormat::parse("s").ok(), ..args.reading.clone() };
        loaded = reading.load_file(path).or(loaded);
    }
    let loaded = loaded?;
    loaded.warnings.iter().for_each(|warning| tracing::warn!("{}: {warning}", path.display()));
    loaded.loops.iter().map(|one| stored(args, path, one, ts_s)).collect()
}

/// Whether a table's header has `op` and `pv`, but no `t`.
fn is_op_pv(path: &Path) -> bool {
    let header = std::fs::read(path).ok().and_then(|bytes| bytes.split(|b| *b == b'\n').next().map(<[u8]>::to_vec));
    let header = String::from_utf8_lossy(&header.unwrap_or_default()).trim_start_matches('\u{feff}').to_lowercase();
    let names: Vec<&str> = header.split(',').map(str::trim).collect();
    names.contains(&"op") && names.contains(&"pv") && !names.contains(&"t")
}

fn stored(args: &NewArgs, path: &Path, one: &LoadedLoop, ts_s: Option<f64>) -> anyhow::Result<CompactLoop> {
    let fault = |fault: String| anyhow!("{}: {}: {fault}", path.display(), one.name);
    let kept = match args.resample {
        Some(step_s) => CompactLoop::of(&even(one, step_s).map_err(fault)?, Some(step_s)),
        None => CompactLoop::of(one, ts_s).map_err(|fault| format!("{fault}; use --resample SECONDS")),
    };
    kept.map_err(fault)
}

/// A table of OP and PV only.
fn columns(path: &Path, name: &str, ts_s: f64) -> anyhow::Result<CompactLoop> {
    let place = || path.display().to_string();
    let mut reader =
        ::csv::ReaderBuilder::new().trim(::csv::Trim::All).flexible(true).from_path(path).with_context(place)?;
    let headers = reader.headers().with_context(place)?.clone();
    let column = |wanted: &str| {
        let found = headers.iter().position(|h| h.trim_start_matches('\u{feff}').eq_ignore_ascii_case(wanted));
        found.ok_or_else(|| {
            anyhow!("{}: the header has no column {wanted:?}; name the columns op,pv or t,op,pv", path.display())
        })
    };
    let (op, pv) = (column("op")?, column("pv")?);
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.with_context(place)?;
        let line = record.position().map_or(0, ::csv::Position::line);
        let cell = |at: usize| match record.get(at).unwrap_or_default() {
            "" => Ok(f64::NAN),
            text => {
                text.parse::<f64>().map_err(|_| anyhow!("{}: line {line}: {text:?} is not a number", path.display()))
            }
        };
        rows.push([cell(op)?, cell(pv)?]);
    }
    if rows.is_empty() {
        bail!("{}: has no data rows", path.display());
    }
    let tags = default_tags(name);
    Ok(CompactLoop { name: name.to_owned(), tags, ts_s, start_ns: Some(0), rows, ..CompactLoop::default() })
}

/// The answer to the question for OP.
enum Answer {
    Numbers(Vec<f64>),
    Loop(Box<CompactLoop>),
}

/// Asks on `ask` for everything that the command line does not give and reads the answers from `answers`.
fn interview(
    answers: &mut impl BufRead,
    ask: &mut impl Write,
    args: &NewArgs,
) -> anyhow::Result<(Vec<CompactLoop>, PathBuf)> {
    let count = repeat(answers, ask, "How many loops? ", |text| match text.parse::<usize>() {
        Ok(n) if (1..=MOST_LOOPS).contains(&n) => Ok(n),
        _ => Err(format!("write a whole number from 1 to {MOST_LOOPS}")),
    })?;
    let mut loops = Vec::with_capacity(count);
    for k in 0..count {
        let mut one = one_loop(answers, ask, args, k)?;
        if given(&args.comment, k, count == 1).is_none() {
            one.comment = repeat(answers, ask, &format!("Comment on loop {}: ", k + 1), |text| Ok(text.to_owned()))?;
        }
        said(args, k, count == 1, &mut one)?;
        loops.push(one);
    }
    let free = |text: &str| {
        let path = PathBuf::from(text);
        let path = if path.extension().is_some() { path } else { path.with_extension("mat") };
        if text.is_empty() {
            return Err("write a file name".to_owned());
        }
        refuse_existing(&path, args.force).map(|()| path).map_err(|e| format!("{e}, or choose another name"))
    };
    let out = match &args.out {
        Some(path) => path.clone(),
        None => repeat(answers, ask, "File to write: ", free)?,
    };
    Ok((loops, out))
}

/// One loop: numbers typed in, or a loop from a file.
fn one_loop(answers: &mut impl BufRead, ask: &mut impl Write, args: &NewArgs, k: usize) -> anyhow::Result<CompactLoop> {
    let name = format!("loop{}", k + 1);
    let number = k + 1;
    let known_s = given(&args.ts, k, true);
    let rows = loop {
        let op = repeat(answers, ask, &format!("OP of loop {number} (numbers, or a file with the loop): "), |text| {
            numbers(text).map(Answer::Numbers).or_else(|fault| of_answer(args, text, known_s).unwrap_or(Err(fault)))
        })?;
        let op = match op {
            Answer::Loop(one) => return Ok(*one),
            Answer::Numbers(op) => op,
        };
        let pv = repeat(answers, ask, &format!("PV of loop {number} (numbers): "), numbers)?;
        match rows_of(&op, &pv) {
            Ok(rows) => break rows,
            Err(fault) => writeln!(ask, "{fault}; enter OP and PV again")?,
        }
    };
    let ts_s = match known_s {
        Some(ts_s) => check_sampling_time(ts_s).map_err(|fault| UsageError(format!("--ts: {fault}")))?,
        None => repeat(answers, ask, &format!("Sampling time of loop {number}, s: "), |text| {
            text.parse::<f64>().map_err(|_| "write seconds, such as 3".to_owned()).and_then(check_sampling_time)
        })?,
    };
    Ok(CompactLoop { tags: default_tags(&name), name, ts_s, start_ns: Some(0), rows, ..CompactLoop::default() })
}

/// The loop of a file given instead of numbers (`FILE`, or `FILE LOOP` if it has several); `None` if there is no such
/// file.
fn of_answer(args: &NewArgs, text: &str, ts_s: Option<f64>) -> Option<Result<Answer, String>> {
    let (path, wanted) =
        if Path::new(text).is_file() { (text, None) } else { text.rsplit_once(' ').map(|(p, l)| (p, Some(l)))? };
    if !Path::new(path).is_file() {
        return None;
    }
    let chosen = || -> Result<CompactLoop, String> {
        let loaded = args.reading.load_file(Path::new(path)).map_err(|e| e.to_string())?;
        let one = match (wanted, &loaded.loops[..]) {
            (Some(wanted), all) => choose_loop(all, wanted)?,
            (None, [one]) => one,
            (None, all) => {
                let names: Vec<&str> = all.iter().take(20).map(|one| one.name.as_str()).collect();
                return Err(format!("it has the loops {}; write {path} and the name of one", names.join(", ")));
            }
        };
        stored(args, Path::new(path), one, ts_s).map_err(|e| e.to_string())
    };
    Some(chosen().map(|one| Answer::Loop(Box::new(one))))
}

/// Repeats a question until its answer is usable; the end of the input is an error.
fn repeat<T>(
    answers: &mut impl BufRead,
    ask: &mut impl Write,
    question: &str,
    understood: impl Fn(&str) -> Result<T, String>,
) -> anyhow::Result<T> {
    loop {
        write!(ask, "{question}")?;
        ask.flush()?;
        let mut line = String::new();
        if answers.read_line(&mut line)? == 0 {
            bail!("the input ended at the question {question:?}; nothing was written");
        }
        match understood(line.trim()) {
            Ok(value) => return Ok(value),
            Err(fault) => writeln!(ask, "{fault}")?,
        }
    }
}

/// Parses numbers as typed by people or copied from MATLAB.
fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let inside = text.trim_matches(|c| "[]();'".contains(c));
    let words = inside.split(|c: char| c.is_whitespace() || ",;".contains(c)).filter(|w| !w.is_empty());
    let number = |word: &str| word.parse::<f64>().map_err(|_| format!("{word:?} is not a number"));
    let found = words.map(number).collect::<Result<Vec<f64>, String>>()?;
    if found.is_empty() { Err("write numbers, such as 1 3 5 or [1;3;5]".to_owned()) } else { Ok(found) }
}

fn show(file: &Path, format: Format) -> anyhow::Result<Outcome> {
    if InputKind::detect(file)? != InputKind::Mat {
        bail!("{}: not a MATLAB file; `stictiond info` shows its format", file.display());
    }
    let store = read(file).with_context(|| file.display().to_string())?;
    store.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    match format {
        Format::Json => say(document(file, &store.loops))?,
        Format::Text => print(&described(file, &store.loops))?,
    }
    Ok(if store.incomplete { Outcome::DataLoss } else { Outcome::Done })
}

/// Number of missing values of OP and of PV.
fn missing(one: &CompactLoop) -> [usize; 2] {
    [0, 1].map(|column| one.rows.iter().filter(|row| !row[column].is_finite()).count())
}

fn document(file: &Path, loops: &[CompactLoop]) -> String {
    let rows: Vec<_> = loops
        .iter()
        .enumerate()
        .map(|(k, one)| {
            let end_ns = one.stamp_ns(one.rows.len().saturating_sub(1));
            json!({
                "loop": format!("loop{}", k + 1), "op_tag": one.tags[0], "pv_tag": one.tags[1], "ts_s": one.ts_s,
                "samples": one.rows.len(), "missing": missing(one), "start_ns": one.start_ns,
                "end_ns": one.start_ns.map(|_| end_ns), "comment": one.comment,
            })
        })
        .collect();
    json!({"schema": "stictiond.compact.v1", "file": file, "loops": rows}).to_string()
}

fn described(file: &Path, loops: &[CompactLoop]) -> String {
    let mut lines = vec![format!("{}: compact store, {} loops", file.display(), loops.len())];
    for (k, one) in loops.iter().enumerate() {
        let [op, pv] = &one.tags;
        lines.push(format!("loop{}: {op}, {pv}; {} samples every {} s", k + 1, one.rows.len(), one.ts_s));
        if one.start_ns.is_some() {
            let end_ns = one.stamp_ns(one.rows.len().saturating_sub(1));
            lines.push(format!("  time        {} to {}", format_rfc3339(one.stamp_ns(0)), format_rfc3339(end_ns)));
        }
        let [op, pv] = missing(one);
        if op + pv > 0 {
            lines.push(format!("  missing     OP {op}, PV {pv}"));
        }
        lines.extend(one.comment.lines().map(|line| format!("  comment     {line}")));
    }
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nothing_said() -> NewArgs {
        NewArgs {
            tables: Vec::new(),
            out: None,
            tag: Vec::new(),
            ts: Vec::new(),
            comment: Vec::new(),
            start: Vec::new(),
            resample: None,
            reading: ReadArgs::default(),
            uncompressed: false,
            force: false,
        }
    }

    #[test]
    fn a_file_a_tag_and_a_start_answer_too() {
        let folder = tempfile::tempdir().unwrap();
        let table = folder.path().join("A.csv");
        std::fs::write(&table, "t,op,pv\n100,1,2\n103,3,4\n106,5,6\n").unwrap();
        let answers = format!("2\n{}\nfrom a file\n1 2\n3 4\nby hand\n", table.display());
        let two = |text: &[&str]| text.iter().map(|t| (*t).to_owned()).collect::<Vec<_>>();
        let args = NewArgs {
            tag: two(&["41FIC101", "41LIC7.OUT,41LIC7.PV"]),
            ts: vec![3.0, 5.0],
            start: two(&["05.01.2026 09:00", "0"]),
            out: Some(folder.path().join("s.mat")),
            reading: ReadArgs { tz: stiction_files::export::Zone::parse("Europe/Berlin").ok(), ..ReadArgs::default() },
            ..nothing_said()
        };
        let (loops, _) = interview(&mut answers.as_bytes(), &mut Vec::new(), &args).unwrap();
        assert_eq!((&loops[0].tags[0], &loops[1].tags[0]), (&"41FIC101.OP".to_owned(), &"41LIC7.OUT".to_owned()));
        assert_eq!((loops[0].start_ns, loops[0].rows.len()), (Some(1_767_600_000_000_000_000), 3));
        assert_eq!((loops[1].ts_s, loops[1].start_ns, loops[1].comment.as_str()), (5.0, Some(0), "by hand"));
    }

    #[test]
    fn the_manuals_example_is_asked_for_and_answered() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("taken.mat");
        std::fs::write(&taken, "x").unwrap();
        let out = folder.path().join("store");
        let answers = format!(
            "two\n2\n[1;3;5]\n[2;4]\n[1;3;5]\n[2;4;6]\n0\n3\nfirst\n3 7 9\n2, 6, 8\n3\n\n{}\n{}\n",
            taken.display(),
            out.display()
        );
        let mut asked = Vec::new();
        let (loops, path) = interview(&mut answers.as_bytes(), &mut asked, &nothing_said()).unwrap();
        let asked = String::from_utf8(asked).unwrap();
        for part in ["whole number", "OP has 3 values and PV 2", "0 s is out of range", "--force"] {
            assert!(asked.contains(part), "{part}: {asked}");
        }
        assert_eq!(loops[0].rows, [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]);
        assert_eq!(loops[1].rows, [[3.0, 2.0], [7.0, 6.0], [9.0, 8.0]]);
        assert_eq!((&loops[0].tags[0], &loops[1].tags[1]), (&"loop1.OP".to_owned(), &"loop2.PV".to_owned()));
        assert_eq!((loops[0].ts_s, loops[0].comment.as_str(), path), (3.0, "first", out.with_extension("mat")));
        let ended = interview(&mut "1\n1 2\n".as_bytes(), &mut Vec::new(), &nothing_said()).unwrap_err();
        assert!(ended.to_string().contains("the input ended"), "{ended}");
    }
}
