//! Over random histories, no statement about a loop or plant contradicts another.

use super::*;
use crate::alarm::{Alarm, AlarmParams, Command};
use proptest::prelude::*;
use stiction::core::ident::region::Size;
use stiction::core::units::Moment;
use stiction::core::verdict::{CountedBy, Oscillation, Window};

fn window(k: usize, (verdict, p, gates, reason): (Verdict, f64, Vec<Gate>, Option<&'static str>)) -> Assessment {
    let end_ns = 10 * (k as i64 + 1);
    let (start, end) = (Moment(end_ns - 10), Moment(end_ns));
    let span = Window { start_ns: start.0, end_ns, start, end, samples: 100, ts_s: 1.0, box_samples: 1 };
    let oscillation =
        Oscillation { oscillating: true, period_s: None, periods: None, samples_per_period: None, regularity: None };
    let stiction = verdict.stiction();
    Assessment {
        verdict,
        stiction,
        p_stiction: Some(p),
        p_calibrated: Some(p),
        grade: Some('C'),
        s: Some(2.0),
        counted_by: Some(CountedBy::Periods),
        strength_by_span: Some(Size::Moderate),
        gates,
        reason,
        ..Assessment::empty(span, oscillation)
    }
}

fn windows() -> impl Strategy<Value = (Verdict, f64, Vec<Gate>, Option<&'static str>)> {
    let found = (prop::sample::select(vec![Verdict::Stiction, Verdict::Deadband]), 0.5..1.0);
    let not = vec![Verdict::Tuning, Verdict::Disturbance, Verdict::CauseUnknown, Verdict::NotOscillating];
    let not_found = (prop::sample::select(not), 0.0..0.5);
    let open = prop::sample::select(vec![vec![], vec![Gate::TooCoarse], vec![Gate::Irregular]]);
    let blocked = prop::sample::select(vec![Gate::FrozenPv, Gate::Manual, Gate::TooFewSamples]);
    prop_oneof![
        4 => (found, open.clone()).prop_map(|((v, p), gates)| (v, p, gates, None)),
        4 => (not_found, open).prop_map(|((v, p), gates)| (v, p, gates, None)),
        1 => blocked.prop_map(|gate| (Verdict::Inconclusive, 0.2, vec![gate], Some(gate.name()))),
    ]
}

#[derive(Debug, Clone)]
enum Step {
    Window((Verdict, f64, Vec<Gate>, Option<&'static str>)),
    Command(&'static str),
    Silent(bool),
    Restart,
}

fn steps() -> impl Strategy<Value = Step> {
    let commands = vec!["ack", "shelve", "unshelve", "suppress", "unsuppress", "out_of_service", "in_service"];
    prop_oneof![
        6 => windows().prop_map(Step::Window),
        1 => prop::sample::select(commands).prop_map(Step::Command),
        1 => any::<bool>().prop_map(Step::Silent),
        1 => Just(Step::Restart),
    ]
}

/// A loop's data as in the daemon.
#[derive(Default)]
struct Held {
    alarm: Alarm,
    document: Option<AlarmDocument>,
    estimate: Option<Assessment>,
    verdicts: Vec<Verdict>,
    silent: bool,
    restored: bool,
    windows: usize,
}

impl Held {
    fn take(&mut self, step: &Step) {
        match step {
            Step::Window(of) => {
                let a = window(self.windows, of.clone());
                let params = AlarmParams { raise: [1, 2], ..AlarmParams::default() };
                self.document = self.alarm.window("L", &a, &params).or(self.document.take());
                self.verdicts.insert(0, a.verdict);
                (self.windows, self.silent, self.restored, self.estimate) = (self.windows + 1, false, false, Some(a));
            }
            Step::Command(cmd) => {
                let command =
                    Command { action: cmd.parse().unwrap(), by: Some("ann".to_owned()), why: None, for_s: None };
                self.document = self.alarm.command("L", &command, 0).ok().or(self.document.take());
            }
            Step::Silent(silent) => self.silent = *silent,
            Step::Restart => {
                self.document = self.document.is_some().then(|| self.alarm.restored("L"));
                self.restored = self.estimate.is_some();
            }
        }
    }

    fn known(&self) -> Known<'_> {
        Known {
            estimate: self.estimate.as_ref(),
            verdicts: self.verdicts.clone(),
            alarm: self.document.as_ref(),
            silent: self.silent,
            restored: self.restored,
        }
    }
}

fn check(held: &Held) -> Result<LoopStatus, TestCaseError> {
    let status = LoopStatus::of(&held.known());
    let of_alarm = held.document.as_ref().and_then(|d| Sign::of_alarm(d.active, d.state == State::OutOfService));
    prop_assert_eq!(
        of_alarm.is_some(),
        matches!(status.sign, Some(Sign::Maintenance)) || of_alarm == Some(Sign::FunctionCheck)
    );
    prop_assert_eq!(of_alarm.unwrap_or(Sign::NothingFound).id(), held.document.as_ref().map_or("none", |d| d.ne107));
    // An active alarm is never hidden by a failed signal or by a window that finds nothing.
    let serviced = held.document.as_ref().is_some_and(|d| d.state != State::OutOfService);
    prop_assert_eq!(status.sign == Some(Sign::Maintenance), status.active && serviced);
    prop_assert!(
        !held.silent
            || status.failed && status.sentence.contains("no new data")
            || !serviced && held.document.is_some()
    );
    // A silent or restored loop displays its newest answer greyed.
    prop_assert_eq!(status.stale, held.estimate.is_some() && (held.silent || held.restored));
    prop_assert_eq!(status.answer.is_some(), held.estimate.is_some());
    let found = status.standing().is_found();
    if let Some(answer) = &status.answer {
        prop_assert_eq!((answer.grade.is_some(), answer.size.is_some()), (found, found));
        prop_assert_eq!(status.verdict.and_then(Verdict::stiction) == Some(true), found);
    }
    let sentence = &status.sentence;
    prop_assert!(
        !sentence.contains("the valve sticks and") && !sentence.contains("dead band") || found,
        "{}",
        sentence
    );
    prop_assert!(!(sentence.contains("no sign of stiction") && sentence.contains("is open")), "{}", sentence);
    if status.sign == Some(Sign::NothingFound) {
        prop_assert_eq!((status.verdict, status.standing()), (Some(Verdict::NotOscillating), Standing::NotSeen));
    }
    Ok(status)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_is_said_of_loops_and_plant_agrees_over_any_history(
        histories in prop::collection::vec(prop::collection::vec(steps(), 0..25), 1..4),
    ) {
        let mut all = Vec::new();
        for history in &histories {
            let mut held = Held::default();
            for step in history {
                let before = LoopStatus::of(&held.known());
                held.take(step);
                let after = check(&held)?;
                if matches!(step, Step::Restart) {
                    let silent = |status: &LoopStatus| status.failed && held.silent;
                    prop_assert_eq!(silent(&before), silent(&after));
                    prop_assert_eq!((before.sign, before.answer), (after.sign, after.answer));
                }
            }
            all.push((check(&held)?, held));
        }
        let in_plant = |(status, held): &(LoopStatus, Held)| {
            let priority = held.document.as_ref().and_then(|d| d.priority);
            (status.clone(), priority)
        };
        let told: Vec<_> = all.iter().map(in_plant).collect();
        let loops = told.iter().map(|(status, priority)| InPlant { name: "L", status, priority: *priority, class: None, p: None });
        let headline = Headline::of(loops, 0, "p");
        let maintain = all.iter().filter(|(status, _)| status.sign == Some(Sign::Maintenance)).count();
        prop_assert_eq!(headline.mood == Mood::Act, maintain > 0);
        prop_assert_eq!(headline.words.contains("No stiction alarm"), maintain == 0 && headline.mood != Mood::Wait);
        prop_assert_eq!(headline.words.contains(&format!("{maintain} of ")), maintain > 0, "{}", &headline.words);
        prop_assert_eq!(headline.first.is_some(), maintain > 0);
        let failed = all.iter().filter(|(status, _)| status.failed).count();
        prop_assert_eq!(headline.more.iter().any(|text| text.contains("failed or missing")), failed > 0);
    }
}

#[test]
fn a_failed_signal_does_not_hide_an_alarm_and_a_restart_does_not_wake_a_silent_loop() {
    let mut held = Held::default();
    let steps = [Step::Window((Verdict::Stiction, 0.9, vec![], None)), Step::Silent(true), Step::Restart];
    let said = steps.map(|step| {
        held.take(&step);
        LoopStatus::of(&held.known())
    });
    let [first, silent, again] = said;
    assert_eq!((first.sign, first.sentence.as_str()), (Some(Sign::Maintenance), "the valve sticks and slips"));
    assert_eq!(silent.sentence, "stiction alarm active; no new data");
    assert!(silent.failed && silent.stale && silent.sign == Some(Sign::Maintenance));
    assert_eq!((again.sign, &again.sentence, again.stale), (silent.sign, &silent.sentence, true));
    let loops = [&first, &silent].map(|status| InPlant { name: "L", status, priority: None, class: None, p: None });
    let headline = Headline::of(loops, 0, "p");
    assert_eq!((headline.words.as_str(), headline.mood), ("2 of 2 valves need maintenance; L first.", Mood::Act));
}

#[test]
fn a_loop_that_oscillates_for_an_unknown_cause_is_out_of_specification_and_an_open_one_is_not_clear() {
    let status = |verdict, p| {
        let a = window(0, (verdict, p, vec![], None));
        LoopStatus::of(&Known { estimate: Some(&a), verdicts: vec![verdict], ..Known::default() })
    };
    assert_eq!(status(Verdict::CauseUnknown, 0.1).sign, Some(Sign::OutOfSpecification));
    assert_eq!(status(Verdict::NotOscillating, 0.1).sign, Some(Sign::NothingFound));
    let open = status(Verdict::NotOscillating, 0.48);
    assert_eq!((open.sign, open.answer.unwrap().probability.as_str()), (None, "open (p 0.48)"));
    assert!(open.sentence.ends_with("whether the valve sticks is open"), "{}", open.sentence);
}
