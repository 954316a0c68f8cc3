//! The changes that readers get, silence, and the newest windows.

use super::*;
use stiction::core::record::Record;
use stiction::core::verdict::{AssessParams, assess};
use stiction::plantwide::GroupDocument;
use stiction_engine::alarm::Alarm;
use stiction_lab::truth::fixture::group::driven_group;

fn estimate(name: &str, end_ns: i64, s: Option<f64>, verdict: Verdict) -> Arc<EstimateDocument> {
    let mut a = assess(&Record::uniform(1.0, vec![1.0; 40], vec![1.0; 40]), &AssessParams::default());
    (a.window.end_ns, a.s, a.verdict, a.stiction) = (end_ns, s, verdict, verdict.stiction());
    let p = Some(if a.stiction == Some(true) { 0.8 } else { 0.1 });
    (a.gates, a.reason, a.p_stiction, a.p_calibrated) = (Vec::new(), None, p, p);
    Arc::new(EstimateDocument::new(name, "hash", a))
}

fn figures(greatest_ns: i64) -> LoopFigures {
    LoopFigures { counts: Default::default(), greatest_ns: Some(greatest_ns), windows: 0, waiting: 0 }
}

fn rows_after(overview: &Overview, version: u64) -> Vec<Row> {
    overview.rows_after(version, None, usize::MAX, 5)
}

#[test]
fn rows_come_in_parts_by_name_and_what_changes_meanwhile_comes_once_more() {
    let (overview, now, place) = (Overview::default(), Instant::now(), LoopContext::default());
    let show = |name: &str| overview.figures(&name.into(), &place, now, &figures(5));
    ["A", "C", "E"].into_iter().for_each(show);
    let names = |version, after, most| {
        let rows = overview.rows_after(version, after, most, 5);
        rows.into_iter().map(|row| row.name).collect::<Vec<_>>()
    };
    let version = overview.changes_after(0).version;
    assert_eq!(names(0, None, 2), ["A", "C"]);
    ["B", "D"].into_iter().for_each(show);
    assert_eq!(names(0, Some("C"), 2), ["D", "E"]);
    assert!(names(0, Some("E"), 2).is_empty());
    assert_eq!(
        (names(version, None, 9), names(version, Some("B"), 9)),
        (vec!["B".into(), "D".into()], vec!["D".into()])
    );
}

#[test]
fn changes_are_told_once_and_everything_to_who_comes_new() {
    let (overview, now, place) = (Overview::default(), Instant::now(), LoopContext::default());
    let [a, b]: [Arc<str>; 2] = ["A".into(), "B".into()];
    overview.estimate(&a, &place, now, estimate("A", 1, Some(2.0), Verdict::Stiction));
    overview.figures(&b, &place, now, &figures(5));
    let (version, rows) = (overview.changes_after(0).version, rows_after(&overview, 0));
    let signs: Vec<_> = rows.iter().map(|r| (r.name.as_str(), r.ne107)).collect();
    assert_eq!(signs, [("A", Some(Sign::OutOfSpecification)), ("B", None)]);
    // New data alone are not a change; an alarm is.
    overview.figures(&b, &place, now, &figures(6));
    assert!(rows_after(&overview, version).is_empty());
    let document = AlarmDocument { active: true, state: State::Unack, ..Alarm::default().restored("A") };
    overview.alarm(&a, &place, now, &document);
    let rows = rows_after(&overview, version);
    let Changes { version: later, alarms, .. } = overview.changes_after(version);
    assert_eq!((rows.len(), rows[0].ne107, rows[0].unacknowledged), (1, Some(Sign::Maintenance), true));
    assert_eq!((alarms.len(), overview.changes_after(later).alarms.len()), (1, 0));
    assert_eq!(rows_after(&overview, 0).len(), 2);
}

