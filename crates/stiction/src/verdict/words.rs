//! An estimate in words that a planner can act on.

use crate::ident::region::{Region, Size};
use crate::units::{duration, number, probability};
use crate::verdict::{Assessment, Gate, Implausible, SCREENED, Verdict};

/// The verdict in a sentence.
#[must_use]
pub const fn verdict(v: Verdict) -> &'static str {
    match v {
        Verdict::Stiction => "the valve sticks and slips",
        Verdict::Deadband => "the valve has a dead band",
        Verdict::Disturbance => "the loop oscillates, most likely from outside; the valve follows its signal",
        Verdict::Tuning => "the loop oscillates, most likely by its own tuning; the valve follows its signal",
        Verdict::NoOscillation => "no regular oscillation, and no stiction seen",
        Verdict::NoStiction => "no stiction seen",
        Verdict::Inconclusive => "this window cannot answer",
    }
}

/// The verdict of a record in a sentence; only suspected where the probability would not raise an alarm.
#[must_use]
pub fn headline(a: &Assessment) -> String {
    let suspected = a.stiction == Some(true) && a.explanation.is_some_and(|opinion| !opinion.alarms());
    format!("{}{}", if suspected { "suspected, not sure: " } else { "" }, verdict(a.verdict))
}

/// A further cause beside the verdict.
#[must_use]
pub const fn beside(v: Verdict) -> &'static str {
    match v {
        Verdict::Tuning => "the controller's tuning makes the loop swing too",
        Verdict::Disturbance => "something from outside drives the loop too",
        other => verdict(other),
    }
}

/// What to do about it.
#[must_use]
pub const fn advice(v: Verdict) -> &'static str {
    match v {
        Verdict::Stiction => "Confirm with a bump test, then have packing, actuator and positioner looked at.",
        Verdict::Deadband => "Confirm with a bump test, then have linkage, gears and positioner looked at for play.",
        Verdict::Disturbance => "Look upstream: another loop or load drives this one. The valve can stay in service.",
        Verdict::Tuning => "Have the tuning looked at: the loop swings by itself. The valve can stay in service.",
        Verdict::NoOscillation | Verdict::NoStiction => "Nothing to be done about this valve on this record.",
        Verdict::Inconclusive => "Take another record: longer, faster sampled, in automatic, while the loop swings.",
    }
}

/// How sure the verdict is, in a sentence.
#[must_use]
pub fn sureness(a: &Assessment) -> String {
    let Some(p) = a.p_stiction else {
        return match a.reason.map(reason) {
            Some(why) => format!("Nothing can be said: {why}."),
            None => "Nothing can be said: a gate blocks the answer.".to_owned(),
        };
    };
    if let (None, Some(why)) = (a.stiction, a.reason) {
        return format!(
            "No answer: {}. The indicators alone would give the valve {}; grade D.",
            reason(why),
            probability(p)
        );
    }
    let odds = match p {
        p if p >= 0.99 => "hardly any doubt that the valve sticks",
        p if p >= 0.9 => "very likely the valve sticks",
        p if p >= 0.6 => "more likely than not the valve sticks",
        p if p > 0.4 => "as good as a coin toss",
        p if p > 0.1 => "more likely than not the valve is well",
        p if p > 0.01 => "very likely the valve is well",
        _ => "hardly any doubt that the valve is well",
    };
    let grade = match a.grade {
        Some('A') => "grade A: no gate met, a narrow interval",
        Some('B') => "grade B: good, with an interval up to 30 % of s",
        Some('C') => "grade C: an answer with reservations",
        _ => "grade D: no answer",
    };
    format!("Probability of sticking {}: {odds}; {grade}.", probability(p))
}

/// A reason for no answer, or for nothing beside it, in words; a gate's are the gate's.
#[must_use]
pub fn reason(name: &str) -> String {
    let known = match name {
        "stuck_signal" => {
            "PV stands still while OP travels: a dead transmitter, a closed block valve, or a valve that does not move at \
             all; look at the transmitter and the valve before anything else"
        }
        "implausible_model" => "only a model that no such loop has would explain this record",
        "daily_cycle" => {
            "the cycle takes a day: weather, shifts or load make it, and nothing is seen of the valve beside it"
        }
        "trend" => "PV is little more than a straight line here; there is no cycle to judge the valve by",
        "op_held" => "OP is stored too seldom within a cycle to show what the valve was sent",
        "too_coarse" => "sticking is likely, but a period has too few samples to show how the stem moves",
        "too_few_periods" => "sticking is likely, but the periods are too few to be sure",
        "not_fitted" => "no model could be fitted",
        "screened" => "a calm loop, of which nothing more was computed",
        _ => "",
    };
    if !known.is_empty() {
        return known.to_owned();
    }
    Gate::ALL.into_iter().find(|g| g.name() == name).map_or_else(|| name.replace('_', " "), |g| gate(g).to_owned())
}

