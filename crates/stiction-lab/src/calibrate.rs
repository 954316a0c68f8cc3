//! Fits the rule and evaluates it on data that it was not fitted to.

use std::collections::BTreeSet;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use stiction::core::verdict::features::{Features, Figures};
use stiction::core::verdict::rule::{Cuts, Logistic, Made, Rule, Weight, logistic};
use stiction::core::verdict::tally::Scored;

/// One case with a known truth, as stored between fits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Example {
    /// A file name, or a simulated loop.
    pub name: String,
    /// The collection of a recording, or the kind of a simulated loop.
    pub source: String,
    /// The valve of a recording; `None` for a simulated loop.
    pub valve: Option<String>,
    /// Group of recordings of the same data.
    pub group: String,
    /// Reserved for the report, never fitted.
    pub held: bool,
    /// The valve sticks.
    pub truth: bool,
    /// The blocking gate that prevents an answer.
    pub gate: Option<String>,
    /// The figures of every window of the case, see [`stiction::core::verdict::figures`].
    pub windows: Vec<Figures>,
}

/// Settings of the fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Names of the features used, one list for each of the rules whose logits are averaged.
    pub features: Vec<Vec<String>>,
    /// Penalty on the squared weights of standardised features.
    pub ridge: f64,
    /// Weight of all simulated loops together, in real valves.
    pub simulated_weight: f64,
    /// Decision thresholds of the rule.
    pub cuts: Cuts,
    /// Seed of the first simulated loop, for the record.
    pub seed: u64,
}

/// Most rounds of reweighting; such a fit converges in fewer than ten.
const ROUNDS: usize = 60;
/// Weights are rounded to multiples of one over this.
const DIGITS: f64 = 1e4;
/// Fewest simulated loops for rescaling the probabilities to their rates.
const ENOUGH: usize = 100;

/// Weight of each example: a valve has weight 1, shared equally by its data groups and within them by their recordings; all
/// simulated loops together have weight `simulated_weight`. Examples without an answer have weight 0.
#[must_use]
pub fn weights(examples: &[Example], simulated_weight: f64) -> Vec<f64> {
    let usable = |e: &&Example| e.gate.is_none();
    let simulated = examples.iter().filter(usable).filter(|e| e.valve.is_none() && !e.held).count();
    let of = |e: &Example| match &e.valve {
        _ if e.gate.is_some() || e.held => 0.0,
        None => simulated_weight / simulated as f64,
        Some(_) => {
            let mates = || examples.iter().filter(usable).filter(|x| x.valve == e.valve && !x.held);
            let groups: BTreeSet<&str> = mates().map(|x| x.group.as_str()).collect();
            let records = mates().filter(|x| x.group == e.group).count();
            1.0 / (groups.len() * records) as f64
        }
    };
    examples.iter().map(of).collect()
}

/// One row of a fit: features, truth, weight, and whether the loop is simulated.
struct Row {
    features: Features,
    truth: f64,
    weight: f64,
    simulated: bool,
}

/// The windows of the examples with a weight, which is divided among them.
fn rows(examples: &[Example], given: &[f64]) -> Vec<Row> {
    let used = examples.iter().zip(given).filter(|(_, w)| **w > 0.0);
    let of = |(e, w): (&Example, &f64)| {
        let (truth, simulated) = (f64::from(u8::from(e.truth)), e.valve.is_none());
        let weight = w / e.windows.len().max(1) as f64;
        let row = move |f: &Figures| Row { features: f.features(), truth, weight, simulated };
        e.windows.iter().map(row).collect::<Vec<_>>()
    };
    used.flat_map(of).collect()
}

/// Fits the rules by L2-penalised logistic regression (iteratively reweighted least squares) to the examples with a weight; a
/// feature that an example lacks is set to its mean. `None` if no example has a weight.
#[must_use]
pub fn fit(examples: &[Example], given: &[f64], settings: &Settings) -> Option<Rule> {
    let rows = rows(examples, given);
    if rows.is_empty() {
        return None;
    }
    let parts: Option<Vec<Logistic>> =
        settings.features.iter().map(|names| fit_one(&rows, names, settings.ridge)).collect();
    let mut rule = Rule { parts: parts?, cuts: settings.cuts, made: made_of(examples, given, settings) };
    let (offset, slope) = rescale(&rows, &rule).unwrap_or((0.0, 1.0));
    for part in &mut rule.parts {
        part.constant = rounded(slope * part.constant + offset);
        part.weights.iter_mut().for_each(|w| w.weight = rounded(slope * w.weight));
    }
    Some(rule)
}

fn rounded(v: f64) -> f64 {
    (v * DIGITS).round() / DIGITS
}

