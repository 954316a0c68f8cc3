//! The decision: what is named, what else is possible, and what is left unnamed.
//!
//! Every answer combines a model (the base, or the base with an effect) with a noise model (white or autoregressive). Its score
//! is the likelihood of one-step predictions of PV at the fitted points, less a penalty for its parameters (Schwarz 1978). One
//! mistimed slip spoils one such prediction, but the whole rest of a free run. If an effect needs coloured noise, a cause
//! outside the catalogue is likely. Held-out blocks take no part in the choice; they confirm it.

use super::calibration::Calibration;
use super::effects::{self, Way};
use super::evidence::{Contender, Evidence};
use super::types::{Alternative, Cause, EffectNote, NONE, Stage, UNKNOWN};
use crate::core::signal::stats;
use crate::core::verdict::rule::logistic;

/// Least probability for naming an effect. On seed 201 of split A, 0.5 named as many effects rightly and three more wrongly.
const NAMED: f64 = 0.6;
/// Alternatives less likely than this are not listed.
const TOLD: f64 = 0.005;
/// Windows that must show a recorder's trace, if there are several: a single one may show it by chance.
const WITH_TRACE: usize = 2;
/// Error over the floor up to which a record is explained.
pub(super) const EXPLAINED: f64 = 1.2;
/// Per cent of the held-out gap above which an effect's share is more than chance.
const CLOSES: f64 = 5.0;

/// The answer without its confirmation.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// What is named.
    pub cause: Cause,
    /// What acts on the plant under what the recorder did, or what the recorder did beside what acts.
    pub second: Option<Alternative>,
    /// What else, best first.
    pub alternatives: Vec<Alternative>,
}

/// An answer that a likelihood can give.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// An effect's id, two joined by `+`, [`NONE`] or [`UNKNOWN`].
    pub id: String,
    /// Probability; the sum over all answers is 1.
    pub p: f64,
}

/// Decides from one record, or from several windows of one valve.
#[must_use]
pub fn decide(windows: &[&Evidence], calibration: &Calibration) -> Decision {
    let answers = answers(windows, calibration);
    let chosen = choose(&answers);
    let trace = trace(windows);
    let skewed = is_most(windows, |w| w.basis.skew.is_some()).then_some(effects::time_skew::EFFECT.id);
    let recorded = trace.filter(|t| is_whole_story(windows, t)).or(skewed).map(|id| (id, calibration.trace));
    let acts = acts(windows).map(|load| (load, calibration.acts));
    let (id, probability) = recorded.or(acts).unwrap_or(chosen);
    let named = chosen.0 != NONE && chosen.0 != UNKNOWN;
    let beside = if recorded.is_some() { Some(chosen) } else { trace.map(|id| (id, calibration.trace)) };
    let second = beside.filter(|_| named).map(|(id, probability)| Alternative { id: id.to_owned(), probability });
    let cause = Cause { id: id.to_owned(), probability, confirmed: false, stage: stage_of(windows, id) };
    let said = |of: &str| of == cause.id || second.as_ref().is_some_and(|s| s.id == of);
    let others: Vec<&Answer> = answers.iter().filter(|a| !said(&a.id)).collect();
    let sum: f64 = others.iter().map(|a| a.p).sum();
    let share = if sum > 0.0 { (1.0 - cause.probability) / sum } else { 0.0 };
    let other = |a: &&Answer| Alternative { id: a.id.clone(), probability: a.p * share };
    let alternatives = others.iter().map(other).filter(|a| a.probability > TOLD).collect();
    Decision { cause, second, alternatives }
}

/// The likeliest answer; an effect only from the probability at which effects are named.
fn choose(answers: &[Answer]) -> (&str, f64) {
    let is_effect = |a: &&Answer| a.id != NONE && a.id != UNKNOWN;
    let named = answers.first().filter(|a| !is_effect(a) || a.p >= NAMED);
    let said = named.or_else(|| answers.iter().find(|a| !is_effect(a)));
    said.map_or((UNKNOWN, 0.0), |a| (&a.id, a.p))
}

