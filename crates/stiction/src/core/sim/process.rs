//! Process models: first order, second order and integrating, with a continuous dead time and exact discretisation.
//!
//! The valve signal is held between samples, so each model is a recursion with two taps: for a lag of `l + f`
//! samples (whole part `l`, fraction `f`),
//! `x[k] = a x[k-1] + b0 v[k-l] + b1 v[k-l-1]`, `a = exp(-1/tau)`, `b0 = 1 - exp(-(1-f)/tau)`, `b1 = 1 - a - b0`.
//! A lag is the dead time plus the one sample that a held signal needs to act, so PV never responds to OP of its own scan.

/// Recursion of a pole with unit static gain (or a unit integrator) after a hold and a fractional delay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pole {
    /// Weight of the last value.
    pub a: f64,
    /// Weight of the newer tap.
    pub b0: f64,
    /// Weight of the older tap.
    pub b1: f64,
}

impl Pole {
    /// First-order lag of `tau` samples (> 0), input delayed by `fraction` of a sample (0..1).
    #[must_use]
    pub fn lag(tau: f64, fraction: f64) -> Self {
        let a = libm::exp(-1.0 / tau);
        let b0 = 1.0 - libm::exp(-(1.0 - fraction) / tau);
        Self { a, b0, b1: 1.0 - a - b0 }
    }

    /// Integrator that gains its input each sample, input delayed by `fraction` of a sample (0..1).
    #[must_use]
    pub fn integrator(fraction: f64) -> Self {
        Self { a: 1.0, b0: 1.0 - fraction, b1: fraction }
    }

    /// Runs the recursion over `v` with `lag` whole samples into `out` (same length), from the state `x0` with the
    /// input before the record held at `v[0]`. Four values at a time: the chain from value to value is a quarter as long.
    pub fn run(&self, lag: usize, v: &[f64], x0: f64, out: &mut Vec<f64>) {
        out.resize(v.len(), 0.0);
        let Some(first) = v.first() else { return };
        let Self { a, b0, b1 } = *self;
        let (n, head, mut x) = (v.len(), (lag + 1).min(v.len()), x0);
        for (k, slot) in out.iter_mut().take(head).enumerate() {
            let newer = if k >= lag { v[k - lag] } else { *first };
            x = a * x + (b0 * newer + b1 * first);
            *slot = x;
        }
        let [a2, a3, a4] = [a * a, a * a * a, (a * a) * (a * a)];
        let (slots, last) = out[head..].as_chunks_mut::<4>();
        let (older, last_older) = v[..n - head].as_chunks::<4>();
        let (newer, last_newer) = v[1..=n - head].as_chunks::<4>();
        for ((slot, o), w) in slots.iter_mut().zip(older).zip(newer) {
            let input: [f64; 4] = core::array::from_fn(|k| b0 * w[k] + b1 * o[k]);
            let p1 = a * input[0] + input[1];
            let p2 = a * p1 + input[2];
            let p3 = a * p2 + input[3];
            *slot = [a * x + input[0], a2 * x + p1, a3 * x + p2, a4 * x + p3];
            x = slot[3];
        }
        for ((slot, o), w) in last.iter_mut().zip(last_older).zip(last_newer) {
            x = a * x + (b0 * w + b1 * o);
            *slot = x;
        }
    }
}

/// Weights of two unit lags in parallel that equal the same two in series: `w1 x1 + w2 x2`, `tau1 != tau2`.
#[must_use]
pub(crate) fn series_weights(tau1: f64, tau2: f64) -> (f64, f64) {
    (tau1 / (tau1 - tau2), -tau2 / (tau1 - tau2))
}

/// Two time constants that [`series_weights`] can use: (nearly) equal ones are separated by 0.05 % around their mean, which
/// changes their response by less than 1e-7 of its size.
#[must_use]
pub(crate) fn separated(tau1: f64, tau2: f64) -> (f64, f64) {
    let mean = 0.5 * (tau1 + tau2);
    if (tau1 - tau2).abs() >= 1e-3 * mean { (tau1, tau2) } else { (mean * 1.0005, mean * 0.9995) }
}

/// Process parameters in samples; the stepping form is [`ProcessState`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProcessModel {
    /// Static gain, or gain per sample if integrating.
    pub gain: f64,
    /// First (or only) time constant, samples; not used if integrating without a second lag.
    pub tau: f64,
    /// Second time constant, samples; 0 for first order.
    pub tau2: f64,
    /// Dead time, samples, fractions allowed.
    pub dead_time: f64,
    /// Integrating instead of self-regulating; `tau` is then a lag before the integrator (0 for none).
    pub integrating: bool,
}

/// The poles of a process with their states: every model is a sum of poles with the same two taps (partial fractions), so each
/// is exact for a held input; two lags use `series_weights`, a lag before an integrator is `1/s - tau/(tau s + 1)`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Poles {
    gain: f64,
    branches: [Branch; 2],
}

