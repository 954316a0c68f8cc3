//! Numbers rounded for people who act on them: two digits, times that can be read off a wall clock, steps that a controller's
//! faceplate accepts. Documents for programs keep the computed values.

use crate::core::units::significant;

/// Significant digits that a person needs.
const DIGITS: usize = 2;
/// Shorter times are rounded to [`GRID_S`], longer ones to two digits, s.
const SHORT_S: f64 = 120.0;
/// Grid of short times, s: what a person can count off a clock.
const GRID_S: f64 = 5.0;
/// Faceplates accept tenths. The bump test also uses half a step, so a step is a multiple of this.
const FACEPLATE: f64 = 0.2;
/// From this OP step on, whole units are enough.
const WHOLE_FROM: f64 = 10.0;

/// Which way a number is rounded.
#[derive(Clone, Copy)]
enum Rounding {
    Nearest,
    Up,
    Down,
}

impl Rounding {
    fn to(self, grid: f64, value: f64) -> f64 {
        let times = value / grid;
        // A value that is a multiple except for rounding errors keeps its multiple.
        let near = times.round();
        let times = match self {
            _ if (times - near).abs() < 1e-9 * near.abs().max(1.0) => near,
            Self::Nearest => near,
            Self::Up => times.ceil(),
            Self::Down => times.floor(),
        };
        times * grid
    }

    /// Rounds to two significant digits, whatever the magnitude.
    fn two_digits(self, value: f64) -> f64 {
        let (mut grid, mut rest) = (0.1, value.abs());
        while rest >= 10.0 && rest.is_finite() {
            (rest, grid) = (rest / 10.0, grid * 10.0);
        }
        while rest < 1.0 && rest > 0.0 {
            (rest, grid) = (rest * 10.0, grid / 10.0);
        }
        self.to(grid, value)
    }

    fn duration(self, seconds: f64) -> String {
        let told = |value: f64, unit: &str| format!("{} {unit}", significant(value, DIGITS + 1));
        match seconds.abs() {
            s if s < GRID_S => told(self.two_digits(seconds), "s"),
            s if s < SHORT_S => told(self.to(GRID_S, seconds), "s"),
            s if s < 7_200.0 => told(self.two_digits(seconds / 60.0), "min"),
            s if s < 172_800.0 => told(self.two_digits(seconds / 3_600.0), "h"),
            _ => told(self.two_digits(seconds / 86_400.0), "days"),
        }
    }
}

/// An approximate duration.
#[must_use]
pub fn about(seconds: f64) -> String {
    Rounding::Nearest.duration(seconds)
}

/// The shortest time that a person must wait: rounded up.
#[must_use]
pub fn at_least(seconds: f64) -> String {
    Rounding::Up.duration(seconds)
}

/// The longest time that is still short enough, such as between two samples: rounded down.
#[must_use]
pub fn at_most(seconds: f64) -> String {
    Rounding::Down.duration(seconds)
}

/// A size, such as a travel of PV.
#[must_use]
pub fn size(value: f64) -> String {
    significant(Rounding::Nearest.two_digits(value), DIGITS)
}

/// The ends of an interval, rounded outwards, so that the written interval is never narrower than the computed one.
#[must_use]
pub fn interval([low, high]: [f64; 2]) -> [String; 2] {
    [Rounding::Down.two_digits(low), Rounding::Up.two_digits(high)].map(|end| significant(end, DIGITS))
}

/// A step of OP that a faceplate accepts, as is its half; steps below the faceplate's resolution keep two digits.
#[must_use]
pub fn op_step(step: f64) -> f64 {
    match step.abs() {
        s if s < FACEPLATE => Rounding::Nearest.two_digits(step),
        s if s < WHOLE_FROM => Rounding::Nearest.to(FACEPLATE, step),
        _ => Rounding::Nearest.two_digits(step),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_a_clock() {
        for (seconds, near, up, down) in [
            (35.9, "35 s", "40 s", "35 s"),
            (85.6, "85 s", "90 s", "85 s"),
            (9.16, "10 s", "10 s", "5 s"),
            (4.44, "4.4 s", "4.5 s", "4.4 s"),
            (0.123, "0.12 s", "0.13 s", "0.12 s"),
            (40.0, "40 s", "40 s", "40 s"),
            (119.0, "120 s", "120 s", "115 s"),
            (14.3 * 60.0, "14 min", "15 min", "14 min"),
            (2.02 * 3600.0, "2 h", "2.1 h", "2 h"),
            (130.0 * 86_400.0, "130 days", "130 days", "130 days"),
        ] {
            assert_eq!([about(seconds), at_least(seconds), at_most(seconds)], [near, up, down], "{seconds}");
        }
        assert_eq!(about(f64::NAN), "unknown days");
    }

    #[test]
    fn sizes_have_two_digits_and_steps_those_of_a_faceplate() {
        for (value, text) in
            [(0.834, "0.83"), (13_712.0, "14000"), (7.44, "7.4"), (0.0, "0"), (-1.61, "-1.6"), (99.7, "100")]
        {
            assert_eq!(size(value), text);
        }
        assert_eq!(interval([7.97, 8.034]), ["7.9", "8.1"]);
        assert_eq!(interval([0.0, 12.5]), ["0", "13"]);
        for (step, taken) in [(0.362, 0.4), (1.64, 1.6), (0.25, 0.2), (0.0432, 0.043), (12.4, 12.0), (2.0, 2.0)] {
            assert!((op_step(step) - taken).abs() < 1e-9, "{step}: {}", op_step(step));
        }
    }
}