/// What a recorder did to PV: of the traces in enough windows the one in most, the strongest first.
fn trace<'e>(windows: &[&'e Evidence]) -> Option<&'e str> {
    let enough = WITH_TRACE.min(windows.len());
    let count = |trace: &str| windows.iter().filter(|w| w.basis.traces.iter().any(|t| t == trace)).count();
    let all = || windows.iter().flat_map(|w| w.basis.traces.iter().map(String::as_str));
    let most = all().map(count).filter(|n| *n >= enough).max()?;
    all().find(|trace| count(trace) == most)
}

/// Whether a trace is all there is: single wild samples only where the rest is explained.
fn is_whole_story(windows: &[&Evidence], trace: &str) -> bool {
    let explained = |w: &Evidence| w.basis.base.over_floor.is_none_or(|over| over < EXPLAINED);
    trace != effects::outliers::EFFECT.id || is_most(windows, explained)
}

/// The load of another loop that the noise model has in both halves: a disturbance that wanders hides it from the free run.
fn acts<'e>(windows: &[&'e Evidence]) -> Option<&'e str> {
    let unexplained = |w: &Evidence| !w.basis.base_at_floor && w.basis.by_mv != Some(Stage::Valve);
    let acting = |w: &Evidence, load: &str| unexplained(w) && w.basis.acts.as_deref() == Some(load);
    let mut all = windows.iter().filter_map(|w| w.basis.acts.as_deref());
    all.find(|load| is_most(windows, |w| acting(w, load)))
}

/// All answers with their probabilities, best first.
#[must_use]
pub fn answers(windows: &[&Evidence], calibration: &Calibration) -> Vec<Answer> {
    let base = summed(windows, |_| None);
    let over_base = |scores: [f64; 5]| scores.map(|score| score - base[0]);
    let of_base = over_base(base);
    let tried: Vec<(&str, [f64; 5])> =
        ids(windows).into_iter().map(|id| (id, over_base(summed(windows, |w| contender(w, id))))).collect();
    let effects: Vec<(&str, f64)> = tried
        .iter()
        .filter(|(id, _)| is_allowed(windows, id))
        .map(|(id, scores)| (*id, of_effect(id, scores, calibration)))
        .collect();
    let higher = best(of_base[2..].iter().copied());
    // Even the right effect misses a share of what there is to explain, so differences count less where that is much.
    let most = best(effects.iter().map(|(_, gained)| *gained).chain([0.0, higher]));
    let nats = calibration.temperature + calibration.misfit * most;
    // White noise larger than PV's floor also has an unknown cause.
    let own_noise = higher.max(of_base[1]).max(0.0) / nats + calibration.unknown;
    // Coloured noise and unknown share these odds; the order of the noise splits them.
    let is_asked = is_most(windows, |w| w.basis.coloured_noise);
    let first = if is_asked { logistic((of_base[1] - higher.max(0.0)) / calibration.temperature) } else { 0.0 };
    let beside = best(tried.iter().flat_map(|(_, scores)| scores[2..].iter().copied())) / nats + calibration.beside;
    let mut odds = vec![
        (NONE, above_floor(windows) / nats + calibration.none),
        (UNKNOWN, (own_noise + libm::log(1.0 - first)).max(beside)),
        (effects::coloured_noise::EFFECT.id, own_noise + libm::log(first)),
    ];
    odds.extend(effects.iter().map(|(id, gained)| (*id, gained / nats - cost(id, calibration))));
    softmax(&odds)
}

/// Log likelihood that an effect gains over the base with white noise, plus a share of what autoregressive noise adds, nats.
fn of_effect(id: &str, scores: &[f64; 5], calibration: &Calibration) -> f64 {
    // A sensor filter colours the noise itself.
    if effects::by_id(id).is_some_and(|e| e.way == Way::Filter) {
        return scores[1];
    }
    let memory = best(scores[1..].iter().copied()) - scores[0];
    scores[0] + calibration.memory * memory.max(0.0)
}

