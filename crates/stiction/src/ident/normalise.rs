//! A record in the form that every fit works on: OP in spans, PV in deviations, times in points.

use super::candidate::{NormalisedRecord, SlipEnd};
use super::choice::{DelayChoice, Options};
use super::class::Limits;
use crate::record::Record;
use crate::signal::stats;
use crate::sim::slips::Stroke;

/// The value on a grid of 2^-24, far finer than any recording: shifting or scaling a record changes its normalised
/// values in the last bits only, and the grid takes those away, so that every search takes the same way.
fn on_grid(x: f64) -> f64 {
    const GRID: f64 = 16_777_216.0;
    (x * GRID).round() / GRID
}

/// Dead times up to here are looked for whatever the loop, points: finer than that a record does not tell them.
const FINEST: f64 = 3.0;

/// The record in normalised form.
pub(crate) fn normalise(record: &Record, options: &Options, span: f64, deviation: f64) -> NormalisedRecord {
    let (n, m) = (record.len(), record.path_per_point());
    let middle = stats::mean(&record.op_path);
    let path: Vec<f64> = record.op_path.iter().map(|u| on_grid((u - middle) / span)).collect();
    let mean: Vec<f64> = path.chunks_exact(m).map(stats::mean).collect();
    let level = stats::mean(&record.pv);
    let pv = record.pv.iter().map(|p| on_grid((p - level) / deviation)).collect();
    let period = options.period_points.unwrap_or(n as f64 / 5.0).clamp(6.0, n as f64);
    let period = (16.0 * period).round() / 16.0;
    let raw = 1.0 / record.box_samples as f64;
    let longest = options.longest_dead_time_s / record.point_s() + raw;
    let most = (0.4 * period).clamp(6.0, 120.0).min(n as f64 / 6.0).min(longest.max(FINEST + raw));
    let lag = match options.delay {
        DelayChoice::Auto => [raw, most],
        DelayChoice::Samples(d) => [raw * (d.max(0.0) + 1.0); 2],
        DelayChoice::Seconds(d) => [raw * (d.max(0.0) / record.ts_s + 1.0); 2],
    };
    let lag = lag.map(|l| l.min(0.5 * n as f64));
    let from = (lag[1].ceil() as usize + 1).min(n / 2);
    let limits = Limits { tau: [0.3, (3.0 * n as f64).max(500.0)], lag };
    let records = NormalisedRecord::records_of(&path);
    let width = ((period / 32.0) as usize).max(1);
    let travel: Vec<f64> = mean.windows(width + 1).map(|w| (w[width] - w[0]).abs() / width as f64).collect();
    let rate = stats::median(&travel);
    NormalisedRecord {
        path,
        per_point: m,
        mean,
        pv,
        limits,
        from,
        period,
        rate,
        records,
        stroke: Stroke::FREE,
        slip_end: SlipEnd::Short,
    }
}
