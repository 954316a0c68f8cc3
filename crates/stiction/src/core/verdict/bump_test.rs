//! The bump test: how to measure a valve's band by hand. An estimate gives its size, or a reason to propose none.
//!
//! In manual, OP moves in one direction in steps of about s / 4 until PV moves: from then on the stem follows OP. OP is
//! reversed; the number of steps until PV moves back measures the band. A second reversal begins with half a step, so its count
//! halves the uncertainty. `stiction-lab calibrate --bump-test` runs the test on simulated valves.

use serde::{Deserialize, Serialize};

use super::Assessment;
use crate::core::guard::{self, Excess, PV_SPANS};
use crate::core::people::{about, at_least, op_step, size};
use crate::core::sim::process::{separated, series_weights};
use crate::core::units::number;

/// Steps as shares of s, finest first: a coarser step is used if noise hides the finer ones.
const SHARES: [f64; 3] = [0.25, 1.0 / 3.0, 0.5];
/// Length of a hold after the dead time, in sums of the time constants; the next is for the wait until PV is steady.
const HOLD: f64 = 1.5;
const SETTLE: f64 = 4.0;
/// Fewest samples in a hold after the dead time.
const SAMPLES: f64 = 6.0;
/// PV counts as moved when its mean changes by this share of a step's effect, or by the least change above the noise.
const MOVED: f64 = 0.3;
/// Most bands by which OP moves in one direction before the test ends without an answer.
const MOST_BANDS: f64 = 2.5;

/// A bump test with its sizes, in OP and PV units of the record.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BumpTest {
    /// The band for which the test is sized, OP units.
    pub s: f64,
    /// Each step of OP, OP units.
    pub step_op: f64,
    /// How long OP is held after a step, s. PV is read as its mean over the last third.
    pub hold_s: f64,
    /// How long PV takes to become steady, s.
    pub settle_s: f64,
    /// PV counts as moved when its mean changes by this, PV units.
    pub moved_pv: f64,
    /// Steps in one direction after which the test ends without an answer.
    pub most_steps: u32,
    /// Expected travel of PV, PV units.
    pub travel_pv: f64,
    /// Travel of PV at which the test must be stopped, PV units.
    pub limit_pv: f64,
    /// Duration of the test, s.
    pub total_s: f64,
}

/// Why no bump test is proposed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Refusal {
    /// No size is known.
    NoSize,
    /// PV of an integrating process does not settle in manual.
    Integrating,
    /// Noise hides the effect of the largest step: standard deviation of the model's residual, effect of half a band, PV units.
    Noise(f64, f64),
    /// The test would demand too much of the loop.
    TooMuch(Excess),
}

/// The test for an estimate, or why none is proposed.
///
/// # Errors
/// [`Refusal`].
pub fn bump_test(a: &Assessment) -> Result<BumpTest, Refusal> {
    let s = a.s.filter(|s| *s > 0.0).ok_or(Refusal::NoSize)?;
    let process = a.process.as_ref().ok_or(Refusal::NoSize)?;
    if process.integrating {
        return Err(Refusal::Integrating);
    }
    let ts_s = if a.window.ts_s.is_finite() { a.window.ts_s } else { 0.0 };
    let lag_s: f64 = process.time_constants_s.iter().sum();
    let hold_s = process.dead_time_s + (HOLD * lag_s).max(SAMPLES * ts_s);
    let settle_s = process.dead_time_s + (SETTLE * lag_s).max(SAMPLES * ts_s);
    // Response to a stem move by the middle of the last third.
    let gain = process.gain.abs();
    let visible = gain * settled(&process.time_constants_s, 5.0 / 6.0 * hold_s - process.dead_time_s);
    let hidden = guard::hidden_below(process.mse, hold_s / (3.0 * ts_s));
    let j = a.j.unwrap_or(0.0);
    let share = SHARES.into_iter().find(|share| hidden <= visible * (0.5 * share * s).max(j));
    let Some(share) = share else { return Err(Refusal::Noise(process.mse.sqrt(), visible * 0.5 * s)) };
    let step_op = share * s;
    let per_band = (1.0 / share).ceil();
    let first_steps = (s + j) / step_op + 1.0;
    let total_s = 3.0 * settle_s + (first_steps.ceil() + 2.0 * per_band + 3.0) * hold_s;
    let travel_pv = gain * (j + step_op);
    let pv_span = a.pv_span.unwrap_or(f64::INFINITY);
    if let Some(excess) = guard::excess(travel_pv, pv_span, total_s) {
        return Err(Refusal::TooMuch(excess));
    }
    Ok(BumpTest {
        s,
        step_op,
        hold_s,
        settle_s,
        moved_pv: (MOVED * visible * step_op).max(hidden),
        most_steps: (MOST_BANDS / share).ceil() as u32,
        travel_pv,
        limit_pv: (2.0 * travel_pv).min(PV_SPANS * pv_span),
        total_s,
    })
}

