//! How much each neighbour tells of the loop beyond what its own past tells, in closed form, and how often shifted neighbours
//! tell as much.
//!
//! Signals are averaged in bins of a 16th of the period. PV is predicted from its own past and OP; a neighbour's signal behind
//! a lag and a delay of up to half a period is added (Granger 1969). A cycle that merely has the same period adds little, since
//! the past has it already, and so does a follower, which repeats what this loop did. The best of all neighbours is compared
//! with the best of the same neighbours shifted in time by at least some periods, on the same bins: a shift leaves a stranger
//! as likely as it was, however much of a cycle is left in what PV's past does not tell. Shifts do not wrap around the record,
//! since a cycle that breaks there would tell less than an unbroken one. Counting ends at ten that tell as much (Besag and
//! Clifford 1991).

use super::super::neighbour::{Load, Neighbour};
use super::super::noise::least_squares::{Orthonormal, taken};
use super::super::problem::Problem;
use crate::core::ident::random::{seeded_rng, uniform};
use crate::core::signal::stats;
use crate::core::sim::process::Pole;

/// Bins in a period.
const BINS: f64 = 16.0;
/// Bins by which PV's own past and OP's are earlier.
const OWN: [usize; 2] = [1, 2];
const OP: [usize; 3] = [0, 1, 2];
/// Lags that are tried, periods, and delays, bins.
const LAGS: [f64; 2] = [0.01, 0.12];
const DELAYS: [isize; 6] = [1, 2, 3, 5, 6, 8];
/// First bin that has a past of all these.
const FIRST: usize = 8;
/// Least shift, periods: usually, and in a short record.
const LEAST_SHIFT: [f64; 2] = [3.0, 2.0];
/// Share of the record that shifted neighbours cover at least.
const OVERLAP: f64 = 0.65;
/// Shifts that are tried, and those that tell as much at which counting ends.
const SHIFTS: usize = 99;
const ENOUGH: usize = 10;
/// Fewest shifts that a p-value is made from.
const FEWEST_SHIFTS: usize = 20;
/// Fewest bins that a comparison is made on.
const FEWEST_BINS: usize = 40;

/// One signal behind one lag, and where it stands among the neighbours.
struct Filtered {
    neighbour: usize,
    from_op: bool,
    is_quick: bool,
    values: Vec<f64>,
}

/// A neighbour's signal, and how much it tells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hit {
    /// Its place among the neighbours.
    pub neighbour: usize,
    /// Whether it is OP, not PV.
    pub from_op: bool,
    /// Share of the prediction error's power that its past takes on the fitted blocks.
    pub share: f64,
    /// The same of its present and future.
    pub future: f64,
}

/// The loop and its neighbours in bins.
pub(super) struct Scan {
    period: f64,
    pv: Vec<f64>,
    op: Vec<f64>,
    /// Bins that count, and those of them that are fitted.
    counts: Vec<bool>,
    fitted: Vec<bool>,
    signals: Vec<Filtered>,
}

/// PV on some bins, free of what its own past and OP tell.
struct Target {
    bins: Vec<usize>,
    own: Orthonormal,
    error: Vec<f64>,
    power: f64,
}

impl Target {
    /// `None` where too few bins count or nothing is left.
    fn new(pv: &[f64], op: &[f64], bins: Vec<usize>) -> Option<Self> {
        if bins.len() < FEWEST_BINS {
            return None;
        }
        let lagged = OWN.into_iter().map(|l| (pv, l)).chain(OP.into_iter().map(|l| (op, l)));
        let past = lagged.map(|(signal, back)| bins.iter().map(|k| signal[k - back]).collect());
        let own = Orthonormal::of(core::iter::once(vec![1.0; bins.len()]).chain(past));
        let mut error: Vec<f64> = bins.iter().map(|k| pv[*k]).collect();
        own.take_out(&mut error);
        let power = stats::dot(&error, &error);
        (power > 0.0).then_some(Self { bins, own, error, power })
    }

    /// Share of the error that a signal takes with a gain of its own, `back` bins earlier; `column` is room to work in.
    fn share(&self, signal: &[f64], back: isize, column: &mut Vec<f64>) -> f64 {
        column.clear();
        column.extend(self.bins.iter().map(|k| signal[k.wrapping_add_signed(-back)]));
        let along = stats::dot(column, &self.error);
        taken(stats::dot(column, column), along, self.own.power_of(column)) / self.power
    }
}

