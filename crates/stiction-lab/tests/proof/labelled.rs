//! The labelled recordings of real loops, read without the program's own readers.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use stiction::core::record::Record;
use stiction::core::units::LoopKind;
use stiction::core::verdict::{AssessParams, Assessment, assess};
use stiction_lab::truth::fixture::boxed;

/// One labelled recording.
pub struct Labelled {
    pub file: String,
    pub label: String,
    /// Kind of loop, as worded in the index.
    pub kind: String,
    pub record: Record,
}

/// Cells of a CSV line, without quotes.
pub fn cells(line: &str) -> Vec<String> {
    let (mut out, mut quoted) = (vec![String::new()], false);
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => out.push(String::new()),
            c => out.last_mut().unwrap().push(c),
        }
    }
    out
}

/// The recordings available for tests; empty if the folder does not exist.
pub fn labelled(folder: &str) -> Vec<Labelled> {
    let root = std::path::Path::new(folder);
    let Ok(index) = std::fs::read_to_string(root.join("INDEX.csv")) else { return Vec::new() };
    let mut lines = index.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let place = |name: &str| header.iter().position(|h| *h == name).unwrap();
    let (file, label, ts) = (place("file"), place("label"), place("sample_time_s"));
    let kind = place("loop_type");
    lines
        .filter_map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            let record = read(&root.join(cells[file]), cells[ts].parse().ok())?;
            let [file, label, kind] = [file, label, kind].map(|at| cells[at].to_owned());
            Some(Labelled { file, label, kind, record })
        })
        .collect()
}

/// Folder of the labelled recordings of real loops, which are not part of the project.
pub const RECORDINGS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");

/// The recordings; if there are none, reports loudly that `test` is skipped.
pub fn labelled_or_skip(test: &str) -> Option<Vec<Labelled>> {
    let all = labelled(RECORDINGS);
    if all.is_empty() {
        skipped(test, "no labelled recordings in ../shared/data");
    }
    (!all.is_empty()).then_some(all)
}

/// Every recording with its full assessment, given its kind of loop. Assessed once for all tests.
pub fn assessed_or_skip(test: &str) -> Option<&'static [(Labelled, Assessment)]> {
    static ALL: OnceLock<Vec<(Labelled, Assessment)>> = OnceLock::new();
    let all = ALL.get_or_init(|| {
        let recordings = labelled(RECORDINGS);
        let next = AtomicUsize::new(0);
        let found: Vec<OnceLock<Assessment>> = recordings.iter().map(|_| OnceLock::new()).collect();
        std::thread::scope(|scope| {
            for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
                scope.spawn(|| {
                    loop {
                        let at = next.fetch_add(1, Ordering::Relaxed);
                        let Some(item) = recordings.get(at) else { break };
                        let kind = item.kind.split(' ').next().and_then(LoopKind::from_name).unwrap_or_default();
                        let params = AssessParams { always_fit: true, kind, ..AssessParams::default() };
                        found[at].set(assess(&item.record, &params)).unwrap();
                    }
                });
            }
        });
        recordings.into_iter().zip(found).map(|(item, found)| (item, found.into_inner().unwrap())).collect()
    });
    if all.is_empty() {
        skipped(test, "no labelled recordings in ../shared/data");
    }
    (!all.is_empty()).then_some(all)
}

/// Reports that a test was skipped, bypassing the harness, which captures the output of passing tests; `tests/run.sh` counts
/// these lines.
pub fn skipped(test: &str, why: &str) {
    use std::io::Write;
    let _ = std::io::stderr().lock().write_all(format!("\nSKIPPED: {test}: {why}\n").as_bytes());
}

/// Reads `t,op,pv[,sp]`, drops rows with values that are not finite or times that do not advance, and averages records above
/// 2000 samples into bins.
fn read(path: &std::path::Path, _ts: Option<f64>) -> Option<Record> {
    let text = std::fs::read_to_string(path).ok()?;
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next()?.split(',').collect();
    let place = |name: &str| header.iter().position(|h| h.trim() == name);
    let (t, op, pv) = (place("t")?, place("op")?, place("pv")?);
    let sp = place("sp");
    let mut rows: Vec<[f64; 4]> = Vec::new();
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |at: usize| cells.get(at).and_then(|c| c.trim().parse::<f64>().ok()).unwrap_or(f64::NAN);
        let row = [number(t), number(op), number(pv), sp.map_or(0.0, number)];
        if row.iter().all(|v| v.is_finite()) && rows.last().is_none_or(|r| r[0] < row[0]) {
            rows.push(row);
        }
    }
    if rows.len() < 2 {
        return None;
    }
    let ts = (rows[rows.len() - 1][0] - rows[0][0]) / (rows.len() - 1) as f64;
    let mut k = 1;
    while rows.len().div_ceil(k) > 2000 {
        k *= 2;
    }
    let column = |at: usize| rows.iter().map(|r| r[at]).collect::<Vec<f64>>();
    let mut record = boxed(ts, &column(1), &column(2), k);
    if sp.is_some() && column(3).iter().any(|v| *v != 0.0) {
        record.sp = Some(column(3).chunks_exact(k).map(|c| c.iter().sum::<f64>() / k as f64).collect());
    }
    let steps: Vec<f64> = rows.windows(2).map(|w| w[1][0] - w[0][0]).collect();
    record.irregularity = 1.4826 * stiction::core::signal::stats::mad(&steps) / ts;
    Some(record)
}
