//! Effects of recording on a signal: exception reporting, swinging-door compression, rounding.

use stiction::core::sim::noise::quantise;

/// Exception reporting: a value is stored if it differs from the last stored one by more than `band`, which is held otherwise.
pub fn exception_hold(x: &mut [f64], band: f64) {
    let Some(mut last) = x.first().copied() else { return };
    for v in x {
        if (*v - last).abs() > band {
            last = *v;
        }
        *v = last;
    }
}

/// Swinging door (Bristol 1990): values are stored such that all others are within `band` of the straight lines between them,
/// and read back along those lines.
pub fn swinging_door(x: &mut [f64], band: f64) {
    let n = x.len();
    let (mut from, mut steepest_low, mut steepest_high) = (0, f64::NEG_INFINITY, f64::INFINITY);
    let mut k = 1;
    while k < n {
        let run = (k - from) as f64;
        steepest_low = steepest_low.max((x[k] - band - x[from]) / run);
        steepest_high = steepest_high.min((x[k] + band - x[from]) / run);
        if steepest_low <= steepest_high {
            k += 1;
            continue;
        }
        // The door is open: the previous value is stored, and the next door starts there.
        line(x, from, k - 1);
        from = k - 1;
        (steepest_low, steepest_high) = (f64::NEG_INFINITY, f64::INFINITY);
    }
    if n > 0 {
        line(x, from, n - 1);
    }
}

fn line(x: &mut [f64], from: usize, to: usize) {
    let (start, end) = (x[from], x[to]);
    let slope = (end - start) / to.saturating_sub(from).max(1) as f64;
    for (k, v) in x[from..to].iter_mut().enumerate().skip(1) {
        *v = start + slope * k as f64;
    }
}

/// Every value rounded to multiples of `quantum`.
pub fn rounded(x: &mut [f64], quantum: f64) {
    x.iter_mut().for_each(|v| *v = quantise(*v, quantum));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave() -> Vec<f64> {
        (0..400).map(|k| 3.0 * libm::sin(f64::from(k) * 0.05) + 0.3 * libm::sin(f64::from(k) * 1.3)).collect()
    }

    #[test]
    fn an_exception_holds_within_its_band() {
        let (raw, mut held) = (wave(), wave());
        exception_hold(&mut held, 0.5);
        assert!(raw.iter().zip(&held).all(|(a, b)| (a - b).abs() <= 0.5));
        assert!(held.windows(2).filter(|w| w[0] != w[1]).count() < 100);
    }

    #[test]
    fn a_swinging_door_keeps_few_points_and_stays_close() {
        let (raw, mut stored) = (wave(), wave());
        swinging_door(&mut stored, 0.5);
        // The stored value may itself be a band off the middle of the line, so the bound is twice the band.
        assert!(raw.iter().zip(&stored).all(|(a, b)| (a - b).abs() <= 1.0 + 1e-9));
        let kinks = stored.windows(3).filter(|w| (w[2] - 2.0 * w[1] + w[0]).abs() > 1e-9).count();
        assert!(kinks < 100 && kinks > 5, "{kinks}");
        let mut untouched = wave();
        swinging_door(&mut untouched, 0.0);
        assert!(raw.iter().zip(&untouched).all(|(a, b)| (a - b).abs() < 1e-9));
    }
}
