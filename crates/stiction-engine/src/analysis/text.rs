//! Documents in words.

use super::Answer;
use stiction::core::units::{self, duration, optional as number, significant};
use stiction::core::verdict::answer::{self, Scale};
use stiction::core::verdict::{Assessment, EstimateDocument, Gate, Process};
use stiction::plantwide;
use stiction::words;
use stiction::words::action::Action;

/// Rows of text with a name and a value; the name is omitted where it repeats.
struct Rows(Vec<String>);

impl Rows {
    fn add(&mut self, name: &str, value: impl AsRef<str>) {
        self.0.push(format!("  {name:<12} {}", value.as_ref()));
    }

    /// Several items under one name, one a line.
    fn list(&mut self, name: &str, items: impl IntoIterator<Item = String>) {
        for (k, item) in items.into_iter().enumerate() {
            self.add(if k == 0 { name } else { "" }, item);
        }
    }
}

/// Everything in an estimate: verdict, size, confidence, action, then the numbers.
fn estimate(document: &EstimateDocument, box_samples: f64, explain: bool) -> Rows {
    let a = &document.assessment;
    let mut rows = Rows(vec![format!("{}: {}: {}", document.loop_name, a.verdict.name(), words::headline(a))]);
    if let Some(size) = words::size(a).filter(|_| a.stiction == Some(true)) {
        rows.add("size", size);
    }
    rows.add("confidence", words::sureness(a));
    rows.list("evidence", words::evidence(a).into_iter().map(|(text, _)| text));
    rows.add("what to do", Action::of(a).map_or_else(|| words::advice(a), |action| action.alone(words::op_unit(a))));
    rows.list("also", a.contributing.iter().map(|v| words::beside(*v).to_owned()));
    if let Some(why) = words::disbelief(a) {
        rows.add("no size", why);
    }
    rows.list("limited by", a.gates.iter().map(|g| format!("{}: {}", g.name(), words::gate(*g))));
    if explain {
        explanation(a, &mut rows);
    }
    numbers(a, box_samples, &mut rows);
    rows
}

/// The probability as a sum of log-odds.
fn explanation(a: &Assessment, rows: &mut Rows) {
    let Some(e) = a.explanation else { return };
    let said = a.indicators.iter().filter(|w| w.vote.is_some());
    let said: Vec<String> = said.map(|w| format!("{} {:+.1}", w.name, w.contribution)).collect();
    rows.add("log-odds", format!("{:+.1} = {:+.1} (base) with {}", e.logit, e.base, said.join(", ")));
    let [called, alarm] = [e.cuts.called, e.cuts.alarm].map(units::number);
    let p = number(a.p_calibrated);
    rows.add(
        "thresholds",
        format!("p {p} where half stick; {called} for the verdict, {alarm} for a window to count towards an alarm"),
    );
}

fn numbers(a: &Assessment, box_samples: f64, rows: &mut Rows) {
    let w = &a.window;
    let averaged = if box_samples > 1.0 { format!(", averaged over {box_samples}") } else { String::new() };
    let (stretch, ts) = (units::from_to(w.start_ns, w.end_ns), units::number(w.ts_s));
    // Uneven samples are resampled onto a grid, so these are not the rows of the file.
    let grid = if a.gates.contains(&Gate::Irregular) { " on an even grid" } else { "" };
    rows.add("window", format!("{stretch}, {} samples of {ts} s{grid}{averaged}", w.samples));
    let o = &a.oscillation;
    if let (Some(period), Some(periods), Some(density)) = (o.period_s, o.periods, o.samples_per_period) {
        let kind = if o.oscillating { "regular" } else { "not regular" };
        rows.add(
            "oscillation",
            format!("{kind}: period {}, {periods:.1} periods, {density:.0} samples each", duration(period)),
        );
    }
    if a.stiction != Some(false) && a.s.is_some() {
        bands(a, rows);
    }
    if let Some(position) = &a.valve_position {
        rows.add("MV", position.words());
    }
    if let Some(index) = a.stiction_index {
        rows.add("index", number(Some(index)));
    }
    if let Some(p) = &a.process {
        rows.add("process", process(p, a.window.ts_s));
    }
    if let Some(least) = a.s_detectable {
        rows.add("detectable", format!("s of {} or more", Scale::of(a).told(least)));
    }
    if let Some(c) = &a.controller {
        let action = if c.td_s > 0.0 { format!(", Td {}", duration(c.td_s)) } else { String::new() };
        let integral =
            if c.ti_s.is_finite() { format!("Ti {}", duration(c.ti_s)) } else { "no integral action seen".to_owned() };
        rows.add("controller", format!("Kc {}, {integral}{action}, R2 {:.3}", units::number(c.kc), c.r2));
    }
    if let Some(grade) = answer::grade(a) {
        rows.add("grade", grade.to_string());
    }
}