#[test]
fn who_looks_while_alarms_change_sees_each_change_once() {
    let overview = Overview::default();
    let (other, now) = (overview.clone(), Instant::now());
    let writer = std::thread::spawn(move || {
        for changed_ns in 1..=ALARMS_KEPT as i64 {
            let document = AlarmDocument { changed_ns, ..Alarm::default().restored("A") };
            other.alarm(&"A".into(), &LoopContext::default(), now, &document);
        }
    });
    let (mut version, mut seen) = (0, Vec::new());
    while seen.last() != Some(&(ALARMS_KEPT as i64)) {
        let changes = overview.changes_after(version);
        version = changes.version;
        seen.extend(changes.alarms.iter().map(|d| d.changed_ns));
    }
    writer.join().unwrap();
    assert_eq!(seen, (1..=ALARMS_KEPT as i64).collect::<Vec<_>>());
    assert_eq!((overview.alarm_changes("A").len(), overview.alarm_changes("B").len()), (ALARMS_KEPT, 0));
}

#[test]
fn readers_are_given_the_loops_that_have_left_or_all_rows() {
    let (overview, now, place) = (Overview::default(), Instant::now(), LoopContext::default());
    let show = |name: &str| overview.figures(&name.into(), &place, now, &figures(5));
    ["A", "B", "C"].into_iter().for_each(show);
    let at = overview.changes_after(0).version;
    ["A", "B", "D"].into_iter().for_each(|name| overview.forget(name));
    show("B");
    let rows = rows_after(&overview, at);
    let Changes { version, full, gone, .. } = overview.changes_after(at);
    assert_eq!((full, rows.len(), rows[0].name.as_str()), (false, 1, "B"));
    assert_eq!(gone, ["A"]);
    assert!(overview.changes_after(version).gone.is_empty());
    for k in 0..=GONE_KEPT {
        show(&format!("L{k}"));
        overview.forget(&format!("L{k}"));
    }
    let away = overview.changes_after(at);
    assert_eq!(
        (away.full, rows_after(&overview, 0).len()),
        (true, 2),
        "the names of all that left are no longer at hand"
    );
}

#[test]
fn a_loop_falls_silent_by_its_own_sampling_and_speaks_again() {
    let (overview, now, place) = (Overview::default(), Instant::now(), LoopContext::default());
    let a: Arc<str> = "A".into();
    overview.estimate(&a, &place, now, estimate("A", 1, None, Verdict::NotOscillating));
    overview.figures(&a, &place, now, &figures(1));
    let at = |s: u64| now + Duration::from_secs(s);
    overview.figures(&a, &place, at(59), &figures(1));
    assert_eq!(overview.row("A", 9).unwrap().ne107, Some(Sign::NothingFound));
    overview.figures(&a, &place, at(61), &figures(1));
    let row = overview.row("A", 9).unwrap();
    assert_eq!((row.ne107, row.silent, overview.data_health(9).silent_loops), (Some(Sign::Failure), true, 1));
    overview.figures(&a, &place, at(62), &figures(2));
    assert!(!overview.row("A", 9).unwrap().silent);
}

#[test]
fn the_cause_that_a_loop_shows_is_that_of_most_of_its_last_windows() {
    let (overview, now, place) = (Overview::default(), Instant::now(), LoopContext::default());
    let a: Arc<str> = "A".into();
    let status = |k: i64, verdict| {
        overview.estimate(&a, &place, now, estimate("A", k * 1_000_000_000, None, verdict));
        let row = overview.row("A", 0).unwrap();
        (row.ne107, row.status)
    };
    for k in 0..6 {
        status(k, Verdict::Tuning);
    }
    // A single window with another cause, or without an oscillation, does not change the displayed one.
    let (ne107, shown) = status(6, Verdict::CauseUnknown);
    assert!(
        ne107 == Some(Sign::OutOfSpecification)
            && shown.contains("its tuning")
            && shown.ends_with("(6 of the last 7 windows)"),
        "{shown}"
    );
    assert_eq!(status(7, Verdict::Stiction).1, "the valve sticks and slips; no alarm: the size is not known");
    for k in 8..12 {
        status(k, Verdict::NotOscillating);
    }
    let (ne107, status) = status(12, Verdict::NotOscillating);
    assert!(ne107 == Some(Sign::NothingFound) && status.contains("no sign of stiction found"), "{status}");
}