/// Log odds against an effect before the record is seen.
fn cost(id: &str, calibration: &Calibration) -> f64 {
    let costs = [(calibration.pair, is_pair(id)), (calibration.bend, bends(id))];
    costs.iter().filter(|(_, is)| *is).map(|(cost, _)| cost).sum()
}

/// Log likelihood, nats, that white noise of the base loses if its size must be PV's noise floor; 0 or less.
fn above_floor(windows: &[&Evidence]) -> f64 {
    let of = |w: &&Evidence| {
        let over = w.basis.base.over_floor.unwrap_or(1.0).max(1.0);
        w.basis.base.fitted[0] as f64 * (0.5 + libm::log(over) - 0.5 * over * over)
    };
    windows.iter().map(of).sum()
}

/// Probabilities of answers with these log odds, best first.
fn softmax(odds: &[(&str, f64)]) -> Vec<Answer> {
    let most = best(odds.iter().map(|(_, z)| *z));
    let mut all: Vec<Answer> =
        odds.iter().map(|(id, z)| Answer { id: (*id).to_owned(), p: libm::exp(z - most) }).collect();
    let sum: f64 = all.iter().map(|a| a.p).sum();
    all.iter_mut().for_each(|a| a.p /= sum);
    all.sort_by(|a, b| b.p.total_cmp(&a.p));
    all
}

fn best(of: impl Iterator<Item = f64>) -> f64 {
    of.fold(f64::NEG_INFINITY, f64::max)
}

/// Whether an id is that of two effects.
fn is_pair(id: &str) -> bool {
    effects::parts(id).nth(1).is_some()
}

/// Whether an effect, or one of two, can fit nearly anything.
fn bends(id: &str) -> bool {
    effects::parts(id).any(|part| effects::by_id(part).is_some_and(|e| e.bends))
}

/// The effects that were tried in any window, each once.
fn ids<'e>(windows: &[&'e Evidence]) -> Vec<&'e str> {
    let mut all: Vec<&str> = windows.iter().flat_map(|w| w.contenders.iter().map(|c| c.id.as_str())).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Scores by the order of the noise, summed over the windows. A window in which the effect was not tried counts as the base.
fn summed<'e>(windows: &[&'e Evidence], of: impl Fn(&'e Evidence) -> Option<&'e Contender>) -> [f64; 5] {
    let each = windows.iter().map(|w| of(w).map_or(&w.basis.base, |c| &c.left).scores());
    each.fold([0.0; 5], |sum, own| core::array::from_fn(|order| sum[order] + own[order]))
}

fn contender<'e>(of: &'e Evidence, id: &str) -> Option<&'e Contender> {
    of.contenders.iter().find(|c| c.id == id)
}

/// Whether an effect is what its name says, and acts where a recorded valve position lets it act.
fn is_allowed(windows: &[&Evidence], id: &str) -> bool {
    let fits = |w: &Evidence| {
        let own = contender(w, id)?;
        let stands = match w.basis.by_mv {
            Some(Stage::Valve) => own.stage == Stage::Valve,
            Some(Stage::Process) => effects::parts(id).all(|id| effects::by_id(id).is_none_or(|e| e.behind_stem)),
            _ => true,
        };
        Some(own.lead > 0.0 && stands)
    };
    is_most(windows, |w| fits(w) == Some(true))
}

fn is_most(windows: &[&Evidence], is: impl Fn(&Evidence) -> bool) -> bool {
    2 * windows.iter().filter(|w| is(w)).count() > windows.len()
}

/// Where an answer acts.
fn stage_of(windows: &[&Evidence], id: &str) -> Stage {
    let weighed = || windows.iter().find_map(|w| contender(w, id)).map(|c| c.stage);
    let known = || effects::by_id(id).map(|e| e.stage);
    if id == NONE { Stage::None } else { weighed().or_else(known).unwrap_or(Stage::CannotTell) }
}

