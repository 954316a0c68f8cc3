//! All figures of the challenge, over all cases and over parts of them.

use serde::Serialize;

use super::{Judged, Right};
use crate::challenge::kinds::Kind;
use crate::challenge::truth::Truth;
use stiction::core::signal::stats::median;
use stiction::core::verdict::tally::{Bin, Scored, brier, reliability_equal, wilson};

/// Cases per line of the reliability table, and most lines.
const BINS: usize = 6;

/// A proportion with its 95 % interval (Wilson 1927); null without a case.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Rate {
    /// Number right.
    pub right: usize,
    /// Total.
    pub of: usize,
    /// Share.
    pub share: Option<f64>,
    /// 95 % interval.
    pub interval: Option<[f64; 2]>,
}

impl Rate {
    fn of(right: usize, of: usize) -> Self {
        let share = (of > 0).then(|| right as f64 / of as f64);
        Self { right, of, share, interval: wilson(right as f64, of as f64) }
    }

    fn count<'a>(cases: impl Iterator<Item = &'a Judged<'a>>, right: impl Fn(&Judged<'_>) -> bool) -> Self {
        let (mut yes, mut all) = (0, 0);
        for case in cases {
            all += 1;
            yes += usize::from(right(case));
        }
        Self::of(yes, all)
    }
}

/// The figures of a group of cases.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Group {
    /// Name of the group.
    pub name: String,
    /// Number of cases.
    pub cases: usize,
    /// Effects of the catalogue for which the right id is named.
    pub top1: Rate,
    /// The right id is named or is the first alternative.
    pub top2: Rate,
    /// The location is right.
    pub stage: Rate,
    /// Answer rate: effects of the catalogue answered with an id.
    pub coverage: Rate,
    /// Precision: right ones among all named effects.
    pub precision: Rate,
    /// Cases without effect for which an effect is named.
    pub named_false_alarms: Rate,
    /// Cases without effect with any answer other than `none`.
    pub all_false_alarms: Rate,
    /// Effects outside the catalogue answered `unknown`.
    pub unknown_foreign: Rate,
    /// Effects of the catalogue, withheld, answered `unknown`.
    pub unknown_withheld: Rate,
    /// The same, also counting an effect as right that is stated to be indistinguishable from the truth.
    pub unknown_or_mate_withheld: Rate,
    /// Two effects at once: one of them (or both) named.
    pub pairs: Rate,
    /// Both named.
    pub both: Rate,
    /// Right ones among second causes, over all cases.
    pub beside: Rate,
    /// Share of the gap closed by right answers, %, median.
    pub closed_right_pct: Option<f64>,
    /// By wrong answers.
    pub closed_wrong_pct: Option<f64>,
    /// True effects with a fit at the noise floor of the training blocks.
    pub true_fit_at_floor: Rate,
    /// Loops without effect with a base at the noise floor.
    pub base_at_floor: Rate,
}

/// Figures of one effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EffectRow {
    /// Its id, `none`, `pair`.
    pub effect: String,
    /// Number of cases, and of those in which the base leaves more than the noise.
    pub cases: usize,
    /// See `cases`.
    pub expressed: usize,
    /// Right answers with the whole catalogue.
    pub named: Rate,
    /// With the effect withheld: answers `unknown`.
    pub unknown: Rate,
    /// Median gap relative to PV's standard deviation, %: of the base, with the named effect, with the true form, and of the
    /// noise.
    pub gap_without_pct: Option<f64>,
    /// See `gap_without_pct`.
    pub gap_with_pct: Option<f64>,
    /// See `gap_without_pct`.
    pub gap_oracle_pct: Option<f64>,
    /// See `gap_without_pct`.
    pub noise_pct: Option<f64>,
    /// Share closed if the answer is right, %, median.
    pub closed_pct: Option<f64>,
}

/// Precision and answer rate for answers of at least this probability.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CurvePoint {
    /// Least probability.
    pub p: f64,
    /// See [`Group::coverage`].
    pub coverage: Rate,
    /// See [`Group::precision`].
    pub precision: Rate,
}

/// Confusion matrix.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Confusion {
    /// Truths (rows).
    pub truths: Vec<String>,
    /// Answers (columns).
    pub answers: Vec<String>,
    /// Rows of counts, one per truth.
    pub counts: Vec<Vec<u32>>,
}

/// All figures.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// `stictiond.challenge.score.v1`.
    pub schema: &'static str,
    /// Seed of the challenge.
    pub seed: u64,
    /// `A` or `B`.
    pub split: String,
    /// Recordings that could not be diagnosed.
    pub errors: usize,
    /// All cases, then groups of them.
    pub groups: Vec<Group>,
    /// One line per effect.
    pub effects: Vec<EffectRow>,
    /// Named effects of at least some probability.
    pub curve: Vec<CurvePoint>,
    /// Reliability: stated probabilities and how often the answer was right.
    pub reliability: Vec<Bin>,
    /// Brier score.
    pub brier: Option<f64>,
    /// Named effects confirmed by held-out data, and right ones among them; and the others.
    pub confirmed: Rate,
    /// See `confirmed`.
    pub suspected: Rate,
    /// Confusion matrix.
    pub confusion: Confusion,
}

