//! Which place, onset or frequency of an effect is worth a fit: its columns, as the noise model sees them and less what the
//! fit has already, against the innovations.

use std::sync::Arc;

use super::search::is_same;
use super::series::Series;
use super::shapes::Shape;
use crate::core::gap::neighbour::Load;
use crate::core::gap::noise::arx::{Fit, START, whitened};
use crate::core::gap::noise::least_squares::{Orthonormal, taken};
use crate::core::signal::stats;

/// Innovations beyond which they are cut, scales: one wild value must not tell all.
const MOST: f64 = 40.0;
/// Part of the record at each end in which no step is looked for.
const ENDS: f64 = 0.05;
/// Onsets of a ramp, and the last, part of the record.
const RAMPS: usize = 15;
const LAST_RAMP: f64 = 0.7;
/// Frequencies of a sinusoid: cycles in the record at which they begin, at which their steps widen, and the highest, cycles
/// a point; both steps.
const CYCLES: [f64; 2] = [3.0, 60.0];
const FASTEST: f64 = 0.4;
const FREQUENCY_STEPS: [f64; 2] = [0.5, 2.0];
/// Multiples of the loop's own frequency that are left out, and how widely.
const OWN: [f64; 5] = [0.5, 1.0, 2.0, 3.0, 4.0];
const OWN_WIDTH: f64 = 0.08;
/// Matched deviations from which a value is wild, points within which it is the wildest, how many there must be, and the
/// largest part of the record.
const WILD: f64 = 6.0;
const NEAR: usize = 3;
const FEWEST_WILD: usize = 3;
const MOST_WILD: f64 = 0.04;
/// Lags and dead times of another loop's signal, periods.
const LAGS: [f64; 5] = [0.01, 0.05, 0.1, 0.2, 0.35];
const DEAD_TIMES: usize = 13;
const LAST_DEAD_TIME: f64 = 0.5;
/// Points of the shortest pulse: less are wild values. And the longest, part of the record.
const SHORTEST_PULSE: usize = 3;
const LONGEST_PULSE: f64 = 0.1;

/// A step as the noise model sees it.
struct SeenStep {
    onset: usize,
    /// Its power, and its products with the innovations and with what the fit knows.
    power: f64,
    along: f64,
    known: Vec<f64>,
}

/// A fit's innovations and what it has explained.
pub struct Scan<'f> {
    fit: &'f Fit,
    n: usize,
    /// The fit's columns.
    known: Orthonormal,
    /// Innovations, cut, of variance 1, beginning at [`START`], less what the columns make of them.
    score: Vec<f64>,
}

impl<'f> Scan<'f> {
    #[must_use]
    pub(crate) fn new(fit: &'f Fit, n: usize) -> Self {
        let known = Orthonormal::of(fit.columns.iter().cloned());
        let mut score: Vec<f64> = fit.e.iter().map(|e| (e / fit.student.scale).clamp(-MOST, MOST)).collect();
        let deviation = stats::std_dev(&score).max(1e-9);
        score.iter_mut().for_each(|s| *s /= deviation);
        known.take_out(&mut score);
        Self { fit, n, known, score }
    }

    /// Twice the log likelihood that a shape would gain; not for drift and bend, which scale the process's own part.
    fn gain_of(&self, shape: &Shape) -> f64 {
        let columns = shape.columns(self.n, &[]);
        let seen = columns.iter().map(|column| whitened(&self.fit.a, column).split_off(START));
        self.known.beyond(seen).power_of(&self.score)
    }

    /// The `most` most promising shapes, each `apart` from those before.
    fn best(
        &self,
        shapes: impl Iterator<Item = Shape>,
        most: usize,
        apart: impl Fn(&Shape, &Shape) -> bool,
    ) -> Vec<Shape> {
        best(shapes.map(|shape| (self.gain_of(&shape), shape)).collect(), most, apart)
    }

    /// Size at which a column is expected to gain this much log likelihood, by the Fisher information of Student's t: exact for
    /// small sizes only, so an effect that shows at a few points needs a larger one.
    #[must_use]
    pub(crate) fn shown(&self, column: &[f64], nats: f64) -> f64 {
        let mut seen = whitened(&self.fit.a, column).split_off(START);
        self.known.take_out(&mut seen);
        let student = &self.fit.student;
        student.scale
            * (2.0 * nats * (student.freedom + 3.0) / (student.freedom + 1.0) / stats::dot(&seen, &seen)).sqrt()
    }

    /// Onsets at which a step is looked for.
    #[must_use]
    pub(crate) fn onsets(&self) -> core::ops::Range<usize> {
        let end = ((1.0 - ENDS) * self.n as f64) as usize;
        START.max((ENDS * self.n as f64) as usize)..end
    }

    /// What A makes of a step: a start of its order, then a constant.
    fn whitened_step(&self) -> Vec<f64> {
        let sum = |sum: &mut f64, a: &f64| {
            *sum += a;
            Some(*sum)
        };
        self.fit.a.iter().scan(0.0, sum).collect()
    }