impl Scan {
    /// Of a record and its neighbours.
    pub(crate) fn new(problem: &Problem, neighbours: &[Neighbour]) -> Self {
        let bin = ((problem.period / BINS).floor() as usize).max(1);
        let counted = |k: usize| !problem.blocks.masked[k] && problem.is_measured(k);
        let fitted = |k: usize| k >= problem.blocks.from && !problem.blocks.held_out[k] && counted(k);
        let bins = problem.n() / bin;
        let means = |x: &[f64]| -> Vec<f64> { x.chunks_exact(bin).map(stats::mean).collect() };
        let all =
            |of: &dyn Fn(usize) -> bool| -> Vec<bool> { (0..bins).map(|b| (b * bin..(b + 1) * bin).all(of)).collect() };
        let period = problem.period / bin as f64;
        let mut signals = Vec::new();
        for (i, neighbour) in neighbours.iter().enumerate() {
            for (from_op, signal) in neighbour.signals() {
                let binned = means(&Load::new(&neighbour.name, from_op, signal, 1.0).values);
                for lag in LAGS {
                    let (pole, mut values) = (Pole::lag(lag * period, 0.0), Vec::new());
                    pole.run(0, &binned, binned.first().copied().unwrap_or(0.0), &mut values);
                    signals.push(Filtered { neighbour: i, from_op, is_quick: lag == LAGS[0], values });
                }
            }
        }
        let (pv, op) = (means(&problem.normalised.pv), means(&problem.normalised.mean));
        Self { period, pv, op, counts: all(&counted), fitted: all(&fitted), signals }
    }

    /// The bins of these that stand from one to another.
    fn target(&self, counts: &[bool], from: usize, to: usize) -> Option<Target> {
        let bins = (from.max(FIRST)..to.min(counts.len())).filter(|b| counts[*b]).collect();
        Target::new(&self.pv, &self.op, bins)
    }

    /// The most that any neighbour's past tells, all shifted by so many bins.
    fn most(&self, target: &Target, shift: isize) -> f64 {
        let mut room = Vec::new();
        let mut most = 0.0_f64;
        for signal in &self.signals {
            for delay in DELAYS {
                most = most.max(target.share(&signal.values, delay + shift, &mut room));
            }
        }
        most
    }

    /// Every signal of a neighbour, the one that tells most first.
    pub(crate) fn hits(&self) -> Vec<Hit> {
        let n = self.counts.len();
        let Some(target) = self.target(&self.fitted, FIRST, n.saturating_sub(FIRST)) else { return Vec::new() };
        let mut room = Vec::new();
        let mut found: Vec<Hit> = Vec::new();
        for signal in &self.signals {
            let mut most = |delays: &mut dyn Iterator<Item = isize>| {
                delays.map(|delay| target.share(&signal.values, delay, &mut room)).fold(0.0, f64::max)
            };
            let share = most(&mut DELAYS.into_iter());
            let future = if signal.is_quick { most(&mut DELAYS.into_iter().map(|d| -d).chain([0])) } else { 0.0 };
            let Filtered { neighbour, from_op, .. } = *signal;
            match found.iter_mut().find(|b| b.neighbour == neighbour && b.from_op == from_op) {
                Some(known) => (known.share, known.future) = (known.share.max(share), known.future.max(future)),
                None => found.push(Hit { neighbour, from_op, share, future }),
            }
        }
        found.sort_by(|a, b| b.share.total_cmp(&a.share));
        found
    }

    /// Shifts that may be drawn, bins.
    fn shifts(&self) -> Vec<isize> {
        let n = self.counts.len();
        let most = ((1.0 - OVERLAP) * n as f64) as isize - FIRST as isize;
        let of = |least: f64| -> Vec<isize> {
            let least = (least * self.period).ceil() as isize;
            (least..=most).flat_map(|s| [s, -s]).collect()
        };
        let [usual, short] = LEAST_SHIFT.map(of);
        if usual.len() >= SHIFTS { usual } else { short }
    }

