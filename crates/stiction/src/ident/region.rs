//! Words for where a pair of bands lies on the fs-fd plane.
//!
//! The plane's triangle has pure dead band on the ray `fs = fd` (j = 0), pure stick-slip on the axis `fd = 0`
//! (j = s), both in between, and strong cases towards its far side `s = S0` (after Lee, Ren and Huang 2008).

/// Bounds of the plane's parts: s over OP's span below which nothing is said, j/s up to which it is dead band, and from
/// which it is stick-slip.
pub const BOUNDS: [f64; 3] = [0.1, 0.15, 0.85];
/// s over OP's span from which sticking is moderate, and above which it is strong.
pub const STRENGTHS: [f64; 2] = [0.2, 0.6];

/// What kind of sticking: by j/s, once s is large enough to be seen at all.
///
/// `none` below a tenth of OP's span; `deadband` below j/s = 0.15; `stick_slip` above 0.85.
#[must_use]
pub fn region(s: f64, j: f64, span: f64) -> &'static str {
    if s < BOUNDS[0] * span || s <= 0.0 {
        "none"
    } else if j / s < BOUNDS[1] {
        "deadband"
    } else if j / s > BOUNDS[2] {
        "stick_slip"
    } else {
        "deadband_stick_slip"
    }
}

/// How strong against the loop's own movement: by s over OP's span, 0.2 and 0.6.
#[must_use]
pub fn strength_by_span(s: f64, span: f64) -> &'static str {
    if s > STRENGTHS[1] * span {
        "strong"
    } else if s >= STRENGTHS[0] * span {
        "moderate"
    } else {
        "weak"
    }
}

/// How severe against the valve's travel, % of OP's range: 0.5, 1 and 2 %; `None` for a range without width.
#[must_use]
pub fn severity_by_range(s: f64, range: [f64; 2]) -> Option<&'static str> {
    let width = (range[1] - range[0]).abs();
    if width.is_nan() || width <= 0.0 {
        return None;
    }
    let percent = 100.0 * s / width;
    Some(match percent {
        p if p < 0.5 => "none",
        p if p < 1.0 => "weak",
        p if p < 2.0 => "moderate",
        _ => "strong",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_of_the_triangle_have_their_names() {
        assert_eq!(region(0.05, 0.0, 1.0), "none");
        assert_eq!(region(0.5, 0.0, 1.0), "deadband");
        assert_eq!(region(0.5, 0.5, 1.0), "stick_slip");
        assert_eq!(region(0.5, 0.25, 1.0), "deadband_stick_slip");
        assert_eq!(strength_by_span(0.7, 1.0), "strong");
        assert_eq!(strength_by_span(0.2, 1.0), "moderate");
        assert_eq!(strength_by_span(0.1, 1.0), "weak");
        assert_eq!(severity_by_range(1.5, [0.0, 100.0]), Some("moderate"));
        assert_eq!(severity_by_range(1.5, [1.0, 1.0]), None);
    }
}
