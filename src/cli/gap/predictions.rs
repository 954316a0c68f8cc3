//! `--predictions`: measured and simulated PV, row by row.

use std::path::Path;

use stiction::gap::Diagnosis;
use stiction::record::Record;
use stiction::signal::align::Point;
use stiction::units::{format_seconds, ns_from_s};

/// One row of the table.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Row {
    t_ns: i64,
    pv: f64,
    simulated: Option<[f64; 2]>,
    held_out: bool,
}

/// A row for every sample of the section. Free runs stand where they count: not where the valve's past has a say, not
/// on masked points, not outside the stretch that was simulated. Where a point of the simulation stands for several
/// samples, a row is such a point, with PV's mean, because that is what was simulated.
pub(super) fn rows(section: &[Point], record: &Record, diagnosis: &Diagnosis) -> Vec<Row> {
    let predictions = &diagnosis.predictions;
    let row = |t_ns: i64, k: usize| {
        let flag = |mask: &[bool]| mask.get(k).copied().unwrap_or(false);
        let value = |x: &[Option<f64>]| x.get(k).copied().flatten().filter(|v| v.is_finite());
        let simulated = value(&predictions.pv_base).zip(value(&predictions.pv_after)).map(|(a, b)| [a, b]);
        Row { t_ns, pv: record.pv[k], simulated, held_out: simulated.is_some() && flag(&predictions.held_out) }
    };
    let outside = |p: &Point| !(record.start_ns..=record.end_ns).contains(&p.t_ns);
    let samples = section.iter().filter(|p| !outside(p)).count();
    if record.box_samples > 1 || samples != record.len() {
        let end_s = |k: usize| (k + 1) as f64 * record.point_s() - record.ts_s;
        return (0..record.len()).map(|k| row(record.start_ns + ns_from_s(end_s(k)), k)).collect();
    }
    let mut next = 0;
    let of = |point: &Point| {
        if outside(point) {
            return Row { t_ns: point.t_ns, pv: point.pv, simulated: None, held_out: false };
        }
        next += 1;
        row(point.t_ns, next - 1)
    };
    section.iter().map(of).collect()
}

/// Writes the rows into a file of another name first: an output is whole or not there.
pub(super) fn write(path: &Path, rows: &[Row]) -> anyhow::Result<()> {
    let mut part = path.to_owned().into_os_string();
    part.push(".part");
    let mut file = csv::Writer::from_path(&part)?;
    file.write_record(["t", "pv", "pv_base", "pv_after", "held_out"])?;
    for row in rows {
        let [base, after] = match row.simulated {
            Some(both) => both.map(|v| v.to_string()),
            None => [String::new(), String::new()],
        };
        let held_out = u8::from(row.held_out).to_string();
        file.write_record([format_seconds(row.t_ns), row.pv.to_string(), base, after, held_out])?;
    }
    file.flush()?;
    drop(file);
    std::fs::rename(&part, path)?;
    Ok(())
}