/// One pole of the sum: its recursion, weight and state.
#[derive(Debug, Clone, Copy)]
struct Branch {
    pole: Pole,
    weight: f64,
    x: f64,
}

impl Branch {
    const NONE: Self = Self { pole: Pole { a: 0.0, b0: 0.0, b1: 0.0 }, weight: 0.0, x: 0.0 };
}

impl Poles {
    /// A process at rest with its input at `v0` (an integrator is at 0); the input comes `fraction` of a sample late.
    #[must_use]
    pub(crate) fn at_rest(model: &ProcessModel, fraction: f64, v0: f64) -> Self {
        let lag = |tau: f64, weight: f64, x: f64| Branch { pole: Pole::lag(tau, fraction), weight, x };
        let branches = match (model.integrating, model.tau > 0.0, model.tau2 > 0.0) {
            (true, false, _) => [Branch { pole: Pole::integrator(fraction), weight: 1.0, x: 0.0 }, Branch::NONE],
            (true, true, _) => {
                [Branch { pole: Pole::integrator(fraction), weight: 1.0, x: 0.0 }, lag(model.tau, -model.tau, 0.0)]
            }
            (false, true, true) => {
                let (tau1, tau2) = separated(model.tau, model.tau2);
                let (w1, w2) = series_weights(tau1, tau2);
                [lag(tau1, w1, v0), lag(tau2, w2, v0)]
            }
            (false, _, _) => [lag(model.tau.max(model.tau2).max(1e-6), 1.0, v0), Branch::NONE],
        };
        Self { gain: model.gain, branches }
    }

    /// The next output, from the newer and older taps of the input.
    pub(crate) fn step(&mut self, newer: f64, older: f64) -> f64 {
        let mut out = 0.0;
        for Branch { pole, weight, x } in &mut self.branches {
            *x = pole.a * *x + pole.b0 * newer + pole.b1 * older;
            out += *weight * *x;
        }
        self.gain * out
    }
}

/// A process model with its state, advanced sample by sample.
#[derive(Debug, Clone)]
pub struct ProcessState {
    integrating: bool,
    poles: Poles,
    history: Vec<f64>,
    newest: usize,
    lag: usize,
}

impl ProcessState {
    /// A process at rest with the valve at `v0` (an integrating one keeps its level there).
    #[must_use]
    pub fn at_rest(model: ProcessModel, v0: f64) -> Self {
        let dead_time = model.dead_time.max(0.0);
        let lag = dead_time as usize;
        let poles = Poles::at_rest(&model, dead_time.fract(), v0);
        Self { integrating: model.integrating, poles, history: vec![v0; lag + 2], newest: 0, lag }
    }

