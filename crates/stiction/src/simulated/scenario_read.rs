//! Parses and validates a scenario, with line numbers for faults.

use std::collections::BTreeSet;

use serde::Deserialize;
use serde::de::IgnoredAny;
use toml::Spanned;

use super::scenario::{LoopSpec, RecordingSpec, Scenario, ScenarioError, Setpoint};
use super::scenario_shape::shape_faults;
use crate::core::sim::closed_loop::ValveLaw;
use crate::core::units::{is_loop_name, parse_time};

/// Most scans of a scenario: one per second for three years.
const MAX_SCANS: f64 = 1e8;
/// Longest dead time, scans.
const MAX_DEAD_SCANS: f64 = 1e6;

/// Positions of the loops in the text.
#[derive(Deserialize)]
struct Places {
    #[serde(rename = "loop")]
    loops: Vec<Spanned<IgnoredAny>>,
}

/// Collects faults with line numbers.
struct Report<'a> {
    text: &'a str,
    /// Byte range of the current table in the text.
    range: (usize, usize),
    context: String,
    faults: Vec<String>,
}

impl Report<'_> {
    /// The line that sets `key` within the current range, or the range's first line.
    fn line_of(&self, key: &str) -> usize {
        let (start, end) = self.range;
        let part = self.text.get(start..end).unwrap_or("");
        let is_word = |c: char| c.is_alphanumeric() || c == '_';
        let found = part.match_indices(key).find(|(at, _)| {
            let before = part[..*at].chars().next_back();
            let after = part[at + key.len()..].trim_start_matches([' ', '\t']);
            !before.is_some_and(is_word) && after.starts_with('=')
        });
        let at = start + found.map_or(0, |(at, _)| at);
        self.text.get(..at).map_or(1, |head| head.matches('\n').count() + 1)
    }

    fn need(&mut self, ok: bool, key: &str, message: impl FnOnce() -> String) {
        if !ok {
            let line = self.line_of(key.rsplit('.').next().unwrap_or(key));
            self.faults.push(format!("line {line}: {}{key} {}", self.context, message()));
        }
    }

    fn positive(&mut self, key: &str, value: f64) {
        self.need(value.is_finite() && value > 0.0, key, || format!("is {value}, but must be greater than 0"));
    }

    fn not_negative(&mut self, key: &str, value: f64) {
        self.need(value.is_finite() && value >= 0.0, key, || format!("is {value}, but must be 0 or more"));
    }

    fn finite(&mut self, key: &str, value: f64) {
        self.need(value.is_finite(), key, || format!("is {value}, but must be a finite number"));
    }

    fn probability(&mut self, key: &str, value: f64) {
        self.need((0.0..=1.0).contains(&value), key, || format!("is {value}, but a probability is 0 to 1"));
    }
}

impl Scenario {
    /// Parses and validates a scenario.
    ///
    /// # Errors
    /// [`ScenarioError::Toml`] if the text is not TOML or one key cannot be read, [`ScenarioError::Invalid`] with all faults if
    /// there are several; both with lines.
    pub fn parse(text: &str) -> Result<Self, ScenarioError> {
        let scenario: Self = toml::from_str(text).map_err(|error| match shape_faults(text) {
            several if several.len() > 1 => ScenarioError::Invalid(several),
            _ => ScenarioError::Toml(error.to_string().trim_end().to_owned()),
        })?;
        let found = faults(&scenario, text);
        if found.is_empty() { Ok(scenario) } else { Err(ScenarioError::Invalid(found)) }
    }
}

/// All faults of a scenario parsed from `text`.
fn faults(scenario: &Scenario, text: &str) -> Vec<String> {
    let starts: Vec<usize> = toml::from_str::<Places>(text)
        .map(|places| places.loops.iter().map(|place| place.span().start).collect())
        .unwrap_or_default();
    let place = |index: usize| starts.get(index).copied().unwrap_or(text.len());
    // These tables may come before or after the loops, so their keys are searched in the whole text.
    let mut report = Report { text, range: (0, text.len()), context: String::new(), faults: Vec::new() };
    check_run(scenario, &mut report);
    let mut names = BTreeSet::new();
    for (index, spec) in scenario.loops.iter().enumerate() {
        report.range = (place(index), place(index + 1));
        report.context = format!("loop {:?}: ", spec.name);
        report.need(is_loop_name(&spec.name), "name", || {
            "is not a valid name: use no empty parts, none of * $ ? #, and no part that starts with @".to_owned()
        });
        report.need(names.insert(spec.name.as_str()), "name", || "is taken by an earlier loop".to_owned());
        check_loop(spec, scenario.run.ts_s, &mut report);
        check_recording(&spec.recording, &mut report);
    }
    report.faults
}