/// Share of its final value that a step response reaches `after_s` past the dead time.
fn settled(time_constants_s: &[f64], after_s: f64) -> f64 {
    let one = |tau: f64| if tau > 0.0 { -libm::expm1(-after_s.max(0.0) / tau) } else { 1.0 };
    match *time_constants_s {
        [first, second] if second > 0.0 => {
            let (tau1, tau2) = separated(first, second);
            let (w1, w2) = series_weights(tau1, tau2);
            w1 * one(tau1) + w2 * one(tau2)
        }
        _ => one(time_constants_s.first().copied().unwrap_or(0.0)),
    }
}

impl BumpTest {
    /// The band from the counts of both reversals, OP units: the mean of the midpoints of the two possible ranges.
    #[must_use]
    pub fn band(&self, [back, forth]: [u32; 2]) -> f64 {
        0.5 * self.step_op * (f64::from(back) + f64::from(forth) - 1.5)
    }

    /// The smallest band that the test can distinguish from zero, OP units.
    #[must_use]
    pub const fn detects(&self) -> f64 {
        self.step_op
    }

    /// The test as instructions, one step per item.
    #[must_use]
    pub fn steps(&self, op_unit: &str) -> Vec<String> {
        let step_op = op_step(self.step_op);
        let [step, half] = [step_op, 0.5 * step_op].map(number);
        let ([hold, settle], total) = ([self.hold_s, self.settle_s].map(at_least), about(self.total_s));
        let [moved, travel, limit, s] = [self.moved_pv, self.travel_pv, self.limit_pv, self.s].map(size);
        vec![
            format!(
                "Agree with operations on about {total} in manual. PV is expected to move by about {travel} PV units. Check \
                 that no alarm limit, interlock or downstream loop is within reach, and put a cascade's master in manual too."
            ),
            format!(
                "Put the controller in manual and wait {settle} until PV is steady. If PV keeps ramping, the loop integrates: \
                 do not continue. Write down OP and PV."
            ),
            format!(
                "Step OP one way by {step} {op_unit}. Hold each step for {hold} and write down OP and the mean of PV over the \
                 last third of the hold. Stop stepping when PV has moved by more than {moved} PV units; wait {settle}."
            ),
            format!(
                "Reverse OP in the same steps and count them until PV moves back by more than {moved} PV units: this is n1. \
                 Wait {settle}."
            ),
            format!(
                "Reverse once more: the first step is {half} {op_unit}, the others {step}. Count until PV moves: this is n2."
            ),
            format!(
                "The band is s = {step} x (n1 + n2 - 1.5) / 2 {op_unit}. About {s} confirms the estimate. Less than {step} \
                 means that the valve shows no band that this test can see."
            ),
            format!(
                "End the test and set OP back to where it began if PV goes further than {limit} PV units from where it began, \
                 or if {} steps one way do not move PV (the band is larger than expected, or the valve does not move).",
                self.most_steps
            ),
        ]
    }

    /// The test in one sentence, for an alarm.
    #[must_use]
    pub fn brief(&self, op_unit: &str) -> String {
        format!(
            "Bump test, with operations' consent and the controller in manual: step OP by {} {op_unit} one way until PV moves, \
             reverse until it moves, and count the steps (about {}; PV moves by about {} PV units; stop if it goes further than {}).",
            number(op_step(self.step_op)),
            about(self.total_s),
            size(self.travel_pv),
            size(self.limit_pv)
        )
    }
}

/// Recommended action if no bump test is proposed.
const OTHER_TEST: &str = "Have a valve signature recorded (travel against signal, slowly up and down, with the loop out of \
     service), or trend the position feedback against OP over several reversals of OP.";

