//! Sentences that are made from the same numbers do not contradict each other.

use super::{answer, beside_position, first, paragraph, report, summary, title, verbose};
use crate::core::gap::document::GapDocument;
use crate::core::gap::enough::EnoughNote;
use crate::core::gap::types::{Alternative, Compared, NextTest};
use crate::core::gap::valve_note::ValveNote;
use crate::core::verdict::ValvePosition;

/// Words that no answer may hold together.
const APART: [[&str; 2]; 17] = [
    ["more than pv's mean does", "no effect of the catalogue"],
    ["next to nothing of the gap", "forward in time"],
    ["explains it (", "adding it closes nothing"],
    ["explains it (", "nothing forward in time"],
    ["explains it (", "is suspected"],
    ["explains it (", "effects tried explains"],
    ["explains it (", "makes next to nothing"],
    ["explains it (", "explains this record"],
    ["a part of it", "adding it closes nothing"],
    ["may explain it", "adding it closes nothing"],
    ["holds clearly more of the gap", "of the gap occurs"],
    ["agree to the noise", "of the gap occurs"],
    ["agree to the noise", "holds clearly more"],
    ["agree to the noise", "PV units above the noise"],
    ["what is left is noise", "left above the noise"],
    ["explains this record", "explains most of this record"],
    ["is as much as can be said", "what is left is noise"],
];

/// A document with other numbers.
struct Varied {
    cause: &'static str,
    confirmed: bool,
    closed: Option<f64>,
    interval: Option<[f64; 2]>,
    forward: f64,
    left: f64,
    even: bool,
}

impl Varied {
    fn document(&self) -> GapDocument {
        let mut d: GapDocument = serde_json::from_str(include_str!("../../../tests/golden/gap-backlash.json")).unwrap();
        self.cause.clone_into(&mut d.cause.id);
        d.cause.confirmed = self.confirmed;
        let floor = d.gap.noise_floor.unwrap();
        let sd = d.gap.gap / d.gap.relative.unwrap();
        d.gap.gap = self.left * sd;
        d.gap.rmse = (d.gap.gap * d.gap.gap + floor * floor).sqrt();
        d.gap.relative = Some(self.left);
        for e in &mut d.effects {
            if e.id == self.cause || self.cause == "unknown" {
                (e.closed_pct, e.closed_interval) = (self.closed, self.interval);
            }
        }
        if let Some(forward) = &mut d.forward {
            forward.closed_pct = Some(self.forward);
        }
        if self.even {
            let told = &mut d.location.uneven;
            for test in
                [&mut told.phases, &mut told.direction, &mut told.segments, &mut told.level].into_iter().flatten()
            {
                test.p = 0.9;
            }
            d.location.trend.onset_ratio = None;
            d.location.bands.iter_mut().for_each(|b| b.share = Some(b.expected));
        }
        d
    }
}

fn every() -> Vec<Varied> {
    let mut out = Vec::new();
    for cause in ["backlash", "hold_compression", "frozen_sensor", "coloured_noise", "none", "unknown"] {
        for closed in [None, Some(-40.0), Some(0.3), Some(7.0), Some(12.0), Some(49.0), Some(60.0), Some(98.0)] {
            for spread in [None, Some(60.0), Some(3.0)] {
                for (left, even) in [(0.0, false), (0.04, true), (0.3, false), (0.9, true), (1.3, false)] {
                    for (confirmed, forward) in [(true, 80.0), (false, -20.0), (false, 70.0)] {
                        let interval = closed.zip(spread).map(|(c, s): (f64, f64)| [c - s, (c + s).min(100.0)]);
                        out.push(Varied { cause, confirmed, closed, interval, forward, left, even });
                    }
                }
            }
        }
    }
    out
}

#[test]
fn no_two_sentences_of_an_answer_contradict_each_other() {
    for varied in every() {
        let d = varied.document();
        let text = [paragraph(&d), summary(&d)[0].clone()].join(" ").to_lowercase();
        for [one, other] in APART {
            let [one, other] = [one, other].map(str::to_lowercase);
            assert!(!(text.contains(&one) && text.contains(&other)), "{one:?} beside {other:?}: {text}");
        }
        assert!(!text.contains("closes -") && !text.contains(", -"), "{text}");
    }
}

