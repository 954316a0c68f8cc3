//! The maintenance list: its order, its texts, and whether work on a valve helped.

use std::collections::BTreeMap;
use std::sync::Arc;

use stiction::core::units::Moment;
use stiction::core::verdict::{Assessment, EstimateDocument, Oscillation, Verdict, Window};
use stiction_engine::alarm::{Alarm, AlarmDocument, LoopContext};
use stictiond::runtime::maintenance::{
    Benefit, Done, Helped, Measured, Removed, SIMULATED, Work, compare, rank, simulable,
};
use stictiond::runtime::overview::Candidate;

fn assessment(verdict: Verdict, p: f64) -> Assessment {
    let (start, end) = (Moment(0), Moment(10));
    let window = Window { start_ns: 0, end_ns: 10, start, end, samples: 100, ts_s: 1.0, box_samples: 1 };
    let oscillation =
        Oscillation { oscillating: true, period_s: None, periods: None, samples_per_period: None, regularity: None };
    let mut a = Assessment::empty(window, oscillation);
    (a.verdict, a.stiction, a.p_stiction, a.p_calibrated) = (verdict, verdict.stiction(), Some(p), Some(p));
    (a.grade, a.s) = (Some('A'), Some(2.0));
    a
}

fn candidate(name: &str, criticality: Option<u8>) -> Candidate {
    let document = EstimateDocument::new(name, "hash", assessment(Verdict::Stiction, 0.9));
    let place = LoopContext { criticality, ..LoopContext::default() };
    Candidate { name: name.to_owned(), place, estimate: Some(Arc::new(document)), ..Candidate::default() }
}

fn with(mut candidate: Candidate, change: impl FnOnce(&mut Assessment)) -> Candidate {
    let document = candidate.estimate.as_mut().map(Arc::make_mut).unwrap();
    change(&mut document.assessment);
    candidate
}

fn removes(share: f64, interval: [f64; 2]) -> Benefit {
    Ok(Removed { share, interval })
}

fn names(work: &[Work]) -> Vec<&str> {
    work.iter().map(|w| w.loop_name.as_str()).collect()
}

#[test]
fn each_part_of_the_cost_moves_a_loop_in_the_list_and_ties_go_by_name() {
    let plain = |name| candidate(name, Some(3));
    let rising = |trend| Candidate { s_trend: Some(trend), ..plain("L") };
    let cost = |candidate: Candidate| rank(&[candidate], &BTreeMap::new())[0].cost;
    let base = cost(plain("L"));
    for dearer in [candidate("L", Some(5)), rising("rising"), with(plain("L"), |a| a.p_stiction = Some(0.99))] {
        assert!(cost(dearer.clone()) > base, "{dearer:?}");
    }
    for cheaper in [candidate("L", Some(1)), rising("falling"), with(plain("L"), |a| a.grade = Some('C'))] {
        assert!(cost(cheaper.clone()) < base, "{cheaper:?}");
    }
    // Without a configured criticality the default counts.
    assert_eq!(cost(candidate("L", None)).to_bits(), base.to_bits());

    let benefits = BTreeMap::from([
        ("LITTLE".to_owned(), removes(0.1, [0.05, 0.2])),
        ("MUCH".to_owned(), removes(0.8, [0.7, 0.9])),
        ("NONE".to_owned(), Err("no model fits".to_owned())),
    ]);
    let given: Vec<Candidate> = ["NONE", "LITTLE", "B", "MUCH", "A"].into_iter().map(plain).collect();
    let work = rank(&given, &benefits);
    assert_eq!(names(&work), ["MUCH", "A", "B", "NONE", "LITTLE"]);
    assert_eq!(work.iter().map(|w| w.rank).collect::<Vec<_>>(), [1, 2, 3, 4, 5]);
    let backwards: Vec<Candidate> = given.into_iter().rev().collect();
    assert_eq!(rank(&backwards, &benefits), work);
}