fn check_run(scenario: &Scenario, report: &mut Report<'_>) {
    let run = &scenario.run;
    report.need(is_loop_name(&scenario.site.prefix), "prefix", || {
        format!("{:?} is not a valid prefix: use no empty parts and none of * $ ? #", scenario.site.prefix)
    });
    if let Err(error) = parse_time(&run.start) {
        report.need(false, "start", || format!("is not valid: {error}"));
    }
    report.positive("duration_s", run.duration_s);
    report.positive("ts_s", run.ts_s);
    report.not_negative("warmup_s", run.warmup_s);
    let scans = (run.duration_s + run.warmup_s) / run.ts_s;
    report.need(scans.is_nan() || scans <= MAX_SCANS, "duration_s", || {
        format!("makes {scans:.0} scans of {} s, but at most {MAX_SCANS:.0} are simulated", run.ts_s)
    });
    report.need(scans.is_nan() || run.duration_s >= run.ts_s, "duration_s", || {
        format!("is {}, shorter than one scan of {} s", run.duration_s, run.ts_s)
    });
    report.need(!scenario.loops.is_empty(), "loop", || "is empty: a plant needs at least one [[loop]]".to_owned());
}

fn check_loop(spec: &LoopSpec, ts_s: f64, report: &mut Report<'_>) {
    let process = &spec.process;
    report.need(process.gain.is_finite() && process.gain != 0.0, "process.gain", || {
        format!("is {}, but must be a finite number other than 0", process.gain)
    });
    let most = if process.integrating { 1 } else { 2 };
    let count = process.time_constants_s.len();
    report.need(count <= most, "process.time_constants_s", || format!("has {count} entries, but at most {most} fit"));
    for tau in &process.time_constants_s {
        report.not_negative("process.time_constants_s", *tau);
    }
    report.not_negative("process.dead_time_s", process.dead_time_s);
    report.need(process.dead_time_s / ts_s <= MAX_DEAD_SCANS || ts_s <= 0.0, "process.dead_time_s", || {
        format!("is {} s, more than {MAX_DEAD_SCANS:.0} scans", process.dead_time_s)
    });

    let controller = &spec.controller;
    report.positive("controller.kc", controller.kc);
    if let Some(ti_s) = controller.ti_s {
        report.need(ti_s > 0.0, "controller.ti_s", || {
            format!("is {ti_s}, but must be greater than 0 (leave it out for no integral action)")
        });
    }
    report.not_negative("controller.td_s", controller.td_s);
    let [lo, hi] = controller.op_range;
    report.need(lo.is_finite() && hi.is_finite() && lo < hi, "controller.op_range", || {
        format!("is [{lo}, {hi}], but the first must be less than the second")
    });
    report.not_negative("controller.op_resolution", controller.op_resolution);
    let op = spec.operating_point.op;
    report.need((lo..=hi).contains(&op) || lo >= hi, "operating_point.op", || {
        format!("is {op}, outside the controller's range {lo} to {hi}")
    });
    report.finite("operating_point.pv", spec.operating_point.pv);

    let valve = &spec.valve;
    report.not_negative("valve.fs", valve.fs);
    report.not_negative("valve.fd", valve.fd);
    let above = valve.fd > valve.fs;
    report.need(!above, "valve.fd", || format!("is {}, greater than fs {}", valve.fd, valve.fs));
    report.need(valve.law != ValveLaw::None || (valve.fs == 0.0 && valve.fd == 0.0), "valve.law", || {
        format!("is \"none\", but fs {} and fd {} are given: choose \"he\" or \"tracking\"", valve.fs, valve.fd)
    });
    report.need((valve.law == ValveLaw::Physical) == valve.friction.is_some(), "valve.friction", || {
        "belongs to law \"physical\", which needs it: { stick, drag, speed, viscous, lag }".to_owned()
    });
    report.need(valve.law != ValveLaw::Physical || valve.fs == 0.0, "valve.fs", || {
        "is given, but the bands of law \"physical\" follow from its friction".to_owned()
    });
    if let Some(of) = &valve.friction {
        report.positive("valve.friction.speed", of.speed);
        report.positive("valve.friction.viscous", of.viscous);
        report.not_negative("valve.friction.lag", of.lag);
        report.need(0.0 < of.drag && of.drag <= of.stick && of.stick.is_finite(), "valve.friction.drag", || {
            format!("is {}, but must be above 0 and at most stick {}", of.drag, of.stick)
        });
    }
    report.not_negative("noise.pv_sd", spec.noise.pv_sd);

    match &spec.setpoint {
        Setpoint::Constant(value) => report.finite("setpoint", *value),
        Setpoint::Moves(moves) => {
            report.need(!moves.is_empty(), "setpoint", || "is an empty list".to_owned());
            for m in moves {
                report.need(m.at_s.is_finite() && m.value.is_finite(), "setpoint", || {
                    format!("moves to {} at {} s, but both must be finite", m.value, m.at_s)
                });
            }
            report.need(moves.windows(2).all(|w| w[0].at_s < w[1].at_s), "setpoint", || {
                "lists its moves out of order: at_s must rise".to_owned()
            });
        }
    }
    let lists = [(&spec.disturbance.load, "disturbance.load"), (&spec.disturbance.pv, "disturbance.pv")];
    for (list, place) in lists {
        for (n, shape) in list.iter().enumerate() {
            for (key, message) in shape.faults() {
                report.need(false, &format!("{place}[{n}].{key}"), || message);
            }
        }
    }
    for hand in &spec.manual {
        report.finite("manual.from_s", hand.from_s);
        report.positive("manual.for_s", hand.for_s);
        report.finite("manual.op", hand.op.unwrap_or(0.0));
    }
}

