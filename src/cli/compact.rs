//! `stictiond compact`: makes and shows the toolbox's compact data stores.

use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use clap::Subcommand;
use serde_json::json;

use super::convert::{refuse_existing, write_store};
use super::{Format, Outcome, UsageError, print, say};
use crate::files::compact::{CompactLoop, check_sampling_time, default_tags, read, rows_of};
use crate::files::{FileError, InputKind, csv};
use crate::units::{format_rfc3339, loop_name_from, parse_time};

/// Most loops and values that are asked for one by one.
const MOST_LOOPS: usize = 10_000;

/// Make or show compact data stores (.mat), as the toolbox's gen_cmpct_Data_stiction makes them.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond compact new                                     asks for everything, as the toolbox does
  stictiond compact new FIC101.csv TIC102.csv --out store.mat
  stictiond compact new op_pv.csv --ts 3 --start 2026-01-05T08:00:00Z --tag FIC101 --comment \"before the repair\"
  stictiond compact show store.mat
  stictiond analyze store.mat --loop 1")]
pub struct Args {
    #[command(subcommand)]
    command: CompactCommand,
}

#[derive(Debug, Subcommand)]
enum CompactCommand {
    New(NewArgs),
    Show(ShowArgs),
}

/// Make a store: from CSV files, or by answering questions.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A CSV file holds t,op,pv, or with --ts just op,pv. Without files the program asks for the number of
loops, then OP, PV (numbers such as 1 3 5 or [1;3;5]), sampling time and comment of each, then the
file's name. Options that may be given once a file stand in the files' order; given once, --ts and
--start hold for all."
)]
pub struct NewArgs {
    /// Tables t,op,pv, one a loop.
    pub tables: Vec<PathBuf>,
    /// The store to write (.mat).
    #[arg(long, value_name = "FILE.mat")]
    pub out: Option<PathBuf>,
    /// Tags of a loop, once a file: OP's and PV's with a comma between, or what both begin with.
    #[arg(long, value_name = "TAG")]
    pub tag: Vec<String>,
    /// Sampling time, s; otherwise the tables' own.
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub ts: Vec<f64>,
    /// A note, once a file.
    #[arg(long, value_name = "TEXT")]
    pub comment: Vec<String>,
    /// Time of the first sample, seconds since 1970 or RFC 3339; otherwise the tables' own, or 1970.
    #[arg(long, value_name = "TIME", allow_negative_numbers = true, value_parser = |text: &str| parse_time(text).map_err(|e| e.to_string()))]
    pub start: Vec<i64>,
    /// Write as save -v6 does, without compression.
    #[arg(long)]
    pub uncompressed: bool,
    /// Replace what exists.
    #[arg(long)]
    pub force: bool,
}

/// Show what a store holds: tags, sampling time, length, comment of each loop.
#[derive(Debug, clap::Args)]
pub struct ShowArgs {
    /// The store.
    pub file: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// What cannot be read or written, with its place; [`UsageError`] where the request must change.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    match &args.command {
        CompactCommand::New(args) => new(args, format),
        CompactCommand::Show(args) => show(&args.file, format),
    }
}

fn new(args: &NewArgs, format: Format) -> anyhow::Result<Outcome> {
    let (loops, out) = if args.tables.is_empty() {
        let given = [!args.tag.is_empty(), !args.ts.is_empty(), !args.comment.is_empty(), !args.start.is_empty()];
        if given.contains(&true) {
            return Err(
                UsageError("--tag, --ts, --comment and --start belong to CSV files, none is given".into()).into()
            );
        }
        interview(&mut std::io::stdin().lock(), &mut std::io::stderr().lock(), args.out.as_deref(), args.force)?
    } else {
        let out = args.out.clone().ok_or_else(|| UsageError("--out FILE.mat is missing".to_owned()))?;
        refuse_existing(&out, args.force)?;
        (from_tables(args)?, out)
    };
    if out.extension().is_none_or(|e| !e.eq_ignore_ascii_case("mat")) {
        return Err(UsageError(format!("{}: a store's name ends in .mat", out.display())).into());
    }
    refuse_existing(&out, args.force)?;
    write_store(&loops, &out, !args.uncompressed)?;
    match format {
        Format::Json => say(document(&out, &loops))?,
        Format::Text => print(&described(&out, &loops))?,
    }
    Ok(Outcome::Done)
}

