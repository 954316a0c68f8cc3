//! Measured and simulated PV of a diagnosed section, row by row.

use stiction::core::gap::Diagnosis;
use stiction::core::record::Record;
use stiction::core::units::ns_from_s;
use stiction::samples::align::Point;

/// One row of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Timestamp, ns.
    pub t_ns: i64,
    /// Measured PV.
    pub pv: f64,
    /// Free runs of the base and of the base with the cause.
    pub simulated: Option<[f64; 2]>,
    /// Whether no model was fitted to this row.
    pub held_out: bool,
}

fn row(diagnosis: &Diagnosis, record: &Record, t_ns: i64, k: usize) -> Row {
    let predictions = &diagnosis.predictions;
    let is_held_out = diagnosis.findings.blocks.held_out.get(k).copied().unwrap_or(false);
    let value = |x: &[Option<f64>]| x.get(k).copied().flatten().filter(|v| v.is_finite());
    let simulated = value(&predictions.pv_base).zip(value(&predictions.pv_after)).map(|(a, b)| [a, b]);
    Row { t_ns, pv: record.pv[k], simulated, held_out: simulated.is_some() && is_held_out }
}

/// A row for every sample of the section. Free runs are given where they are scored: not while the valve's unknown past
/// matters, not at masked points, and not outside the simulated stretch. If a simulated point covers several samples, the row
/// is that point with the mean of PV.
#[must_use]
pub fn rows(section: &[Point], record: &Record, diagnosis: &Diagnosis) -> Vec<Row> {
    let row = |t_ns: i64, k: usize| row(diagnosis, record, t_ns, k);
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