#[test]
fn an_effect_that_closes_less_than_a_tenth_is_never_the_headline() {
    for varied in every() {
        let d = varied.document();
        let [conclusion, next, cost] = summary(&d);
        let named = d.named().filter(|e| e.closed_pct.is_some_and(|c| c < 10.0));
        if named.is_some() {
            assert!(conclusion.starts_with("Unknown: ") && first(&d).starts_with("unknown"), "{conclusion}");
            assert!(!report(&d).starts_with(&format!("{}: {}", d.loop_name, d.cause.id)));
        }
        assert!(next.starts_with("Measure next: ") && cost.starts_with("Cost: "), "{next} {cost}");
        assert_eq!(
            conclusion.starts_with("The valve: "),
            conclusion.contains("backlash of") && named.is_none() && d.cause.confirmed
        );
    }
}

#[test]
fn words_agree_with_the_figures_beside_them() {
    for varied in every() {
        let d = varied.document();
        let text = paragraph(&d);
        let closes = varied.closed.filter(|_| !["none", "unknown"].contains(&varied.cause));
        if text.contains("explains it (") {
            assert!(closes.is_some_and(|c| c >= 50.0) && varied.confirmed, "{text}");
            assert!(varied.interval.is_none_or(|[low, _]| low > 0.0), "{text}");
        }
        if text.contains("effects tried explains") {
            assert!(varied.closed.is_none_or(|c| c < 50.0), "{text}");
        }
        if text.contains("explains this record") {
            assert!(varied.left <= 0.1, "{text}");
        }
        if text.contains("makes next to nothing") {
            assert!(closes.is_some_and(|c| c < 10.0), "{text}");
        }
        assert!(report(&d).lines().count() == 4 && verbose(&d).lines().count() > 10);
    }
}

#[test]
fn another_loop_is_said_whether_it_acts_or_not_and_named_where_no_free_run_was_fitted() {
    let mut d: GapDocument = serde_json::from_str(include_str!("../../../tests/golden/gap-backlash.json")).unwrap();
    let compared = |acts: Option<&str>| Compared {
        offered: 3,
        best: Some("F7".to_owned()),
        share: Some(0.2),
        p_value: Some(0.02),
        acts: acts.map(str::to_owned),
        fitted: Vec::new(),
    };
    d.neighbours = Some(compared(None));
    assert!(
        verbose(&d).contains("3 compared; the past of F7 predicts PV best, 20 % less error than without it (p 0.02)")
    );
    assert!(verbose(&d).contains("none acts on PV in both halves"));
    (d.neighbours, d.cause.id) = (Some(compared(Some("F7"))), "neighbour(F7)".to_owned());
    assert!(verbose(&d).contains("F7 acts on PV in both halves"));
    assert!(summary(&d)[0].starts_with("Outside the valve: "), "{}", summary(&d)[0]);
    assert!(!paragraph(&d).contains("explains it"), "{}", paragraph(&d));
}

#[test]
fn what_is_named_beside_the_cause_is_said_with_its_own_figures() {
    let mut d: GapDocument = serde_json::from_str(include_str!("../../../tests/golden/gap-backlash.json")).unwrap();
    assert!(!answer(&d).contains("with ") && !paragraph(&d).contains("too (p"), "nothing is");
    "hold_compression".clone_into(&mut d.cause.id);
    let beside = |id: &str| Some(Alternative { id: id.to_owned(), probability: 0.8 });
    d.second_cause = beside("gain_drift");
    d.effects.iter_mut().find(|e| e.id == "gain_drift").unwrap().closed_pct = Some(42.0);
    assert!(answer(&d).ends_with(", with gain_drift"), "{}", answer(&d));
    assert!(paragraph(&d).contains("shows (p 0.80)") && paragraph(&d).contains("42 % of the gap"), "{}", paragraph(&d));
    "backlash".clone_into(&mut d.cause.id);
    d.second_cause = beside("swinging_door");
    assert!(paragraph(&d).contains("the record shows") && paragraph(&d).contains("too (p 0.80)"), "{}", paragraph(&d));
}

