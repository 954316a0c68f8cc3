//! Scenarios: simulated plants in TOML.
//!
//! ```toml
//! [site]
//! prefix = "demo"                        # prefix of every key
//! [run]
//! start = "2026-01-05T08:00:00Z"         # time of the first scan
//! duration_s = 1800.0
//! ts_s = 1.0                             # time between scans
//! seed = 1
//! warmup_s = 600.0                       # simulated before the first scan, not recorded (default 0)
//! [[loop]]
//! name = "FIC101"
//! label = "stiction"                     # the truth in one word, optional
//! operating_point = { op = 50.0, pv = 60.0 }      # operating point of the process
//! setpoint = 60.0                        # or [{ at_s = 0.0, value = 60.0 }, ...]
//! process = { gain = 2.0, time_constants_s = [20.0], dead_time_s = 5.0 }
//! controller = { kc = 0.4, ti_s = 20.0, op_resolution = 0.01 }
//! valve = { law = "he", fs = 3.0, fd = 1.0 }
//! noise = { pv_sd = 0.05 }
//! disturbance = { load = [{ sine = { amplitude = 1.0, period_s = 80.0 } }], pv = [] }
//! recording = { pv_quantum = 0.01 }
//! ```

use serde::Deserialize;
use thiserror::Error;

use crate::core::record::Signal;
use crate::core::sim::actuator::Actuator;
use crate::core::sim::closed_loop::{LoopModel, ValveLaw, ValveModel};
use crate::core::sim::controller::{Action, PidSettings};
use crate::core::sim::disturbance::Disturbance;
use crate::core::sim::friction::{Friction, FrictionSpec};
use crate::core::sim::process::ProcessModel;
use crate::core::sim::slips::Stroke;
use crate::core::units::{format_rfc3339, ns_from_s, number, parse_time};

/// Why a text is not a valid scenario.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum ScenarioError {
    /// Not TOML, an unknown key, a missing key or a value of the wrong type; the message has line and column.
    #[error("{0}")]
    Toml(String),
    /// All invalid values, each with its line.
    #[error("{} in the scenario:\n  {}", faults(.0.len()), .0.join("\n  "))]
    Invalid(Vec<String>),
}

fn faults(n: usize) -> String {
    if n == 1 { "1 fault".to_owned() } else { format!("{n} faults") }
}

/// A simulated plant.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Key prefix.
    pub site: SiteSpec,
    /// Start and duration.
    pub run: RunSpec,
    /// Its loops.
    #[serde(rename = "loop")]
    pub loops: Vec<LoopSpec>,
}

/// Key prefix of a plant.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SiteSpec {
    /// Prefix of every key.
    pub prefix: String,
}

/// Start and duration of a run.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunSpec {
    /// Time of the first recorded scan: seconds since 1970 as text, or RFC 3339.
    pub start: String,
    /// Length of the recording, s.
    pub duration_s: f64,
    /// Time between scans, s.
    pub ts_s: f64,
    /// Seed of all random choices.
    pub seed: u64,
    /// Time simulated before the first recorded scan, s.
    #[serde(default)]
    pub warmup_s: f64,
}

/// One loop.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopSpec {
    /// Name, unique in the scenario.
    pub name: String,
    /// The truth in one word.
    pub label: Option<Label>,
    /// The truth in a sentence.
    pub note: Option<String>,
    /// Operating point of the process.
    pub operating_point: OperatingPoint,
    /// Set point.
    pub setpoint: Setpoint,
    /// Process.
    pub process: ProcessSpec,
    /// Controller.
    pub controller: ControllerSpec,
    /// Valve; default: no friction.
    #[serde(default)]
    pub valve: ValveSpec,
    /// Measurement noise; default: none.
    #[serde(default)]
    pub noise: NoiseSpec,
    /// External disturbances.
    #[serde(default)]
    pub disturbance: DisturbanceSpec,
    /// Periods in manual.
    #[serde(default)]
    pub manual: Vec<ManualSpec>,
    /// Effects of recording.
    #[serde(default)]
    pub recording: RecordingSpec,
}

/// The truth about a loop in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Label {
    /// The valve sticks and slips.
    Stiction,
    /// The valve has a dead band.
    Deadband,
    /// Healthy valve, calm loop.
    NoStiction,
    /// Healthy valve, controller tuned too tight.
    Tuning,
    /// Healthy valve, external disturbance.
    Disturbance,
}

impl Label {
    /// Word of the label in labelled sets.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stiction => "stiction",
            Self::Deadband => "deadband",
            Self::NoStiction => "no_stiction",
            Self::Tuning => "tuning",
            Self::Disturbance => "disturbance",
        }
    }
}

