//! The best process without friction: what every valve model is compared with.

use super::candidate::NormalisedRecord;
use super::class::Class;
use super::fit::{Fitted, Fitter, Freedom, Target};

/// The best process of one class and sign that takes OP as it is, from an even look at time constants and lags of which
/// the best `settled` are improved until nothing helps any more. Its squared error is at most that of no process at all.
pub(crate) fn best(
    normalised: &NormalisedRecord,
    target: &Target,
    class: Class,
    sign: f64,
    settled: usize,
) -> Option<Fitted> {
    let freedom = Freedom { fd: [0.0, 0.0], fd_default: 0.0, sign, limits: normalised.limits };
    let mut fitter = Fitter::default();
    let mut fits: Vec<Fitted> = Vec::new();
    for tau in [0.01, 0.05, 0.2, 1.0] {
        for lag in [0.01, 0.05, 0.12, 0.25] {
            let at = normalised.limits.lag[0] + lag * normalised.period;
            let shape = class.clamp(class.start(tau * normalised.period, at), &normalised.limits);
            fits.push(fitter.linear(class, &shape, normalised.frictionless(), target, &freedom));
        }
    }
    fits.sort_by(|a, b| a.sse.total_cmp(&b.sse));
    let mut best = fits.first().copied()?;
    for start in fits.into_iter().take(settled) {
        let found = fitter.settle(class, start, normalised.frictionless(), target, &freedom);
        if found.sse < best.sse {
            best = found;
        }
    }
    Some(best)
}
