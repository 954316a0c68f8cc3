//! Process models: first order, second order and integrating, with a continuous dead time and exact discretisation.
//!
//! The valve signal is held between samples, so each model is a recursion with two taps: for a lag of `l + f`
//! samples (whole part `l`, fraction `f`),
//! `x[k] = a x[k-1] + b0 v[k-l] + b1 v[k-l-1]`, `a = exp(-1/tau)`, `b0 = 1 - exp(-(1-f)/tau)`, `b1 = 1 - a - b0`.
//! A lag is the dead time plus the one sample that a held signal needs to act, so PV never responds to OP of its own scan.

/// Recursion of a pole with unit static gain (or a unit integrator) behind a hold and a fractional delay.
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
    /// input before the record held at `v[0]`.
    pub fn run(&self, lag: usize, v: &[f64], x0: f64, out: &mut Vec<f64>) {
        out.clear();
        let Some(first) = v.first().copied() else { return };
        let mut x = x0;
        let head = (lag + 1).min(v.len());
        for k in 0..head {
            let newer = if k >= lag { v[k - lag] } else { first };
            x = self.a * x + self.b0 * newer + self.b1 * first;
            out.push(x);
        }
        for pair in v.windows(2).take(v.len() - head) {
            x = self.a * x + self.b0 * pair[1] + self.b1 * pair[0];
            out.push(x);
        }
    }
}

/// Two recursions, each with its own lag, input and start as in [`Pole::run`] and equal to it but for rounding,
/// several times as fast. `v` are of equal length, `out` are set to it.
pub(crate) fn run_pair(poles: [Pole; 2], lags: [usize; 2], v: [&[f64]; 2], x0: [f64; 2], out: [&mut Vec<f64>; 2]) {
    let n = v[0].len().min(v[1].len());
    let [first, second] = out;
    first.resize(n, 0.0);
    second.resize(n, 0.0);
    let x0 = [head(poles[0], lags[0], &v[0][..n], x0[0], first), head(poles[1], lags[1], &v[1][..n], x0[1], second)];
    let from = lags.map(|lag| (lag + 1).min(n));
    if from[0] == from[1] {
        // Side by side, neither chain waits for the other.
        tails(poles, [&v[0][..n], &v[1][..n]], x0, from[0], [first, second]);
    } else {
        tails([poles[0]], [&v[0][..n]], [x0[0]], from[0], [first]);
        tails([poles[1]], [&v[1][..n]], [x0[1]], from[1], [second]);
    }
}

/// As [`run_pair`] for one recursion.
pub(crate) fn run_one(pole: Pole, lag: usize, v: &[f64], x0: f64, out: &mut Vec<f64>) {
    out.resize(v.len(), 0.0);
    if !v.is_empty() {
        let state = head(pole, lag, v, x0, out);
        tails([pole], [v], [state], (lag + 1).min(v.len()), [out]);
    }
}

/// The values of a recursion while its input is still that before the record, and the last of them.
fn head(pole: Pole, lag: usize, v: &[f64], x0: f64, out: &mut [f64]) -> f64 {
    let mut x = x0;
    for (k, slot) in out.iter_mut().take(lag + 1).enumerate() {
        let newer = if k >= lag { v[k - lag] } else { v[0] };
        x = pole.a * x + (pole.b0 * newer + pole.b1 * v[0]);
        *slot = x;
    }
    x
}

/// Recursions from value `from` on, four values at a time: the chain from value to value is a quarter as long.
fn tails<const N: usize>(poles: [Pole; N], v: [&[f64]; N], mut x: [f64; N], from: usize, out: [&mut Vec<f64>; N]) {
    let n = v.iter().fold(usize::MAX, |n, v| n.min(v.len()));
    if n <= from {
        return;
    }
    let powers = poles.map(|p| [p.a, p.a * p.a, p.a * p.a * p.a, (p.a * p.a) * (p.a * p.a)]);
    let slots = out.map(|out| out[from..n].as_chunks_mut::<4>());
    let old = v.map(|v| v[..n - from].as_chunks::<4>());
    let new = v.map(|v| v[1..n - from + 1].as_chunks::<4>());
    for block in 0..(n - from) / 4 {
        for i in 0..N {
            let (Pole { a, b0, b1 }, [_, a2, a3, a4]) = (poles[i], powers[i]);
            let (o, w) = (&old[i].0[block], &new[i].0[block]);
            let input: [f64; 4] = core::array::from_fn(|k| b0 * w[k] + b1 * o[k]);
            let p1 = a * input[0] + input[1];
            let p2 = a * p1 + input[2];
            let p3 = a * p2 + input[3];
            slots[i].0[block] = [a * x[i] + input[0], a2 * x[i] + p1, a3 * x[i] + p2, a4 * x[i] + p3];
            x[i] = slots[i].0[block][3];
        }
    }
    for i in 0..N {
        let Pole { a, b0, b1 } = poles[i];
        for ((slot, o), w) in slots[i].1.iter_mut().zip(old[i].1).zip(new[i].1) {
            x[i] = a * x[i] + (b0 * w + b1 * o);
            *slot = x[i];
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

/// The poles of a process with their values: every model is a sum of poles with the same two taps (partial fractions), so each
/// is exact for a held input; two lags by `series_weights`, a lag before an integrator as `1/s - tau/(tau s + 1)`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Poles {
    gain: f64,
    branches: [Branch; 2],
}

/// One pole of the sum: its recursion, weight and value.
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
    /// A process at rest with its input, which comes `fraction` of a sample late, at `v0` (an integrator is at 0).
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

    /// The next output, from the input's newer and older tap.
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
    fn a_pair_is_two_runs() {
        let v: Vec<f64> = (0..60).map(|k| libm::sin(f64::from(k) * 0.7)).collect();
        let w: Vec<f64> = v.iter().map(|x| x * x).collect();
        let poles = [Pole::lag(7.0, 0.4), Pole::integrator(0.2)];
        for lags in [[3, 0], [0, 5], [80, 2]] {
            let (mut a, mut b, mut alone) = (Vec::new(), Vec::new(), Vec::new());
            run_pair(poles, lags, [&v, &w], [0.5, -1.0], [&mut a, &mut b]);
            poles[0].run(lags[0], &v, 0.5, &mut alone);
            assert!(a.len() == 60 && a.iter().zip(&alone).all(|(p, q)| (p - q).abs() < 1e-12));
            poles[1].run(lags[1], &w, -1.0, &mut alone);
            assert!(b.len() == 60 && b.iter().zip(&alone).all(|(p, q)| (p - q).abs() < 1e-12));
        }
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