    /// Steps at each of these onsets.
    fn seen_steps(&self, onsets: core::ops::Range<usize>) -> Vec<SeenStep> {
        let start = self.whitened_step();
        let (level, start) = start.split_last().map_or((0.0, &[][..]), |(level, start)| (*level, start));
        let sums: Vec<Vec<f64>> = self.known.0.iter().chain([&self.score]).map(|c| tail_sums(c)).collect();
        let length = self.n - START;
        let product = |x: &[f64], sums: &[f64], at: usize| {
            let first: f64 = start.iter().zip(&x[at..]).map(|(w, x)| w * x).sum();
            first + level * sums[(at + start.len()).min(length)]
        };
        let seen = |onset: usize| {
            let at = onset - START;
            let within = &start[..start.len().min(length - at)];
            let rest = (length - at).saturating_sub(start.len()) as f64;
            let power = within.iter().map(|w| w * w).sum::<f64>() + level * level * rest;
            let known = self.known.0.iter().zip(&sums).map(|(x, sums)| product(x, sums, at)).collect();
            SeenStep { onset, power, along: product(&self.score, &sums[sums.len() - 1], at), known }
        };
        onsets.map(seen).collect()
    }

    /// The most promising `most` steps.
    #[must_use]
    pub(crate) fn steps(&self, most: usize) -> Vec<Shape> {
        let gain = |step: &SeenStep| taken(step.power, step.along, stats::dot(&step.known, &step.known));
        let found = self.seen_steps(self.onsets()).iter().map(|step| (gain(step), step.onset)).collect();
        best(found, most, |_, _| true).into_iter().map(Shape::Step).collect()
    }

    /// Lengths of pulses, points.
    fn lengths(&self) -> core::ops::RangeInclusive<usize> {
        SHORTEST_PULSE..=(LONGEST_PULSE * self.n as f64) as usize
    }

    /// The most promising `most` pulses: each is a step less a later one.
    #[must_use]
    pub(crate) fn pulses(&self, most: usize) -> Vec<Shape> {
        let step = self.whitened_step();
        let at = |i: usize| step[i.min(step.len() - 1)];
        // Power of a whitened pulse of each length by its first points.
        let powers: Vec<Vec<f64>> = self
            .lengths()
            .map(|length| {
                let value = |i: usize| if i < length { at(i) } else { at(i) - at(i - length) };
                let sum = |sum: &mut f64, i: usize| {
                    *sum += value(i) * value(i);
                    Some(*sum)
                };
                (0..length + step.len()).scan(0.0, sum).collect()
            })
            .collect();
        let steps = self.seen_steps(self.onsets().start..self.n);
        let mut found: Vec<(f64, (usize, usize))> = Vec::new();
        for (k, on) in steps.iter().enumerate() {
            for (length, powers) in self.lengths().zip(&powers) {
                let Some(off) = steps.get(k + length) else { break };
                let power = powers[(self.n - on.onset).min(powers.len()) - 1];
                let known = on.known.iter().zip(&off.known).map(|(on, off)| (on - off) * (on - off)).sum();
                found.push((taken(power, on.along - off.along, known), (on.onset, length)));
            }
        }
        let apart =
            |(at, length): &(usize, usize), (other, long): &(usize, usize)| at + length < *other || other + long < *at;
        best(found, most, apart).into_iter().map(|(at, length)| Shape::Pulse(at, length)).collect()
    }

    /// The most promising `most` ramps.
    #[must_use]
    pub(crate) fn ramps(&self, most: usize) -> Vec<Shape> {
        let at = |i: usize| (self.n as f64 * LAST_RAMP * i as f64 / (RAMPS - 1) as f64) as usize;
        self.best((0..RAMPS).map(|i| Shape::Ramp(at(i))), most, |_, _| true)
    }

    /// Frequencies at which a sinusoid is looked for, cycles a point.
    #[must_use]
    pub(crate) fn frequencies(&self, series: &Series) -> Vec<f64> {
        let n = self.n as f64;
        let mut cycles = CYCLES[0];
        let mut out = Vec::new();
        while cycles / n < FASTEST {
            let own = cycles / n * series.period;
            if OWN.iter().all(|h| (own / h - 1.0).abs() > OWN_WIDTH) {
                out.push(cycles / n);
            }
            cycles += FREQUENCY_STEPS[usize::from(cycles >= CYCLES[1])];
        }
        out
    }

    /// The most promising `most` sinusoids.
    #[must_use]
    pub(crate) fn sinusoids(&self, frequencies: &[f64], most: usize) -> Vec<Shape> {
        let apart = |x: &Shape, y: &Shape| !is_same(x, y, self.n);
        self.best(frequencies.iter().map(|f| Shape::Sinusoid(*f)), most, apart)
    }

    /// The most promising `most` places of each load, no sooner than a point behind it.
    #[must_use]
    pub(crate) fn neighbours(&self, series: &Series, most: usize) -> Vec<Shape> {
        let dead_time = |i: usize| LAST_DEAD_TIME * series.period * i as f64 / (DEAD_TIMES - 1) as f64;
        let places =
            || LAGS.iter().flat_map(|lag| (0..DEAD_TIMES).map(move |i| [lag * series.period, dead_time(i).max(1.0)]));
        let of_load = |load: &Arc<Load>| {
            self.best(places().map(|place| Shape::Neighbour(Arc::clone(load), place)), most, |_, _| true)
        };
        series.loads.iter().flat_map(of_load).collect()
    }