fn backlash() -> GapDocument {
    serde_json::from_str(include_str!("../../../tests/golden/gap-backlash.json")).unwrap()
}

fn sticking(position: Option<ValvePosition>) -> ValveNote {
    ValveNote {
        sentence: "the valve sticks and slips".to_owned(),
        sticks: Some(true),
        p_stiction: Some(0.96),
        s: Some(5.5),
        size: Some("5.5 OP units".to_owned()),
        cycle_s: Some(75.0),
        no_bump_test: None,
        position,
    }
}

#[test]
fn a_sticking_valve_is_the_title_and_only_the_rest_is_unknown() {
    for varied in every() {
        let d = GapDocument { valve: Some(sticking(None)), ..varied.document() };
        let title = format!("{}: the valve sticks and slips, s = 5.5 OP units\n", d.loop_name);
        assert!(report(&d).starts_with(&title) && !summary(&d)[0].starts_with("Unknown"), "{}", report(&d));
        assert!(paragraph(&d).starts_with("The valve sticks and slips, s = 5.5 OP units. "), "{}", paragraph(&d));
    }
}

#[test]
fn a_model_that_is_good_enough_says_so_and_asks_for_nothing() {
    for cause in ["none", "unknown", "backlash"] {
        let mut d = backlash();
        cause.clone_into(&mut d.cause.id);
        d.good_enough = EnoughNote::of(0.02, Some(0.03));
        d.next_test = None;
        let [conclusion, next, cost] = summary(&d);
        assert_eq!(
            conclusion,
            "The model is good enough: what is left is 2 % of PV's movement, below PV's noise (3 %)."
        );
        assert_eq!([next, cost], ["Measure next: nothing.", "Cost: none."]);
        assert_eq!(answer(&d), "good enough");
        for asked in ["would settle it", "distinguishes", "more could be told"] {
            assert!(!verbose(&d).contains(asked), "{asked}: {}", verbose(&d));
        }
    }
}

#[test]
fn what_is_recorded_is_said_and_not_asked_for() {
    let mut d = backlash();
    "unknown".clone_into(&mut d.cause.id);
    d.next_test = None;
    assert!(summary(&d)[1].contains("valve position"));
    d.valve = Some(sticking(Some(ValvePosition { hysteresis: Some(5.4), halves: None })));
    assert!(report(&d).contains("Measured OP-to-MV hysteresis 5.4 OP units."), "{}", report(&d));
    assert_eq!(summary(&d)[1], "Measure next: nothing.");
    let left = |asked: &str| beside_position(asked);
    assert_eq!(left("the valve position"), None);
    assert_eq!(left("the valve position over several slips"), None);
    assert_eq!(
        left("the valve position, or OP moved slowly to the stop").as_deref(),
        Some("OP moved slowly to the stop")
    );
    assert_eq!(left("the valve position during one slow ramp of OP").as_deref(), Some("one slow ramp of OP"));
    assert_eq!(left("a second sensor").as_deref(), Some("a second sensor"));
}

#[test]
fn a_test_says_what_it_costs_and_the_valves_own_cycle_is_not_external() {
    let mut d = backlash();
    d.good_enough = None;
    d.next_test = Some(NextTest {
        signal: "op".to_owned(),
        size: 1.64,
        duration_s: 26.0,
        separates: ["backlash".to_owned(), "extra_lag".to_owned()],
        p: 0.99,
        total_s: 104.0,
        moves_pv: 3.2,
    });
    assert_eq!(summary(&d)[2], "Cost: 104 s in manual, OP moved by 1.64 both ways, PV by about 3.2.");
    assert!(title(&d).starts_with("backlash"), "{}", title(&d));
    let mut sinusoid: GapDocument =
        serde_json::from_str(include_str!("../../../tests/golden/gap-sinusoid.json")).unwrap();
    sinusoid.next_test = None;
    let of_effect = |d: &GapDocument| super::effect::phrase(d.named().unwrap());
    assert!(of_effect(&sinusoid).starts_with("an external sinusoid"));
    sinusoid.effects.iter_mut().for_each(|e| e.own_cycle = true);
    assert!(of_effect(&sinusoid).starts_with("a part of the valve's own cycle"));
}
