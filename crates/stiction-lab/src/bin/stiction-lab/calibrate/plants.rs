//! `stiction-lab calibrate --plants`: fits the rules for loops that share an oscillation, and scores them.

use std::fs;
use std::path::Path;

use anyhow::Context;
use serde_json::json;

use stiction::plantwide::Calibration;
use stiction_lab::calibrate_plants::{APART, Count, Judged, Score, Settings, calibrate, score};
use stiction_lab::plants::Difficulty;
use stiction_lab::truth::Half;
use stictiond::cli::{Format, Outcome, on_all_cores, say};

/// Fits the rules to `plants` easy and as many hard plants, unless those of this build are requested; scores them on as many
/// plants of the other half, whose clocks differ by up to `skew` periods.
///
/// # Errors
/// `out` cannot be written; the plants contain no example for one of the rules.
pub(super) fn run(plants: u64, seed: u64, skew: f64, out: Option<&Path>, format: Format) -> anyhow::Result<Outcome> {
    let settings = Settings::default();
    let rules = match out {
        Some(_) => calibrate(&gather(Half::Calibration, plants, seed), &settings)
            .context("the plants hold too few examples to fit the rules to: ask for more")?,
        None => Calibration::shipped().clone(),
    };
    let held: Vec<Judged> =
        gather(Half::Report, plants, seed).into_iter().map(|plant| plant.with_skewed_clocks(skew)).collect();
    let of = |difficulty: Difficulty| {
        let some: Vec<Judged> = held.iter().filter(|plant| plant.difficulty() == difficulty).cloned().collect();
        score(&some, &rules, settings.foreign, seed)
    };
    let scores = Difficulty::ALL.map(of);
    match format {
        Format::Text => say(table(&scores))?,
        Format::Json => say(json!({"schema": "stictiond.calibration_plants.v1", "rules": rules, "report": scores}))?,
    }
    if let Some(out) = out {
        let text = serde_json::to_string_pretty(&rules)? + "\n";
        fs::write(out, text).with_context(|| format!("{}: cannot be written", out.display()))?;
    }
    Ok(Outcome::Done)
}

fn gather(half: Half, plants: u64, seed: u64) -> Vec<Judged> {
    let seeds = seed..seed.saturating_add(plants);
    let items: Vec<(Difficulty, u64)> = seeds.flat_map(|seed| Difficulty::ALL.map(|d| (d, seed))).collect();
    let name = |item: &(Difficulty, u64)| format!("{} plant {} {}", half.name(), item.0.name(), item.1);
    on_all_cores(&items, name, |(difficulty, seed)| Judged::new(half, *seed, *difficulty))
}

fn table(scores: &[Score; 2]) -> String {
    let mut lines = vec![format!("{:<58}{:>20}{:>20}", "", Difficulty::Easy.name(), Difficulty::Hard.name())];
    let sizes = scores.each_ref().map(|s| format!("{} / {}", s.plants, s.loops));
    lines.push(format!("{:<58}{:>20}{:>20}", "plants / loops", sizes[0], sizes[1]));
    let mut row = |name: &str, of: &dyn Fn(&Score) -> Count| {
        let [easy, hard] = scores.each_ref().map(|s| {
            let count = of(s);
            if count.of == 0 { "-".to_owned() } else { format!("{}/{} {:.3}", count.found, count.of, count.share()) }
        });
        lines.push(format!("{name:<58}{easy:>20}{hard:>20}"));
    };
    row("pairs of one oscillation linked, 8 periods and more", &|s| s.links[0]);
    row("pairs of one oscillation linked, fewer periods", &|s| s.links[1]);
    row("pairs of one plant that share nothing, linked", &|s| s.false_links);
    for (k, [low, high]) in APART.into_iter().enumerate() {
        let name = format!("pairs of two plants, periods {} to {} % apart, linked", 100.0 * low, 100.0 * high);
        row(&name, &|s| s.foreign_links[k]);
    }
    row("linked pairs that the stored frames would leave out", &|s| s.left_out);
    row("pairs inside a group that share one oscillation", &|s| s.precision);
    row("pairs of one visible oscillation inside one group", &|s| s.recall);
    row("independent loops put into a group", &|s| s.alone_grouped);
    row("groups of a sticking valve: ranked first", &|s| s.first);
    row("  named as the source", &|s| s.named);
    row("  another loop named", &|s| s.other_named);
    row("groups driven from outside: said so", &|s| s.outside);
    row("  a loop named", &|s| s.outside_named);
    row("groups whose source is not measured: no loop named", &|s| s.unmeasured);
    row("healthy members called sticking (p >= 0.5), alone", &|s| s.false_positives[0]);
    row("  by the group", &|s| s.false_positives[1]);
    row("sources called sticking, alone", &|s| s.sources[0]);
    row("  by the group", &|s| s.sources[1]);
    row("sticking followers called sticking, alone", &|s| s.second_valves[0]);
    row("  by the group", &|s| s.second_valves[1]);
    row("  reported as masked", &|s| s.second_valves[2]);
    lines.join("\n")
}