fn fit_one(rows: &[Row], names: &[String], ridge: f64) -> Option<Logistic> {
    let k = names.len();
    let (mut means, mut scales) = (Vec::with_capacity(k), Vec::with_capacity(k));
    for name in names {
        let known = || rows.iter().filter_map(|r| Some((r.features.get(name)?, r.weight)));
        let total: f64 = known().map(|(_, w)| w).sum();
        let mean = if total > 0.0 { known().map(|(x, w)| x * w).sum::<f64>() / total } else { 0.0 };
        let squares: f64 = known().map(|(x, w)| w * (x - mean) * (x - mean)).sum();
        means.push(rounded(mean));
        scales.push(if squares > 0.0 { (squares / total).sqrt() } else { 1.0 });
    }
    let cell = |row: usize, column: usize| match column {
        0 => 1.0,
        c => rows[row].features.get(&names[c - 1]).map_or(0.0, |x| (x - means[c - 1]) / scales[c - 1]),
    };
    let x = DMatrix::from_fn(rows.len(), k + 1, cell);
    let made: Vec<[f64; 2]> = rows.iter().map(|r| [r.truth, r.weight]).collect();
    let solution = regress(&x, &made, ridge)?;
    let of = |i: usize| Weight { feature: names[i].clone(), weight: solution[i + 1] / scales[i], mean: means[i] };
    let weights: Vec<Weight> = (0..k).map(of).collect();
    let shift: f64 = weights.iter().map(|w| w.weight * w.mean).sum();
    Some(Logistic { constant: solution[0] - shift, weights })
}

fn made_of(examples: &[Example], weights: &[f64], settings: &Settings) -> Made {
    let used: Vec<&Example> = examples.iter().zip(weights).filter(|(_, w)| **w > 0.0).map(|(e, _)| e).collect();
    let loops = |truth: bool| used.iter().filter(|e| e.valve.is_none() && e.truth == truth).count();
    let valves: BTreeSet<&str> = used.iter().filter_map(|e| e.valve.as_deref()).collect();
    Made {
        sticking_loops: loops(true),
        healthy_loops: loops(false),
        simulated_weight: settings.simulated_weight,
        recordings: used.iter().filter(|e| e.valve.is_some()).count(),
        valves: valves.len(),
        ridge: settings.ridge,
        seed: settings.seed,
    }
}

/// Offset and slope that turn the logits into calibrated probabilities for the simulated loops (Platt 1999), which are numerous
/// enough: real recordings help to choose the weights, but are too few to estimate rates.
fn rescale(rows: &[Row], rule: &Rule) -> Option<(f64, f64)> {
    let simulated: Vec<&Row> = rows.iter().filter(|r| r.simulated).collect();
    if simulated.len() < ENOUGH {
        return None;
    }
    let logits: Vec<f64> = simulated.iter().map(|r| rule.opinion(&r.features).logit).collect();
    let columns = DMatrix::from_fn(logits.len(), 2, |row, column| if column == 0 { 1.0 } else { logits[row] });
    let made: Vec<[f64; 2]> = simulated.iter().map(|r| [r.truth, 1.0]).collect();
    let found = regress(&columns, &made, 0.0)?;
    (found[1] > 0.0).then_some((found[0], found[1]))
}

/// Weights of the columns of `x` (the first is the constant, which is not penalised); each element of `made` is truth and
/// weight.
pub(crate) fn regress(x: &DMatrix<f64>, made: &[[f64; 2]], ridge: f64) -> Option<DVector<f64>> {
    let (n, k) = x.shape();
    let mut b = DVector::<f64>::zeros(k);
    for _ in 0..ROUNDS {
        let z = x * &b;
        let mut gradient = DVector::<f64>::zeros(k);
        let mut hessian = DMatrix::<f64>::zeros(k, k);
        for row in 0..n {
            let [truth, weight] = made[row];
            let p = logistic(z[row]);
            let (pull, curve) = (weight * (p - truth), (weight * p * (1.0 - p)).max(1e-12));
            for i in 0..k {
                gradient[i] += pull * x[(row, i)];
                for j in 0..k {
                    hessian[(i, j)] += curve * x[(row, i)] * x[(row, j)];
                }
            }
        }
        for i in 1..k {
            gradient[i] += ridge * b[i];
            hessian[(i, i)] += ridge;
        }
        let step = hessian.cholesky()?.solve(&gradient);
        b -= &step;
        if step.amax() < 1e-9 {
            break;
        }
    }
    Some(b)
}

/// Applies a rule to an example.
#[must_use]
pub fn ask(rule: &Rule, example: &Example, weight: f64) -> Scored {
    if example.gate.is_some() {
        return Scored { truth: example.truth, answer: None, p: None, weight };
    }
    let Some((window, opinion)) = rule.answer(&example.windows) else {
        return Scored { truth: example.truth, answer: None, p: None, weight };
    };
    let fitted = example.windows[window].fit.is_some();
    let answer = (fitted || !opinion.sticks()).then_some(opinion.sticks());
    Scored { truth: example.truth, answer, p: Some(opinion.p()), weight }
}

