//! The parts between OP and flow other than the stem's friction: a lag before the stem; limited speed, stops, backlash and
//! the valve's characteristic behind it.

use super::steps::Path;

/// Fewest values per point with a lag.
const PARTS: usize = 5;

/// Dynamics before and behind a stem; times in values of OP.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Actuator {
    /// Time constant of the lag before the stem, values; 0 for none.
    pub lag: f64,
    /// Largest speed of the output, OP units per value.
    pub rate: f64,
    /// Limits of the output, OP units.
    pub stops: [f64; 2],
    /// Backlash behind the stem, OP units.
    pub play: f64,
    /// Relative growth of the characteristic's slope per OP unit, and where the slope is 1.
    pub bend: f64,
    /// See `bend`.
    pub middle: f64,
}

impl Actuator {
    /// No dynamics: only the stem.
    pub const NONE: Self = Self {
        lag: 0.0,
        rate: f64::INFINITY,
        stops: [f64::NEG_INFINITY, f64::INFINITY],
        play: 0.0,
        bend: 0.0,
        middle: 0.0,
    };

    /// The actuator's positions during one OP value, at the middle of each part, and its position at the end.
    #[must_use]
    pub(crate) fn drives(&self, drive: f64, op: f64) -> ([f64; PARTS], f64) {
        let step = 1.0 / (self.lag * PARTS as f64).max(1e-3);
        let after = |parts: f64| op + (drive - op) * libm::exp(-step * parts);
        (core::array::from_fn(|i| after(i as f64 + 0.5)), after(PARTS as f64))
    }

    /// Whether something behind the stem changes its signal.
    #[must_use]
    pub(crate) fn shapes_flow(&self) -> bool {
        Self { lag: 0.0, ..*self } != Self::NONE
    }

    /// The flow for a stem at `position`, with the state of the parts behind it.
    #[must_use]
    pub(crate) fn flow(&self, position: f64, [slow, far]: &mut [f64; 2]) -> f64 {
        *slow = if self.rate < f64::INFINITY { rate_step(*slow, position, self.rate) } else { position };
        let open = stop_step(*slow, self.stops);
        *far = if self.play > 0.0 { play_step(*far, open, self.play) } else { open };
        if self.bend == 0.0 { *far } else { self.middle + bent(*far - self.middle, self.bend) }
    }

    /// The same characteristic relative to another OP value, and the resulting factor of the gain behind it.
    #[must_use]
    pub fn counted_from(self, middle: f64) -> (Self, f64) {
        (Self { middle, ..self }, libm::exp(self.bend * (middle - self.middle)))
    }
}

impl Default for Actuator {
    fn default() -> Self {
        Self::NONE
    }
}

/// A characteristic at `v` whose slope is 1 at 0 and grows by the share `bend` per unit.
#[must_use]
fn bent(v: f64, bend: f64) -> f64 {
    if bend == 0.0 { v } else { libm::expm1(bend * v) / bend }
}

/// Backlash of `width` behind the stem: the output rests until the stem has crossed it.
#[must_use]
fn play_step(far: f64, stem: f64, width: f64) -> f64 {
    far.clamp(stem - 0.5 * width, stem + 0.5 * width)
}

/// A stem that follows `wanted` by at most `rate` per step.
#[must_use]
fn rate_step(stem: f64, wanted: f64, rate: f64) -> f64 {
    stem + (wanted - stem).clamp(-rate, rate)
}

/// A stem between a lower and an upper stop, `stops[0] <= stops[1]`.
#[must_use]
fn stop_step(stem: f64, stops: [f64; 2]) -> f64 {
    stem.clamp(stops[0], stops[1])
}

