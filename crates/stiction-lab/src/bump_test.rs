//! Runs the bump test that an estimate proposes on the simulated valve, and reads the result as the instructions say.

use serde::Serialize;

use crate::truth::draw::Draw;
use crate::truth::{Half, Regime, TruthLoop};
use stiction::core::guard::Excess;
use stiction::core::signal::stats;
use stiction::core::sim::closed_loop::{Stem, ValveLaw, ValveModel};
use stiction::core::sim::process::ProcessState;
use stiction::core::verdict::bump_test::{BumpTest, Refusal, bump_test};
use stiction::core::verdict::{AssessParams, Assessment, assess};

/// Limits of the noise levels, shares of PV's spread.
pub const NOISE: [f64; 5] = [0.005, 0.01, 0.02, 0.05, 0.1];
/// Valve laws, by their names in tables.
pub const LAWS: [&str; 2] = ["he", "tracking"];
/// Largest relative error of a band that counts as read well.
const CLOSE: f64 = 0.15;

/// Result for one loop: the test on its own valve, and the same test on a valve without friction.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trial {
    /// Seed of the loop.
    pub seed: u64,
    /// Valve law.
    pub law: &'static str,
    /// Noise relative to PV's spread without noise.
    pub noise_share: f64,
    /// The valve's band, OP units.
    pub truth: f64,
    /// The estimate's band, OP units.
    pub estimate: f64,
    /// Why no test was proposed.
    pub refused: Option<&'static str>,
    /// Band read from the test; `None` if no test was proposed or it was stopped.
    pub read: Option<f64>,
    /// Band read from the valve without friction.
    pub read_healthy: Option<f64>,
    /// Least band that the test distinguishes from zero, OP units.
    pub detects: f64,
    /// Largest travel of PV relative to the expected one.
    pub travel_ratio: f64,
    /// Duration relative to the stated one.
    pub time_ratio: f64,
}

/// Simulates and assesses the loop of a seed and law, and runs the test that the estimate proposes.
#[must_use]
pub fn sticking(half: Half, law: &'static str, seed: u64) -> Option<Trial> {
    const REGIMES: [[Regime; 3]; 2] = [
        [Regime::HeStart, Regime::HeSteady, Regime::HeSetPoint],
        [Regime::TrackingStart, Regime::TrackingSteady, Regime::TrackingSetPoint],
    ];
    let of_law = REGIMES[usize::from(law == LAWS[1])];
    let case = crate::truth::accuracy(half, of_law[(seed % 3) as usize], seed);
    let a = assess(&case.record(), &AssessParams { always_fit: true, ..AssessParams::default() });
    // A test is proposed only if stiction was found.
    (a.stiction == Some(true)).then(|| trial(&case, &a))
}

fn trial(case: &TruthLoop, a: &Assessment) -> Trial {
    let out = Trial {
        seed: case.seed,
        law: case.law,
        noise_share: case.noise_share,
        truth: case.s.unwrap_or(0.0),
        estimate: a.s.unwrap_or(f64::NAN),
        refused: None,
        read: None,
        read_healthy: None,
        detects: f64::NAN,
        travel_ratio: f64::NAN,
        time_ratio: f64::NAN,
    };
    match bump_test(a) {
        Ok(plan) => {
            let healthy = Person::new(&TruthLoop { law: "none", ..case.clone() }, &plan).carry_out();
            let read_healthy = healthy.map(|counts| plan.band(counts));
            let mut person = Person::new(case, &plan);
            let read = person.carry_out().map(|counts| plan.band(counts));
            let travel_ratio = person.furthest / plan.travel_pv;
            let time_ratio = person.scans as f64 * case.ts_s / plan.total_s;
            Trial { read, read_healthy, detects: plan.detects(), travel_ratio, time_ratio, ..out }
        }
        Err(refusal) => Trial { refused: Some(name(refusal)), ..out },
    }
}