/// What is not believed of a model or its record.
#[must_use]
pub const fn implausible(what: Implausible) -> &'static str {
    match what {
        Implausible::DailyCycle => "the cycle takes a day",
        Implausible::Trend => "PV is little more than a straight line",
        Implausible::DeadTime => "the dead time is longer than such a loop, or its own period, allows",
        Implausible::TimeConstant => "a time constant is longer than such a loop has, or than the window",
        Implausible::Gain => "the gain would take PV far beyond where it was",
        Implausible::Integrating => "such a loop does not integrate",
        Implausible::Fit => "it follows PV hardly better than PV's mean does",
    }
}

/// Why no size and no model are given, where none was believed.
#[must_use]
pub fn disbelief(a: &Assessment) -> Option<String> {
    let said: Vec<&str> = a.implausible.iter().map(|what| implausible(*what)).collect();
    (!said.is_empty()).then(|| format!("no size and no process model are given: {}", said.join("; ")))
}

/// The size, in OP units and in % of travel where the range is known; an upper bound where no stiction is seen.
#[must_use]
pub fn size(a: &Assessment, op_range: Option<[f64; 2]>) -> Option<String> {
    let s = a.s?;
    if a.stiction == Some(false) {
        let [_, high] = a.s_interval?;
        let of_travel =
            op_range.map(|[low, top]| format!(" ({} % of travel)", number(100.0 * high / (top - low).abs())));
        return Some(format!("at most {} OP units{}", number(high), of_travel.unwrap_or_default()));
    }
    let of_travel = |v: f64| op_range.map(|[low, high]| 100.0 * v / (high - low).abs());
    let mut text = match of_travel(s) {
        Some(percent) => format!("{} % of travel ({} OP units)", number(percent), number(s)),
        None => format!("{} OP units", number(s)),
    };
    if let Some([low, high]) = a.s_interval {
        let [low, high] = [low, high].map(|v| number(of_travel(v).unwrap_or(v)));
        let unit = if op_range.is_some() { " %" } else { "" };
        text = format!("{text}, 90 % interval {low} to {high}{unit}");
    }
    if let (Some(fs), Some(fd)) = (a.fs, a.fd) {
        text = format!("{text}; static band {}, kinetic band {} OP units", number(fs), number(fd));
    }
    let words: Vec<String> = [a.strength_by_span.map(Size::name), a.region.map(Region::name)]
        .into_iter()
        .flatten()
        .map(|w| w.replace('_', " "))
        .filter(|w| w != "none")
        .collect();
    if !words.is_empty() {
        text = format!("{text}; by its share of OP's swing: {}", words.join(", "));
    }
    Some(text)
}

/// What is said of an indicator without words of its own.
const UNNAMED: &str = "a sign in the record";

/// What an indicator looks at.
#[must_use]
pub fn looks_at(name: &str) -> &'static str {
    match name {
        "likelihood" => "how much likelier the record is with friction than without, where that leaves only noise",
        "confirmed" => "whether that fit could be an accident (few turns of the stem, OP an image of PV)",
        "moves" => "the same gain for PV's changes, which slow disturbances hardly touch",
        "horch" => "whether OP and PV are out of phase by a quarter, as behind a sticking valve",
        "jumps" => "whether PV moves in jumps while OP moves steadily",
        "curve_fit" => "whether half cycles are triangles rather than sinusoids",
        "travel" => "how far OP goes while PV stands",
        "one_step_gain" => "how much better a sticking stem foretells PV's next step than OP does",
        "periodicity" => "how much of PV's movement keeps time on its own account, as a load from outside does",
        _ => UNNAMED,
    }
}

/// What speaks for and against, strongest first: words, logits.
#[must_use]
pub fn evidence(a: &Assessment) -> Vec<(String, f64)> {
    let mut said: Vec<_> = a.indicators.iter().filter(|w| w.contribution.abs() >= 0.05).collect();
    said.sort_by(|x, y| y.contribution.abs().total_cmp(&x.contribution.abs()));
    let side = |c: f64| if c > 0.0 { "for the valve" } else { "against it" };
    said.iter().map(|w| (format!("{}: speaks {}", looks_at(w.name), side(w.contribution)), w.contribution)).collect()
}

