//! Sticking loops for the accuracy of s and j: the regime fixes one property, and everything else is drawn.

use super::TruthLoop;
use super::draw::{Draw, scaled, span, std_dev};
use super::rig::{Drive, Rig, Run, motions, swing, tune, turns};
use stiction::core::sim::closed_loop::{ValveLaw, ValveModel};
use stiction::core::sim::disturbance::Disturbance;
use stiction::core::sim::friction::Friction;
use stiction::core::sim::noise::quantise;
use stiction::core::sim::process::ProcessModel;

/// Kinds of sticking loops, each with its own row in the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Regime {
    /// He's law, limit cycle with its start.
    HeStart,
    /// He's law, limit cycle, the first third or more not recorded.
    HeSteady,
    /// He's law, set-point moves.
    HeSetPoint,
    /// Tracking law, limit cycle with its start.
    TrackingStart,
    /// Tracking law, limit cycle, the first third or more not recorded.
    TrackingSteady,
    /// Tracking law, set-point moves.
    TrackingSetPoint,
    /// Noise of 0.5 to 2 % of PV's spread.
    LowNoise,
    /// Noise of 2 to 5 %.
    MiddleNoise,
    /// Noise of 5 to 10 %.
    HighNoise,
    /// 5 to 8 periods.
    FewCycles,
    /// 10 to 25 periods.
    ManyCycles,
    /// 50 to 80 samples per period.
    ShortPeriod,
    /// 80 to 300 samples per period.
    LongPeriod,
    /// First order and dead time.
    FirstOrder,
    /// Second order and dead time.
    SecondOrder,
    /// Integrating and dead time.
    Integrating,
    /// An unmodelled sine.
    UnknownSine,
    /// An unmodelled random walk.
    UnknownWalk,
    /// An unmodelled step.
    UnknownStep,
    /// Unmodelled coloured noise.
    UnknownColoured,
    /// An unmodelled ramp.
    UnknownRamp,
    /// A force-balance valve instead of a law.
    PhysicalValve,
    /// OP recorded in steps of 0.1.
    RoundedOp,
    /// Every other sample recorded.
    Decimated,
}

impl Regime {
    /// Every regime, in the order of tables.
    pub const ALL: [Self; 24] = [
        Self::HeStart,
        Self::HeSteady,
        Self::HeSetPoint,
        Self::TrackingStart,
        Self::TrackingSteady,
        Self::TrackingSetPoint,
        Self::LowNoise,
        Self::MiddleNoise,
        Self::HighNoise,
        Self::FewCycles,
        Self::ManyCycles,
        Self::ShortPeriod,
        Self::LongPeriod,
        Self::FirstOrder,
        Self::SecondOrder,
        Self::Integrating,
        Self::UnknownSine,
        Self::UnknownWalk,
        Self::UnknownStep,
        Self::UnknownColoured,
        Self::UnknownRamp,
        Self::PhysicalValve,
        Self::RoundedOp,
        Self::Decimated,
    ];