fn check_recording(recording: &RecordingSpec, report: &mut Report<'_>) {
    report.need(!recording.signals.is_empty(), "recording.signals", || "is empty: nothing would be sent".to_owned());
    let distinct: BTreeSet<_> = recording.signals.iter().collect();
    report.need(distinct.len() == recording.signals.len(), "recording.signals", || "names a signal twice".to_owned());
    report.not_negative("recording.op_quantum", recording.op_quantum);
    report.not_negative("recording.pv_quantum", recording.pv_quantum);
    report.probability("recording.duplicate_p", recording.duplicate_p);
    report.probability("recording.out_of_order_p", recording.out_of_order_p);
    report.probability("recording.late_p", recording.late_p);
    report.probability("recording.lost_p", recording.lost_p);
    report.probability("recording.missing_p", recording.missing_p);
    report.not_negative("recording.out_of_order_s", recording.out_of_order_s);
    report.not_negative("recording.late_s", recording.late_s);
    for gap in &recording.gaps {
        report.finite("recording.gaps.from_s", gap.from_s);
        report.positive("recording.gaps.for_s", gap.for_s);
    }
    for jump in &recording.clock_jumps {
        report.finite("recording.clock_jumps.at_s", jump.at_s);
        let small = jump.by_s.is_finite() && jump.by_s.abs() <= 1e9;
        report.need(small, "recording.clock_jumps.by_s", || format!("is {}, but at most 1e9 s fit", jump.by_s));
    }
}

#[cfg(test)]
mod tests {
    use crate::simulated::scenario::{Scenario, ScenarioError};

    const GOOD: &str = r#"
[site]
prefix = "p"
[run]
start = "2026-01-05T08:00:00Z"
duration_s = 60.0
ts_s = 1.0
seed = 1
[[loop]]
name = "A"
operating_point = { op = 50.0, pv = 50.0 }
setpoint = 50.0
process = { gain = 1.0, time_constants_s = [10.0], dead_time_s = 2.0 }
controller = { kc = 1.0, ti_s = 10.0 }
valve = { law = "he", fs = 2.0, fd = 1.0 }
noise = { pv_sd = 0.1 }
[[loop]]
name = "B"
operating_point = { op = 50.0, pv = 50.0 }
setpoint = 50.0
process = { gain = 1.0 }
controller = { kc = 1.0 }
"#;

    fn fails(from: &str, to: &str) -> String {
        assert!(GOOD.contains(from));
        Scenario::parse(&GOOD.replacen(from, to, 1)).unwrap_err().to_string()
    }

    #[test]
    fn the_good_one_is_good() {
        assert_eq!(Scenario::parse(GOOD).unwrap().loops.len(), 2);
    }

    #[test]
    fn every_fault_is_named_with_its_line() {
        for (from, to, line, words) in [
            ("prefix = \"p\"", "prefix = \"a//b\"", 3, "prefix \"a//b\" is not a valid prefix"),
            ("start = \"2026-01-05T08:00:00Z\"", "start = \"soon\"", 5, "start is not valid"),
            ("duration_s = 60.0", "duration_s = 0.1", 6, "shorter than one scan"),
            ("duration_s = 60.0", "duration_s = 1e12", 6, "at most 100000000 are simulated"),
            ("ts_s = 1.0", "ts_s = 0.0", 7, "ts_s is 0, but must be greater than 0"),
            ("fd = 1.0", "fd = 3.0", 15, "loop \"A\": valve.fd is 3, greater than fs 2"),
            ("law = \"he\"", "law = \"none\"", 15, "choose \"he\" or \"tracking\""),
            ("kc = 1.0, ti_s = 10.0", "kc = -1.0, ti_s = 10.0", 14, "controller.kc is -1"),
            ("ti_s = 10.0", "ti_s = 0.0", 14, "leave it out for no integral action"),
            ("[10.0], dead", "[1.0, 2.0, 3.0], dead", 13, "has 3 entries, but at most 2 fit"),
            ("dead_time_s = 2.0", "dead_time_s = 1.0, integrating = true, gain2 = 1.0", 13, "unknown field `gain2`"),
            ("dead_time_s = 2.0", "dead_time_s = -2.0", 13, "dead_time_s is -2"),
            ("pv_sd = 0.1", "pv_sd = -0.1", 16, "noise.pv_sd is -0.1"),
            ("name = \"B\"", "name = \"A\"", 18, "is taken by an earlier loop"),
            ("name = \"B\"", "name = \"*\"", 18, "is not a valid name"),
            ("process = { gain = 1.0 }", "process = { gain = 0.0 }", 21, "loop \"B\": process.gain is 0"),
            (
                "controller = { kc = 1.0 }",
                "controller = { kc = 1.0, op_range = [60.0, 90.0] }",
                19,
                "outside the controller's",
            ),
        ] {
            let message = fails(from, to);
            assert!(message.contains(&format!("line {line}")), "{to}: want line {line} in {message}");
            assert!(message.contains(words), "{to}: {message}");
        }
    }