#[test]
fn a_restart_shows_the_newest_recorded_answer_as_an_old_one_and_a_silent_loop_stays_silent() {
    let (overview, now, place) = (Overview::default(), Instant::now(), LoopContext::default());
    let of = |name: &str| estimate(name, 1_000_000_000, Some(2.0), Verdict::Stiction);
    let now_ns = 7_200_000_000_000;
    let restore = |name: &str, age_s: u64| {
        let newest_ns = now_ns - 1_000_000_000 * age_s as i64;
        let heard = now.checked_sub(Duration::from_secs(age_s)).unwrap();
        overview.restore(&name.into(), &place, (heard, Some(newest_ns)), Some(of(name)));
        // The restored stream has no newer sample.
        overview.figures(&name.into(), &place, now, &figures(newest_ns));
    };
    restore("A", 7_100);
    restore("B", 1);
    let told = |name: &str| {
        let row = overview.row(name, now_ns).unwrap();
        (row.ne107, row.silent, row.stale, row.size.is_some())
    };
    assert_eq!(told("A"), (Some(Sign::Failure), true, true, true));
    assert_eq!(told("B"), (Some(Sign::OutOfSpecification), false, true, true));
    assert_eq!(overview.data_health(now_ns).silent_loops, 1);
    overview.figures(&"A".into(), &place, now, &figures(now_ns));
    assert_eq!(told("A"), (Some(Sign::OutOfSpecification), false, true, true));
    overview.estimate(&"A".into(), &place, now, of("A"));
    assert!(!overview.row("A", now_ns).unwrap().stale);
    let headline = overview.headline("p");
    assert_eq!(headline.words, "No stiction alarm in 2 valves.");
}

#[test]
fn the_newest_windows_stay_and_tell_how_s_goes() {
    let (overview, now, place) = (Overview::default(), Instant::now(), LoopContext::default());
    let a: Arc<str> = "A".into();
    for k in 0..40_i64 {
        let s = 2.0 + 0.05 * k as f64;
        overview.estimate(&a, &place, now, estimate("A", k * 1_000_000_000, Some(s), Verdict::Stiction));
    }
    let row = overview.row("A", 0).unwrap();
    assert_eq!((row.recent.len(), row.recent[RECENT - 1].t_ms, row.s_trend), (RECENT, 39_000.0, Some("rising")));
    let steady: VecDeque<Recent> = (0..8)
        .map(|k| Recent { t_ms: 0.0, p: None, s: Some(3.0 + 0.1 * f64::from(k % 2)), verdict: Verdict::Stiction })
        .collect();
    assert_eq!(trend(&steady), Some("steady"));
    assert_eq!(trend(&steady.iter().take(5).copied().collect()), None);
}

fn group(end_ns: i64, members: &[&str]) -> Arc<GroupDocument> {
    Arc::new(driven_group(end_ns, members))
}

#[test]
fn a_group_goes_on_where_most_of_its_members_are() {
    let (overview, now) = (Overview::default(), Instant::now());
    assert!(overview.groups(now).compared_age_s.is_none());
    overview.show_groups(now, vec![group(1, &["A", "B", "C"]), group(1, &["X", "Y"])]);
    // C joins X and Y; the groups come in a different order.
    overview.show_groups(now, vec![group(2, &["X", "Y", "C"]), group(2, &["A", "B"])]);
    let shown = overview.groups(now).groups;
    let told: Vec<_> = shown.iter().map(|g| (g.id, g.document.members.join(""), g.history.len())).collect();
    assert_eq!(told, [(0, "AB".to_owned(), 2), (1, "XYC".to_owned(), 2)]);
    assert_eq!(shown[1].history[0].members, ["X", "Y"]);
    // A group that has ended is not shown, and continues when it returns; the history is bounded.
    overview.show_groups(now, Vec::new());
    assert!(overview.groups(now).groups.is_empty());
    for k in 0..300 {
        overview.show_groups(now, vec![group(3 + k, &["A", "B"])]);
    }
    let shown = overview.groups(now + Duration::from_secs(5));
    assert_eq!(shown.compared_age_s, Some(5.0));
    assert_eq!((shown.groups[0].id, shown.groups[0].history.len()), (0, 200));
}

