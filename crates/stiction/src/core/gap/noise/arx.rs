//! The noise model: PV's own past and what the valve did, `A(q) y = B u + c + e` (ARX, Ljung 1999, ch. 4); or, without B, the
//! past of what a model's free run leaves of PV.
//!
//! B is eight flat bins of u that begin one point back: at lag 0 the fit would find the inverse controller. An effect `E` with
//! coefficients `beta` enters as `A(q) (y - E beta)`, so that it is seen through the innovations and not through a free run;
//! `beta` and `A` take turns. Innovations follow Student's t, by reweighted least squares.

use super::least_squares::{left, solve};
use super::student::Student;
use crate::core::signal::stats;

/// First point whose innovation counts, and how far its prediction looks back in PV and in free runs.
pub(crate) const START: usize = 24;
pub(crate) const LONGEST_LAG: usize = 12;
/// Orders of A that are tried.
const ORDERS: [usize; 5] = [1, 2, 4, 8, LONGEST_LAG];
/// Bins of u, and how many of them reach over a period.
const BINS: usize = 8;
const BINS_IN_PERIOD: f64 = 24.0;
/// Rounds in which weights, A and effects take turns.
const ROUNDS: usize = 3;
/// Variances of PV from which the process' part alone is larger than any record's: B/A is not stable.
const LARGEST: f64 = 20.0;

/// A series with a signal that drives it.
#[derive(Debug, Clone)]
pub struct Design {
    /// PV in standard deviations, less a model's free run if there is one.
    pub y: Vec<f64>,
    /// That free run.
    run: Option<Vec<f64>>,
    /// Flat bins of u at each point.
    bins: Vec<Vec<f64>>,
    /// Points in a bin.
    pub width: usize,
    /// Points that count; the innovations of the others are left out.
    pub used: Vec<bool>,
}

/// A fitted noise model.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Coefficients of A by rising lag; the first is 1.
    pub a: Vec<f64>,
    /// B, one coefficient a bin; empty without u.
    pub b: Vec<f64>,
    /// Coefficients of the effects.
    pub beta: Vec<f64>,
    /// The constant.
    pub constant: f64,
    /// Innovations from point [`START`] on, standard deviations of PV.
    pub e: Vec<f64>,
    /// Their distribution.
    pub student: Student,
    /// Columns that were regressed on, from point [`START`] on, the effects' last.
    pub columns: Vec<Vec<f64>>,
}

impl Fit {
    /// Log likelihood, nats.
    #[must_use]
    pub(crate) fn log_likelihood(&self) -> f64 {
        self.student.log_likelihood
    }

    /// Order of A.
    #[must_use]
    pub(crate) fn order(&self) -> usize {
        self.a.len() - 1
    }
}

/// `A(q) x`, x taken as 0 before its first point.
#[must_use]
pub(crate) fn whitened(a: &[f64], x: &[f64]) -> Vec<f64> {
    let at = |k: usize| a.iter().take(k + 1).enumerate().map(|(i, a)| a * x[k - i]).sum();
    (0..x.len()).map(at).collect()
}

impl Design {
    /// The design of PV `y` driven by `u`, both in standard deviations, or by nothing; `period` is that of the oscillation, points.
    #[must_use]
    pub(crate) fn new(y: &[f64], u: Option<&[f64]>, period: f64) -> Self {
        let width = ((period / BINS_IN_PERIOD).round() as usize).max(1);
        let bins = u.map(|u| bins(u, width)).unwrap_or_default();
        Self { y: y.to_vec(), run: None, bins, width, used: vec![true; y.len()] }
    }

    /// The design of what a free run leaves of PV.
    #[must_use]
    pub(crate) fn of_residual(pv: &[f64], run: &[f64], period: f64) -> Self {
        let y: Vec<f64> = pv.iter().zip(run).map(|(y, x)| y - x).collect();
        Self { run: Some(run.to_vec()), ..Self::new(&y, None, period) }
    }

    /// PV where `y` is what the free run leaves.
    #[must_use]
    pub(crate) fn pv(&self, y: &[f64]) -> Vec<f64> {
        match &self.run {
            Some(run) => y.iter().zip(run).map(|(y, x)| y + x).collect(),
            None => y.to_vec(),
        }
    }

    /// The same with other points that count.
    #[must_use]
    pub(crate) fn where_used(&self, used: impl Fn(usize) -> bool) -> Self {
        Self { used: (0..self.y.len()).map(used).collect(), ..self.clone() }
    }

    /// The same with another `y`.
    #[must_use]
    pub(crate) fn with_y(&self, y: Vec<f64>) -> Self {
        Self { y, ..self.clone() }
    }

