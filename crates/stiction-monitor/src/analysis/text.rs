//! Documents in words.

use super::Answer;
use stiction::ident::region::{Region, Size};
use stiction::units::{self, duration, optional as number, significant};
use stiction::verdict::words;
use stiction::verdict::{Assessment, EstimateDocument};

fn gates(a: &Assessment) -> String {
    a.gates.iter().map(|g| g.name()).collect::<Vec<_>>().join(", ")
}

/// Everything an estimate says; boxes need not hold a whole number of samples.
fn estimate(document: &EstimateDocument, box_samples: f64) -> String {
    let a = &document.assessment;
    let w = &a.window;
    let mut lines = vec![format!("{}: {} ({})", document.loop_name, a.verdict.name(), words::headline(a))];
    let mut row = |name: &str, value: String| lines.push(format!("  {name:<12} {value}"));
    let boxes = if box_samples > 1.0 { format!(", in boxes of {box_samples}") } else { String::new() };
    let (stretch, ts) = (units::from_to(w.start_ns, w.end_ns), units::number(w.ts_s));
    row("window", format!("{stretch}, {} samples of {ts} s{boxes}", w.samples));
    let o = &a.oscillation;
    if let (Some(period), Some(periods), Some(density)) = (o.period_s, o.periods, o.samples_per_period) {
        let kind = if o.oscillating { "regular" } else { "not regular" };
        row(
            "oscillation",
            format!("{kind}: period {}, {periods:.1} periods, {density:.0} samples each", duration(period)),
        );
    }
    if let Some(p) = a.p_stiction {
        let said = a.indicators.iter().filter(|w| w.vote.is_some());
        let said: Vec<String> = said.map(|w| format!("{} {:+.1}", w.name, w.contribution)).collect();
        let base = a.explanation.map_or(0.0, |e| e.base);
        let p = units::probability(p);
        row("sticking", format!("p {p}: from {base:+.1} by {} (logits)", said.join(", ")));
    }
    if let Some(reason) = a.reason {
        let row_name = if a.stiction.is_some() { "no more" } else { "no answer" };
        row(row_name, format!("{reason}: {}", words::reason(reason)));
    }
    if let Some(why) = words::disbelief(a) {
        row("no size", why);
    }
    if let (Some(false), Some([_, high])) = (a.stiction, a.s_interval) {
        row("stiction", format!("s at most {} (OP units)", number(Some(high))));
    } else if a.s.is_some() {
        row("stiction", format!("fs {}  fd {}  (OP units)", number(a.fs), number(a.fd)));
        row("", format!("s {}  j {}  s/span {}", number(a.s), number(a.j), number(a.s_over_span)));
        for (name, interval) in [("s", a.s_interval), ("j", a.j_interval), ("fs", a.fs_interval), ("fd", a.fd_interval)]
        {
            if let Some([low, high]) = interval {
                let seen =
                    if name == "j" && a.j_identifiable == Some(false) { " (not seen apart from the gain)" } else { "" };
                row("90 %", format!("{name} {} to {}{seen}", number(Some(low)), number(Some(high))));
            }
        }
        let sizes = [a.strength_by_span, a.severity_by_range].map(|size| size.map(Size::name));
        let words: Vec<&str> = [sizes[0], a.region.map(Region::name), sizes[1]].into_iter().flatten().collect();
        row("class", words.join(", "));
    }
    if let Some(index) = a.stiction_index {
        row("index", number(Some(index)));
    }
    if let Some(p) = &a.process {
        let lags: Vec<String> = p.time_constants_s.iter().map(|t| duration(*t)).collect();
        let lags = match lags.len() {
            0 => "no time constant".to_owned(),
            1 => format!("time constant {}", lags[0]),
            _ => format!("time constants {}", lags.join(" and ")),
        };
        let kind = if p.integrating { "integrating" } else { "self-regulating" };
        row(
            "process",
            format!(
                "order {} {kind}: gain {}, {lags}, dead time {}, fit {:.1} %",
                p.order,
                units::number(p.gain),
                duration(p.dead_time_s),
                p.fit_pct
            ),
        );
    }
    if let Some(least) = a.s_detectable {
        row("detectable", format!("s from {} on would have been seen", number(Some(least))));
    }
    if let Some(c) = &a.controller {
        let action = if c.td_s > 0.0 { format!(", Td {}", duration(c.td_s)) } else { String::new() };
        row("controller", format!("Kc {}, Ti {}{action}, R2 {:.3}", units::number(c.kc), duration(c.ti_s), c.r2));
    }
    if !a.contributing.is_empty() {
        row("besides", a.contributing.iter().map(|v| v.name()).collect::<Vec<_>>().join(", "));
    }
    if !a.gates.is_empty() {
        row("gates", gates(a));
    }
    if let Some(grade) = a.grade {
        row("grade", grade.to_string());
    }
    lines.join("\n")
}

/// An estimate with what `analyze` adds: what was looked at, what was enforced, what the solver found.
#[must_use]
pub fn answer(answer: &Answer) -> String {
    let averaged = answer.selection.downsample.filter(|d| !d.like_toolbox).map(|d| d.ratio);
    let box_samples = averaged.unwrap_or(answer.document.assessment.window.box_samples as f64);
    let mut lines = vec![estimate(&answer.document, box_samples)];
    let mut row = |name: &str, value: String| lines.push(format!("  {name:<12} {value}"));
    let taken = &answer.selection;
    let words = taken.section.words();
    if !words.is_empty() {
        row("section", words);
    }
    if let Some(kind) = taken.detrend {
        row("detrended", format!("{kind:?}").to_lowercase());
    }
    if let Some(d) = &taken.downsample {
        let how = if d.like_toolbox {
            "samples dropped, as the toolbox does"
        } else {
            "averaged, the valve law on every OP value"
        };
        let left = d.points_per_period.map_or(String::new(), |p| format!(", {p:.0} points left of a period"));
        row("downsampled", format!("by {}: {} samples to {} points{left} ({how})", d.ratio, d.samples, d.points));
    }
    if let Some(s0) = answer.s0 {
        row("constraint", format!("fs + fd <= S0 = {}", number(Some(s0))));
    }
    if let Some(mse) = answer.document.assessment.process.as_ref().map(|p| p.mse) {
        row("least MSE", format!("{} (PV units squared)", mean_square(mse)));
    }
    if let Some(s) = &answer.scored {
        row("given model", format!("{}: fit {:.1} %, MSE {}", s.model, s.fit_pct, mean_square(s.mse)));
    }
    if let Some(s) = &answer.solver {
        row(
            "solver",
            format!(
                "{}: fs {}  fd {}  MSE {}",
                s.name,
                number(s.fs),
                number(s.fd),
                s.mse.map_or("-".to_owned(), mean_square)
            ),
        );
        let stopped = format!(
            "{} of {} models tried in {:.1} s, {}",
            s.evaluations,
            s.evaluations_limit,
            s.elapsed_ms / 1e3,
            s.stopped.name()
        );
        let bound = s
            .lower_bound_mse
            .map_or(String::new(), |b| format!("; believed bound {} (heuristic, no proof)", mean_square(b)));
        row("", stopped + &bound);
        row(
            "",
            format!("the estimate's own bands have MSE {} there", s.estimate_mse.map_or("-".to_owned(), mean_square)),
        );
    }
    if let Some(ms) = answer.document.assessment.elapsed_ms {
        row("run time", format!("{:.2} s", ms / 1e3));
    }
    lines.join("\n")
}

/// A mean squared error with digits enough to compare two models.
fn mean_square(value: f64) -> String {
    significant(value, 5)
}