fn bands(a: &Assessment, rows: &mut Rows) {
    let scale = Scale::of(a);
    let number = |band: Option<f64>| number(band.map(|band| scale.value(band)));
    let law = a.valve_model.map_or_else(String::new, |law| format!(", {}", law.words()));
    rows.add("bands", format!("fs {}  fd {}  ({}{law})", number(a.fs), number(a.fd), scale.unit()));
    let share = a.s_over_span.map_or_else(|| "-".to_owned(), units::number);
    rows.add("", format!("s {}  j {}  s/span {share}", number(a.s), number(a.j)));
    if a.s_thirds.len() > 1 {
        let thirds: Vec<String> = a.s_thirds.iter().map(|s| number(Some(*s))).collect();
        rows.add("", format!("s of parts of the window: {}", thirds.join(", ")));
    }
    for (name, interval) in [("s", a.s_interval), ("j", a.j_interval), ("fs", a.fs_interval), ("fd", a.fd_interval)] {
        if let Some([low, high]) = interval {
            let open = if name == "j" && a.j_identifiable == Some(false) { " (not identifiable)" } else { "" };
            let upper = if name == "s" && words::at_bound(a) {
                "or more".to_owned()
            } else {
                format!("to {}", number(Some(high)))
            };
            rows.add("90 %", format!("{name} {} {upper}{open}", number(Some(low))));
        }
    }
    let class = a.severity_by_range.map(|size| format!("{}, relative to travel", size.name()));
    let region = a.region.map(|region| region.name().replace('_', " "));
    rows.add("class", [class, region].into_iter().flatten().collect::<Vec<_>>().join(", "));
}

/// Two time constants within this ratio and up to this many samples: their sum is known, but not the order.
const ALIKE: f64 = 1.3;
const SHORT: f64 = 5.0;

/// A tested model with its intervals; an untested one is not given.
fn process(p: &Process, ts_s: f64) -> String {
    if !p.tested {
        return "not given: the record does not test a model (nothing but the controller moves OP, or the model does not hold in the \
                rest of the record)"
            .to_owned();
    }
    let lags: Vec<String> = p.time_constants_s.iter().map(|t| duration(*t)).collect();
    let lags = match p.time_constants_s[..] {
        [] => "no time constant".to_owned(),
        [_] => format!("time constant {}", lags[0]),
        [a, b, ..] if a <= ALIKE * b && a <= SHORT * ts_s => {
            format!("time constants of about {} together, order not identifiable", duration((a + b).round().max(a)))
        }
        _ => format!("time constants {}", lags.join(" and ")),
    };
    let within = |interval: Option<[f64; 2]>, said: fn(f64) -> String| {
        interval.map_or_else(String::new, |[low, high]| format!(" ({} to {})", said(low), said(high)))
    };
    format!(
        "order {} {}: gain {}{}, {lags}, dead time {}{}, fit {:.1} %",
        p.order,
        if p.integrating { "integrating" } else { "self-regulating" },
        units::number(p.gain),
        within(p.gain_interval, units::number),
        duration(p.dead_time_s),
        within(p.dead_time_interval_s, duration),
        p.fit_pct
    )
}

/// An estimate with the additions of `analyze`: the data used, the constraints, the solver's result.
#[must_use]
pub fn answer(answer: &Answer) -> String {
    said(answer, false)
}

/// The same with the log-odds behind the probability.
#[must_use]
pub fn explained(answer: &Answer) -> String {
    said(answer, true)
}

fn said(answer: &Answer, explain: bool) -> String {
    let averaged = answer.selection.downsample.filter(|d| !d.like_toolbox).map(|d| d.ratio);
    let box_samples = averaged.unwrap_or(answer.document.assessment.window.box_samples as f64);
    let mut rows = estimate(&answer.document, box_samples, explain);
    let mut row = |name: &str, value: String| rows.add(name, value);
    if let Some(group) = &answer.document.group {
        row("group", plantwide::of_member(group));
    }
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
            "averaged; the valve law sees every OP value"
        };
        let left = d.points_per_period.map_or(String::new(), |p| format!(", {p:.0} points per period"));
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
            .map_or(String::new(), |b| format!("; estimated lower bound {} (heuristic, not proven)", mean_square(b)));
        row("", stopped + &bound);
        row(
            "",
            format!(
                "the estimate's own bands have MSE {} in the solver's model; use the bands above",
                s.estimate_mse.map_or("-".to_owned(), mean_square)
            ),
        );
    }
    if let Some(ms) = answer.document.assessment.elapsed_ms {
        row("run time", format!("{:.2} s", ms / 1e3));
    }
    rows.0.join("\n")
}

/// A mean squared error with enough digits to compare two models.
fn mean_square(value: f64) -> String {
    significant(value, 5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_is_shown_where_it_was_tested_with_no_more_than_is_known() {
        let mut model = Process {
            order: 2,
            gain: 1.5,
            time_constants_s: vec![2.67, 2.53],
            dead_time_s: 4.0,
            integrating: false,
            mse: 0.1,
            fit_pct: 80.0,
            tested: true,
            gain_interval: Some([1.2, 1.8]),
            dead_time_interval_s: None,
        };
        let said = process(&model, 1.0);
        assert!(said.contains("gain 1.5 (1.2 to 1.8)") && said.contains("about 5"), "{said}");
        assert!(
            said.contains("order not identifiable") && !process(&model, 0.1).contains("not identifiable"),
            "{said}"
        );
        model.tested = false;
        let said = process(&model, 1.0);
        assert!(said.starts_with("not given") && !said.contains("1.5"), "{said}");
    }
}
