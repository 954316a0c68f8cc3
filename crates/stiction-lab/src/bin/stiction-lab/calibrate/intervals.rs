//! `stiction-lab calibrate --intervals`: the required width of intervals, and how often they contain the truth.

use std::fs;
use std::path::Path;

use anyhow::Context;
use serde_json::json;

use stiction::core::ident::width::Settings;
use stiction_lab::calibrate_intervals::{Coverage, Row, fit, look, table};
use stiction_lab::truth::{Half, Regime};
use stictiond::cli::{Format, Outcome, on_all_cores, print, say};

/// Measures `loops` loops of every regime and half, starting with `seed`; fits on one half, reports the other, and writes the
/// result to `out`.
///
/// # Errors
/// `out` cannot be written.
pub(super) fn run(loops: u64, seed: u64, out: Option<&Path>, format: Format) -> anyhow::Result<Outcome> {
    let fitted = gather(Half::Calibration, loops, seed);
    let made = format!(
        "calibrate --intervals {loops} --seed {seed}: least widths that hold the truth in nine of ten of the {} loops \
         of the calibration half in each class; gate is set, not measured",
        fitted.len()
    );
    let settings = fit(&fitted, Settings::shipped(), made);
    let report = table(&gather(Half::Report, loops, seed), &settings);
    match format {
        Format::Text => say_text(&settings, &report)?,
        Format::Json => {
            say(json!({"schema": "stictiond.calibration_intervals.v1", "settings": settings, "report": report}))?;
        }
    }
    if let Some(out) = out {
        let text = serde_json::to_string_pretty(&settings)? + "\n";
        fs::write(out, text).with_context(|| format!("{}: cannot be written", out.display()))?;
    }
    Ok(Outcome::Done)
}

fn gather(half: Half, loops: u64, seed: u64) -> Vec<Row> {
    let seeds = seed..seed.saturating_add(loops);
    let items: Vec<(Regime, u64)> = seeds.flat_map(|seed| Regime::ALL.map(|regime| (regime, seed))).collect();
    let name = |item: &(Regime, u64)| format!("{} {} {}", half.name(), item.0.name(), item.1);
    on_all_cores(&items, name, |(regime, seed)| look(half, *regime, *seed)).into_iter().flatten().collect()
}

fn say_text(settings: &Settings, report: &[Coverage]) -> anyhow::Result<()> {
    print(&format!("{}\n", serde_json::to_string_pretty(settings)?))?;
    say("\nloops of the report half: error of s in %, coverage of the 90 % intervals, their median width in % of s")?;
    for c in report {
        let [s, j, fs, fd] = c.held;
        let [s_width, j_width, ..] = c.width_pct;
        say(format!(
            "  {:<20} {:>5}  median {:>6.2}  p90 {:>6.2}  coverage s {s:.2} j {j:.2} fs {fs:.2} fd {fd:.2}  width s \
             {s_width:>6.2} j {j_width:>6.2}  j identifiable {:.2}",
            c.name, c.loops, c.median_pct, c.p90_pct, c.identifiable
        ))?;
    }
    Ok(())
}