/// A gate in words.
#[must_use]
pub const fn gate(g: Gate) -> &'static str {
    match g {
        Gate::Manual => "the controller was in manual",
        Gate::BadQuality => "too many values were missing or bad",
        Gate::FrozenPv => "PV never moves",
        Gate::FrozenOp => "OP never moves",
        Gate::Saturated => "OP stands at a limit",
        Gate::TooFewSamples => "too few usable samples, or under two periods",
        Gate::Skipped => "the fit was not done: the machine was too busy, or the daemon stopped",
        Gate::TooFewPeriods => "few periods: intervals are wide",
        Gate::TooCoarse => "sampled too coarsely for trustworthy bands",
        Gate::SetpointSteps => "the set point moved in steps: the oscillation test is disturbed",
        Gate::Quantised => "OP or PV stands on a coarse grid",
        Gate::Compressed => "the history was compressed: corners of PV are the recorder's",
        Gate::Irregular => "the sampling time is not constant",
        Gate::Excursion => "something that happened once, such as a trip or a start-up, was cut out of the fit",
    }
}

/// What this record leaves open.
#[must_use]
pub fn unknowns(a: &Assessment, op_range: Option<[f64; 2]>) -> Vec<String> {
    let mut out: Vec<String> = a.gates.iter().map(|g| format!("{} ({})", gate(*g), g.name())).collect();
    let screened = a.reason == Some(SCREENED);
    if screened {
        out.push("all else: a calm loop, of which nothing more was computed (screened)".to_owned());
    } else if let Some(why) = disbelief(a) {
        out.push(why);
    } else if a.s.is_none() {
        out.push("the size: no model was fitted".to_owned());
    } else if a.j_identifiable == Some(false) {
        out.push("the slip jump j: the stem slips too seldom to tell it from the process gain".to_owned());
    }
    if a.gates.contains(&Gate::TooCoarse)
        && let Some(period) = a.oscillation.period_s
    {
        out.push(format!("with a sample every {} or faster it would be told", duration(period / 50.0)));
    }
    if a.s.is_some() && op_range.is_none() {
        out.push(
            "the size in % of travel: OP's range is not known (--op-range, or op_range in the configuration)".into(),
        );
    }
    match a.s_detectable {
        Some(least) => out.push(format!("bands below s = {} OP units would not have been seen here", number(least))),
        None if a.stiction == Some(false) && !screened => {
            out.push("how small a band would have been seen here: this record cannot tell".to_owned());
        }
        None => {}
    }
    out
}

/// A test by hand that shows the band without any model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BumpTest {
    /// First move, OP units: takes up the slack in one direction.
    pub first_op: f64,
    /// Each step back, OP units.
    pub step_op: f64,
    /// Steps back.
    pub steps: u32,
    /// Hold after each move, s.
    pub hold_s: f64,
    /// All of it, s.
    pub total_s: f64,
    /// How far PV goes at most, PV units; per hold where the process integrates.
    pub pv_move: f64,
}

/// The longest that a test may take, s: operations give a loop away for a shift at most.
const SHIFT_S: f64 = 8.0 * 3_600.0;
/// Steps back.
const STEPS: u32 = 6;
/// First move, bands: usual, and the least that still takes up the slack.
const FIRST_MOVE: [f64; 2] = [1.5, 1.2];

/// The bump test for an estimate with a fit: a first move of 1.5 s takes up the slack, then steps of a quarter of s go
/// back until PV follows, held for the dead time and three of the largest time constant (a quarter of the period where
/// the process integrates). PV that first follows after n steps shows a band of about n s / 4. The first move, or the
/// holds of an integrating process, are made smaller where PV would else go further than it did in the record; see
/// [`too_much`].
#[must_use]
pub fn bump_test(a: &Assessment) -> Option<BumpTest> {
    let (s, process) = (a.s.filter(|s| *s > 0.0)?, a.process.as_ref()?);
    let gain = process.gain.abs();
    let room = a.pv_span.unwrap_or(f64::INFINITY);
    let shortest = process.dead_time_s.max(2.0 * a.window.ts_s);
    let [mut first_op, least_op] = FIRST_MOVE.map(|bands| bands * s);
    let (hold_s, pv_move) = if process.integrating {
        let usual = process.dead_time_s + 0.25 * a.oscillation.period_s.unwrap_or(4.0 * process.dead_time_s);
        let hold_s = usual.min(room / (gain * first_op)).max(shortest);
        (hold_s, gain * first_op * hold_s)
    } else {
        let settle = 3.0 * process.time_constants_s.first().copied().unwrap_or(0.0);
        first_op = first_op.min(room / gain).max(least_op);
        ((process.dead_time_s + settle).max(shortest), gain * first_op)
    };
    let total_s = hold_s * f64::from(STEPS + 1);
    Some(BumpTest { first_op, step_op: 0.25 * s, steps: STEPS, hold_s, total_s, pv_move })
}

/// Why operations would not give the loop away for a test: it takes longer than a shift, or moves PV further than it went
/// in the record.
#[must_use]
pub fn too_much(a: &Assessment, test: &BumpTest) -> Option<String> {
    let room = a.pv_span.unwrap_or(f64::INFINITY);
    let mut said = Vec::new();
    if test.total_s > SHIFT_S {
        said.push(format!("take {}, more than a shift", duration(test.total_s)));
    }
    if test.pv_move > room * (1.0 + 1e-9) {
        said.push(format!(
            "move PV by {}, when it went no further than {} in this record",
            number(test.pv_move),
            number(room)
        ));
    }
    (!said.is_empty()).then(|| said.join(" and "))
}

