//! All available recordings of real loops: every answer is plausible to a control engineer.
#![allow(missing_docs)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::labelled;

use stiction::core::guard::{PV_SPANS, SHIFT_S};
use stiction::core::record::Record;
use stiction::core::verdict::Assessment;
use stiction::core::verdict::bump_test::bump_test;
use stiction::words;

/// Implausible properties of an answer, by limits wider than the program's own and independent of its table.
fn nonsense(a: &Assessment, record: &Record, kind: &str) -> Vec<String> {
    let [pv_span, op_span] = [&record.pv, &record.op_path].map(|x| {
        let (low, high) = x.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
        high - low
    });
    let (window_s, floor) = (record.len() as f64 * record.point_s(), 3.0 * record.point_s());
    let mut out = Vec::new();
    let mut add = |met: bool, what: String| {
        if met {
            out.push(what);
        }
    };
    if let Some(p) = &a.process {
        let flow = kind == "flow";
        let tau = p.time_constants_s.first().copied().unwrap_or(0.0);
        let dead = p.dead_time_s;
        add(dead > if flow { floor.max(60.0) } else { 7_200.0 }, format!("dead time {dead} s"));
        add(tau > window_s || (flow && tau > floor.max(300.0)), format!("time constant {tau} s"));
        add(flow && p.integrating, "a flow that integrates".to_owned());
        add(!p.integrating && p.gain.abs() * op_span > 50.0 * pv_span, format!("gain {}", p.gain));
        add(p.fit_pct < 0.0, format!("fit {} %", p.fit_pct));
    }
    add(a.s.is_some_and(|s| s > 1.001 * op_span), format!("s {:?} of a span of {op_span}", a.s));
    let day = a.oscillation.period_s.is_some_and(|p| (0.9..1.1).contains(&(p / 86_400.0)));
    add(a.stiction == Some(true) && day, "a valve with a daily cycle".to_owned());
    if let Ok(t) = bump_test(a) {
        add(t.total_s > SHIFT_S, format!("a test of {} s", t.total_s));
        add(
            t.travel_pv.max(t.limit_pv) > 1.001 * PV_SPANS * pv_span,
            format!("a test that moves PV by {}", t.travel_pv),
        );
    }
    let told = format!("{} {} {}", words::headline(a), words::advice(a), words::size(a).unwrap_or_default());
    add(told.contains("by the bump test") && told.contains("No bump test"), format!("contradictory advice: {told}"));
    add(
        a.stiction == Some(true) && words::at_bound(a) && !told.contains("at least "),
        format!("a bound as a value: {told}"),
    );
    add(a.stiction != Some(true) && !words::bump_test(a).is_empty(), "a test without a finding".to_owned());
    let well = a.stiction == Some(false) && !["no sign of stiction", "is open"].iter().any(|part| told.contains(part));
    add(well, format!("a negative result without its limit: {told}"));
    let below = matches!(a.grade, Some('B' | 'C')) && !told.contains("(grade ");
    add(below, format!("a grade without its reservation: {told}"));
    if a.stiction == Some(false) {
        for interval in [a.s_interval, a.fs_interval, a.fd_interval, a.j_interval].into_iter().flatten() {
            add(interval[0] > 0.0, format!("no stiction, but an interval {interval:?}"));
        }
    }
    out
}

#[test]
fn no_model_that_no_plant_has_is_reported_on_any_recording() {
    let test = "no_model_that_no_plant_has_is_reported_on_any_recording";
    let Some(all) = labelled::assessed_or_skip(test) else { return };
    assert!(all.len() >= 100, "{} recordings only", all.len());
    let mut faults = Vec::new();
    for (item, found) in all {
        let told = nonsense(found, &item.record, &item.kind);
        faults.extend(told.into_iter().map(|what| format!("{}: {} {what}", item.file, found.verdict.name())));
    }
    assert!(faults.is_empty(), "{} of {}:\n{}", faults.len(), all.len(), faults.join("\n"));
}
