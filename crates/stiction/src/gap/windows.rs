//! Windows of one valve joined to one record: where each begins, and what is its own.
//!
//! Physics and effects are common. A window's level is its own: a load has no mean in any window. So is its start: points
//! are left out until a slip of its own has settled the stem, and with it the process. A sinusoid has a phase in
//! each, since nobody knows how long the time between two windows was for it.

use core::ops::Range;

/// Periods that are left out at the start of a window.
const SETTLES: f64 = 0.75;

/// The windows of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Windows {
    /// First point of each; that of the first is 0.
    starts: Vec<usize>,
    /// What the base leaves of PV at each point, any unit.
    left: Vec<f64>,
}

impl Windows {
    /// Windows from these points on, of a record of which the base leaves this.
    #[must_use]
    pub const fn new(starts: Vec<usize>, left: Vec<f64>) -> Self {
        Self { starts, left }
    }

    /// The points of each window of a record of `n` points, as far as it goes.
    pub fn ranges(&self, n: usize) -> impl Iterator<Item = Range<usize>> + '_ {
        let ends = self.starts.iter().skip(1).copied().chain([n]);
        self.starts.iter().copied().zip(ends).map(move |(from, to)| from.min(n)..to.min(n))
    }

    /// The first point of a window that counts, at least `longest_lag` points behind its start.
    #[must_use]
    pub fn settled(window: &Range<usize>, period: f64, longest_lag: usize) -> usize {
        let own = (SETTLES * period).round() as usize;
        window.start + if window.start == 0 { longest_lag } else { longest_lag.max(own).min(window.len()) }
    }

    /// Takes its mean over the points that are fitted out of a load in each window; over all where none is fitted.
    pub fn centre(&self, load: &mut [f64], fitted: &[[usize; 2]]) {
        for window in self.ranges(load.len()) {
            let mut sum = [0.0; 2];
            for [from, to] in fitted {
                let part = (*from).max(window.start)..(*to).min(window.end);
                if !part.is_empty() {
                    sum = [sum[0] + load[part.clone()].iter().sum::<f64>(), sum[1] + part.len() as f64];
                }
            }
            if sum[1] == 0.0 {
                sum = [load[window.clone()].iter().sum(), window.len() as f64];
            }
            let mean = sum[0] / sum[1].max(1.0);
            load[window].iter_mut().for_each(|x| *x -= mean);
        }
    }

    /// A sinusoid of this frequency, radians a point, and the one a quarter of a turn later, in each window with the phase that
    /// what the base leaves has there.
    #[must_use]
    pub fn waves(&self, omega: f64, n: usize, fitted: &[[usize; 2]]) -> [Vec<f64>; 2] {
        let mut out = [Vec::with_capacity(n), Vec::with_capacity(n)];
        for window in self.ranges(n) {
            let phase = self.phase(omega, &window, fitted);
            for k in window {
                let at = omega * k as f64 - phase;
                out[0].push(libm::cos(at));
                out[1].push(libm::sin(at));
            }
        }
        out
    }

    /// The phase at which a sinusoid explains most of what is left in a window.
    fn phase(&self, omega: f64, window: &Range<usize>, fitted: &[[usize; 2]]) -> f64 {
        let parts = fitted.iter().map(|[from, to]| (*from).max(window.start)..(*to).min(window.end));
        let points: Vec<usize> = parts.flatten().filter(|k| *k < self.left.len()).collect();
        let mean = points.iter().map(|k| self.left[*k]).sum::<f64>() / points.len().max(1) as f64;
        let [a, b] = points.iter().fold([0.0; 2], |[a, b], k| {
            let (at, left) = (omega * *k as f64, self.left[*k] - mean);
            [a + left * libm::cos(at), b + left * libm::sin(at)]
        });
        libm::atan2(b, a)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_stays_in_its_window() {
        let windows = Windows::new(vec![0, 100, 200], vec![0.0; 300]);
        let mut step: Vec<f64> = (0..300).map(|k| if k >= 150 { 1.0 } else { 0.0 }).collect();
        windows.centre(&mut step, &[[0, 300]]);
        assert!(step[..100].iter().chain(&step[200..]).all(|x| *x == 0.0));
        assert_eq!((step[149], step[150]), (-0.5, 0.5));
    }

    #[test]
    fn a_sinusoid_is_found_with_the_phase_of_each_window() {
        let phases = [0.4, 2.9, -1.7];
        let course: Vec<f64> = (0..300).map(|k| libm::cos(0.3 * k as f64 - phases[k / 100])).collect();
        let windows = Windows::new(vec![0, 100, 200], course.clone());
        let [along, across] = windows.waves(0.3, 300, &[[0, 300]]);
        let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(a, b)| a * b).sum::<f64>() / 150.0;
        assert!((product(&along, &course) - 1.0).abs() < 0.05, "{}", product(&along, &course));
        assert!(product(&across, &course).abs() < 0.05);
    }

    #[test]
    fn the_start_of_a_later_window_is_left_out() {
        assert_eq!(Windows::settled(&(0..400), 100.0, 30), 30);
        assert_eq!(Windows::settled(&(400..900), 100.0, 30), 475);
    }
}