    /// How often shifted neighbours tell as much as the neighbours themselves: a p-value. `None` where the record is too
    /// short for shifts of some periods.
    pub(crate) fn p_value(&self, seed: u64) -> Option<f64> {
        let mut open = self.shifts();
        let n = self.counts.len();
        let mut rng = seeded_rng(seed, 77);
        let (mut tried, mut as_much) = (0_usize, 0_usize);
        while tried < SHIFTS && !open.is_empty() {
            let shift = open.swap_remove(((uniform(&mut rng) * open.len() as f64) as usize).min(open.len() - 1));
            let from = FIRST + shift.max(0).unsigned_abs();
            let Some(target) = self.target(&self.counts, from, n - shift.min(0).unsigned_abs()) else { continue };
            tried += 1;
            as_much += usize::from(self.most(&target, shift) >= self.most(&target, 0));
            if as_much == ENOUGH {
                return Some(as_much as f64 / tried as f64);
            }
        }
        (tried >= FEWEST_SHIFTS).then(|| (as_much + 1) as f64 / (tried + 1) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::record::Record;
    use crate::core::sim::noise::Noise;

    const N: usize = 1200;
    const PERIOD: f64 = 60.0;

    /// A cycle whose phase wanders.
    fn cycle(noise: &mut Noise, period: f64) -> Vec<f64> {
        let mut phase = 6.0 * noise.uniform();
        (0..N)
            .map(|_| {
                phase += (1.0 + 0.15 * noise.gaussian()) * core::f64::consts::TAU / period;
                libm::sin(phase) + 0.3 * libm::sin(3.0 * phase)
            })
            .collect()
    }

    fn unrelated_loops(noise: &mut Noise, count: usize) -> Vec<Neighbour> {
        let of = |i: usize, noise: &mut Noise| {
            let period = PERIOD * (1.0 + 0.05 * noise.gaussian());
            Neighbour { name: format!("N{i}"), pv: cycle(noise, period), op: cycle(noise, period) }
        };
        (0..count).map(|i| of(i, noise)).collect()
    }

    /// A loop whose PV answers its OP and some load, with noise.
    fn loop_with(load: &[f64], noise: &mut Noise) -> Problem {
        let op = cycle(noise, PERIOD);
        let answer = Load::new("own", true, &op, 1.0).behind(8.0, 3.0, N);
        let pv = (0..N).map(|k| answer[k] + load[k] + 0.05 * noise.gaussian()).collect();
        Problem::new(&Record::uniform(1.0, op, pv), Some(PERIOD), 1, vec![false; N])
    }

    #[test]
    fn under_unrelated_loops_a_small_p_value_is_as_rare_as_it_says() {
        let mut noise = Noise::new(11, 0);
        let mut seen = Vec::new();
        for run in 0..150 {
            let load: Vec<f64> = cycle(&mut noise, PERIOD).iter().map(|x| 0.3 * x).collect();
            let problem = loop_with(&load, &mut noise);
            let scan = Scan::new(&problem, &unrelated_loops(&mut noise, 4));
            seen.push(scan.p_value(run).unwrap());
        }
        let share = |level: f64| seen.iter().filter(|p| **p <= level).count() as f64 / seen.len() as f64;
        // Three standard errors, and a little for the steps of the p-value.
        let error = |level: f64| 3.0 * (level * (1.0 - level) / seen.len() as f64).sqrt() + 0.02;
        for level in [0.05, 0.1, 0.25, 0.5, 0.75] {
            assert!(share(level) < level + error(level), "p <= {level} in {}", share(level));
        }
        // Small ones are rarer than they say, since comparisons on overlapping bins agree; the middle is where it belongs.
        assert!((share(0.5) - 0.5).abs() < 0.2, "{}", share(0.5));
    }

    #[test]
    fn the_neighbour_that_acts_tells_most_and_a_follower_only_what_was() {
        let mut noise = Noise::new(12, 0);
        let mut neighbours = unrelated_loops(&mut noise, 20);
        let load = Load::new("N7", true, &neighbours[7].op.clone(), 1.0).behind(6.0, 9.0, N);
        let load: Vec<f64> = load.iter().map(|x| 0.4 * x).collect();
        neighbours[7].pv.fill(4.0);
        let problem = loop_with(&load, &mut noise);
        let scan = Scan::new(&problem, &neighbours);
        let best = scan.hits()[0];
        assert!((best.neighbour, best.from_op) == (7, true) && best.share > best.future, "{best:?}");
        assert!(scan.p_value(3).unwrap() <= 0.01);
        // What follows this loop shows its past; a copy of PV shows its present.
        let pv = problem.normalised.pv.clone();
        for (lag, delay) in [(6.0, 9.0), (1e-3, 0.0)] {
            let shown = Load::new("F", false, &pv, 1.0).behind(lag, delay, N);
            let follower = Neighbour { name: "F".to_owned(), pv: shown, op: vec![0.0; N] };
            let told = Scan::new(&problem, &[follower]).hits()[0];
            assert!(told.future > told.share, "{told:?}");
        }
    }

    #[test]
    fn a_record_of_few_periods_gives_no_p_value() {
        let mut noise = Noise::new(13, 0);
        let mut problem = loop_with(&[0.0; N], &mut noise);
        problem.period = 290.0;
        assert_eq!(Scan::new(&problem, &unrelated_loops(&mut noise, 2)).p_value(1), None);
    }
}