    /// PV (without noise) of this sample, given the valve position held since the sample before.
    ///
    /// `rest` is the valve position at which an integrating process keeps its level; other processes ignore it.
    pub fn step(&mut self, valve: f64, rest: f64) -> f64 {
        let n = self.history.len();
        self.newest = (self.newest + 1) % n;
        self.history[self.newest] = valve;
        let tap = |back: usize| self.history[(self.newest + n - back % n) % n];
        let offset = if self.integrating { rest } else { 0.0 };
        let (newer, older) = (tap(self.lag) - offset, tap(self.lag + 1) - offset);
        self.poles.step(newer, older)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_reaches_63_per_cent_after_dead_time_and_tau() {
        let model = ProcessModel { gain: 2.0, tau: 20.0, tau2: 0.0, dead_time: 5.0, integrating: false };
        let mut process = ProcessState::at_rest(model, 0.0);
        let out: Vec<f64> = (0..60).map(|_| process.step(1.0, 0.0)).collect();
        assert_eq!(out[4], 0.0);
        // The first step() already covers one sample: 25 samples after the change, 20 after the dead time.
        assert!((out[24] - 2.0 * (1.0 - libm::exp(-1.0))).abs() < 1e-12);
    }

    #[test]
    fn the_stepper_and_the_filter_are_one_model() {
        let v: Vec<f64> = (0..80).map(|k| if (k / 13) % 2 == 0 { 1.0 } else { -0.5 }).collect();
        let model = ProcessModel { gain: 1.0, tau: 7.0, tau2: 0.0, dead_time: 3.4, integrating: false };
        let mut process = ProcessState::at_rest(model, v[0]);
        let stepped: Vec<f64> = v.iter().map(|&x| process.step(x, 0.0)).collect();
        let mut filtered = Vec::new();
        Pole::lag(7.0, 0.4).run(3, &v, v[0], &mut filtered);
        for (a, b) in stepped.iter().zip(&filtered) {
            assert!((a - b).abs() < 1e-12);
        }
    }

    #[test]
    fn a_fractional_delay_lies_between_the_whole_ones() {
        let v: Vec<f64> = (0..40).map(|k| f64::from(u8::from(k >= 5))).collect();
        let run = |delay: f64| {
            let mut out = Vec::new();
            Pole::lag(4.0, delay.fract()).run(delay as usize, &v, 0.0, &mut out);
            out[12]
        };
        assert!(run(3.0) > run(3.5) && run(3.5) > run(4.0));
    }

    #[test]
    fn a_run_is_its_recursion_value_by_value() {
        let v: Vec<f64> = (0..61).map(|k| libm::sin(f64::from(k) * 0.7)).collect();
        for (pole, lag) in [(Pole::lag(7.0, 0.4), 3), (Pole::integrator(0.2), 0), (Pole::lag(2.0, 0.9), 80)] {
            let at = |k: i32| v[k.max(0) as usize];
            let mut x = 0.5;
            let mut out = vec![9.0; 7];
            pole.run(lag, &v, 0.5, &mut out);
            assert_eq!(out.len(), v.len());
            for (k, found) in (0..).zip(&out) {
                x = pole.a * x + pole.b0 * at(k - lag as i32) + pole.b1 * at(k - lag as i32 - 1);
                assert!((x - found).abs() < 1e-12, "{k}");
            }
        }
        Pole::lag(2.0, 0.0).run(3, &[], 0.0, &mut Vec::new());
    }

    #[test]
    fn lags_in_series_settle_at_the_gain() {
        let (w1, w2) = series_weights(9.0, 4.0);
        assert!((w1 + w2 - 1.0).abs() < 1e-12);
        let model = ProcessModel { gain: 3.0, tau: 9.0, tau2: 4.0, dead_time: 0.0, integrating: false };
        let mut process = ProcessState::at_rest(model, 0.0);
        let last = (0..300).map(|_| process.step(1.0, 0.0)).last().unwrap();
        assert!((last - 3.0).abs() < 1e-9);
    }

    #[test]
    fn an_integrator_holds_its_level_at_rest() {
        let model = ProcessModel { gain: 0.1, tau: 0.0, tau2: 0.0, dead_time: 2.0, integrating: true };
        let mut process = ProcessState::at_rest(model, 40.0);
        assert_eq!((0..50).map(|_| process.step(40.0, 40.0)).last().unwrap(), 0.0);
        let level: Vec<f64> = (0..10).map(|_| process.step(41.0, 40.0)).collect();
        assert!((level[9] - 0.1 * 8.0).abs() < 1e-12);
    }

    /// The response of two lags in series to a unit step, from the textbook.
    fn two_lags(tau1: f64, tau2: f64, t: f64) -> f64 {
        if tau1 == tau2 {
            return 1.0 - (1.0 + t / tau1) * libm::exp(-t / tau1);
        }
        1.0 - (tau1 * libm::exp(-t / tau1) - tau2 * libm::exp(-t / tau2)) / (tau1 - tau2)
    }

    #[test]
    fn second_order_steps_are_exact_also_with_equal_lags_and_a_broken_dead_time() {
        for (tau, tau2, tolerance) in [(9.0, 4.0, 1e-12), (4.0, 9.0, 1e-12), (6.0, 6.0, 1e-6), (6.0, 6.001, 1e-6)] {
            let model = ProcessModel { gain: 2.0, tau, tau2, dead_time: 2.3, integrating: false };
            let mut process = ProcessState::at_rest(model, 0.0);
            for k in 1..80 {
                let want = 2.0 * two_lags(tau, tau2, (f64::from(k) - 2.3).max(0.0));
                assert!((process.step(1.0, 0.0) - want).abs() < tolerance, "{tau} {tau2} at {k}");
            }
        }
    }

    #[test]
    fn the_second_order_stepper_agrees_with_the_parallel_filters() {
        let v: Vec<f64> = (0..90).map(|k| if (k / 11) % 2 == 0 { 1.0 } else { -0.5 }).collect();
        let model = ProcessModel { gain: 1.0, tau: 12.0, tau2: 5.0, dead_time: 4.6, integrating: false };
        let mut process = ProcessState::at_rest(model, v[0]);
        let (mut x1, mut x2) = (Vec::new(), Vec::new());
        Pole::lag(12.0, 4.6_f64.fract()).run(4, &v, v[0], &mut x1);
        Pole::lag(5.0, 4.6_f64.fract()).run(4, &v, v[0], &mut x2);
        let (w1, w2) = series_weights(12.0, 5.0);
        for (k, &valve) in v.iter().enumerate() {
            assert!((process.step(valve, 0.0) - (w1 * x1[k] + w2 * x2[k])).abs() < 1e-12);
        }
    }

    #[test]
    fn a_lag_before_an_integrator_is_exact_and_keeps_its_rest() {
        let (tau, dead) = (5.0, 1.5);
        let model = ProcessModel { gain: 0.2, tau, tau2: 0.0, dead_time: dead, integrating: true };
        let mut process = ProcessState::at_rest(model, 30.0);
        for _ in 0..20 {
            assert_eq!(process.step(30.0, 30.0), 0.0);
        }
        for k in 1..60 {
            let t = (f64::from(k) - dead).max(0.0);
            let want = 0.2 * 2.0 * (t - tau * (1.0 - libm::exp(-t / tau)));
            assert!((process.step(32.0, 30.0) - want).abs() < 1e-11);
        }
    }
}
