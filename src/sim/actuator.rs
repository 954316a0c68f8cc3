//! What else stands between OP and the flow beside friction: play, stops, a stem that cannot keep up. One step each.

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

#[cfg(test)]
mod tests {
    use super::*;

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
