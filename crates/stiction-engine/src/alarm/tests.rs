//! The alarm, step by step and in any order.

use super::*;
use Priority::{High, Urgent};
use proptest::prelude::*;
use stiction::core::ident::region::Size;
use stiction::core::units::Moment;
use stiction::core::verdict::rule::{Cuts, Opinion};
use stiction::core::verdict::{CountedBy, Oscillation, Process, Verdict, Window};

fn assessment(k: i64, verdict: Verdict, s: f64, severity_by_range: Size) -> Assessment {
    let (start_ns, end_ns) = (k * 10, (k + 1) * 10);
    let (start, end) = (Moment(start_ns), Moment(end_ns));
    let window = Window { start_ns, end_ns, start, end, samples: 100, ts_s: 1.0, box_samples: 1 };
    let oscillation =
        Oscillation { oscillating: true, period_s: None, periods: None, samples_per_period: None, regularity: None };
    let mut a = Assessment::empty(window, oscillation);
    a.verdict = verdict;
    a.stiction = verdict.stiction();
    a.s = Some(s);
    a.counted_by = Some(CountedBy::Periods);
    a.severity_by_range = Some(severity_by_range);
    a
}

fn run(alarm: &mut Alarm, verdicts: &[(Verdict, f64)]) -> Vec<State> {
    let params = AlarmParams { raise: [3, 4], s_limit_op: 1.0, s_limit_span: 0.0 };
    let each = verdicts.iter().enumerate();
    each.filter_map(|(k, (v, s))| alarm.window("L", &assessment(k as i64, *v, *s, Size::Weak), &params))
        .map(|d| d.state)
        .collect()
}

const YES: (Verdict, f64) = (Verdict::Stiction, 2.0);
const NO: (Verdict, f64) = (Verdict::Disturbance, 0.0);
const SILENT: (Verdict, f64) = (Verdict::Inconclusive, 0.0);

#[test]
fn it_takes_m_of_n_windows_and_silence_holds() {
    let mut alarm = Alarm::default();
    assert!(run(&mut alarm, &[YES, YES, SILENT, NO]).is_empty());
    assert_eq!(run(&mut alarm, &[SILENT, SILENT, YES]), [State::Unack]);
    assert!(run(&mut alarm, &[SILENT; 50]).is_empty());
    assert!(alarm.active);
    assert_eq!(run(&mut alarm, &[NO, NO, NO]), [State::RtnUnack]);
}

#[test]
fn windows_that_do_not_count_neither_raise_nor_clear_and_those_that_do_may_take_turns() {
    let params = AlarmParams { raise: [3, 4], s_limit_op: 1.0, s_limit_span: 0.0 };
    let window = |k, verdict, counted_by| Assessment { counted_by, ..assessment(k, verdict, 2.0, Size::Weak) };
    let mut alarm = Alarm::default();
    let mut take =
        |k, verdict, counted_by| alarm.window("L", &window(k, verdict, counted_by), &params).map(|d| d.state);
    assert!((0..9).all(|k| take(k, Verdict::Stiction, None).is_none()));
    let rules = [CountedBy::Reversals, CountedBy::Periods, CountedBy::Reversals].map(Some);
    assert_eq!(rules.map(|rule| take(10, Verdict::Stiction, rule)), [None, None, Some(State::Unack)]);
    assert!((20..29).all(|k| take(k, Verdict::Tuning, None).is_none()));
    assert_eq!(rules.map(|rule| take(30, Verdict::Tuning, rule)), [None, None, Some(State::RtnUnack)]);
}

#[test]
fn a_window_that_cannot_raise_an_alarm_says_why() {
    let found = assessment(0, Verdict::Stiction, 2.0, Size::Weak);
    assert_eq!(no_alarm(&found), None);
    assert!(no_alarm(&Assessment { s: None, ..found.clone() }).unwrap().contains("size"));
    let explanation = Some(Opinion { base: 0.0, logit: 0.1, cuts: Cuts { called: 0.5, alarm: 0.7 } });
    assert!(no_alarm(&Assessment { explanation, ..found.clone() }).unwrap().contains("threshold"));
    assert_eq!(no_alarm(&assessment(0, Verdict::Inconclusive, 2.0, Size::Weak)), None);
}

