//! Valve models: OP in, stem position out. Each formula exists only here.

/// He's two-parameter model (He et al. 2007): the stem rests until the unbalanced signal exceeds `fs`, then jumps to
/// `op -+ fd`. Stateless form: the stem position is the only state, because `op - position` is the residual force.
///
/// Bands in OP units, `0 <= fd <= fs`. While OP moves one way it gives a staircase of steps of `fs - fd`. A heavily damped
/// valve tracks smoothly instead; use [`tracking_step`].
#[must_use]
pub fn he_step(position: f64, op: f64, fs: f64, fd: f64) -> f64 {
    let force = op - position;
    if force > fs {
        op - fd
    } else if force < -fs {
        op + fd
    } else {
        position
    }
}

/// State of the tracking model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tracking {
    /// Stem position, OP units.
    pub position: f64,
    /// Direction of motion, 0 at rest.
    pub direction: i8,
}

/// The tracking (sliding) model: at rest as He's; once moving, the stem follows `op -+ fd` until OP reverses (Chen 2008 with
/// He's breakaway test; agrees with Kano 2004 on noise-free OP).
#[must_use]
pub fn tracking_step(state: Tracking, op: f64, fs: f64, fd: f64) -> Tracking {
    if state.direction != 0 {
        let d = f64::from(state.direction);
        let candidate = op - d * fd;
        if d * (candidate - state.position) >= 0.0 {
            return Tracking { position: candidate, ..state };
        }
    }
    let position = he_step(state.position, op, fs, fd);
    let direction = if position == state.position { 0 } else { (op - state.position).signum() as i8 };
    Tracking { position, direction }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_friction_is_identity() {
        let mut v = 0.0;
        for op in [0.5, -0.2, 3.0, 3.0, 2.9] {
            v = he_step(v, op, 0.0, 0.0);
            assert_eq!(v, op);
        }
    }

    #[test]
    fn he_reverses_after_s_and_jumps_j() {
        let (fs, fd) = (3.0, 1.0);
        let (mut v, mut op, mut top) = (0.0, 0.0, 0.0);
        while op < 10.0 {
            op += 0.01;
            let next = he_step(v, op, fs, fd);
            if next != v {
                top = op;
            }
            v = next;
        }
        // After the last slip upwards OP falls by s = fs + fd before the stem moves, and the stem then jumps by j = fs - fd.
        let before = v;
        while he_step(v, op, fs, fd) == v {
            op -= 0.01;
        }
        assert!((top - op - (fs + fd)).abs() < 0.02);
        assert!((before - he_step(v, op, fs, fd) - (fs - fd)).abs() < 0.02);
    }

    #[test]
    fn tracking_slides_without_steps_and_rests_at_reversal() {
        let (fs, fd) = (3.0, 1.0);
        let mut state = Tracking { position: 0.0, direction: 0 };
        for k in 0..=1000 {
            state = tracking_step(state, f64::from(k) * 0.01, fs, fd);
        }
        assert!((state.position - 9.0).abs() < 1e-9 && state.direction == 1);
        let resting = tracking_step(state, 9.5, fs, fd);
        assert_eq!(resting, Tracking { position: state.position, direction: 0 });
    }
}