    /// Points that count.
    #[must_use]
    pub(crate) fn count(&self) -> usize {
        self.used.iter().skip(START).filter(|used| **used).count()
    }

    /// Lags of `y`, bins of u and the constant, from point [`START`] on.
    fn regressors(&self, y: &[f64], order: usize) -> Vec<Vec<f64>> {
        let n = y.len();
        let lags = (1..=order).map(|lag| y[START - lag..n - lag].to_vec());
        let bins = self.bins.iter().map(|bin| bin[START..].to_vec());
        lags.chain(bins).chain([vec![1.0; n - START]]).collect()
    }

    /// `y` less the effects.
    #[must_use]
    pub(crate) fn less(&self, effects: &[Vec<f64>], beta: &[f64]) -> Vec<f64> {
        left(effects, &self.y, beta)
    }

    /// Fits A of an order, B, the constant and the effects, whose A begins from that of `from`.
    #[must_use]
    pub(crate) fn fit(&self, order: usize, effects: &[Vec<f64>], from: Option<&Fit>) -> Option<Fit> {
        self.fit_in(order, effects, from, ROUNDS)
    }

    /// The same in a number of rounds.
    #[must_use]
    pub(crate) fn fit_in(&self, order: usize, effects: &[Vec<f64>], from: Option<&Fit>, rounds: usize) -> Option<Fit> {
        let used = &self.used[START..];
        if self.count() < 2 * (order + self.bins.len() + 1 + effects.len()) {
            return None;
        }
        let mut a = match from {
            Some(fit) => fit.a.clone(),
            None if effects.is_empty() => vec![1.0],
            None => self.fit_in(order, &[], None, rounds)?.a,
        };
        let mut beta = vec![0.0; effects.len()];
        let mut weights: Vec<f64> = used.iter().map(|used| f64::from(u8::from(*used))).collect();
        // One more round without the effects' columns leaves innovations that belong to A and beta alike.
        let last = if effects.is_empty() { rounds } else { rounds + 1 };
        for round in 1..=last {
            let y = self.less(effects, &beta);
            let mut columns = self.regressors(&y, order);
            let own = columns.len();
            if round <= rounds {
                columns.extend(effects.iter().map(|x| whitened(&a, x).split_off(START)));
            }
            let found = solve(&columns, &y[START..], &weights)?;
            let e = left(&columns, &y[START..], &found);
            beta.iter_mut().zip(&found[own..]).for_each(|(beta, more)| *beta += more);
            a = core::iter::once(1.0).chain(found[..order].iter().map(|x| -x)).collect();
            let student = Student::of(e.iter().zip(used).filter(|(_, used)| **used).map(|(e, _)| *e));
            if round == last {
                let b = found[order..own - 1].to_vec();
                columns.truncate(own);
                columns.extend(effects.iter().map(|x| whitened(&a, x).split_off(START)));
                return Some(Fit { a, b, beta, constant: found[own - 1], e, student, columns });
            }
            let weigh = |(e, used): (&f64, &bool)| if *used { student.weight(*e) } else { 0.0 };
            weights = e.iter().zip(used).map(weigh).collect();
        }
        None
    }

    /// The best order by BIC (Schwarz 1978), and its BIC, nats, with so many parameters beside those of this design.
    #[must_use]
    pub(crate) fn best(&self, beside: usize) -> Option<(Fit, f64)> {
        let log_n = libm::log(self.y.len() as f64);
        let bic = |fit: Fit| {
            let parameters = fit.order() + self.bins.len() + beside;
            let value = fit.log_likelihood() - 0.5 * parameters as f64 * log_n;
            (fit, value)
        };
        let all = ORDERS.iter().filter_map(|order| self.fit(*order, &[], None).map(bic));
        all.max_by(|x, y| x.1.total_cmp(&y.1))
    }

    /// PV as A and B make it of u and of `e` at each point, from rest.
    #[must_use]
    pub(crate) fn driven(&self, fit: &Fit, e: &[f64]) -> Vec<f64> {
        let mut x: Vec<f64> = Vec::with_capacity(e.len());
        for (k, e) in e.iter().enumerate() {
            let by_u: f64 = self.bins.iter().zip(&fit.b).map(|(bin, b)| b * bin[k]).sum();
            let own: f64 = fit.a[1..].iter().take(k).enumerate().map(|(i, a)| a * x[k - 1 - i]).sum();
            x.push(by_u - own + e);
        }
        x
    }