#[test]
fn a_follower_says_what_drives_it_until_it_is_in_no_group() {
    let (overview, now, place) = (Overview::default(), Instant::now(), LoopContext::default());
    for name in ["A", "B", "C"] {
        overview.figures(&name.into(), &place, now, &figures(5));
    }
    let Changes { version, compared, .. } = overview.changes_after(0);
    assert!(!compared);
    overview.show_groups(now, vec![group(1, &["A", "B"])]);
    let rows = rows_after(&overview, version);
    let Changes { version, compared, .. } = overview.changes_after(version);
    let driven: Vec<_> = rows.iter().map(|r| (r.name.as_str(), r.driven.as_deref())).collect();
    assert_eq!((compared, driven), (true, vec![("B", Some("driven by A, p 0.90"))]));
    overview.show_groups(now, Vec::new());
    let rows = rows_after(&overview, version);
    let version = overview.changes_after(version).version;
    assert_eq!((rows.len(), rows[0].driven.as_deref()), (1, None));
    assert!(!overview.changes_after(version).compared);
}

#[test]
fn an_obstacle_lasts_from_the_first_of_the_newest_windows_that_have_it() {
    let (overview, now, place) = (Overview::default(), Instant::now(), LoopContext::default());
    let name: Arc<str> = "A".into();
    let window = |start_ns: i64, reason: Option<&'static str>| {
        let verdict = if reason.is_some() { Verdict::Inconclusive } else { Verdict::CauseUnknown };
        let mut document = EstimateDocument::clone(&estimate("A", start_ns, None, verdict));
        (document.assessment.reason, document.assessment.window.start_ns) = (reason, start_ns);
        overview.estimate(&name, &place, now, Arc::new(document));
        overview.obstacles(now).obstacles.first().map(|o| (o.kind, o.since_ms))
    };
    assert_eq!(overview.obstacles(now).share, None);
    overview.figures(&name, &place, now, &figures(1));
    assert_eq!(overview.obstacles(now).obstacles[0].kind, ObstacleKind::Waiting);
    assert_eq!(window(1_000_000, Some("manual")), Some((ObstacleKind::Manual, Some(1.0))));
    assert_eq!(window(2_000_000, Some("manual")), Some((ObstacleKind::Manual, Some(1.0))));
    assert_eq!(window(3_000_000, Some("saturated")), Some((ObstacleKind::AtLimit, Some(3.0))));
    assert_eq!(window(4_000_000, Some("trend")), Some((ObstacleKind::Other, Some(4.0))));
    assert_eq!((window(5_000_000, None), overview.obstacles(now).judged), (None, 1));
    assert_eq!(window(6_000_000, Some("manual")), Some((ObstacleKind::Manual, Some(6.0))));
}