    /// Wild values, by the innovations that one leaves behind; `None` where there are too few or too many.
    #[must_use]
    pub(crate) fn outliers(&self) -> Option<Shape> {
        let a = &self.fit.a;
        let mut e = vec![0.0; START];
        e.extend_from_slice(&self.fit.e);
        let power = stats::dot(a, a);
        let matched: Vec<f64> =
            (0..self.n).map(|k| e[k..].iter().zip(a).map(|(e, a)| e * a).sum::<f64>() / power).collect();
        let sizes: Vec<f64> = matched.iter().map(|x| x.abs()).collect();
        let least = WILD * (1.4826 * stats::median(&sizes) + 1e-12);
        let wildest = |k: &usize| {
            let around = &sizes[k - NEAR..=k + NEAR];
            sizes[*k] > least && around.iter().all(|x| *x <= sizes[*k])
        };
        let at: Vec<usize> = (START..self.n - NEAR).filter(wildest).collect();
        let fits = at.len() >= FEWEST_WILD && at.len() as f64 <= MOST_WILD * self.n as f64;
        fits.then_some(Shape::Outliers(at))
    }

    /// How many shapes of a kind are looked through.
    #[must_use]
    pub(crate) fn tried(&self, shape: &Shape, frequencies: usize) -> usize {
        match shape {
            Shape::Step(_) => self.onsets().len(),
            Shape::Pulse(..) => self.onsets().len() * self.lengths().count(),
            Shape::Ramp(_) => RAMPS,
            Shape::Sinusoid(_) => frequencies,
            Shape::Neighbour(..) => LAGS.len() * DEAD_TIMES,
            Shape::Drift | Shape::Bend | Shape::Outliers(_) => 1,
        }
    }
}

/// Sums from each place to the end, 0 behind it.
fn tail_sums(x: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; x.len() + 1];
    for k in (0..x.len()).rev() {
        out[k] = out[k + 1] + x[k];
    }
    out
}

/// The `most` values of the largest gain, each `apart` from those before.
fn best<T>(mut found: Vec<(f64, T)>, most: usize, apart: impl Fn(&T, &T) -> bool) -> Vec<T> {
    found.sort_by(|x, y| y.0.total_cmp(&x.0));
    let mut out: Vec<T> = Vec::new();
    for (_, value) in found {
        if out.len() < most && out.iter().all(|other| apart(other, &value)) {
            out.push(value);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::budget::Known;
    use crate::core::record::Record;
    use crate::core::sim::noise::Noise;

    #[test]
    fn the_short_way_to_a_step_is_the_long_one() {
        let mut noise = Noise::new(5, 4);
        let op: Vec<f64> = (0..500).map(|_| noise.gaussian()).collect();
        let mut y = 0.0;
        let pv: Vec<f64> = (0..500)
            .map(|k| {
                y = 0.8 * y + 0.2 * noise.gaussian();
                y + if k >= 300 { 2.0 } else { 0.0 }
            })
            .collect();
        let known = Known { period: Some(40.0), ..Known::default() };
        let series = Series::of(&Record::uniform(1.0, op, pv), &known).unwrap();
        let fit = series.driven_by(Some(&series.op)).fit(4, &[], None).unwrap();
        let scan = Scan::new(&fit, 500);
        let long = |onset: usize| scan.gain_of(&Shape::Step(onset));
        let best = scan.onsets().max_by(|x, y| long(*x).total_cmp(&long(*y))).unwrap();
        assert_eq!(scan.steps(1), [Shape::Step(best)]);
        assert!(best.abs_diff(300) <= 2, "{best}");
        let long = |at: usize, length: usize| scan.gain_of(&Shape::Pulse(at, length));
        let all = scan.onsets().flat_map(|at| (3..=50).map(move |length| (at, length))).filter(|(at, l)| at + l < 500);
        let best = all.max_by(|x, y| long(x.0, x.1).total_cmp(&long(y.0, y.1))).unwrap();
        assert_eq!(scan.pulses(1), [Shape::Pulse(best.0, best.1)]);
        // Small steps gain what is asked in the mean over their onsets and signs.
        let gained = |onset: usize| {
            let step = &Shape::Step(onset).columns(500, &[])[0];
            let (size, mut seen) = (scan.shown(step, 0.5), whitened(&fit.a, step).split_off(START));
            scan.known.take_out(&mut seen);
            let loss = |size: f64| fit.student.loss(fit.e.iter().zip(&seen).map(|(e, x)| e + size * x));
            0.5 * (loss(size) + loss(-size)) - loss(0.0)
        };
        let gains: Vec<f64> = (50..290).step_by(4).map(gained).collect();
        assert!((stats::mean(&gains) / 0.5 - 1.0).abs() < 0.4, "{gains:?}");
    }
}