    /// The regime's name in tables and random streams.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::HeStart => "he start",
            Self::HeSteady => "he steady",
            Self::HeSetPoint => "he set point",
            Self::TrackingStart => "tracking start",
            Self::TrackingSteady => "tracking steady",
            Self::TrackingSetPoint => "tracking set point",
            Self::LowNoise => "noise .5-2 %",
            Self::MiddleNoise => "noise 2-5 %",
            Self::HighNoise => "noise 5-10 %",
            Self::FewCycles => "5-8 cycles",
            Self::ManyCycles => "10-25 cycles",
            Self::ShortPeriod => "period 50-80",
            Self::LongPeriod => "period 80-300",
            Self::FirstOrder => "first order",
            Self::SecondOrder => "second order",
            Self::Integrating => "integrating",
            Self::UnknownSine => "unknown sine",
            Self::UnknownWalk => "unknown walk",
            Self::UnknownStep => "unknown step",
            Self::UnknownColoured => "unknown coloured",
            Self::UnknownRamp => "unknown ramp",
            Self::PhysicalValve => "physical valve",
            Self::RoundedOp => "op rounded .1",
            Self::Decimated => "decimated by 2",
        }
    }

    /// Whether the valve follows a law, OP is recorded exactly, and PV has only white noise.
    #[must_use]
    pub const fn is_matched(self) -> bool {
        !matches!(self, Self::PhysicalValve | Self::RoundedOp | Self::Decimated) && !self.is_disturbed()
    }

    /// Whether an unmodelled disturbance moves PV.
    #[must_use]
    pub const fn is_disturbed(self) -> bool {
        matches!(
            self,
            Self::UnknownSine | Self::UnknownWalk | Self::UnknownStep | Self::UnknownColoured | Self::UnknownRamp
        )
    }

    fn law(self, draw: &mut Draw) -> ValveLaw {
        let any = if draw.chance(0.5) { ValveLaw::He } else { ValveLaw::Tracking };
        match self {
            Self::HeStart | Self::HeSteady | Self::HeSetPoint => ValveLaw::He,
            Self::TrackingStart | Self::TrackingSteady | Self::TrackingSetPoint => ValveLaw::Tracking,
            Self::PhysicalValve => ValveLaw::Physical,
            _ => any,
        }
    }

    fn shape(self, draw: &mut Draw) -> Shape {
        let any = draw.pick(&[Shape::Start, Shape::Steady, Shape::SetPoint], Shape::Start);
        let cycle = if any == Shape::SetPoint { Shape::Steady } else { any };
        match self {
            Self::HeStart | Self::TrackingStart => Shape::Start,
            Self::HeSteady | Self::TrackingSteady => Shape::Steady,
            Self::HeSetPoint | Self::TrackingSetPoint => Shape::SetPoint,
            // Only a cycle has a period.
            Self::FewCycles | Self::ManyCycles | Self::ShortPeriod | Self::LongPeriod => cycle,
            _ => any,
        }
    }

    fn noise(self, draw: &mut Draw) -> f64 {
        match self {
            Self::LowNoise => draw.log_between(0.005, 0.02),
            Self::MiddleNoise => draw.log_between(0.02, 0.05),
            Self::HighNoise => draw.log_between(0.05, 0.1),
            _ => draw.log_between(0.005, 0.1),
        }
    }

    /// Samples, and samples per period.
    fn length(self, draw: &mut Draw) -> (usize, f64) {
        let (cycles, periods) = match self {
            Self::FewCycles => ((5.0, 8.0), (125.0, 300.0)),
            Self::ManyCycles => ((10.0, 25.0), (50.0, 190.0)),
            Self::ShortPeriod => ((12.5, 25.0), (50.0, 80.0)),
            Self::LongPeriod => ((5.0, 23.0), (80.0, 300.0)),
            _ => ((5.0, 25.0), (50.0, 300.0)),
        };
        let period = draw.log_between(periods.0, periods.1);
        let (least, most) = ((1_000.0_f64).max(cycles.0 * period), (1_900.0_f64).min(cycles.1 * period));
        (draw.between(least.min(most), most) as usize, period)
    }

    /// The unmodelled disturbance, with half span 1.
    fn disturbance(self, draw: &mut Draw, period: f64, n: usize, from: usize) -> Option<Vec<f64>> {
        let (ends, at) = (n as f64, draw.between(0.2, 0.8));
        let at_s = from as f64 + at * (ends - from as f64);
        let shape = match self {
            Self::UnknownSine => {
                let ratio = draw.log_between(0.3, 3.0);
                return Some(draw.sine(period * ratio, n));
            }
            Self::UnknownWalk => Disturbance::RandomWalk { sd_per_root_s: 1.0 },
            Self::UnknownStep => Disturbance::Step { size: draw.sign(), at_s },
            Self::UnknownColoured => Disturbance::Ar1 { sd: 1.0, time_constant_s: period * draw.log_between(0.1, 1.0) },
            Self::UnknownRamp => {
                Disturbance::Ramp { size: draw.sign(), from_s: from as f64, over_s: (ends - from as f64) * (0.3 + at) }
            }
            _ => return None,
        };
        Some(draw.series(shape, n))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shape {
    Start,
    Steady,
    SetPoint,
}

impl Shape {
    const fn name(self) -> &'static str {
        match self {
            Self::Start => "limit cycle",
            Self::Steady => "steady limit cycle",
            Self::SetPoint => "set-point moves",
        }
    }
}

/// A process in units in which it takes about 20 scans, and the name of its order.
pub(super) fn process(draw: &mut Draw, kind: usize) -> (ProcessModel, &'static str) {
    let gain = draw.sign() * draw.log_between(0.4, 3.0) * draw.pick(&[0.1, 1.0, 4.0, 15.0], 1.0);
    let dead_time = 20.0 * draw.log_between(0.05, 0.8);
    let tau2 = 20.0 * draw.between(0.2, 0.8);
    match kind {
        0 => (ProcessModel { gain, tau: 20.0, tau2: 0.0, dead_time, integrating: false }, "first order"),
        1 => (ProcessModel { gain, tau: 20.0, tau2, dead_time, integrating: false }, "second order"),
        _ => {
            let gain = gain / 20.0;
            (ProcessModel { gain, tau: 0.0, tau2: 0.0, dead_time, integrating: true }, "integrating")
        }
    }
}