impl Refusal {
    /// Why no test is proposed.
    #[must_use]
    pub fn words(&self) -> String {
        match self {
            Self::NoSize => "the size is not known".to_owned(),
            Self::Integrating => "the process integrates, so PV does not settle in manual".to_owned(),
            Self::Noise(noise, gives) => format!(
                "noise and disturbances of PV ({} PV units) hide what a step gives (at most {} PV units)",
                size(*noise),
                size(*gives)
            ),
            Self::TooMuch(excess) => excess.words(),
        }
    }

    /// Why no test is proposed, and what to do instead.
    #[must_use]
    pub fn instead(&self) -> String {
        format!("No bump test is proposed: {}. {OTHER_TEST}", self.words())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::record::Record;
    use crate::core::verdict::{Oscillation, Process, Window};

    fn estimate(s: f64, j: f64, pv_span: f64) -> Assessment {
        let window = Window::of(&Record::uniform(1.0, vec![0.0; 40], vec![0.0; 40]));
        let oscillation = Oscillation {
            oscillating: true,
            period_s: Some(100.0),
            periods: None,
            samples_per_period: None,
            regularity: None,
        };
        let process = Process {
            order: 1,
            gain: -2.0,
            time_constants_s: vec![20.0],
            dead_time_s: 6.0,
            integrating: false,
            mse: 0.01,
            fit_pct: 90.0,
            tested: true,
            gain_interval: None,
            dead_time_interval_s: None,
        };
        Assessment {
            s: Some(s),
            j: Some(j),
            pv_span: Some(pv_span),
            process: Some(process),
            ..Assessment::empty(window, oscillation)
        }
    }

    #[test]
    fn the_test_follows_from_s_and_the_process() {
        let t = bump_test(&estimate(8.0, 3.0, 10.0)).unwrap();
        assert_eq!((t.step_op, t.hold_s, t.settle_s, t.travel_pv), (2.0, 36.0, 86.0, 10.0));
        assert!(t.total_s < 1_000.0 && t.limit_pv == 20.0 && t.most_steps == 10, "{t:?}");
        // s is the reading if PV moves at the fourth or fifth step: within an eighth of a band.
        assert_eq!([t.band([4, 4]), t.band([5, 5]), t.band([1, 1])], [6.5, 8.5, 0.5]);
        assert!(t.band([1, 2]) < t.detects());
        let words = t.steps("%").join(" ");
        // Rounded up, so that PV has enough time.
        assert!(words.contains("for 40 s") && words.contains("wait 90 s"), "{words}");
        assert!(words.contains("by 2 %") && words.contains("n1 + n2 - 1.5") && words.contains("interlock"), "{words}");
    }

    #[test]
    fn no_test_goes_beyond_the_guard_and_each_refusal_says_what_else_to_do() {
        let refused = |a: &Assessment| bump_test(a).unwrap_err();
        assert_eq!(refused(&estimate(8.0, 8.0, 9.0)), Refusal::TooMuch(Excess::Travel(20.0, 9.0)));
        let mut slow = estimate(8.0, 3.0, 10.0);
        slow.process.iter_mut().for_each(|p| p.time_constants_s = vec![2_000.0]);
        assert!(matches!(refused(&slow), Refusal::TooMuch(Excess::Duration(t)) if t > guard::SHIFT_S));
        let mut noisy = estimate(8.0, 0.0, 10.0);
        noisy.process.iter_mut().for_each(|p| p.mse = 100.0);
        assert!(matches!(refused(&noisy), Refusal::Noise(..)));
        let mut level = estimate(8.0, 0.0, 10.0);
        level.process.iter_mut().for_each(|p| p.integrating = true);
        let said = refused(&level).instead();
        assert!(said.contains("No bump test is proposed") && said.contains("valve signature"), "{said}");
        level.s = None;
        assert_eq!(refused(&level), Refusal::NoSize);
    }

    #[test]
    fn what_two_lags_have_made_is_what_they_make_one_after_the_other() {
        let [a, b] = [settled(&[20.0, 5.0], 25.0), settled(&[20.0, 20.0], 40.0)];
        let exact = 1.0 - (20.0 * libm::exp(-25.0 / 20.0) - 5.0 * libm::exp(-5.0)) / 15.0;
        assert!((a - exact).abs() < 1e-12 && (b - (1.0 - 3.0 * libm::exp(-2.0))).abs() < 1e-6, "{a} {b}");
    }
}