fn middle(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    (!values.is_empty()).then(|| median(&values))
}

/// Share of the gap that the named effect closes, per cent, if a free run can predict the truth (one of two effects closes its
/// own part).
fn closed(case: &Judged<'_>) -> Option<f64> {
    if case.truth.unpredictable {
        return None;
    }
    case.entry(case.said())?.closed_pct
}

fn is(case: &Judged<'_>, kind: Right) -> bool {
    case.truth.answer == kind
}

fn group(name: &str, cases: &[Judged<'_>]) -> Group {
    let of = |kind: Right| cases.iter().filter(move |c| is(c, kind));
    let named = || cases.iter().filter(|c| c.names() && !is(c, Right::Pair));
    let withheld = |mate: usize| {
        let asked: Vec<bool> = of(Right::Known).filter_map(|c| c.without_truth().map(|w| c.owns_up(w)[mate])).collect();
        Rate::of(asked.iter().filter(|yes| **yes).count(), asked.len())
    };
    let closing = |right: bool| middle(named().filter(|c| c.is_true(c.said()) == right).filter_map(closed));
    let floors: Vec<bool> = of(Right::Known).filter_map(|c| c.entry(&c.truth.effect)?.at_floor).collect();
    let base: Vec<bool> = of(Right::None).filter_map(|c| c.answer.base_at_floor).collect();
    let reached = |found: &[bool]| Rate::of(found.iter().filter(|yes| **yes).count(), found.len());
    let second = |c: &Judged<'_>| c.document().and_then(|d| d.alternatives.first()).is_some_and(|a| c.is_right(&a.id));
    let stage = |c: &Judged<'_>| c.document().is_some_and(|d| c.truth.stages.contains(&d.place.stage));
    Group {
        name: name.to_owned(),
        cases: cases.len(),
        top1: Rate::count(of(Right::Known), |c| c.is_right(c.said())),
        top2: Rate::count(of(Right::Known), |c| c.is_right(c.said()) || second(c)),
        stage: Rate::count(of(Right::Known), |c| stage(c) || c.is_right(c.said())),
        coverage: Rate::count(of(Right::Known), |c| c.names()),
        precision: Rate::count(named(), |c| c.is_true(c.said())),
        named_false_alarms: Rate::count(of(Right::None), |c| c.names()),
        all_false_alarms: Rate::count(of(Right::None), |c| c.said() != "none"),
        unknown_foreign: Rate::count(of(Right::Foreign), |c| c.is_right(c.said())),
        unknown_withheld: withheld(0),
        unknown_or_mate_withheld: withheld(1),
        pairs: Rate::count(of(Right::Pair), |c| c.is_right(c.said())),
        both: Rate::count(of(Right::Pair), |c| c.names_both()),
        beside: Rate::count(cases.iter().filter(|c| c.beside().is_some()), |c| {
            c.beside().is_some_and(|id| c.truth.effect.split('+').any(|part| part == id))
        }),
        closed_right_pct: closing(true),
        closed_wrong_pct: closing(false),
        true_fit_at_floor: reached(&floors),
        base_at_floor: reached(&base),
    }
}

/// All cases and the parts that are reported.
fn groups(all: &[Judged<'_>]) -> Vec<Group> {
    type Part<'p> = (&'static str, &'p dyn Fn(&Judged<'_>) -> bool);
    let nothing = |c: &Judged<'_>| is(c, Right::None);
    let parts: [Part<'_>; 13] = [
        ("all cases", &|_| true),
        ("effect expressed", &|c| nothing(c) || c.is_expressed()),
        ("set-point moves", &|c| c.truth.setpoint_moves),
        ("limit cycle only", &|c| !c.truth.setpoint_moves),
        ("with the start", &|c| c.truth.transient),
        ("without the start", &|c| !c.truth.transient),
        ("noise under 2 %", &|c| c.truth.noise_share() < 0.02),
        ("noise 2 to 5 %", &|c| (0.02..0.05).contains(&c.truth.noise_share())),
        ("noise from 5 %", &|c| c.truth.noise_share() >= 0.05),
        ("MV recorded", &|c| c.truth.mv),
        ("OP and PV only", &|c| !c.truth.mv),
        ("small effects", &|c| c.truth.size.as_deref().is_none_or(|s| s == "small")),
        ("large effects", &|c| c.truth.size.as_deref().is_none_or(|s| s == "large")),
    ];
    parts.iter().map(|(name, keep)| group(name, &all.iter().copied().filter(|c| keep(c)).collect::<Vec<_>>())).collect()
}