    /// What valve and process make of u by themselves, a model's free run or `B/A u`, standard deviations of PV; `None` where
    /// that grows beyond what any record shows.
    #[must_use]
    pub fn simulated(&self, fit: &Fit) -> Option<Vec<f64>> {
        if self.run.is_some() {
            return self.run.clone();
        }
        let mut x = self.driven(fit, &vec![0.0; self.y.len()]);
        let mean = stats::mean(&x);
        x.iter_mut().for_each(|x| *x -= mean);
        // Not a number is not below.
        (stats::variance(&x) <= LARGEST * stats::variance(&self.y)).then_some(x)
    }

    /// Innovations of a fit for `y`, from point [`START`] on.
    #[must_use]
    pub(crate) fn innovations(&self, fit: &Fit, y: &[f64]) -> Vec<f64> {
        let columns = self.regressors(y, fit.order());
        let lags = fit.a[1..].iter().map(|a| -a);
        let all: Vec<f64> = lags.chain(fit.b.iter().copied()).chain([fit.constant]).collect();
        left(&columns, &y[START..], &all)
    }
}

/// Means of u over bins of `width` points, the first ending one point back, at every point; u is taken to have rested at its
/// first value before.
fn bins(u: &[f64], width: usize) -> Vec<Vec<f64>> {
    let first = u.first().copied().unwrap_or(0.0);
    let mut sums = vec![0.0];
    for (k, u) in u.iter().enumerate() {
        sums.push(sums[k] + u - first);
    }
    let bin = |j: usize| {
        let mean =
            |k: usize| (sums[k.saturating_sub(j * width)] - sums[k.saturating_sub((j + 1) * width)]) / width as f64;
        (0..u.len()).map(mean).collect()
    };
    (0..BINS).map(bin).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::noise::Noise;

    /// PV and OP of a first-order process driven by steps of OP, with a disturbance that wanders, in standard deviations, and
    /// the process' gain in these.
    fn driven() -> ([Vec<f64>; 2], f64) {
        let (mut noise, mut x, mut d) = (Noise::new(7, 2), 0.0, 0.0);
        let op: Vec<f64> = (0..800).map(|k| if (k / 37) % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let mut pv = Vec::new();
        for k in 0..800 {
            x = 0.9 * x + 0.1 * if k > 0 { op[k - 1] } else { op[0] };
            d = 0.9 * d + 0.05 * noise.gaussian();
            pv.push(x + d);
        }
        let gain = stats::std_dev(&op) / stats::std_dev(&pv);
        let scaled = |x: &[f64]| x.iter().map(|v| (v - stats::mean(x)) / stats::std_dev(x)).collect();
        ([scaled(&pv), scaled(&op)], gain)
    }

    #[test]
    fn a_shared_pole_and_the_gain_are_found() {
        let ([pv, op], own_gain) = driven();
        let design = Design::new(&pv, Some(&op), 74.0);
        let (fit, _) = design.best(0).unwrap();
        assert!(fit.order() <= 4 && (fit.a.iter().sum::<f64>() - 0.1).abs() < 0.1, "{:?}", fit.a);
        let x = design.simulated(&fit).unwrap();
        let gain = fit.b.iter().sum::<f64>() / fit.a.iter().sum::<f64>() / own_gain;
        assert!((gain - 1.0).abs() < 0.15, "{gain}");
        assert!(stats::dot(&x, &pv) / stats::dot(&pv, &pv) > 0.8);
        let without = Design::new(&pv, None, 74.0).best(0).unwrap().0;
        assert!(fit.log_likelihood() - without.log_likelihood() > 100.0);
    }

    #[test]
    fn the_size_of_a_step_is_found_through_the_innovations() {
        let ([pv, op], _) = driven();
        let step: Vec<f64> = (0..pv.len()).map(|k| f64::from(u8::from(k >= 433))).collect();
        let design = Design::new(&pv, Some(&op), 74.0);
        let y = design.less(core::slice::from_ref(&step), &[-0.8]);
        let design = design.with_y(y);
        let before = design.fit(2, &[], None).unwrap();
        let after = design.fit(2, &[step], Some(&before)).unwrap();
        assert!((after.beta[0] - 0.8).abs() < 0.15, "{:?}", after.beta);
        assert!(after.log_likelihood() - before.log_likelihood() > 20.0);
        let alone = design.less(&[], &[]);
        let again = design.innovations(&before, &alone);
        assert!(again.iter().zip(&before.e).all(|(x, y)| (x - y).abs() < 1e-9));
    }

    #[test]
    fn a_bin_begins_one_point_back() {
        let bins = bins(&[0.0, 1.0, 2.0, 3.0, 4.0], 2);
        assert_eq!(bins[0], [0.0, 0.0, 0.5, 1.5, 2.5]);
        assert_eq!(bins[1], [0.0, 0.0, 0.0, 0.0, 0.5]);
    }
}