#[test]
fn it_is_acknowledged_once_and_clears_with_a_dead_band() {
    let mut alarm = Alarm::default();
    run(&mut alarm, &[YES; 3]);
    let ack = Command { action: AlarmAction::Ack, by: Some("ann".into()), why: None, for_s: None };
    assert_eq!(alarm.command("L", &ack, 5).unwrap().state, State::Acked);
    assert!(matches!(alarm.command("L", &ack, 5), Err(CommandError::NothingToAcknowledge { .. })));
    assert!(run(&mut alarm, &[(Verdict::Stiction, 0.9); 10]).is_empty());
    assert_eq!(run(&mut alarm, &[(Verdict::Stiction, 0.7); 4]), [State::Normal]);
}

#[test]
fn one_of_three_does_not_flap() {
    let params = AlarmParams { raise: [1, 3], s_limit_op: 1.0, s_limit_span: 0.0 };
    let mut alarm = Alarm::default();
    let mut changes = Vec::new();
    for (k, verdict) in [Verdict::Stiction, Verdict::Tuning, Verdict::Tuning, Verdict::Tuning].into_iter().enumerate() {
        changes.extend(alarm.window("L", &assessment(k as i64, verdict, 2.0, Size::Weak), &params).map(|d| d.state));
    }
    assert_eq!(changes, [State::Unack, State::RtnUnack]);
}

#[test]
fn it_is_raised_again_when_it_gets_worse() {
    let params = AlarmParams { raise: [1, 1], s_limit_op: 1.0, s_limit_span: 0.0 };
    let mut alarm = Alarm::default();
    alarm.window("L", &assessment(0, Verdict::Stiction, 2.0, Size::Weak), &params).unwrap();
    let ack = Command { action: AlarmAction::Ack, by: Some("ann".into()), why: None, for_s: None };
    alarm.command("L", &ack, 5).unwrap();
    assert!(alarm.window("L", &assessment(1, Verdict::Stiction, 9.0, Size::Strong), &params).is_none());
    let again = alarm.window("L", &assessment(2, Verdict::Stiction, 9.0, Size::Strong), &params).unwrap();
    assert_eq!((again.state, again.class), (State::Unack, Some(Size::Strong)));
    assert_eq!((again.event, again.marks.acknowledged.clone()), (Event::Worse, None));
    let priority = |criticality| again.clone().at(&LoopContext { criticality, ..LoopContext::default() }).priority;
    assert_eq!([None, Some(3), Some(5)].map(priority), [High, High, Urgent].map(Some));
    let over = alarm.window("L", &assessment(3, Verdict::Tuning, 0.0, Size::Weak), &params).unwrap();
    assert_eq!(over.at(&LoopContext { criticality: Some(5), ..LoopContext::default() }).priority, None);
}

#[test]
fn the_same_tag_at_another_site_has_other_identities() {
    let params = AlarmParams { raise: [1, 1], s_limit_op: 1.0, s_limit_span: 0.0 };
    let raised = || Alarm::default().window("L", &assessment(0, Verdict::Stiction, 2.0, Size::Weak), &params).unwrap();
    let at = |site: &str| {
        let document = raised().at(&LoopContext { site: site.into(), ..LoopContext::default() });
        (document.event_id, document.occurrence_id.unwrap())
    };
    let (north, south) = (at("north"), at("south"));
    assert_eq!(north, at("north"));
    assert!(north.0 != south.0 && north.1 != south.1, "{north:?} {south:?}");
}

fn asks(cmd: &str, why: Option<&str>) -> Command {
    Command { action: cmd.parse().unwrap(), by: Some("ann".into()), why: why.map(str::to_owned), for_s: Some(3600) }
}