/// The effect's name in tables.
fn row_name<'a>(case: &Judged<'a>) -> &'a str {
    if is(case, Right::Pair) { "two effects" } else { case.truth.effect.as_str() }
}

fn row_names() -> Vec<&'static str> {
    let kinds = Kind::CATALOGUE.iter().chain(&[Kind::FILTER]).chain(&Kind::FOREIGN).map(|k| k.id());
    ["none"].into_iter().chain(kinds).chain(["two effects"]).collect()
}

fn effect_row(name: &str, cases: &[Judged<'_>]) -> EffectRow {
    let share = |c: &Judged<'_>, gap: f64| 100.0 * gap / c.truth.pv_sd;
    let above = |rmse: f64, noise: f64| (rmse * rmse - noise * noise).max(0.0).sqrt();
    let asked: Vec<bool> = cases.iter().filter_map(|c| c.without_truth().map(|w| c.owns_up(w)[0])).collect();
    let base = |c: &Judged<'_>| c.document().map(|d| share(c, above(d.gap.rmse, c.truth.noise_sd)));
    let with = |c: &Judged<'_>| c.entry(&c.truth.effect).map(|e| share(c, e.gap_after));
    let oracle = |c: &Judged<'_>| c.truth.oracle_rmse.map(|r| share(c, above(r, c.truth.noise_sd)));
    EffectRow {
        effect: name.to_owned(),
        cases: cases.len(),
        expressed: cases.iter().filter(|c| c.is_expressed()).count(),
        named: Rate::count(cases.iter(), |c| c.is_right(c.said())),
        unknown: Rate::of(asked.iter().filter(|yes| **yes).count(), asked.len()),
        gap_without_pct: middle(cases.iter().filter_map(base)),
        gap_with_pct: middle(cases.iter().filter_map(with)),
        gap_oracle_pct: middle(cases.iter().filter_map(oracle)),
        noise_pct: middle(cases.iter().map(|c| 100.0 * c.truth.noise_share())),
        closed_pct: middle(cases.iter().filter(|c| c.names() && c.is_true(c.said())).filter_map(closed)),
    }
}

fn curve(all: &[Judged<'_>]) -> Vec<CurvePoint> {
    let p_of = |c: &Judged<'_>| c.document().map_or(0.0, |d| d.cause.probability);
    let at = |p: f64| {
        let called = |c: &Judged<'_>| c.names() && p_of(c) >= p;
        let known = all.iter().filter(|c| is(c, Right::Known));
        let named = all.iter().filter(|c| !is(c, Right::Pair) && called(c));
        CurvePoint { p, coverage: Rate::count(known, called), precision: Rate::count(named, |c| c.is_true(c.said())) }
    };
    [0.0, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95].into_iter().map(at).collect()
}

fn confusion(all: &[Judged<'_>]) -> Confusion {
    let truths: Vec<String> = row_names().into_iter().map(str::to_owned).collect();
    let mut answers: Vec<String> = ["none", "unknown"].into_iter().map(str::to_owned).collect();
    answers.extend(Kind::CATALOGUE.iter().chain(&[Kind::FILTER]).map(|k| k.id().to_owned()));
    answers.push("other".to_owned());
    let mut counts = vec![vec![0; answers.len()]; truths.len()];
    for case in all {
        let row = truths.iter().position(|t| t == row_name(case));
        let column = answers.iter().position(|a| a == case.said()).unwrap_or(answers.len() - 1);
        if let Some(slot) = row.and_then(|r| counts.get_mut(r)?.get_mut(column)) {
            *slot += 1;
        }
    }
    Confusion { truths, answers, counts }
}

impl Figures {
    pub(super) fn of(truth: &Truth, all: &[Judged<'_>]) -> Self {
        let sure: Vec<Scored> = all
            .iter()
            .filter(|c| !is(c, Right::Pair))
            .filter_map(|c| {
                let p = c.document()?.cause.probability;
                Some(Scored { truth: c.is_right(c.said()), answer: None, p: Some(p), weight: 1.0 })
            })
            .collect();
        let borne_out = |wanted: bool| {
            let calls = all.iter().filter(|c| c.names() && c.document().is_some_and(|d| d.cause.confirmed == wanted));
            Rate::count(calls, |c| c.is_true(c.said()))
        };
        let row = |name: &str| {
            let its: Vec<Judged<'_>> = all.iter().copied().filter(|c| row_name(c) == name).collect();
            effect_row(name, &its)
        };
        Self {
            schema: "stictiond.challenge.score.v1",
            seed: truth.seed,
            split: truth.split.clone(),
            errors: all.iter().filter(|c| c.said() == "error").count(),
            groups: groups(all),
            effects: row_names().into_iter().map(row).collect(),
            curve: curve(all),
            reliability: reliability_equal(&sure, BINS),
            brier: brier(&sure),
            confirmed: borne_out(true),
            suspected: borne_out(false),
            confusion: confusion(all),
        }
    }
}