/// The test as an instruction, or why none is proposed; `None` without a size and a process.
#[must_use]
pub fn proposal(a: &Assessment) -> Option<String> {
    let (s, test) = (a.s?, bump_test(a)?);
    Some(too_much(a, &test).map_or_else(
        || bump_words(&test, s),
        |why| {
            format!(
                "None is proposed: it would {why}. Ask operations for a stroke test with the loop out of service instead."
            )
        },
    ))
}

/// The bump test as an instruction.
#[must_use]
pub fn bump_words(t: &BumpTest, s: f64) -> String {
    format!(
        "Ask operations for the loop in manual, for {} in all, with PV free to move by {} PV units. Move OP by {} in one \
         direction, wait {}. Then move it back in steps of {}, waiting {} after each, up to {} steps. A sound valve \
         moves PV at the first step back; with the band found here ({}) PV follows only after about {} steps.",
        duration(t.total_s),
        number(t.pv_move),
        number(t.first_op),
        duration(t.hold_s),
        number(t.step_op),
        duration(t.hold_s),
        t.steps,
        number(s),
        (s / t.step_op).ceil()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Record;
    use crate::verdict::{Oscillation, Process, Window};

    fn empty() -> Assessment {
        let window = Window::of(&Record::uniform(1.0, vec![0.0; 40], vec![0.0; 40]));
        let oscillation = Oscillation {
            oscillating: false,
            period_s: Some(100.0),
            periods: None,
            samples_per_period: None,
            regularity: None,
        };
        Assessment::empty(window, oscillation)
    }

    #[test]
    fn a_bump_test_follows_from_s_and_the_process() {
        let mut a = empty();
        assert_eq!((bump_test(&a), size(&a, None)), (None, None));
        a.s = Some(8.0);
        a.process = Some(Process {
            order: 1,
            gain: -2.0,
            time_constants_s: vec![20.0],
            dead_time_s: 6.0,
            integrating: false,
            mse: 0.1,
            fit_pct: 90.0,
        });
        let t = bump_test(&a).unwrap();
        assert_eq!((t.first_op, t.step_op, t.hold_s, t.total_s, t.pv_move), (12.0, 2.0, 66.0, 462.0, 24.0));
        assert!(bump_words(&t, 8.0).contains("about 4 steps"));
        // Kept within what PV did, or not proposed.
        a.pv_span = Some(20.0);
        assert_eq!(bump_test(&a).map(|t| (t.first_op, t.pv_move)), Some((10.0, 20.0)));
        assert!(proposal(&a).unwrap().contains("in all, with PV free to move by 20"));
        a.pv_span = Some(10.0);
        let said = proposal(&a).unwrap();
        assert!(said.contains("None is proposed: it would move PV by 19.2, when it went no further than 10"), "{said}");
        a.pv_span = None;
        a.process.iter_mut().for_each(|p| p.time_constants_s = vec![2_000.0]);
        assert!(proposal(&a).unwrap().contains("it would take 11.7 h, more than a shift"));
        assert!(f64::from(t.steps) * t.step_op > 8.0, "the steps must pass the band");
    }

    #[test]
    fn every_indicator_has_words() {
        let names = crate::verdict::rule::OF_THE_FIT.into_iter().chain(crate::detect::ALL.iter().map(|d| d.name()));
        let silent: Vec<&str> = names.filter(|name| looks_at(name) == UNNAMED).collect();
        assert!(silent.is_empty(), "{silent:?}");
    }

    #[test]
    fn what_is_missing_is_said_not_shown_as_zero() {
        let mut a = empty();
        assert!(unknowns(&a, None).iter().any(|u| u.contains("no model")) && evidence(&a).is_empty());
        assert!(sureness(&a).contains("blocks"));
        a.reason = Some("stuck_signal");
        assert!(sureness(&a).contains("dead transmitter"));
        a.s = Some(2.0);
        a.s_interval = Some([1.0, 4.0]);
        assert_eq!(size(&a, Some([0.0, 200.0])).unwrap(), "1 % of travel (2 OP units), 90 % interval 0.5 to 2 %");
        assert_eq!(size(&a, None).unwrap(), "2 OP units, 90 % interval 1 to 4");
        assert!(unknowns(&a, None).iter().any(|u| u.contains("--op-range")));
        a.stiction = Some(false);
        assert_eq!(size(&a, Some([0.0, 200.0])).unwrap(), "at most 4 OP units (2 % of travel)");
    }
}