/// Whether held-out blocks, and where it can say so the run forward in time, bear a call out.
#[must_use]
pub(crate) fn confirmed(effect: &EffectNote, forward: Option<[f64; 2]>) -> bool {
    let closes = effect.closed_pct.is_some_and(|c| c > CLOSES) || effect.gap_after < 0.9 * effect.gap_before;
    let local = effects::parts(&effect.id).any(|id| effects::by_id(id).is_some_and(|e| e.local));
    closes && (local || forward.is_none_or(|[before, after]| after < before))
}

/// Whether held-out blocks alone bear an answer out, for one that was decided from several windows or again.
#[must_use]
pub fn holds_out(windows: &[&Evidence], id: &str) -> bool {
    if id == NONE {
        return is_most(windows, |w| w.basis.base_at_floor);
    }
    let tried: Vec<&Contender> = windows.iter().filter_map(|w| contender(w, id)).collect();
    let closed: Vec<f64> = tried.iter().filter_map(|c| c.closed_pct).collect();
    let shown = trace(windows) == Some(id) || id == effects::time_skew::EFFECT.id;
    if tried.is_empty() { shown } else { !closed.is_empty() && stats::median(&closed) > CLOSES }
}

/// Whether free run can predict an effect.
#[must_use]
pub(crate) fn predictable(id: &str) -> bool {
    effects::parts(id).all(|part| effects::by_id(part).is_none_or(|e| e.predictable && e.way != Way::Noise))
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::evidence::{Basis, Left};
    use super::*;

    /// Numbers that make every case below clear.
    fn calibration() -> Calibration {
        Calibration { temperature: 1.0, misfit: 0.02, ..Calibration::blank() }
    }

    /// What a fit leaves: nats a point with white noise, and what noise adds that has a memory of one point, or of more.
    fn left(white: f64, [first, more]: [f64; 2]) -> Left {
        let of = |order: usize| white + if order > 0 { first } else { 0.0 } + if order > 1 { more } else { 0.0 };
        Left { over_floor: Some(1.0), fitted: [900, 8], one_step: core::array::from_fn(|order| [of(order); 2]) }
    }

    pub(in crate::core::gap) fn basis(traces: &[&str]) -> Basis {
        Basis {
            traces: traces.iter().map(|t| (*t).to_owned()).collect(),
            acts: None,
            skew: None,
            coloured_noise: true,
            by_mv: None,
            base_at_floor: false,
            base: left(0.0, [0.0; 2]),
        }
    }

    /// An effect that gains so much a point over the base, and what a memory of first order adds.
    pub(in crate::core::gap) fn contender(id: &str, gain: f64, memory: f64) -> Contender {
        let left = Left { fitted: [900, 10], ..left(gain, [memory, 0.0]) };
        Contender { id: id.to_owned(), stage: Stage::Process, lead: gain, closed_pct: Some(60.0), left }
    }

    fn said(basis: Basis, contenders: Vec<Contender>) -> String {
        decide(&[&Evidence { basis, contenders }], &calibration()).cause.id
    }

    #[test]
    fn the_noise_that_an_answer_needs_decides_between_them() {
        let with_memory = |memory| Basis { base: left(0.0, memory), ..basis(&[]) };
        let weak = || vec![contender("ramp", 0.001, 0.0)];
        assert_eq!(said(basis(&[]), weak()), NONE, "two numbers cost more than they gain");
        assert_eq!(said(basis(&[]), vec![contender("ramp", 0.3, 0.0)]), "ramp");
        assert_eq!(said(with_memory([0.3, 0.0]), weak()), "coloured_noise");
        assert_eq!(said(with_memory([0.3, 0.1]), weak()), UNKNOWN, "a cycle elsewhere is of higher order");
        let not_asked = Basis { coloured_noise: false, ..with_memory([0.3, 0.0]) };
        assert_eq!(said(not_asked, weak()), UNKNOWN);
        assert_eq!(said(basis(&[]), vec![contender("ramp", 0.3, 0.2)]), UNKNOWN, "what it leaves is no noise");
        assert_eq!(said(with_memory([0.3, 0.1]), vec![contender("ramp", 0.6, 0.0)]), "ramp");
    }

    #[test]
    fn probabilities_sum_to_one_and_an_effect_is_named_where_it_is_likelier_than_all_else() {
        let lag = |gain: f64| contender("extra_lag", gain, 0.0);
        let of = |rivals: Vec<Contender>| Evidence { basis: basis(&[]), contenders: rivals };
        let evidence = of(vec![lag(0.301), contender("integrating", 0.295, 0.0)]);
        let all = answers(&[&evidence], &calibration());
        assert!((all.iter().map(|a| a.p).sum::<f64>() - 1.0).abs() < 1e-12 && all[0].id == "extra_lag");
        let named = decide(&[&evidence], &calibration());
        let told: f64 = named.alternatives.iter().map(|a| a.probability).sum();
        assert!((named.cause.probability + told - 1.0).abs() < 0.02 && named.alternatives[0].id == "integrating");
        let three = ["integrating", "backlash"].map(|id| contender(id, 0.301, 0.0));
        let unsure = decide(&[&of(three.into_iter().chain([lag(0.301)]).collect())], &calibration());
        assert_eq!((named.cause.id.as_str(), unsure.cause.id.as_str()), ("extra_lag", UNKNOWN));
    }

    #[test]
    fn what_a_recorder_did_is_the_cause_and_what_acts_under_it_the_second() {
        let ramp = |gain| vec![contender("ramp", gain, 0.0)];
        let of = |contenders| decide(&[&Evidence { basis: basis(&["swinging_door"]), contenders }], &calibration());
        let both = of(ramp(0.3));
        assert_eq!((both.cause.id.as_str(), both.second.unwrap().id.as_str()), ("swinging_door", "ramp"));
        assert_eq!(of(ramp(0.0)).second, None);
        let over =
            |over| Basis { base: Left { over_floor: Some(over), ..left(0.0, [0.0; 2]) }, ..basis(&["outliers"]) };
        assert_eq!(said(over(1.1), ramp(0.3)), "outliers");
        assert_eq!(said(over(3.0), ramp(0.3)), "ramp", "single wild samples are not all that is left");
        let skewed = Basis { skew: Some(5.0), ..basis(&[]) };
        assert_eq!(said(skewed, ramp(0.3)), "time_skew");
    }

    #[test]
    fn a_load_of_both_halves_is_named_but_where_the_base_or_the_valve_position_explains_pv() {
        let load = "neighbour(F7)";
        let evidence = |basis: Basis| Evidence { basis, contenders: vec![contender("sinusoid", 0.3, 0.0)] };
        let named = |basis: Basis| decide(&[&evidence(basis)], &calibration()).cause;
        let acts = || Basis { acts: Some(load.to_owned()), ..basis(&[]) };
        let cause = named(acts());
        assert_eq!((cause.id.as_str(), cause.stage), (load, Stage::Disturbance));
        assert!((cause.probability - calibration().acts).abs() < 1e-12);
        assert_ne!(decide(&[&evidence(acts()).without("neighbour")], &calibration()).cause.id, load);
        assert_ne!(named(Basis { by_mv: Some(Stage::Valve), ..acts() }).id, load);
        assert_ne!(named(Basis { base_at_floor: true, ..acts() }).id, load);
    }

    #[test]
    fn windows_add_what_they_show() {
        let window = |gain: f64| Evidence { basis: basis(&[]), contenders: vec![contender("ramp", gain, 0.0)] };
        let said = |windows: &[&Evidence]| decide(windows, &calibration()).cause.id;
        let (faint, silent) = (window(0.011), Evidence { contenders: Vec::new(), ..window(0.0) });
        assert_eq!(said(&[&faint]), NONE);
        assert_eq!(said(&[&faint; 5]), "ramp");
        assert_eq!(said(&[&faint, &silent, &silent]), NONE, "most windows did not try it");
    }
}