/// Operating point of the process, where the loop starts.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OperatingPoint {
    /// Valve position, OP units.
    pub op: f64,
    /// PV, PV units.
    pub pv: f64,
}

/// A set point over time.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged, expecting = "a number or a list of { at_s, value }")]
pub enum Setpoint {
    /// Constant, PV units.
    Constant(f64),
    /// Changes in time order; the first value also applies before its time.
    Moves(Vec<SetpointMove>),
}

/// A change of the set point.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetpointMove {
    /// Time from the start of the recording, s.
    pub at_s: f64,
    /// Set point from then on, PV units.
    pub value: f64,
}

impl Setpoint {
    /// The set point at `t_s` seconds from the start, PV units.
    #[must_use]
    pub fn at(&self, t_s: f64) -> f64 {
        match self {
            Self::Constant(value) => *value,
            Self::Moves(moves) => {
                let last = moves.iter().rev().find(|m| m.at_s <= t_s).or(moves.first());
                last.map_or(0.0, |m| m.value)
            }
        }
    }
}

/// A process in physical units.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProcessSpec {
    /// PV units per OP unit, and per second if integrating.
    pub gain: f64,
    /// None, one or two time constants, s; if integrating at most one, a lag before the integrator.
    #[serde(default)]
    pub time_constants_s: Vec<f64>,
    /// Dead time, s.
    #[serde(default)]
    pub dead_time_s: f64,
    /// Whether it integrates.
    #[serde(default)]
    pub integrating: bool,
}

/// A controller in physical units.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControllerSpec {
    /// Gain, OP units per PV unit, > 0; the action follows the sign of the process gain.
    pub kc: f64,
    /// Integral time, s; default: no integral action.
    pub ti_s: Option<f64>,
    /// Derivative time, s.
    #[serde(default)]
    pub td_s: f64,
    /// Lower and upper limit of OP.
    #[serde(default = "percent")]
    pub op_range: [f64; 2],
    /// OP is rounded to multiples of this, OP units; 0 for no rounding.
    #[serde(default)]
    pub op_resolution: f64,
}

const fn percent() -> [f64; 2] {
    [0.0, 100.0]
}

/// A valve; its travel is the range 0..100 or the controller's range, whichever is wider.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ValveSpec {
    /// Law.
    pub law: ValveLaw,
    /// Static band, OP units.
    #[serde(default)]
    pub fs: f64,
    /// Kinetic band, OP units.
    #[serde(default)]
    pub fd: f64,
    /// Of law `physical`, which has no `fs` and `fd`: its friction.
    #[serde(default)]
    pub friction: Option<FrictionSpec>,
    /// Additional properties of the stem; only from a model file.
    #[serde(skip)]
    pub stroke: Stroke,
    /// Parts around the stem; only from a model file.
    #[serde(skip)]
    pub actuator: Actuator,
}

impl Default for ValveSpec {
    fn default() -> Self {
        Self { law: ValveLaw::None, fs: 0.0, fd: 0.0, friction: None, stroke: Stroke::FREE, actuator: Actuator::NONE }
    }
}

/// Measurement noise.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseSpec {
    /// Standard deviation of white noise on PV, PV units; the controller receives it.
    pub pv_sd: f64,
}

/// External disturbances.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DisturbanceSpec {
    /// At the process input, OP units.
    pub load: Vec<Disturbance>,
    /// At PV, PV units.
    pub pv: Vec<Disturbance>,
}

/// A period in manual.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ManualSpec {
    /// Start, s from the start of the recording.
    pub from_s: f64,
    /// Duration, s.
    pub for_s: f64,
    /// OP meanwhile; default: its current value.
    pub op: Option<f64>,
}

/// Effects of recording and transport. Probabilities are per value.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingSpec {
    /// Signals that are sent.
    pub signals: Vec<Signal>,
    /// OP (and valve position) is recorded in multiples of this, OP units; 0 for no rounding. The valve receives OP as the
    /// controller sent it.
    pub op_quantum: f64,
    /// PV is recorded in multiples of this, PV units; 0 for no rounding.
    pub pv_quantum: f64,
    /// Probability that a value is sent a second time, with the next scan.
    pub duplicate_p: f64,
    /// Probability that a value arrives up to `out_of_order_s` late, after newer ones.
    pub out_of_order_p: f64,
    /// Greatest such delay, s.
    pub out_of_order_s: f64,
    /// Probability that a value arrives `late_s` late.
    pub late_p: f64,
    /// That delay, s.
    pub late_s: f64,
    /// Probability that a value is lost.
    pub lost_p: f64,
    /// Probability that a value is sent as missing.
    pub missing_p: f64,
    /// Periods without any value.
    pub gaps: Vec<GapSpec>,
    /// Jumps of the timestamp clock.
    pub clock_jumps: Vec<ClockJumpSpec>,
}

