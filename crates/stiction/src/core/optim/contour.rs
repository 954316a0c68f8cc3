//! The contour grid: a regular grid over the triangle, then a local search around its best points.

use super::{Meter, Objective, Outcome, Settings, Solver, Termination, local};

/// The contour solver (the coarse map of Lee, Ren and Huang's method, then local refinement).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Contour;

/// Number of separate minima of the grid that are refined.
const MINIMA: usize = 3;

impl Solver for Contour {
    fn name(&self) -> &'static str {
        "contour"
    }

    fn search(&self, objective: &mut dyn Objective, settings: &Settings) -> Outcome {
        let step = (settings.fineness_pct / 100.0).clamp(0.002, 0.5);
        let mut meter = Meter::new(objective, settings.budget);
        let mut map = Vec::new();
        'grid: for s in levels(step) {
            for j in levels_up_to(step, s) {
                let Some(cost) = meter.ask([s, j]) else { break 'grid };
                map.push((cost, [s, j]));
            }
        }
        map.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut refined: Vec<[f64; 2]> = Vec::new();
        for (cost, point) in map {
            let apart = refined.iter().all(|r| (r[0] - point[0]).abs().max((r[1] - point[1]).abs()) > 1.5 * step);
            if cost.is_finite() && apart && meter.outcome.stopped != Termination::Budget {
                local::compass(&mut meter, point, cost, 0.5 * step, 0.02 * step);
                refined.push(point);
            }
            if refined.len() == MINIMA {
                break;
            }
        }
        meter.outcome
    }
}

/// Values of s: whole steps up to 1, preceded by half steps for small bands.
fn levels(step: f64) -> Vec<f64> {
    let whole = (1.0 / step + 1e-9).floor() as usize;
    let mut out = vec![step / 4.0, step / 2.0];
    out.extend((1..=whole).map(|k| (k as f64 * step).min(1.0)));
    out
}

/// Values of j for an s: 0, whole steps below s, and s.
fn levels_up_to(step: f64, s: f64) -> Vec<f64> {
    let mut out: Vec<f64> = (0..).map(|k| f64::from(k) * step).take_while(|j| *j < s - 1e-9).collect();
    out.push(s);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_covers_the_triangle() {
        let points: usize = levels(0.05).into_iter().map(|s| levels_up_to(0.05, s).len()).sum();
        assert_eq!(points, 234);
        assert_eq!(levels(0.3).last().copied(), Some(0.8999999999999999));
    }
}