#[test]
fn what_people_do_stands_apart_from_what_raised_it() {
    let mut alarm = Alarm::default();
    let params = AlarmParams { raise: [1, 1], s_limit_op: 1.0, s_limit_span: 0.0 };
    let raised = alarm.window("L", &assessment(0, Verdict::Stiction, 2.0, Size::Weak), &params).unwrap();
    assert_eq!((raised.event, raised.since_ns, raised.by.as_deref()), (Event::Raised, Some(10), None));
    assert_eq!((raised.figures.s, raised.figures.s_limit, raised.unit.as_str()), (Some(2.0), Some(1.0), "OP"));
    // Without a process no test can be sized; the alarm says so, and what to do instead.
    let what = raised.what_to_do.as_deref().unwrap();
    assert!(what.contains("No bump test is proposed") && what.contains("valve signature"), "{what}");
    let acked = alarm.command("L", &asks("ack", Some("seen")), 20).unwrap();
    assert_eq!((acked.why.as_deref(), acked.detail.as_str()), (raised.why.as_deref(), "seen"));
    assert_eq!(acked.marks.acknowledged.as_ref().map(|m| (m.by.as_str(), m.at_ns)), Some(("ann", 20)));
    assert_eq!(acked.occurrence_id, raised.occurrence_id);
    assert_ne!(acked.event_id, raised.event_id);
    let shelved = alarm.command("L", &asks("shelve", None), 20).unwrap();
    let until_ns = 20 + 3_600_000_000_000;
    assert_eq!(shelved.marks.shelved.as_ref().and_then(|m| m.until_ns), Some(until_ns));
    assert_eq!(shelved.marks.shelved.and_then(|m| m.until).as_deref(), Some("1970-01-01T01:00:00.00000002Z"));
    // The restored document has the identity of the same event.
    let restored = alarm.restored("L");
    assert_eq!((restored.event, &restored.event_id), (Event::Restored, &shelved.event_id));
    assert_eq!(alarm.command("L", &asks("out_of_service", None), 30).unwrap().ne107, "C");
    assert_eq!(alarm.command("L", &asks("in_service", None), 31).unwrap().ne107, "M");
    let over = alarm.window("L", &assessment(1, Verdict::Tuning, 0.0, Size::Weak), &params).unwrap();
    assert_eq!((over.event, over.state, over.ne107), (Event::Cleared, State::Shelved, "none"));
    assert_eq!((&over.occurrence_id, over.since_ns, over.class), (&raised.occurrence_id, Some(10), None));
    // In the normal state only the shelving remains.
    let taken = alarm.command("L", &asks("unshelve", None), 40).unwrap();
    assert_eq!((taken.occurrence_id, taken.why, taken.marks), (None, None, Marks::default()));
    let nobody = Command { by: None, ..asks("suppress", None) };
    assert_eq!(alarm.command("L", &nobody, 50).unwrap_err(), CommandError::Nameless);
}

#[test]
fn what_to_do_is_the_bump_test_of_the_estimate_in_the_places_unit() {
    let mut alarm = Alarm::default();
    let params = AlarmParams { raise: [1, 1], s_limit_op: 1.0, s_limit_span: 0.0 };
    let mut a = assessment(0, Verdict::Stiction, 2.0, Size::Weak);
    let lag = Process {
        order: 1,
        gain: 2.0,
        time_constants_s: vec![20.0],
        dead_time_s: 6.0,
        integrating: false,
        mse: 1e-4,
        fit_pct: 95.0,
        tested: true,
        gain_interval: None,
        dead_time_interval_s: None,
    };
    (a.j, a.pv_span, a.process) = (Some(1.0), Some(4.0), Some(lag));
    let raised = alarm.window("L", &a, &params).unwrap();
    let what = raised.at(&LoopContext { op_unit: Some("%".into()), ..LoopContext::default() }).what_to_do.unwrap();
    assert!(what.contains("step OP by 0.6 % one way") && what.contains("packing"), "{what}");
    assert!(what.contains("PV moves by about 3 PV units") && !what.contains("No bump test"), "{what}");
    // The action survives a restart.
    let kept: Alarm = serde_json::from_str(&serde_json::to_string(&alarm).unwrap()).unwrap();
    assert_eq!(kept.restored("L").what_to_do, alarm.restored("L").what_to_do);
}

