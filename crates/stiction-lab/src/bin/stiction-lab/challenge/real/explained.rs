//! How much of real recordings with a regular cycle the base explains, what the best effect adds on held-out blocks, and
//! why something remains unexplained.

use serde_json::{Value, json};

use super::{called, text};
use stiction::core::detect::oscillation;
use stiction::core::gap::{Diagnosis, Fit, GapOptions, Serial, UNKNOWN, diagnose};
use stiction::core::record::Record;
use stiction::core::signal::stats;
use stictiond::cli::say;

/// Share of PV's variance above which the base counts as informative.
const FOLLOWS: f64 = 0.5;
/// Share of the squared gap, in components slower than the oscillation or within the worst blocks, above which that is
/// where the gap is.
const MOSTLY: f64 = 0.5;
/// Fraction of the blocks considered for most of the error.
const FEW_BLOCKS: f64 = 0.2;
/// Periods needed for blocks to be comparable.
const FEW_PERIODS: f64 = 8.0;

/// The line of one recording; `regular` is false if it has no cycle.
pub(super) fn of(record: &Record, options: &GapOptions) -> anyhow::Result<Value> {
    let found = oscillation::detect(&record.op(), &record.pv).filter(|o| o.oscillating);
    let Some(cycle) = found else { return Ok(json!({ "part": "explained", "regular": false })) };
    let options = GapOptions { period_points: Some(cycle.period_points), ..options.clone() };
    let made = diagnose(record, &options, &Serial)?;
    let variance = held_out_variance(record, &made);
    let share = |fit: &Fit| 1.0 - fit.rmse * fit.rmse / variance;
    let fits = || made.findings.effects.iter().filter_map(|e| e.fit.as_ref().map(|fit| (e, fit)));
    let best =
        fits().filter(|(e, _)| e.lead > 0.0 || e.id == made.cause.id).min_by(|a, b| a.1.rmse.total_cmp(&b.1.rmse));
    let noise = made.findings.floor.noise_floor.map(|f| f * f / variance);
    Ok(json!({
        "part": "explained",
        "regular": true,
        "period_samples": cycle.period_points * record.box_samples as f64,
        "periods": record.len() as f64 / cycle.period_points,
        "base": share(&made.findings.base),
        "noise": noise,
        "best": best.map(|(e, _)| e.id.clone()),
        "adds": best.map(|(_, fit)| share(fit) - share(&made.findings.base)),
        "answer": called(&made),
        "confirmed": made.cause.confirmed,
        "kind": kind(record, &made, cycle.period_points, share(&made.findings.base)),
    }))
}

/// Variance of the held-out PV, PV units squared.
fn held_out_variance(record: &Record, made: &Diagnosis) -> f64 {
    let counts = |k: &usize| made.findings.blocks.held_out[*k] && !made.findings.blocks.masked[*k];
    let pv: Vec<f64> = (made.findings.blocks.from..record.len()).filter(counts).map(|k| record.pv[k]).collect();
    stats::variance(&pv).max(f64::MIN_POSITIVE)
}

/// Why a record stays unexplained, from the base's residuals; empty for one that has an answer.
fn kind(record: &Record, made: &Diagnosis, period: f64, base: f64) -> Option<&'static str> {
    if made.cause.id != UNKNOWN {
        return None;
    }
    let left: Vec<f64> = record.pv.iter().zip(&made.findings.base.prediction).map(|(y, p)| y - p).collect();
    let left = &left[made.findings.blocks.from..];
    Some(if (left.len() as f64) < FEW_PERIODS * period {
        "few periods"
    } else if slow_share(left, period) > MOSTLY {
        "slow drift"
    } else if share_of_few(left, period) > MOSTLY {
        "upsets"
    } else if base < FOLLOWS {
        "OP does not make PV's swing"
    } else {
        "changing oscillation"
    })
}

/// Share of the residual that moves more slowly than one and a half periods.
fn slow_share(left: &[f64], period: f64) -> f64 {
    let length = ((1.5 * period) as usize).max(1);
    let slow: Vec<f64> = left.chunks(length).map(stats::mean).collect();
    stats::variance(&slow) / stats::variance(left).max(f64::MIN_POSITIVE)
}

/// Share of the squared error in the period-long blocks with most of it.
fn share_of_few(left: &[f64], period: f64) -> f64 {
    let mut sums: Vec<f64> =
        left.chunks((period as usize).max(1)).map(|block| block.iter().map(|e| e * e).sum()).collect();
    sums.sort_by(|a, b| b.total_cmp(a));
    let few = ((FEW_BLOCKS * sums.len() as f64).ceil() as usize).max(1);
    sums[..few.min(sums.len())].iter().sum::<f64>() / sums.iter().sum::<f64>().max(f64::MIN_POSITIVE)
}

/// The table with totals.
pub(super) fn table(lines: &[&Value]) -> anyhow::Result<()> {
    let regular: Vec<&&Value> = lines.iter().filter(|l| l["regular"] == true).collect();
    if regular.is_empty() {
        return Ok(());
    }
    say(
        "recording                                  label          periods  base   noise  best effect           adds   answer               kind",
    )?;
    let pct = |v: &Value| v.as_f64().map_or_else(|| "-".to_owned(), |x| format!("{:.0}", 100.0 * x));
    for line in &regular {
        let doubt = if line["confirmed"] == false && line["answer"]["cause"] != UNKNOWN { "?" } else { "" };
        say(format!(
            "{:<42} {:<14} {:>7.1} {:>5} {:>7}  {:<20} {:>5}   {:<20} {}",
            text(&line["file"]),
            text(&line["label"]),
            line["periods"].as_f64().unwrap_or(0.0),
            pct(&line["base"]),
            pct(&line["noise"]),
            text(&line["best"]),
            pct(&line["adds"]),
            format!("{}{doubt}", text(&line["answer"]["cause"])),
            line["kind"].as_str().unwrap_or("")
        ))?;
    }
    let of = |name: &str| -> Vec<f64> { regular.iter().filter_map(|l| l[name].as_f64()).collect() };
    let unknown = regular.iter().filter(|l| l["answer"]["cause"] == UNKNOWN).count();
    say(format!(
        "\n{} of {} recordings cycle regularly: the base explains {:.0} % of PV (median), the best effect adds {:.0} %; {} stay \
         unknown",
        regular.len(),
        lines.len(),
        100.0 * stats::median(&of("base")),
        100.0 * stats::median(&of("adds")),
        unknown
    ))?;
    Ok(())
}