#[test]
fn the_sentences_name_the_benefit_or_why_it_is_not_known() {
    let why = |benefit: Option<Benefit>| {
        let benefits = benefit.map(|b| ("L".to_owned(), b)).into_iter().collect();
        rank(&[candidate("L", Some(4))], &benefits).remove(0).why
    };
    let said = why(Some(removes(0.5, [0.354, 0.6])));
    assert_eq!(said, "Criticality 4 of 5; a repair removes 35 to 60 % of PV's variation.");
    assert!(why(Some(removes(0.2, [0.0, 0.6]))).contains("at most 60 % of PV's variation, perhaps nothing"));
    assert!(why(Some(removes(0.0, [0.0, 0.0]))).contains("does not reduce"));
    let unknown = why(Some(Err("no model fits".to_owned())));
    assert!(unknown.contains("assumes") && unknown.contains("cannot be estimated: no model fits"), "{unknown}");
    assert!(why(None).contains("still being computed"));

    let many: Vec<Candidate> = (0..=SIMULATED).map(|k| candidate(&format!("L{k:03}"), None)).collect();
    let work = rank(&many, &BTreeMap::new());
    assert!(work[..SIMULATED].iter().all(|w| w.pending) && !work[SIMULATED].pending);
    assert!(work[SIMULATED].why.contains("first 30 loops only"), "{}", work[SIMULATED].why);
}

#[test]
fn an_alarm_whose_newest_window_finds_nothing_stays_in_the_list_and_no_valve_is_called_healthy() {
    let alarm =
        AlarmDocument { active: true, what_to_do: Some("Do a test.".to_owned()), ..Alarm::default().restored("L") };
    let mut unseen = with(candidate("L", None), |a| {
        (a.verdict, a.stiction, a.p_stiction, a.p_calibrated) =
            (Verdict::CauseUnknown, Some(false), Some(0.1), Some(0.1));
    });
    assert!(simulable(&unseen).is_none());
    unseen.alarm = Some(Arc::new(alarm));
    unseen.driven = Some("driven by A, p 0.94".to_owned());
    let work = rank(&[unseen], &BTreeMap::new()).remove(0);
    assert_eq!(work.what_to_do, "Do a test.");
    assert!(work.sure.contains("not seen") && work.sure.contains("still active"), "{}", work.sure);
    assert!(work.sure.contains("Driven by A, p 0.94: repair the source first"), "{}", work.sure);
    assert!(!work.pending && work.s.is_none() && !work.sure.contains("healthy"));
}

#[test]
fn work_on_a_valve_helped_only_where_both_sides_show_it() {
    let windows = |count: usize, s: Option<f64>, pv_sd: f64| {
        let p = Some(if s.is_some() { 0.9 } else { 0.1 });
        vec![Measured { stiction: Some(s.is_some()), p, s, pv_sd: Some(pv_sd) }; count]
    };
    let before = windows(5, Some(4.0), 2.0);
    let repaired = compare(&before, &windows(4, None, 0.5), Done::Found);
    assert_eq!(repaired.helped, Helped::Yes);
    assert!(
        repaired.words.contains("not seen since (p 0.10)") && repaired.words.contains("was 2 and is 0.5"),
        "{}",
        repaired.words
    );
    assert_eq!((repaired.before.s, repaired.after.s), (Some(4.0), None));
    assert_eq!((repaired.before.pv_sd, repaired.after.pv_sd), (Some(2.0), Some(0.5)));
    let helped = |before: &[Measured], after: &[Measured], done| compare(before, after, done).helped;
    assert_eq!(helped(&before, &windows(4, Some(2.0), 1.0), Done::Found), Helped::Partly);
    assert_eq!(helped(&before, &windows(4, Some(3.9), 2.0), Done::Found), Helped::No);
    let mixed = compare(&before, &[windows(2, Some(3.9), 2.0), windows(4, None, 0.5)].concat(), Done::Found);
    assert_eq!(mixed.helped, Helped::Partly);
    assert!(
        mixed.words.starts_with("2 of 6 windows since the review find stiction, before it 5 of 5"),
        "{}",
        mixed.words
    );
    let after = compare(&before, &windows(4, None, 0.5), Done::Repaired).words;
    assert!(after.starts_with("Stiction was seen before the repair (p 0.90) and is not seen since"), "{after}");
    assert_eq!(helped(&before, &windows(2, None, 0.5), Done::Found), Helped::Unknown);
    assert_eq!(helped(&[], &windows(4, None, 0.5), Done::Found), Helped::Unknown);
    assert_eq!(helped(&windows(5, None, 1.0), &windows(4, None, 0.5), Done::Found), Helped::Unknown);
    assert_eq!(helped(&before, &windows(4, None, 0.5), Done::Nothing), Helped::Unknown);
    // Windows without an answer count on neither side.
    assert_eq!(helped(&before, &[Measured::default(); 9], Done::Found), Helped::Unknown);
}