#[test]
fn the_limit_fits_loops_of_every_size() {
    let alarms = |s: f64, span: f64, params: &AlarmParams| {
        let mut alarm = Alarm::default();
        let window = |k| Assessment { s_over_span: Some(s / span), ..assessment(k, Verdict::Stiction, s, Size::Weak) };
        (0..10).any(|k| alarm.window("L", &window(k), params).is_some())
    };
    let default = AlarmParams::default();
    // A small cycle in %, one of a loop whose OP runs from 0 to 1, and a larger band under wide moves of OP.
    assert!(alarms(0.6, 1.2, &default) && alarms(0.006, 0.012, &default) && alarms(1.5, 60.0, &default));
    assert!(!alarms(0.6, 20.0, &default));
    // A tenth of a quiet loop's span is less than a new valve may have.
    assert!(!alarms(0.3, 1.9, &default));
    let of_travel = |s: f64| {
        let a = Assessment {
            s_over_span: Some(0.5),
            op_range: Some([0.0, 1.0]),
            ..assessment(0, Verdict::Stiction, s, Size::Weak)
        };
        Evidence::of(&a, &default)
    };
    assert_eq!((of_travel(0.006), of_travel(0.003)), (Evidence::For, Evidence::Against));
    let in_op = AlarmParams { s_limit_op: 2.0, s_limit_span: 0.0, ..default };
    assert!(!alarms(0.6, 1.2, &in_op) && alarms(2.1, 60.0, &in_op));
    let any = AlarmParams { s_limit_op: 0.0, s_limit_span: 0.0, ..default };
    assert!(alarms(1e-6, 60.0, &any));
}

#[test]
fn a_memory_of_an_earlier_build_is_taken_over() {
    let earlier = r#"{"state":"acked","active":true,"history_for":7,"history_against":0,"class":"weak","worse_windows":0,
        "raised_ns":10,"window_end_ns":10}"#;
    let alarm: Alarm = serde_json::from_str(earlier).unwrap();
    let restored = alarm.restored("L");
    assert_eq!((restored.state, restored.active, restored.class), (State::Acked, true, Some(Size::Weak)));
    assert_eq!(restored.since_ns, Some(10));
}

proptest! {
    #[test]
    fn states_and_activity_agree_in_any_order(steps in proptest::collection::vec(0_u8..6, 0..64)) {
        let params = AlarmParams { raise: [2, 3], s_limit_op: 1.0, s_limit_span: 0.0 };
        let mut alarm = Alarm::default();
        for (k, step) in steps.into_iter().enumerate() {
            let verdict = [Verdict::Stiction, Verdict::Disturbance, Verdict::Inconclusive][usize::from(step % 3)];
            if step == 5 {
                let _ = alarm.command("L", &Command { action: AlarmAction::Ack, by: Some("ann".into()), why: None, for_s: None }, k as i64);
            } else {
                alarm.window("L", &assessment(k as i64, verdict, f64::from(step), Size::Weak), &params);
            }
            prop_assert_eq!(alarm.active, matches!(alarm.state, State::Unack | State::Acked));
            let text = serde_json::to_string(&alarm).unwrap();
            prop_assert_eq!(serde_json::from_str::<Alarm>(&text).unwrap(), alarm.clone());
        }
    }
}

#[test]
fn an_alarm_that_is_not_raised_says_what_its_windows_counted_for() {
    let params = AlarmParams { raise: [3, 4], s_limit_op: 5.0, s_limit_span: 0.0 };
    let windows = |verdicts: &[(Verdict, f64)]| -> Vec<Assessment> {
        verdicts.iter().enumerate().map(|(k, (v, s))| assessment(k as i64, *v, *s, Size::Weak)).collect()
    };
    let said = |verdicts: &[(Verdict, f64)]| why_not_active(&windows(verdicts), &params);
    let small = said(&[(Verdict::Stiction, 9.0), YES, YES, NO]);
    assert!(small.starts_with("1 of the last 4 windows that count") && small.contains("3 of 4 are needed"), "{small}");
    assert!(small.contains("s 2 is below the limit of 5 OP units") && small.contains("no stiction found"), "{small}");
    assert_eq!(small.matches("below the limit").count(), 1, "{small}");
    let mut coarse = windows(&[SILENT; 4]);
    coarse.iter_mut().for_each(|a| a.reason = Some("too_coarse"));
    let coarse = why_not_active(&coarse, &params);
    assert!(
        coarse.starts_with("no window counts") && coarse.len() > "no window counts, 3 of 4 are needed: ".len(),
        "{coarse}"
    );
    assert_eq!(why_not_active(&[], &params), "no window counts, 3 of 4 are needed");
}