/// OP after a lag of `tau` points.
///
/// The lag advances between two raw samples while OP is held, so a slip may occur anywhere between them: each part has the
/// exact value at its middle.
#[must_use]
pub(crate) fn lag_path(op: &Path, tau: f64) -> Path {
    let per_point = op.per_point();
    let parts = PARTS.div_ceil(per_point);
    let step = 1.0 / (tau * (per_point * parts) as f64).max(1e-3);
    let (whole, half) = (libm::exp(-step), libm::exp(-0.5 * step));
    let mut drive = op.values().first().copied().unwrap_or(0.0);
    let mut values = Vec::with_capacity(op.values().len() * parts);
    for op in op.values() {
        for _ in 0..parts {
            values.push(op + (drive - op) * half);
            drive = op + (drive - op) * whole;
        }
    }
    Path::new(values, per_point * parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lag_moves_on_between_two_samples() {
        let op: Vec<f64> = (0..40).map(|k| libm::sin(f64::from(k) * 0.4)).collect();
        let path = lag_path(&Path::new(op.clone(), 1), 2.5);
        assert_eq!(path.per_point(), PARTS);
        let mut drive = op[0];
        for (op, parts) in op.iter().zip(path.values().chunks_exact(PARTS)) {
            for (i, x) in parts.iter().enumerate() {
                let time = (i as f64 + 0.5) / PARTS as f64;
                assert!((x - (op + (drive - op) * libm::exp(-time / 2.5))).abs() < 1e-12);
            }
            drive = op + (drive - op) * libm::exp(-1.0 / 2.5);
        }
        // A point that already has many values is not divided further.
        let fine = lag_path(&Path::new(op.clone(), 8), 2.5);
        assert_eq!((fine.per_point(), fine.values().len()), (8, op.len()));
    }

    #[test]
    fn the_parts_behind_a_stem_act_in_their_order() {
        let actuator = Actuator { rate: 2.0, stops: [0.0, 5.0], play: 1.0, bend: 0.1, middle: 3.0, ..Actuator::NONE };
        let mut memory = [1.0, 1.0];
        // Up by 2 to 3, then by 2 to the stop at 5; the flow is half the backlash behind.
        let flows = [9.0, 9.0, 9.0].map(|x| actuator.flow(x, &mut memory));
        let flow = |v: f64| 3.0 + libm::expm1(0.1 * (v - 3.0)) / 0.1;
        assert_eq!(flows, [flow(2.5), flow(4.5), flow(4.5)]);
        // With another reference point the curve is the same, except for its gain and a constant.
        let (other, gain) = Actuator { bend: 0.1, middle: 3.0, ..Actuator::NONE }.counted_from(7.0);
        let way = |a: Actuator| a.flow(9.0, &mut [9.0; 2]) - a.flow(4.0, &mut [4.0; 2]);
        assert!((gain * way(other) - way(Actuator { bend: 0.1, middle: 3.0, ..Actuator::NONE })).abs() < 1e-12);
        assert_eq!(Actuator::NONE.flow(7.25, &mut [0.0; 2]), 7.25);
    }

    #[test]
    fn a_drive_is_the_lagged_path_value_by_value() {
        let op: Vec<f64> = (0..30).map(|k| libm::sin(f64::from(k) * 0.3)).collect();
        let path = lag_path(&Path::new(op.clone(), 1), 4.0);
        let (actuator, mut drive) = (Actuator { lag: 4.0, ..Actuator::NONE }, op[0]);
        for (op, path) in op.iter().zip(path.values().chunks_exact(PARTS)) {
            let (drives, next) = actuator.drives(drive, *op);
            assert!(drives.iter().zip(path).all(|(a, b)| (a - b).abs() < 1e-12));
            drive = next;
        }
    }

    #[test]
    fn play_holds_until_it_is_crossed() {
        let mut far = 0.0;
        let path = [1.0, 2.0, 1.5, 1.0, 0.0];
        let out: Vec<f64> = path
            .iter()
            .map(|v| {
                far = play_step(far, *v, 1.0);
                far
            })
            .collect();
        assert_eq!(out, [0.5, 1.5, 1.5, 1.5, 0.5]);
    }

    #[test]
    fn rate_and_stops_limit() {
        assert_eq!(rate_step(1.0, 5.0, 0.5), 1.5);
        assert_eq!(rate_step(1.0, 0.8, 0.5), 0.8);
        assert_eq!(stop_step(7.0, [0.0, 5.0]), 5.0);
        assert_eq!(stop_step(-7.0, [f64::NEG_INFINITY, 5.0]), -7.0);
    }
}
