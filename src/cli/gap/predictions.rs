//! `--predictions`: measured and simulated PV, row by row.

use std::path::Path;

use crate::gap::Diagnosis;
use crate::record::Record;
use crate::signal::align::Point;
use crate::units::format_seconds;

/// One row of the table.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Row {
    t_ns: i64,
    pv: f64,
    simulated: Option<[f64; 2]>,
    held_out: bool,
}

/// A row for every sample of the section. Free runs stand where they count: not where the valve's past has a say, not
/// on masked points, not outside the stretch that was simulated. In a boxed record a row is a box, with its last
/// sample's stamp and PV's mean, because that is what was simulated.
pub(super) fn rows(section: &[Point], record: &Record, diagnosis: &Diagnosis) -> Vec<Row> {
    let inside = |t_ns: i64| (record.start_ns..=record.end_ns).contains(&t_ns);
    let predictions = &diagnosis.predictions;
    let at = |k: usize| -> (Option<[f64; 2]>, bool) {
        let flag = |mask: &[bool]| mask.get(k).copied().unwrap_or(false);
        let counts = k >= diagnosis.blocks.from && !flag(&predictions.masked);
        let both = predictions.pv_base.get(k).copied().flatten().zip(predictions.pv_after.get(k).copied().flatten());
        let both = both.filter(|(a, b)| counts && a.is_finite() && b.is_finite());
        (both.map(|(a, b)| [a, b]), both.is_some() && flag(&predictions.held_out))
    };
    let mut out = Vec::with_capacity(section.len());
    let mut sample = 0;
    for point in section {
        if !inside(point.t_ns) {
            out.push(Row { t_ns: point.t_ns, pv: point.pv, simulated: None, held_out: false });
            continue;
        }
        sample += 1;
        if sample % record.box_samples == 0 && sample / record.box_samples <= record.len() {
            let k = sample / record.box_samples - 1;
            let (simulated, held_out) = at(k);
            out.push(Row { t_ns: point.t_ns, pv: record.pv[k], simulated, held_out });
        }
    }
    out
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