/// The `k`-th of several values, the only one for all if `shared`, else nothing.
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
            let text = format!("{name} is given {count} times for {files} files; give it once a file, or once");
            return Err(UsageError(text).into());
        }
    }
    let mut loops = Vec::with_capacity(files);
    for (k, path) in args.tables.iter().enumerate() {
        let ts_s = given(&args.ts, k, true);
        if let Some(ts_s) = ts_s {
            check_sampling_time(ts_s).map_err(|fault| UsageError(format!("--ts: {fault}")))?;
        }
        let stem = path.file_stem().map_or_else(|| "loop".into(), |stem| stem.to_string_lossy());
        let mut one = from_table(path, &loop_name_from(&stem), ts_s)?;
        if let Some(start_ns) = given(&args.start, k, true) {
            one.start_ns = Some(start_ns);
        }
        if let Some(tag) = given(&args.tag, k, files == 1) {
            one.tags = match tag.split_once(',') {
                Some((op, pv)) => [op.trim().to_owned(), pv.trim().to_owned()],
                None => default_tags(&tag),
            };
        }
        one.comment = given(&args.comment, k, files == 1).unwrap_or_default();
        loops.push(one);
    }
    Ok(loops)
}

fn from_table(path: &Path, name: &str, ts_s: Option<f64>) -> anyhow::Result<CompactLoop> {
    let place = path.display();
    match InputKind::detect(path)? {
        InputKind::Csv => {}
        other => {
            let text = format!("{place}: a .{} file; convert it: stictiond convert {place} store.mat", other.name());
            return Err(UsageError(text).into());
        }
    }
    match csv::read(path) {
        Ok(table) => {
            table.warnings.iter().for_each(|warning| tracing::warn!("{place}: {warning}"));
            CompactLoop::from_samples(name, &table.samples, ts_s).map_err(|fault| anyhow!("{place}: {fault}"))
        }
        Err(FileError::Csv { source: csv::CsvError::NoColumn { column: "t", .. }, .. }) => match ts_s {
            Some(ts_s) => columns(path, name, ts_s),
            None => bail!("{place}: has no column t; say the sampling time by --ts"),
        },
        Err(error) => Err(error.into()),
    }
}

/// A table of OP and PV alone.
fn columns(path: &Path, name: &str, ts_s: f64) -> anyhow::Result<CompactLoop> {
    let place = || path.display().to_string();
    let mut reader =
        ::csv::ReaderBuilder::new().trim(::csv::Trim::All).flexible(true).from_path(path).with_context(place)?;
    let headers = reader.headers().with_context(place)?.clone();
    let column = |wanted: &str| {
        let found = headers.iter().position(|h| h.trim_start_matches('\u{feff}').eq_ignore_ascii_case(wanted));
        found.ok_or_else(|| anyhow!("{}: the header has no column {wanted:?}; write op,pv or t,op,pv", path.display()))
    };
    let (op, pv) = (column("op")?, column("pv")?);
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.with_context(place)?;
        let line = record.position().map_or(0, ::csv::Position::line);
        let cell = |at: usize| match record.get(at).unwrap_or_default() {
            "" => Ok(f64::NAN),
            text => text.parse::<f64>().map_err(|_| anyhow!("{}: line {line}: {text:?} is no number", path.display())),
        };
        rows.push([cell(op)?, cell(pv)?]);
    }
    if rows.is_empty() {
        bail!("{}: holds no row", path.display());
    }
    let tags = default_tags(name);
    Ok(CompactLoop { name: name.to_owned(), tags, ts_s, start_ns: Some(0), comment: String::new(), rows })
}

