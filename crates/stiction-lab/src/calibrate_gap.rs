//! The gap's decision fitted to loops of known cause: what `calibration.json` holds.

use sha2::{Digest, Sha256};

use crate::challenge::{Deck, Kind, Split};
use stiction::core::detect::oscillation;
use stiction::core::gap::calibration::Calibration;
use stiction::core::gap::{Evidence, GapError, GapOptions, Serial, answers, diagnose, effects};
use stiction::core::record::Record;

/// Floor for the probability of a right answer, so that loops whose search failed do not dominate the fit.
const LEAST: f64 = 1e-3;
/// Pattern search: first step as a share of each number, growth and shrinkage of steps, step at which it ends, most rounds.
const FIRST: f64 = 0.5;
const GROWS: f64 = 1.3;
const SHRINKS: f64 = 0.6;
const LAST: f64 = 0.01;
const ROUNDS: usize = 60;
/// Least temperature: below 1 the decision would be more certain than the likelihood.
const COLDEST: f64 = 1.0;
/// Numbers are rounded to thousandths.
const DIGITS: f64 = 1e3;

/// A loop of known cause.
#[derive(Debug, Clone)]
pub struct Example {
    /// Stored scores of its fits.
    pub evidence: Evidence,
    /// Answers that are right.
    pub right: Vec<String>,
    /// How much it counts.
    pub weight: f64,
}

/// The fitted numbers of a calibration.
const NUMBERS: [fn(&mut Calibration) -> &mut f64; 8] = [
    |c| &mut c.none,
    |c| &mut c.unknown,
    |c| &mut c.memory,
    |c| &mut c.pair,
    |c| &mut c.bend,
    |c| &mut c.temperature,
    |c| &mut c.misfit,
    |c| &mut c.beside,
];

/// Maximises the likelihood of the right answers by a pattern search. No starting value may be 0, as steps are shares of it.
#[must_use]
pub fn fit(examples: &[Example], from: &Calibration) -> Calibration {
    let mut best = from.clone();
    let mut most = log_likelihood(examples, &best);
    let sizes = NUMBERS.map(|number| number(&mut best).abs());
    let mut steps = sizes.map(|size| FIRST * size);
    for _ in 0..ROUNDS {
        for (number, step) in NUMBERS.iter().zip(&mut steps) {
            let [up, down] = [*step, -*step].map(|by| {
                let mut tried = best.clone();
                *number(&mut tried) += by;
                bound(&mut tried);
                (log_likelihood(examples, &tried), tried)
            });
            let (reached, tried) = if up.0 >= down.0 { up } else { down };
            let better = reached > most;
            *step *= if better { GROWS } else { SHRINKS };
            if better {
                (most, best) = (reached, tried);
            }
        }
        if steps.iter().zip(sizes).all(|(step, size)| *step < LAST * size) {
            break;
        }
    }
    for number in NUMBERS {
        let fitted = number(&mut best);
        *fitted = (*fitted * DIGITS).round() / DIGITS;
    }
    best
}

/// Keeps shares between 0 and 1, and the temperature at 1 or above.
const fn bound(of: &mut Calibration) {
    of.memory = of.memory.clamp(0.0, 1.0);
    of.temperature = of.temperature.max(COLDEST);
    of.misfit = of.misfit.max(0.0);
}

fn log_likelihood(examples: &[Example], calibration: &Calibration) -> f64 {
    let of = |example: &Example| {
        let all = answers(&[&example.evidence], calibration);
        let right: f64 = all.iter().filter(|a| example.right.contains(&a.id)).map(|a| a.p).sum();
        example.weight * libm::log(right.max(LEAST))
    };
    examples.iter().map(of).sum()
}

/// A name for the gap's search: a hash of what it makes of one loop, the evidence to three digits.
///
/// # Errors
/// The loop cannot be diagnosed.
pub fn search_id() -> Result<String, GapError> {
    let dealt = Deck::of(1, Split::A, &[Some(Kind::Sinusoid)], 1).deal(0);
    let record = dealt.map_or_else(|| Record::uniform(1.0, Vec::new(), Vec::new()), |dealt| dealt.record);
    let period_points = oscillation::detect(&record.op(), &record.pv).map(|found| found.period_points);
    let diagnosis = diagnose(&record, &GapOptions { period_points, ..GapOptions::default() }, &Serial)?;
    let evidence = diagnosis.evidence();
    // Whether two effects are looked for at once depends on the calibration itself.
    let single = evidence.contenders.iter().filter(|c| effects::parts(&c.id).nth(1).is_none());
    let mut leads: Vec<String> = single.map(|c| format!("{} {:.3}\n", c.id, c.lead)).collect();
    leads.sort();
    let hash = Sha256::digest(format!("{:.3?}\n{}", evidence.basis.base.over_floor, leads.concat()));
    Ok(hash.iter().take(4).map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::gap::evidence::{Basis, Contender, Left};
    use stiction::core::gap::{NONE, Stage, UNKNOWN};
    use stiction::core::sim::noise::Noise;

    /// What a fit leaves: log likelihood a point with white noise, and what noise with a memory adds.
    fn left(white: f64, memory: f64) -> Left {
        let one_step = core::array::from_fn(|order| [white + if order > 0 { memory } else { 0.0 }; 2]);
        Left { over_floor: Some(1.0), fitted: [500, 8], one_step }
    }

    fn evidence(base: [f64; 2], effect: [f64; 2]) -> Evidence {
        let contender = Contender {
            id: "extra_lag".to_owned(),
            stage: Stage::Process,
            lead: effect[0] - base[0],
            closed_pct: Some(50.0),
            left: left(effect[0], effect[1]),
        };
        let basis = Basis {
            traces: Vec::new(),
            acts: None,
            skew: None,
            coloured_noise: false,
            by_mv: None,
            base_at_floor: false,
            base: left(base[0], base[1]),
        };
        Evidence { basis, contenders: vec![contender] }
    }

    #[test]
    fn the_numbers_are_found_that_tell_three_kinds_of_loops_apart() {
        let mut noise = Noise::new(5, 0);
        let mut all = Vec::new();
        for _ in 0..60 {
            let mut some = |from: f64, to: f64| from + (to - from) * noise.uniform();
            let gain = some(0.2, 1.0);
            let loops = [
                (NONE, evidence([1.0, 0.0], [1.0 + some(0.0, 0.02), 0.0])),
                ("extra_lag", evidence([1.0, some(0.0, 0.2)], [1.0 + gain, some(0.0, 0.01)])),
                (UNKNOWN, evidence([1.0, some(0.2, 0.4)], [1.02, some(0.2, 0.4)])),
            ];
            all.extend(loops.map(|(id, evidence)| Example { evidence, right: vec![id.to_owned()], weight: 1.0 }));
        }
        let biased = Calibration { unknown: 8.0, none: -2.0, ..Calibration::blank() };
        let made = fit(&all, &biased);
        let hits = |calibration: &Calibration| {
            let said = |e: &Example| e.right.contains(&answers(&[&e.evidence], calibration)[0].id);
            all.iter().filter(|e| said(e)).count()
        };
        assert!(hits(&made) >= 165 && hits(&made) > hits(&biased) + 20, "{} {}", hits(&biased), hits(&made));
        assert!(made.temperature >= COLDEST && log_likelihood(&all, &made) > log_likelihood(&all, &biased));
    }
}
