//! The report for hand-made documents: escaping, order, and self-contained files.

use super::*;
use stiction::core::verdict::{Oscillation, Verdict, Window};

fn report(names: &[&str]) -> Report {
    let op: Vec<f64> = (0..400).map(|k| 50.0 + (f64::from(k) * 0.1).sin()).collect();
    let pv: Vec<f64> = (0..400).map(|k| 20.0 - (f64::from(k) * 0.1 - 1.0).sin()).collect();
    let record = Record::uniform(1.0, op, pv);
    let quiet =
        Oscillation { oscillating: false, period_s: None, periods: None, samples_per_period: None, regularity: None };
    let one = |name: &str| LoopReport {
        document: EstimateDocument::new(name, "hash", Assessment::empty(Window::of(&record), quiet)),
        record: record.clone(),
        original: None,
        tags: Tags::of_loop(name, false, false),
        comment: Some(format!("comment of {name}")),
        notes: vec![format!("samples of {name} skipped")],
        full: false,
        detail: None,
    };
    Report {
        input: names.join("/"),
        command: format!("stictiond analyze {} --report out.html", names.join("/")),
        warnings: vec![format!("{} has gaps", names.join("/"))],
        loops: names.iter().map(|n| one(n)).collect(),
        groups: None,
    }
}

#[test]
fn names_from_outside_are_text_everywhere() {
    let evil = "<script>alert('1')</script>\" onload=\"x";
    for report in [report(&[evil]), report(&[evil, "other"])] {
        let html = page(&report).unwrap();
        // The page contains only its own script.
        assert_eq!(html.matches("<script").count(), 1);
        assert!(html.contains("&lt;script&gt;alert") && !html.contains("\" onload=\"x"));
        let svg = sheet(&report).unwrap();
        assert!(!svg.contains("<script") && svg.contains("&lt;script") && !svg.contains("\" onload=\"x"));
    }
}

#[test]
fn axes_have_the_units_that_were_said() {
    let mut report = report(&["FIC101"]);
    assert!(page(&report).unwrap().contains(">PV units</text>"));
    report.loops[0].tags.units = ["%", "m3/h <wet>"].map(str::to_owned);
    let html = page(&report).unwrap();
    assert!(html.contains(">%</text>") && html.contains(">m3/h &lt;wet&gt;</text>"));
    assert!(!html.contains("PV units</text>") && !html.contains("OP units</text>"));
}

#[test]
fn skipped_samples_stand_in_the_page_and_a_person_can_sign_it() {
    let html = page(&report(&["FIC101"])).unwrap();
    for part in ["Samples of FIC101 skipped.", "Work order", "Signature", "Date"] {
        assert!(html.contains(part), "{part}");
    }
}

#[test]
fn a_page_fetches_nothing() {
    let html = page(&report(&["FIC101", "TIC2"])).unwrap();
    for word in ["http://", "https://", "src=", "<link", "@import", "url("] {
        assert!(!html.contains(word), "{word}");
    }
    let svg = sheet(&report(&["FIC101"])).unwrap();
    assert_eq!(svg.matches("http").count(), 1, "the namespace alone");
}

#[test]
fn the_most_urgent_loop_comes_first() {
    let mut r = report(&["well", "blocked", "small", "large"]);
    for (k, p, s) in [(0, 0.1, 9.0), (2, 0.991, 1.0), (3, 0.99, 5.0)] {
        let a = &mut r.loops[k].document.assessment;
        (a.p_stiction, a.p_calibrated, a.s) = (Some(p), Some(p), Some(s));
        a.verdict = if p > 0.5 { Verdict::Stiction } else { Verdict::CauseUnknown };
        a.stiction = Some(p > 0.5);
    }
    assert_eq!(r.by_urgency(), [3, 2, 0, 1]);
    let html = page(&r).unwrap();
    assert!(
        html.contains("stiction found in <b>2</b>") && html.find("#loop-3").unwrap() < html.find("#loop-2").unwrap()
    );
    assert!(html.contains("stictiond analyze well/blocked/small/large --report out.html"));
}

#[test]
fn three_hundred_loops_stay_small() {
    let names: Vec<String> = (0..300).map(|k| format!("LOOP{k}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let html = page(&report(&names)).unwrap();
    assert!(html.len() < 12_000_000, "{} bytes", html.len());
    assert_eq!(html.matches("<details class=\"loop\"").count(), 300);
}

#[test]
fn groups_are_cards_and_none_is_said() {
    let mut report = report(&["A", "<i>B</i>"]);
    assert!(!page(&report).unwrap().contains("oscillation of its group"));
    report.groups = Some(Vec::new());
    assert!(page(&report).unwrap().contains("No loops share an oscillation"));
    report.groups = Some(vec![stiction_lab::truth::fixture::group::driven_group(1, &["A", "<i>B</i>"])]);
    let html = page(&report).unwrap();
    assert!(html.contains("A causes the oscillation (p 0.90)"));
    assert!(html.contains("driven by A, p 0.90") && html.contains("#loop-1\">&lt;i&gt;B") && !html.contains("<i>B"));
}