/// Asks for everything on `ask` and reads the answers from `answers`.
fn interview(
    answers: &mut impl BufRead,
    ask: &mut impl Write,
    out: Option<&Path>,
    force: bool,
) -> anyhow::Result<(Vec<CompactLoop>, PathBuf)> {
    let count = repeat(answers, ask, "How many loops? ", |text| match text.parse::<usize>() {
        Ok(n) if (1..=MOST_LOOPS).contains(&n) => Ok(n),
        _ => Err(format!("write a whole number from 1 to {MOST_LOOPS}")),
    })?;
    let mut loops = Vec::with_capacity(count);
    for k in 1..=count {
        let name = format!("loop{k}");
        let rows = loop {
            let op = repeat(answers, ask, &format!("OP of loop {k} (numbers): "), numbers)?;
            let pv = repeat(answers, ask, &format!("PV of loop {k} (numbers): "), numbers)?;
            match rows_of(&op, &pv) {
                Ok(rows) => break rows,
                Err(fault) => writeln!(ask, "{fault}; both once more")?,
            }
        };
        let ts_s = repeat(answers, ask, &format!("Sampling time of loop {k}, s: "), |text| {
            text.parse::<f64>().map_err(|_| "write seconds, such as 3".to_owned()).and_then(check_sampling_time)
        })?;
        let comment = repeat(answers, ask, &format!("Comment on loop {k}: "), |text| Ok(text.to_owned()))?;
        loops.push(CompactLoop { tags: default_tags(&name), name, ts_s, start_ns: Some(0), comment, rows });
    }
    let free = |text: &str| {
        let path = PathBuf::from(text);
        let path = if path.extension().is_some() { path } else { path.with_extension("mat") };
        if text.is_empty() {
            return Err("write a file's name".to_owned());
        }
        refuse_existing(&path, force).map(|()| path).map_err(|e| format!("{e}, or choose another name"))
    };
    let out = match out {
        Some(path) => path.to_owned(),
        None => repeat(answers, ask, "File to write: ", free)?,
    };
    Ok((loops, out))
}

/// One question until its answer can be used; the end of the input is an error.
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
            bail!("the input ended at {question:?}; nothing was written");
        }
        match understood(line.trim()) {
            Ok(value) => return Ok(value),
            Err(fault) => writeln!(ask, "{fault}")?,
        }
    }
}

/// Numbers as people and MATLAB write them.
fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let inside = text.trim_matches(|c| "[]();'".contains(c));
    let words = inside.split(|c: char| c.is_whitespace() || ",;".contains(c)).filter(|w| !w.is_empty());
    let number = |word: &str| word.parse::<f64>().map_err(|_| format!("{word:?} is no number"));
    let found = words.map(number).collect::<Result<Vec<f64>, String>>()?;
    if found.is_empty() { Err("write numbers, such as 1 3 5 or [1;3;5]".to_owned()) } else { Ok(found) }
}

fn show(file: &Path, format: Format) -> anyhow::Result<Outcome> {
    if InputKind::detect(file)? != InputKind::Mat {
        bail!("{}: not a MATLAB file; stictiond info shows what it is", file.display());
    }
    let store = read(file).with_context(|| file.display().to_string())?;
    store.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    match format {
        Format::Json => say(document(file, &store.loops))?,
        Format::Text => print(&described(file, &store.loops))?,
    }
    Ok(if store.incomplete { Outcome::DataLoss } else { Outcome::Done })
}

/// Missing values of OP and of PV.
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
        let (loops, path) = interview(&mut answers.as_bytes(), &mut asked, None, false).unwrap();
        let asked = String::from_utf8(asked).unwrap();
        for part in ["whole number", "OP has 3 values, PV 2", "0 s cannot be", "--force"] {
            assert!(asked.contains(part), "{part}: {asked}");
        }
        assert_eq!(loops[0].rows, [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]);
        assert_eq!(loops[1].rows, [[3.0, 2.0], [7.0, 6.0], [9.0, 8.0]]);
        assert_eq!((&loops[0].tags[0], &loops[1].tags[1]), (&"loop1.OP".to_owned(), &"loop2.PV".to_owned()));
        assert_eq!((loops[0].ts_s, loops[0].comment.as_str(), path), (3.0, "first", out.with_extension("mat")));
        let ended = interview(&mut "1\n1 2\n".as_bytes(), &mut Vec::new(), None, false).unwrap_err();
        assert!(ended.to_string().contains("the input ended"), "{ended}");
    }
}