impl Default for RecordingSpec {
    fn default() -> Self {
        Self {
            signals: vec![Signal::Op, Signal::Sp, Signal::Mode, Signal::Pv],
            op_quantum: 0.0,
            pv_quantum: 0.0,
            duplicate_p: 0.0,
            out_of_order_p: 0.0,
            out_of_order_s: 2.0,
            late_p: 0.0,
            late_s: 60.0,
            lost_p: 0.0,
            missing_p: 0.0,
            gaps: Vec::new(),
            clock_jumps: Vec::new(),
        }
    }
}

/// A period without any value.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GapSpec {
    /// Start, s from the start of the recording.
    pub from_s: f64,
    /// Duration, s.
    pub for_s: f64,
}

/// A jump of the timestamp clock.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClockJumpSpec {
    /// True time of the jump, s from the start of the recording.
    pub at_s: f64,
    /// Added to every later timestamp, s; negative for a jump back.
    pub by_s: f64,
}

impl Scenario {
    /// Timestamp of the first recorded scan, ns since 1970.
    #[must_use]
    pub fn start_ns(&self) -> i64 {
        // A parsed scenario has a readable start.
        parse_time(&self.run.start).unwrap_or(0)
    }

    /// Number of scans in the recording.
    #[must_use]
    pub fn scans(&self) -> u64 {
        // A part of a scan at the end counts as none, rounding errors aside.
        (self.run.duration_s / self.run.ts_s + 1e-9).floor() as u64
    }

    /// Names of the loops in order of their indices.
    pub fn loop_names(&self) -> impl Iterator<Item = &str> {
        self.loops.iter().map(|l| l.name.as_str())
    }

    /// The truth about this plant in words: one paragraph per loop.
    #[must_use]
    pub fn truth(&self) -> String {
        let end_ns = self.start_ns() + ns_from_s(self.run.duration_s);
        let mut text = format!(
            "Simulated plant {:?}: {} scans, one every {} s, from {} to {}, seed {}.\n",
            self.site.prefix,
            self.scans(),
            self.run.ts_s,
            self.run.start,
            format_rfc3339(end_ns),
            self.run.seed
        );
        for spec in &self.loops {
            text.push_str(&spec.truth());
        }
        text
    }
}

impl LoopSpec {
    /// The loop's parameters for the simulation, sampled every `ts_s` seconds.
    #[must_use]
    pub fn model(&self, ts_s: f64) -> LoopModel {
        let mut taus = self.process.time_constants_s.iter().map(|tau| tau / ts_s);
        let [op_min, op_max] = self.controller.op_range;
        LoopModel {
            ts_s,
            process: ProcessModel {
                gain: if self.process.integrating { self.process.gain * ts_s } else { self.process.gain },
                tau: taus.next().unwrap_or(0.0),
                tau2: taus.next().unwrap_or(0.0),
                dead_time: self.process.dead_time_s / ts_s,
                integrating: self.process.integrating,
            },
            rest_op: self.operating_point.op,
            rest_pv: self.operating_point.pv,
            controller: PidSettings {
                kc: self.controller.kc,
                ti_s: self.controller.ti_s.unwrap_or(f64::INFINITY),
                td_s: self.controller.td_s,
                action: if self.process.gain > 0.0 { Action::Reverse } else { Action::Direct },
                op_min,
                op_max,
                op_resolution: self.controller.op_resolution,
            },
            valve: ValveModel {
                law: self.valve.law,
                fs: self.valve.fs,
                fd: self.valve.fd,
                travel_min: op_min.min(0.0),
                travel_max: op_max.max(100.0),
                stroke: self.valve.stroke,
                actuator: self.valve.actuator,
                friction: self.valve.friction.map_or(Friction::NONE, FrictionSpec::friction),
            },
            pv_noise_sd: self.noise.pv_sd,
            load: self.disturbance.load.clone(),
            pv_disturbance: self.disturbance.pv.clone(),
        }
    }

