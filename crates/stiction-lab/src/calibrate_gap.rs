//! Fits the weights of the gap's decision to decisions of known outcome: the contents of `calibration.json`.

use nalgebra::{DMatrix, DVector};
use sha2::{Digest, Sha256};

use crate::challenge::{Deck, Kind, Split};
use stiction::core::detect::oscillation;
use stiction::core::gap::probability::{Features, NAMES, Outcome, Weights, softmax};
use stiction::core::gap::{GapError, GapOptions, Serial, diagnose, effects};
use stiction::core::record::Record;

/// Newton steps of a fit; weights are rounded to multiples of one over the second.
const STEPS: usize = 40;
const DIGITS: f64 = 1e4;

/// Fits weights to decisions of known outcome, each with its own weight: Newton steps with the penalty `ridge` on all squared
/// weights except the constant's.
#[must_use]
pub fn fit(cases: &[(Features, Outcome, f64)], ridge: f64) -> Weights {
    const K: usize = NAMES.len();
    let mut w = DVector::<f64>::zeros(2 * K);
    for _ in 0..STEPS {
        let (mut hessian, mut slope) = (DMatrix::<f64>::zeros(2 * K, 2 * K), DVector::<f64>::zeros(2 * K));
        for (features, outcome, weight) in cases {
            let x = features.values();
            let z = |from: usize| (0..K).map(|i| w[from + i] * x[i]).sum::<f64>();
            let [right, none, _] = softmax([z(0), z(K)]);
            let p = [right, none];
            let came = [Outcome::Right, Outcome::None].map(|o| f64::from(u8::from(o == *outcome)));
            for a in 0..2 {
                for i in 0..K {
                    slope[a * K + i] += weight * (came[a] - p[a]) * x[i];
                    for b in 0..2 {
                        let bend = if a == b { p[a] * (1.0 - p[a]) } else { -p[a] * p[b] };
                        for j in 0..K {
                            hessian[(a * K + i, b * K + j)] += weight * bend * x[i] * x[j];
                        }
                    }
                }
            }
        }
        for i in 0..2 * K {
            let held = if i % K == 0 { 1e-3 } else { ridge };
            hessian[(i, i)] += held;
            slope[i] -= held * w[i];
        }
        let Some(step) = hessian.cholesky().map(|c| c.solve(&slope)) else { break };
        w += &step;
        if step.norm() < 1e-8 {
            break;
        }
    }
    let kept = |x: f64| (x * DIGITS).round() / DIGITS;
    NAMES.iter().enumerate().map(|(i, name)| ((*name).to_owned(), [kept(w[i]), kept(w[K + i])])).collect()
}

/// Identifies the gap's search: a hash of its result for one loop, with the evidence rounded to three digits.
///
/// # Errors
/// The loop cannot be diagnosed.
pub fn search_id() -> Result<String, GapError> {
    let dealt = Deck::of(1, Split::A, &[Some(Kind::Sinusoid)], 1).deal(0);
    let record = dealt.map_or_else(|| Record::uniform(1.0, Vec::new(), Vec::new()), |dealt| dealt.record);
    let period_points = oscillation::detect(&record.op(), &record.pv).map(|found| found.period_points);
    let diagnosis = diagnose(&record, &GapOptions { period_points, ..GapOptions::default() }, &Serial)?;
    let evidence = diagnosis.evidence();
    // Whether pairs of effects are tried depends on the calibration itself, so they are left out.
    let single = evidence.contenders.iter().filter(|c| effects::parts(&c.id).nth(1).is_none());
    let mut leads: Vec<String> = single.map(|c| format!("{} {:.3}\n", c.id, c.lead)).collect();
    leads.sort();
    let hash = Sha256::digest(format!("{:.3?}\n{}", evidence.basis.base.over_floor, leads.concat()));
    Ok(hash.iter().take(4).map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::gap::probability::Calibration;

    fn features(lead: f64, closed: f64) -> Features {
        let mut values = [0.0; NAMES.len()];
        (values[0], values[1], values[4]) = (1.0, lead, closed);
        Features::from_values(values)
    }

    #[test]
    fn weights_are_recovered() {
        let mut noise = stiction::core::sim::noise::Noise::new(5, 0);
        let truth = |lead: f64, closed: f64| softmax([4.0 * lead - 1.5, 2.0 * closed - 1.0]);
        let cases: Vec<_> = (0..6000)
            .map(|_| {
                let (lead, closed) = (noise.uniform(), noise.uniform());
                let [right, none, _] = truth(lead, closed);
                let luck = noise.uniform();
                let outcome = match luck {
                    u if u < right => Outcome::Right,
                    u if u < right + none => Outcome::None,
                    _ => Outcome::Other,
                };
                (features(lead, closed), outcome, 1.0)
            })
            .collect();
        let made = Calibration { weights: fit(&cases, 0.1), ..Calibration::blank() };
        for (lead, closed) in [(0.1, 0.2), (0.9, 0.5), (0.4, 0.9)] {
            let (found, [right, none, other]) = (made.outcomes(&features(lead, closed)), truth(lead, closed));
            assert!((found.right - right).abs() < 0.05 && (found.none - none).abs() < 0.05, "{found:?} {right} {none}");
            assert!((found.right + found.none + found.other - 1.0).abs() < 1e-12 && other > 0.0);
        }
    }
}