    #[test]
    fn all_faults_come_at_once() {
        let text = GOOD
            .replace("fd = 1.0", "fd = 9.0")
            .replace("ts_s = 1.0", "ts_s = -1.0")
            .replace("gain = 1.0 }", "gain = nan }");
        let Err(ScenarioError::Invalid(faults)) = Scenario::parse(&text) else { panic!("accepted") };
        assert_eq!(faults.len(), 3, "{faults:?}");
        // Faults of the shape are reported too, without their consequences.
        let text = GOOD
            .replace("ts_s = 1.0", "ts_s = \"1\"\ntss = 2.0")
            .replacen("gain = 1.0 }", "gian = 1.0 }", 1)
            .replacen("fd = 1.0", "fdd = 1.0", 1);
        let Err(ScenarioError::Invalid(faults)) = Scenario::parse(&text) else { panic!("accepted") };
        for part in ["invalid type: string \"1\"", "unknown field `tss`", "unknown field `gian`", "unknown field `fdd`"]
        {
            assert!(
                faults.iter().any(|fault| fault.starts_with("line ") && fault.contains(part)),
                "{part}: {faults:?}"
            );
        }
        assert!(!faults.iter().any(|fault| fault.contains("missing field `ts_s`")), "{faults:?}");
    }

    #[test]
    fn lists_and_effects_are_checked_too() {
        let with = |extra: &str| Scenario::parse(&format!("{GOOD}{extra}\n"));
        for (extra, words) in [
            (
                "disturbance = { load = [{ sine = { amplitude = 1.0, period_s = 0.0 } }] }",
                "disturbance.load[0].period_s is 0",
            ),
            ("disturbance = { load = [{ sinus = { amplitude = 1.0 } }] }", "unknown variant `sinus`"),
            ("recording = { late_p = 1.5 }", "recording.late_p is 1.5, but a probability is 0 to 1"),
            ("recording = { signals = [\"op\", \"op\"] }", "names a signal twice"),
            ("recording = { signals = [] }", "nothing would be sent"),
            ("recording = { gaps = [{ from_s = 1.0, for_s = 0.0 }] }", "recording.gaps.for_s is 0"),
            ("recording = { clock_jumps = [{ at_s = 1.0, by_s = 1e12 }] }", "at most 1e9 s"),
            ("manual = [{ from_s = 1.0, for_s = -1.0 }]", "manual.for_s is -1"),
            ("label = \"sticky\"", "unknown variant `sticky`"),
        ] {
            let message = with(extra).unwrap_err().to_string();
            assert!(message.contains(words) && message.contains("line 23"), "{extra}: {message}");
        }
        let moves = GOOD.replacen(
            "setpoint = 50.0",
            "setpoint = [{ at_s = 9.0, value = 1.0 }, { at_s = 3.0, value = 2.0 }]",
            1,
        );
        let message = Scenario::parse(&moves).unwrap_err().to_string();
        assert!(message.contains("line 12") && message.contains("at_s must rise"), "{message}");
        let words = GOOD.replacen("setpoint = 50.0", "setpoint = \"high\"", 1);
        let message = Scenario::parse(&words).unwrap_err().to_string();
        assert!(message.contains("line 12") && message.contains("a number or a list"), "{message}");
    }

    #[test]
    fn texts_that_are_no_scenario_are_answered() {
        for text in ["", "x", "[site]\nprefix = \"p\"", "[[loop]]\nname = 3", "loop = 3"] {
            let message = Scenario::parse(text).unwrap_err().to_string();
            assert!(message.contains("line ") || message.contains("missing field"), "{text:?}: {message}");
        }
    }
}
