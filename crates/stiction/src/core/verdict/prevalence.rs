//! The probability of stiction in a plant where the share of sticking valves is not one half.
//!
//! The classifier is calibrated on sets in which half of the valves stick. If fewer stick, the same evidence proves less: the
//! posterior odds scale with the prior odds.

/// Share of sticking valves among the calibration loops; documents without a prevalence refer to it.
pub const CALIBRATED_FOR: f64 = 0.5;

/// Default share of sticking valves, unless a plant configures one: "about 20-30 % of all control loops oscillate due to valve
/// problems caused by static friction or hysteresis" (Srinivasan, Rengaswamy and Miller, Ind. Eng. Chem. Res. 44, 2005,
/// 6708-6718).
pub const PREVALENCE: f64 = 0.3;

/// Shares that a plant may configure.
pub const SHARES: [f64; 2] = [0.001, 0.999];

/// The probability if `prevalence` of the valves stick, from the calibrated one; both 0..1.
#[must_use]
pub fn for_prevalence(p_calibrated: f64, prevalence: f64) -> f64 {
    // A prior of 0 or 1 would ignore every record.
    let prevalence = prevalence.clamp(1e-6, 1.0 - 1e-6);
    let yes = p_calibrated * prevalence / (1.0 - prevalence);
    yes / (yes + (1.0 - p_calibrated))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_of_the_documentation_is_what_the_conversion_gives() {
        for (p, [half, third, tenth, twentieth]) in [
            (0.5, [50.0, 30.0, 10.0, 5.0]),
            (0.7, [70.0, 50.0, 21.0, 11.0]),
            (0.9, [90.0, 79.0, 50.0, 32.0]),
            (0.96, [96.0, 91.0, 73.0, 56.0]),
            (0.99, [99.0, 98.0, 92.0, 84.0]),
        ] {
            let at = |prevalence| (100.0 * for_prevalence(p, prevalence)).round();
            assert_eq!([0.5, PREVALENCE, 0.1, 0.05].map(at), [half, third, tenth, twentieth], "{p}");
        }
        for p in [0.0, 0.123, 0.3, 0.7, 0.8, 1.0] {
            assert_eq!(for_prevalence(p, CALIBRATED_FOR).to_bits(), p.to_bits(), "{p}");
        }
        assert_eq!([0.0, 1.0].map(|p| for_prevalence(p, 0.1)), [0.0, 1.0]);
        assert!([for_prevalence(1.0, 0.0), for_prevalence(0.0, 1.0)].iter().all(|p| p.is_finite()));
    }
}