/// Judges every recording by a rule fitted without its valve, in the order of the examples; simulated loops are in the fits,
/// but not in the result.
#[must_use]
pub fn leave_one_valve_out<'e>(examples: &'e [Example], settings: &Settings) -> Vec<(&'e Example, Scored)> {
    let weights = weights(examples, settings.simulated_weight);
    let valves: BTreeSet<&str> = examples.iter().filter_map(|e| e.valve.as_deref()).collect();
    let mut out = Vec::new();
    for valve in valves {
        let without: Vec<f64> = examples
            .iter()
            .zip(&weights)
            .map(|(e, w)| if e.valve.as_deref() == Some(valve) { 0.0 } else { *w })
            .collect();
        let Some(rule) = fit(examples, &without, settings) else { continue };
        out.extend(examples.iter().filter(|e| e.valve.as_deref() == Some(valve)).map(|e| (e, ask(&rule, e, 1.0))));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::detect::{ALL, Detector};
    use stiction::core::verdict::features::FitFigures;
    use stiction::core::verdict::tally::{Tally, miscalibration, reliability_equal};

    fn settings(features: &[&str]) -> Settings {
        Settings {
            features: vec![features.iter().map(|f| (*f).to_owned()).collect()],
            ridge: 1e-6,
            simulated_weight: 1000.0,
            cuts: Cuts { called: 0.5, alarm: 0.7 },
            seed: 1,
        }
    }

    /// Loops whose truth follows a logistic law in `travel`, and does not depend on `horch`.
    fn loops(n: usize) -> Vec<Example> {
        let mut state = 7_u64;
        let mut draw = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..n)
            .map(|k| {
                let (travel, horch) = (draw(), draw());
                let score = |d: &dyn Detector| match d.name() {
                    "travel" => Some(travel),
                    "horch" if k % 10 != 3 => Some(horch),
                    _ => None,
                };
                let fit = Some(FitFigures::default());
                let figures = Figures { fit, setpoint_share: 0.0, interpolated: false, detectors: ALL.map(score) };
                Example {
                    name: format!("loop {k}"),
                    source: "drawn".to_owned(),
                    valve: None,
                    group: format!("loop {k}"),
                    held: k % 2 == 1,
                    truth: draw() < logistic(-3.0 + 6.0 * travel),
                    gate: None,
                    windows: vec![figures],
                }
            })
            .collect()
    }

    #[test]
    fn a_logistic_law_is_found_again_and_is_calibrated() {
        let examples = loops(8000);
        let settings = settings(&["travel", "horch"]);
        let rule = fit(&examples, &weights(&examples, 1000.0), &settings).unwrap();
        assert!((rule.parts[0].weights[0].weight - 6.0).abs() < 0.5, "{rule:?}");
        assert!(rule.parts[0].weights[1].weight.abs() < 0.3, "{rule:?}");
        assert!((rule.parts[0].constant + 3.0).abs() < 0.4, "{rule:?}");
        assert_eq!(rule.made.sticking_loops + rule.made.healthy_loops, 4000);
        let told: Vec<Scored> = examples.iter().filter(|e| e.held).map(|e| ask(&rule, e, 1.0)).collect();
        assert!(miscalibration(&reliability_equal(&told, 10)).unwrap() < 0.03);
        assert!(Tally::of(&told).right() > 0.7 * 4000.0);
    }

    #[test]
    fn a_valve_weighs_one_and_is_judged_by_strangers() {
        let mut examples = loops(200);
        for (k, e) in examples.iter_mut().enumerate().take(30) {
            (e.valve, e.held) = (Some(format!("valve {}", k / 10)), false);
            if k < 5 {
                e.group = "same".to_owned();
            }
        }
        examples[29].gate = Some("frozen_pv".to_owned());
        let weights = weights(&examples, 40.0);
        for valve in 0..3 {
            assert!((weights[10 * valve..10 * valve + 10].iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
        assert_eq!(weights[29], 0.0);
        assert!((weights[0] - 1.0 / 30.0).abs() < 1e-12 && (weights[5] - 1.0 / 6.0).abs() < 1e-12);
        assert!((weights[30..].iter().sum::<f64>() - 40.0).abs() < 1e-9);
        let told = leave_one_valve_out(&examples, &settings(&["travel"]));
        assert_eq!(told.len(), 30);
        assert_eq!(told.iter().filter(|(_, s)| s.p.is_none()).count(), 1);
        assert!(fit(&examples, &[0.0; 200], &settings(&["travel"])).is_none());
    }
}
