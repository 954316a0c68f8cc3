//! Compass search: steps along s, j and both until none helps, then half the step. Needs no derivative, because the surface
//! is piecewise constant.

use super::Meter;

/// Search directions in order.
const DIRECTIONS: [[f64; 2]; 8] =
    [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]];

/// Searches from `point` (of known `cost`) with steps from `step` down to `finest`.
pub(crate) fn compass(meter: &mut Meter<'_>, mut point: [f64; 2], mut cost: f64, mut step: f64, finest: f64) {
    while step > finest {
        let mut moved = false;
        for d in DIRECTIONS {
            let next = on_triangle([point[0] + d[0] * step, point[1] + d[1] * step]);
            if next == point {
                continue;
            }
            let Some(found) = meter.ask(next) else { return };
            if found < cost {
                (point, cost, moved) = (next, found, true);
            }
        }
        if !moved {
            step *= 0.5;
        }
    }
}

/// The nearest point with `0 <= j <= s <= 1`, s first.
#[must_use]
pub(crate) fn on_triangle(point: [f64; 2]) -> [f64; 2] {
    let s = point[0].clamp(0.0, 1.0);
    [s, point[1].clamp(0.0, s)]
}