const fn name(refusal: Refusal) -> &'static str {
    match refusal {
        Refusal::NoSize => "no model",
        Refusal::Integrating => "integrating",
        Refusal::Noise(..) => "noise",
        Refusal::TooMuch(Excess::Travel(..)) => "PV's travel",
        Refusal::TooMuch(Excess::Duration(_)) => "duration",
    }
}

/// A person at the controller in manual, who sees PV with its noise.
struct Person<'t> {
    plan: &'t BumpTest,
    valve: ValveModel,
    stem: Stem,
    process: ProcessState,
    /// Valve position at which an integrating process keeps its level, OP units.
    rest: f64,
    draw: Draw,
    noise_sd: f64,
    ts_s: f64,
    /// Sign of the process gain.
    sign: f64,
    op: f64,
    /// PV before the test, and its largest travel from there, without noise.
    start: f64,
    furthest: f64,
    scans: u64,
}

impl<'t> Person<'t> {
    fn new(case: &TruthLoop, plan: &'t BumpTest) -> Self {
        let mut draw = Draw::new(case.seed, "bump test");
        let (s, j) = (case.s.unwrap_or(0.0), case.j.unwrap_or(0.0));
        let (fs, fd) = (0.5 * (s + j), 0.5 * (s - j));
        let law = match case.law {
            "he" => ValveLaw::He,
            "tracking" => ValveLaw::Tracking,
            _ => ValveLaw::None,
        };
        let op = stats::mean(&case.op);
        // The stem rests at a random position in its band.
        let position = op + 0.999 * fs * draw.between(-1.0, 1.0);
        let mut process = ProcessState::at_rest(case.process, position);
        let start = process.step(position, position);
        Self {
            plan,
            valve: ValveModel { law, fs, fd, ..ValveModel::HEALTHY },
            stem: Stem::at_rest(position),
            process,
            rest: position,
            draw,
            noise_sd: case.noise_sd,
            ts_s: case.ts_s,
            sign: case.process.gain.signum(),
            op,
            start,
            furthest: 0.0,
            scans: 0,
        }
    }

    /// Holds OP and reads PV as its mean over the last third.
    fn hold(&mut self, seconds: f64) -> f64 {
        let scans = (seconds / self.ts_s).ceil().max(3.0) as usize;
        let from = scans - scans / 3;
        let mut sum = 0.0;
        for k in 0..scans {
            self.stem = self.valve.step(self.stem, self.op);
            let pv = self.process.step(self.stem.position, self.rest);
            self.furthest = self.furthest.max((pv - self.start).abs());
            self.scans += 1;
            if k >= from {
                sum += pv + self.noise_sd * self.draw.gaussian();
            }
        }
        sum / (scans - from) as f64
    }

    /// Steps OP towards `direction` until PV moves that way, then waits; returns the number of steps, and PV afterwards.
    fn until_it_moves(&mut self, direction: f64, first_share: f64, from: f64, begin: f64) -> Option<(u32, f64)> {
        for n in 1..=self.plan.most_steps {
            let share = if n == 1 { first_share } else { 1.0 };
            self.op += direction * share * self.plan.step_op;
            let pv = self.hold(self.plan.hold_s);
            if (pv - begin).abs() > self.plan.limit_pv {
                return None;
            }
            if direction * self.sign * (pv - from) > self.plan.moved_pv {
                return Some((n, self.hold(self.plan.settle_s)));
            }
        }
        None
    }

    /// The counts of both reversals; `None` if the test was stopped.
    fn carry_out(&mut self) -> Option<[u32; 2]> {
        let begin = self.hold(self.plan.settle_s);
        let (_, up) = self.until_it_moves(1.0, 1.0, begin, begin)?;
        let (back, down) = self.until_it_moves(-1.0, 1.0, up, begin)?;
        let (forth, _) = self.until_it_moves(1.0, 0.5, down, begin)?;
        Some([back, forth])
    }
}