#[test]
fn a_configured_loop_that_sends_nothing_is_silent_and_each_loop_needs_its_own_samples() {
    let text = "[site]\nprefix = \"p\"\n[window]\nmin_samples_per_period = 40\n[[loop]]\nname = \"A\"\n\
                min_samples_per_period = 20\n[[loop]]\nname = \"B\"\nop = \"gw/b\"\narea = \"u\"\n";
    let config = Arc::new(stiction_engine::config::Config::parse(text).unwrap());
    let (overview, now, place) = (Overview::default(), Instant::now(), LoopContext::default());
    let later = now + Duration::from_secs(301);
    overview.expect(config.clone(), now, 5_000_000);
    let kinds = |at| overview.obstacles(at).obstacles.iter().map(|o| o.kind).collect::<Vec<_>>();
    assert_eq!((kinds(now), kinds(later)), (vec![ObstacleKind::Waiting; 2], vec![ObstacleKind::Silent; 2]));
    // A reload does not restart the wait.
    overview.expect(config, later, 9_000_000);
    let found = overview.obstacles(later);
    let b = &found.obstacles[1];
    assert_eq!((found.loops, found.judged, b.appeared, b.since_ms), (2, 0, false, Some(5.0)));
    assert_eq!((b.area.as_deref(), b.remedy.as_str()), (Some("u"), "check that something publishes gw/b and p/B/pv"));
    for (name, needed) in [("A", "20 samples"), ("C", "40 samples")] {
        let mut document = EstimateDocument::clone(&estimate(name, 1, None, Verdict::Inconclusive));
        let a = &mut document.assessment;
        (a.reason, a.gates, a.oscillation.period_s) = (Some("too_coarse"), vec![Gate::TooCoarse], Some(100.0));
        overview.estimate(&name.into(), &place, later, Arc::new(document));
        let found = overview.obstacles(later);
        let remedy = &found.obstacles.iter().find(|o| o.loop_name == name).unwrap().remedy;
        assert!(remedy.contains(needed), "{remedy}");
    }
    let mut document = EstimateDocument::clone(&estimate("D", 1, None, Verdict::NotOscillating));
    document.assessment.gates = vec![Gate::TooCoarse];
    overview.estimate(&"D".into(), &place, later, Arc::new(document));
    let found = overview.obstacles(later);
    assert!(found.obstacles.iter().all(|o| o.loop_name != "D"), "the period of noise needs no samples");
    // A forgotten loop is still awaited.
    overview.figures(&"A".into(), &place, later, &figures(7_000_000));
    overview.forget("A");
    let found = overview.obstacles(later);
    let a = &found.obstacles[0];
    assert_eq!((a.loop_name.as_str(), a.words.as_str(), a.since_ms), ("A", "no new data", Some(7.0)));
}

#[test]
fn the_beginning_of_an_obstacle_and_the_trend_outlive_a_restart() {
    let (now, place, name) = (Instant::now(), LoopContext::default(), Arc::<str>::from("A"));
    let window = |overview: &Overview, start_ns: i64, reason: &'static str| {
        let mut document = EstimateDocument::clone(&estimate("A", start_ns, None, Verdict::Inconclusive));
        (document.assessment.reason, document.assessment.window.start_ns) = (Some(reason), start_ns);
        overview.estimate(&name, &place, now, Arc::new(document));
        overview.obstacles(now).obstacles[0].since_ms
    };
    let first = Overview::default();
    window(&first, 1_000_000, "manual");
    first.add_share(&first.obstacles(now), 2_000_000);
    let kept = first.kept(&first.survey(now), Some(3));
    let json = serde_json::to_vec(&kept).unwrap();
    let again = || {
        let overview = Overview::default();
        overview.take_over(serde_json::from_slice(&json).unwrap());
        overview.figures(&name, &place, now, &figures(1));
        overview
    };
    let second = again();
    assert_eq!(second.kept(&second.survey(now), Some(3)), kept, "a run without a window forgets nothing");
    assert_eq!(second.obstacles(now).trend[0], SharePoint { t_ms: 2.0, judged: 0, loops: 1, share: 0.0 });
    assert_eq!(window(&second, 9_000_000, "manual"), Some(1.0));
    assert_eq!(window(&again(), 9_000_000, "saturated"), Some(9.0), "another obstacle begins with its window");
}

#[test]
fn the_trend_is_bounded() {
    let (overview, now) = (Overview::default(), Instant::now());
    overview.figures(&"A".into(), &LoopContext::default(), now, &figures(1));
    let found = overview.obstacles(now);
    (0..800).for_each(|k| overview.add_share(&found, k));
    let trend = overview.obstacles(now).trend;
    assert_eq!((trend.len(), trend[743].t_ms), (744, 799e-6));
}