/// A physical valve whose friction ranges from staircase to smooth tracking at the speed of a cycle of `period` scans.
pub(super) fn physical(draw: &mut Draw, fs: f64, fd: f64, period: f64) -> Friction {
    let pace = 2.0 * (fs + fd) / period;
    let vs = pace * draw.log_between(0.1, 10.0);
    let lag = draw.between(0.1, 0.8);
    Friction::new(fs, fd, vs, draw.log_between(0.1, 1.5), lag)
}

/// Largest movement of the stem in one scan that counts as rest, OP units.
fn still(valve: &ValveModel) -> f64 {
    if valve.law == ValveLaw::Physical { 2e-3 * valve.fs } else { 1e-9 }
}

/// Whether a record can show its sticking valve: the stem moves several times, by more than a small part of its band, and the
/// band is not small compared with OP's travel.
pub(super) fn shows_stiction(valve: &ValveModel, seen: &Run) -> bool {
    let (s, _) = bands(valve);
    motions(&seen.mv, still(valve)) >= 4 && span(&seen.mv) >= 0.1 * s && s >= 0.08 * span(&seen.op)
}

/// True stick band and slip jump of a valve, OP units.
pub(super) fn bands(valve: &ValveModel) -> (f64, f64) {
    match valve.law {
        ValveLaw::Physical => valve.friction.measure(),
        _ => (valve.fs + valve.fd, valve.fs - valve.fd),
    }
}

pub(super) const fn law_name(law: ValveLaw) -> &'static str {
    match law {
        ValveLaw::None => "none",
        ValveLaw::He => "he",
        ValveLaw::Tracking => "tracking",
        ValveLaw::Physical => "physical",
    }
}

/// The rig of a limit cycle with the requested period (scans), from a run without noise; also that run and its initial offset,
/// OP units.
pub(super) fn cycling(mut rig: Rig, draw: &mut Draw, period: f64) -> Option<(Rig, Run, f64)> {
    const PILOT: usize = 2_400;
    // Away from the operating point, so that no stem position is in equilibrium.
    let start = draw.sign() * draw.between(0.6, 2.0) * rig.valve.fs;
    for _ in 0..2 {
        let mut drive = Drive::none(PILOT);
        drive.sp.fill(start * rig.pv_per_op(period));
        let run = rig.run(&drive, 0.0, 0);
        let (_, now) = turns(&run.mv, still(&rig.valve));
        let now = now?;
        if (now / period - 1.0).abs() < 0.1 {
            // Sustained: the last quarter oscillates like the one before.
            let (third, last) = (span(&run.pv[PILOT / 2..PILOT * 3 / 4]), span(&run.pv[PILOT * 3 / 4..]));
            return ((last / third - 1.0).abs() < 0.3).then_some((rig, run, start));
        }
        rig = rig.stretched(period / now);
    }
    let mut drive = Drive::none(PILOT);
    drive.sp.fill(start * rig.pv_per_op(period));
    let run = rig.run(&drive, 0.0, 0);
    let (_, now) = turns(&run.mv, still(&rig.valve));
    ((now? / period - 1.0).abs() < 0.2).then_some((rig, run, start))
}

