//! He's curve fit: sinusoidal half cycles do not come from a valve.

use super::{Detector, View};
use crate::core::signal::spectrum::zero_crossings;

/// `E_sin / (E_sin + E_tri)` of the half cycles of OP and of PV, the larger of the two, 0.3..0.65 (He et al. 2007, the
/// triangle's apex free). A small value rules out sticking; a large one says little, because noisy healthy loops have large
/// values too. 0.5 with fewer than three half cycles.
pub(super) struct Sine;

/// Positions tried for the apex.
const PLACES: usize = 12;

impl Detector for Sine {
    fn name(&self) -> &'static str {
        "curve_fit"
    }

    fn score(&self, view: &View) -> Option<f64> {
        let of = |x: &[f64]| curve_fit(x, view.output.period).unwrap_or(0.5);
        Some(of(&view.output.op_fast).max(of(&view.pv_fast)).clamp(0.3, 0.65))
    }
}

/// `E_sin / (E_sin + E_tri)` of the half cycles of a signal around 0 with a period of `period` points; `None` with fewer than
/// three.
#[must_use]
pub fn curve_fit(x: &[f64], period: f64) -> Option<f64> {
    let places = zero_crossings(x, 0.0);
    let (mut sine, mut triangle, mut halves) = (0.0, 0.0, 0);
    for w in places.windows(2) {
        let (from, to) = (w[0].ceil() as usize, w[1].floor() as usize);
        let length = w[1] - w[0];
        if to < from + 5 || length < 0.2 * period || length > 1.2 * period {
            continue;
        }
        let part = &x[from..=to];
        let place = |k: usize| (from as f64 + k as f64 - w[0]) / length;
        sine += misfit(part, |k| libm::sin(core::f64::consts::PI * place(k)));
        triangle += (1..=PLACES)
            .map(|apex| {
                let apex = apex as f64 / (PLACES + 1) as f64;
                misfit(part, |k| (place(k) / apex).min((1.0 - place(k)) / (1.0 - apex)))
            })
            .fold(f64::INFINITY, f64::min);
        halves += 1;
    }
    (halves >= 3 && sine + triangle > 0.0).then(|| sine / (sine + triangle))
}

/// Squared error of the best multiple of a shape.
fn misfit(part: &[f64], shape: impl Fn(usize) -> f64) -> f64 {
    let (mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0);
    for (k, y) in part.iter().enumerate() {
        let s = shape(k);
        sxx += s * s;
        sxy += s * y;
        syy += y * y;
    }
    if sxx > 0.0 { (syy - sxy * sxy / sxx).max(0.0) } else { syy }
}