/// A row of the table: the trials for one law and one level of noise.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Law.
    pub law: &'static str,
    /// Limits of the noise level, shares of PV's spread.
    pub noise: [f64; 2],
    /// Estimates that found stiction.
    pub estimates: usize,
    /// Tests proposed.
    pub tests: usize,
    /// Tests stopped by a criterion.
    pub ended: usize,
    /// Bands read within 15 % of the truth.
    pub close: usize,
    /// Median and 90th percentile of the error, % of the truth.
    pub error_pct: [f64; 2],
    /// 90th percentiles of PV's travel over the expected one, and of the duration over the stated one.
    pub travel_and_time: [f64; 2],
    /// Valves without friction on which the test read less than it can detect.
    pub healthy_below: usize,
}

impl Row {
    fn of(law: &'static str, noise: [f64; 2], trials: &[&Trial]) -> Self {
        let done: Vec<&&Trial> = trials.iter().filter(|t| t.refused.is_none()).collect();
        let error = |t: &&&Trial| t.read.map_or(f64::INFINITY, |read| (read / t.truth - 1.0).abs());
        let errors: Vec<f64> = done.iter().map(error).collect();
        let decile = |x: &[f64], share: f64| {
            let sorted = stats::sorted(x);
            sorted.get(((share * sorted.len() as f64).ceil() as usize).max(1) - 1).copied().unwrap_or(f64::NAN)
        };
        let of = |figure: fn(&Trial) -> f64| decile(&done.iter().map(|t| figure(t)).collect::<Vec<_>>(), 0.9);
        Self {
            law,
            noise,
            estimates: trials.len(),
            tests: done.len(),
            ended: done.iter().filter(|t| t.read.is_none()).count(),
            close: errors.iter().filter(|e| **e <= CLOSE).count(),
            error_pct: [0.5, 0.9].map(|share| 100.0 * decile(&errors, share)),
            travel_and_time: [of(|t| t.travel_ratio), of(|t| t.time_ratio)],
            healthy_below: done.iter().filter(|t| t.read_healthy.is_some_and(|read| read < t.detects)).count(),
        }
    }
}

/// Rows by law and noise, then the total.
#[must_use]
pub fn table(trials: &[Trial]) -> Vec<Row> {
    let mut out = Vec::new();
    for law in LAWS {
        for level in NOISE.windows(2) {
            let inside = |t: &&Trial| t.law == law && (level[0]..level[1]).contains(&t.noise_share);
            out.push(Row::of(law, [level[0], level[1]], &trials.iter().filter(inside).collect::<Vec<_>>()));
        }
    }
    out.push(Row::of("both", [NOISE[0], NOISE[4]], &trials.iter().collect::<Vec<_>>()));
    out
}

/// The first trials in order whose estimate proposes a test, at most `count` per law and level of noise; until then trials
/// without a test are kept, too.
#[must_use]
pub fn enough(trials: Vec<Trial>, count: usize) -> Vec<Trial> {
    let mut taken = [[0_usize; 4]; 2];
    let place = |t: &Trial| {
        let level = NOISE.windows(2).position(|l| (l[0]..l[1]).contains(&t.noise_share))?;
        Some((usize::from(t.law == LAWS[1]), level))
    };
    let mut keep = |t: &Trial| {
        let Some((law, level)) = place(t) else { return false };
        let full = taken[law][level] >= count;
        taken[law][level] += usize::from(!full && t.refused.is_none());
        !full
    };
    trials.into_iter().filter(|t| keep(t)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_band_is_read_off_the_valve_and_off_none() {
        let trials: Vec<Trial> =
            (0..6).flat_map(|seed| LAWS.map(|law| sticking(Half::Calibration, law, seed))).flatten().collect();
        let row = table(&trials).pop().unwrap();
        assert!(row.tests >= 4 && row.close == row.tests && row.healthy_below == row.tests, "{row:?}");
    }
}
