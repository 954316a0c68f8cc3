//! What else stands between OP and the flow beside friction: play, stops, a stem that cannot keep up, one step each; and
//! a lag in front of it.

/// Values a point has at least behind a lag.
const PARTS: usize = 5;

/// Play of `width` behind the stem (backlash): the far side stands still until the stem has crossed it.
#[must_use]
pub fn play_step(far: f64, stem: f64, width: f64) -> f64 {
    far.clamp(stem - 0.5 * width, stem + 0.5 * width)
}

/// A stem that follows `wanted` by at most `rate` a step.
#[must_use]
pub fn rate_step(stem: f64, wanted: f64, rate: f64) -> f64 {
    stem + (wanted - stem).clamp(-rate, rate)
}

/// A stem between a lower and an upper stop, `stops[0] <= stops[1]`.
#[must_use]
pub fn stop_step(stem: f64, stops: [f64; 2]) -> f64 {
    stem.clamp(stops[0], stops[1])
}

/// `op` (`per_point` raw values a point) behind a lag of `tau` points into `path`; answers how many values a point has.
///
/// The lag moves on between two raw samples while OP is held, so a slip falls anywhere between them: each part has the
/// value at its middle, exactly.
pub fn lag_path(op: &[f64], per_point: usize, tau: f64, path: &mut Vec<f64>) -> usize {
    let parts = PARTS.div_ceil(per_point);
    let step = 1.0 / (tau * (per_point * parts) as f64).max(1e-3);
    let (whole, half) = (libm::exp(-step), libm::exp(-0.5 * step));
    let mut drive = op.first().copied().unwrap_or(0.0);
    path.clear();
    for op in op {
        for _ in 0..parts {
            path.push(op + (drive - op) * half);
            drive = op + (drive - op) * whole;
        }
    }
    per_point * parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lag_moves_on_between_two_samples() {
        let op: Vec<f64> = (0..40).map(|k| libm::sin(f64::from(k) * 0.4)).collect();
        let mut path = Vec::new();
        assert_eq!(lag_path(&op, 1, 2.5, &mut path), PARTS);
        let mut drive = op[0];
        for (op, parts) in op.iter().zip(path.chunks_exact(PARTS)) {
            for (i, x) in parts.iter().enumerate() {
                let time = (i as f64 + 0.5) / PARTS as f64;
                assert!((x - (op + (drive - op) * libm::exp(-time / 2.5))).abs() < 1e-12);
            }
            drive = op + (drive - op) * libm::exp(-1.0 / 2.5);
        }
        // A point that already has many values gets no more.
        assert_eq!((lag_path(&op, 8, 2.5, &mut path), path.len()), (8, op.len()));
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