/// One loop of `regime`, or `None` if the draw does not fit it.
pub(super) fn attempt(draw: &mut Draw, regime: Regime) -> Option<TruthLoop> {
    let law = regime.law(draw);
    let shape = regime.shape(draw);
    let share = regime.noise(draw);
    let every = if regime == Regime::Decimated { 2 } else { 1 };
    let (n, wanted) = regime.length(draw);
    let (n, wanted) = (n * every, wanted * every as f64);
    let kind = match regime {
        Regime::FirstOrder => 0,
        Regime::SecondOrder => 1,
        Regime::Integrating => 2,
        _ => draw.pick(&[0, 0, 0, 1, 2], 0),
    };
    let (process, process_kind) = process(draw, kind);
    let tight = draw.log_between(0.12, 0.5);
    let (kc, ti, td, _) = tune(draw, &process, tight)?;
    let fs = draw.log_between(0.8, 6.0);
    let valve = ValveModel { law, fs, fd: fs * draw.between(0.05, 0.9), ..ValveModel::HEALTHY };
    let as_law = ValveModel { law: if law == ValveLaw::Physical { ValveLaw::Tracking } else { law }, ..valve };
    let rig = Rig {
        process,
        kc,
        ti,
        td,
        valve: as_law,
        rest_op: draw.between(35.0, 65.0),
        rest_pv: process.gain.abs() * draw.between(20.0, 200.0) * if process.integrating { 20.0 } else { 1.0 },
        op_min: 0.0,
        op_max: 100.0,
        curvature: 0.0,
    };
    let (mut rig, pilot, start) = cycling(rig, draw, wanted)?;
    rig.valve = ValveModel { friction: physical(draw, fs, valve.fd, wanted), ..valve };

    // Inputs of the loop.
    let from = if shape == Shape::Steady { (n as f64 * draw.between(0.55, 1.0)) as usize } else { 0 };
    let total = n + from;
    let mut drive = Drive::none(total);
    let unit = rig.pv_per_op(wanted);
    let half_swing = 0.5 * span(&pilot.pv[pilot.pv.len() / 2..]);
    if shape == Shape::SetPoint {
        let size = unit * fs * draw.between(0.7, 3.0);
        let hold = draw.between(0.6, 1.5) * wanted.max(80.0);
        drive.sp = draw.steps(hold, total).iter().map(|x| x * size).collect();
    } else {
        drive.sp.fill(start * unit);
    }
    let size = draw.between(0.2, 1.0);
    let mut disturbance = 0.0;
    if let Some(series) = regime.disturbance(draw, wanted, total, from) {
        // Half of the disturbances enter at the process input; for a linear process that equals their response added to PV.
        let series = if !process.integrating && draw.chance(0.5) { rig.through_process(&series) } else { series };
        drive.pv = scaled(&series, size * half_swing);
        disturbance = size;
    }

    // The noise is relative to PV's spread without it.
    let calm = rig.run(&drive, 0.0, 0).thinned(from, every);
    let noise_sd = share * std_dev(&calm.pv);
    let mut run = rig.run(&drive, noise_sd, draw.seed()).thinned(from, every);
    let (s, j) = bands(&rig.valve);
    let moves = motions(&run.mv, still(&rig.valve));
    let (turned, _) = turns(&run.mv, still(&rig.valve));
    let inside = run.op.iter().all(|u| (0.5..=99.5).contains(u));
    let enough = moves >= 6 && turned >= if shape == Shape::SetPoint { 3 } else { 6 };
    if !(run.is_finite() && inside && enough && span(&run.op) > s && swing(&calm.pv) > 0.0) {
        return None;
    }
    if regime == Regime::RoundedOp {
        run.op.iter_mut().for_each(|u| *u = quantise(*u, 0.1));
    }
    let ts_s = draw.pick(&[0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0], 1.0);
    let recorded = rig.stretched(1.0 / every as f64);
    Some(TruthLoop {
        op: run.op,
        pv: run.pv,
        sp: run.sp,
        mv: run.mv,
        ts_s,
        noise_sd,
        floor_sd: regime.is_matched().then_some(noise_sd),
        sticks: true,
        law: law_name(law),
        s: Some(s),
        j: Some(j),
        process: recorded.process,
        controller: recorded.settings(ts_s),
        travel: [rig.valve.travel_min, rig.valve.travel_max],
        seed: 0,
        kind: shape.name(),
        process_kind,
        record_kind: match regime {
            Regime::RoundedOp => "op quantised",
            Regime::Decimated => "decimated",
            _ => "raw",
        },
        cause: "valve",
        regime: regime.name(),
        noise_share: share,
        period: wanted / every as f64,
        disturbance,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::{Half, accuracy};

    #[test]
    fn every_regime_is_reached() {
        for regime in Regime::ALL {
            for seed in 0..3 {
                let found = accuracy(Half::Calibration, regime, seed);
                assert!((990..=1_910).contains(&found.pv.len()), "{regime:?} {}", found.pv.len());
                let (s, j) = (found.s.unwrap(), found.j.unwrap());
                assert!(s > 0.0 && (0.0..=s).contains(&j) && span(&found.op) > s, "{regime:?} {seed}: {s} {j}");
                assert_eq!((found.regime, found.floor_sd.is_some()), (regime.name(), regime.is_matched()));
                assert!(found.cycles() < 26.0 && found.sticks && motions(&found.mv, 1e-9) >= 6);
            }
        }
    }
}