    /// The truth about this loop in words.
    #[must_use]
    pub fn truth(&self) -> String {
        let Self { name, valve, process, controller, .. } = self;
        let label = self.label.map_or(String::new(), |l| format!(" ({})", l.name()));
        let friction = match valve.law {
            ValveLaw::None => "valve without friction".to_owned(),
            ValveLaw::Physical => {
                let (s, j) = valve.friction.map_or((0.0, 0.0), |of| of.friction().measure());
                format!("valve with forces: s {} j {} when moved slowly, OP units", number(s), number(j))
            }
            law => format!(
                "valve law {}: fs {} fd {} (s {} j {}), OP units",
                if law == ValveLaw::He { "he" } else { "tracking" },
                valve.fs,
                valve.fd,
                valve.fs + valve.fd,
                valve.fs - valve.fd
            ),
        };
        let taus: Vec<String> = process.time_constants_s.iter().map(ToString::to_string).collect();
        let integral = controller.ti_s.map_or("none".to_owned(), |ti| format!("{ti} s"));
        let mut text = format!(
            "{name}{label}: {friction}; {}process, gain {}{}, time constants [{}] s, dead time {} s; controller Kc {}, \
             Ti {integral}, Td {} s; PV noise sd {}",
            if process.integrating { "integrating " } else { "" },
            process.gain,
            if process.integrating { " a second" } else { "" },
            taus.join(", "),
            process.dead_time_s,
            controller.kc,
            controller.td_s,
            self.noise.pv_sd
        );
        for (what, place) in [(&self.disturbance.load, "load"), (&self.disturbance.pv, "PV disturbance")] {
            for disturbance in what {
                text.push_str(&format!("; {place}: {disturbance}"));
            }
        }
        text.push_str(&self.note.as_ref().map_or(".\n".to_owned(), |note| format!(". {note}\n")));
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: &str = r#"
[site]
prefix = "demo"
[run]
start = "2026-01-05T08:00:00Z"
duration_s = 1800.0
ts_s = 0.5
seed = 1
[[loop]]
name = "FIC101"
label = "stiction"
note = "Only an example."
operating_point = { op = 50.0, pv = 60.0 }
setpoint = [{ at_s = 10.0, value = 60.0 }, { at_s = 100.0, value = 62.0 }]
process = { gain = -2.0, time_constants_s = [20.0, 4.0], dead_time_s = 5.0 }
controller = { kc = 0.4, ti_s = 20.0, td_s = 1.0 }
valve = { law = "tracking", fs = 3.0, fd = 1.0 }
noise = { pv_sd = 0.05 }
disturbance = { load = [{ sine = { amplitude = 1.0, period_s = 80.0 } }], pv = [{ random_walk = { sd_per_root_s = 0.1 } }] }
recording = { op_quantum = 0.01, pv_quantum = 0.01 }
[[loop]]
name = "LIC102"
operating_point = { op = 50.0, pv = 60.0 }
setpoint = 60.0
process = { gain = 0.02, integrating = true }
controller = { kc = 0.4 }
"#;

    #[test]
    fn physical_units_become_samples() {
        let scenario = Scenario::parse(EXAMPLE).unwrap();
        assert_eq!((scenario.scans(), scenario.start_ns()), (3_600, 1_767_600_000_000_000_000));
        let model = scenario.loops[0].model(0.5);
        assert_eq!((model.process.tau, model.process.tau2, model.process.dead_time), (40.0, 8.0, 10.0));
        assert_eq!((model.process.gain, model.controller.action), (-2.0, Action::Direct));
        assert_eq!((model.valve.law, model.valve.fs, model.valve.travel_max), (ValveLaw::Tracking, 3.0, 100.0));
        let level = scenario.loops[1].model(0.5);
        assert_eq!((level.process.gain, level.process.tau, level.controller.ti_s), (0.01, 0.0, f64::INFINITY));
        assert_eq!((level.valve, level.controller.action), (ValveModel::HEALTHY, Action::Reverse));
    }

    #[test]
    fn set_points_hold_until_they_move() {
        let sp = &Scenario::parse(EXAMPLE).unwrap().loops[0].setpoint;
        assert_eq!([-50.0, 10.0, 99.9, 100.0, 1e9].map(|t| sp.at(t)), [60.0, 60.0, 60.0, 62.0, 62.0]);
    }

    #[test]
    fn the_truth_names_what_is_wrong_with_each_loop() {
        let truth = Scenario::parse(EXAMPLE).unwrap().truth();
        for words in [
            "FIC101 (stiction): valve law tracking: fs 3 fd 1 (s 4 j 2)",
            "time constants [20, 4] s, dead time 5 s",
            "load: sine of amplitude 1, period 80 s",
            "PV disturbance: random walk",
            "Only an example.",
            "LIC102: valve without friction; integrating process, gain 0.02 a second",
            "Ti none",
            "3600 scans, one every 0.5 s",
        ] {
            assert!(truth.contains(words), "{words:?} is not in:\n{truth}");
        }
    }
}
