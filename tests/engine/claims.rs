//! The program's statements never exceed what the data support. Each case is a claim that was once too strong, with the
//! program's or browser's text where it might reappear.

use std::collections::BTreeMap;
use std::fs;
use std::sync::Arc;

use stiction::core::record::Record;
use stiction::core::units::FinalElement;
use stiction::core::verdict::rule::{Cuts, Opinion};
use stiction::core::verdict::{
    AssessParams, Assessment, CountedBy, EstimateDocument, Oscillation, SCREENED, Verdict, Window, assess,
    for_prevalence,
};
use stiction::over_time::{WindowResult, over_time};
use stiction::words;
use stiction::words::action::what_to_do;
use stiction::words::answer::Answer;
use stiction_engine::alarm::{Alarm, AlarmParams};
use stiction_engine::status::{Known, LoopStatus};
use stictiond::runtime::maintenance::rank;
use stictiond::runtime::overview::Candidate;

/// A claim, and the output where it might appear.
struct Case {
    claim: &'static str,
    read: fn() -> String,
    says: &'static [&'static str],
    never: &'static [&'static str],
}

/// An estimate with this verdict and calibrated probability.
fn estimate(verdict: Verdict, p: f64) -> Assessment {
    let oscillation = Oscillation {
        oscillating: verdict != Verdict::NotOscillating,
        period_s: Some(60.0),
        periods: Some(20.0),
        samples_per_period: Some(60.0),
        regularity: Some(5.0),
    };
    let found = verdict.stiction() == Some(true);
    let prevalence = AssessParams::default().prevalence;
    Assessment {
        verdict,
        stiction: verdict.stiction(),
        p_calibrated: Some(p),
        p_stiction: Some(for_prevalence(p, prevalence)),
        prevalence,
        confidence: Some(p.max(1.0 - p)),
        grade: found.then_some('A'),
        s: Some(2.0),
        s_interval: Some([1.9, 2.1]),
        s_over_span: Some(0.5),
        s_detectable: (!found).then_some(1.25),
        j_identifiable: Some(true),
        counted_by: Some(CountedBy::Periods),
        explanation: Some(Opinion { base: 0.0, logit: (p / (1.0 - p)).ln(), cuts: Cuts { called: 0.5, alarm: 0.7 } }),
        ..Assessment::empty(Window::of(&Record::uniform(1.0, vec![0.0; 40], vec![0.0; 40])), oscillation)
    }
}

/// Everything that report, terminal and tile say about an estimate.
fn told(a: &Assessment) -> String {
    let tile = LoopStatus::of(&Known { estimate: Some(a), verdicts: vec![a.verdict], ..Known::default() });
    let parts = [words::headline(a), words::sureness(a), words::seen(a), what_to_do(a), words::unknowns(a).join(". ")];
    let [answer, tile] = [serde_json::to_string(&Answer::of(a)), serde_json::to_string(&tile)].map(Result::unwrap);
    let text = format!("{}\n{answer}\n{tile}\n{}", parts.join("\n"), alarm(a));
    assert!(
        !["healthy", "in order", "moves freely", "no stiction", "✓"].iter().any(|word| text.contains(word)),
        "{text}"
    );
    text
}

/// The alarm's text after three windows with stiction and then three like `last`.
fn alarm(last: &Assessment) -> String {
    let params = AlarmParams { raise: [3, 4], s_limit_op: 1.0, s_limit_span: 0.0 };
    let (mut alarm, mut text) = (Alarm::default(), String::new());
    let sticks = estimate(Verdict::Stiction, 0.95);
    for (k, a) in [&sticks, &sticks, &sticks, last, last, last].into_iter().enumerate() {
        let window = Window { end_ns: 10 + k as i64, ..a.window };
        let document = alarm.window("L", &Assessment { window, ..a.clone() }, &params);
        text.extend(document.map(|d| format!("{}\n{}\n", d.line(), serde_json::to_string(&d).unwrap())));
    }
    text
}

/// A calm loop, judged as in the daemon.
fn screened() -> Assessment {
    let noise = |k: u64| {
        let mut z = k.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f64 / f64::from(1 << 24)
    };
    let (op, pv) = (1..1_001).map(|k| (50.0 + noise(k), 20.0 + noise(k + 1_000_000))).unzip();
    let record = Record::uniform(1.0, pv, op);
    let found = assess(&record, &AssessParams::default());
    assert_eq!(found.reason, Some(SCREENED));
    found
}

/// The maintenance row and the document of a calm loop; a test next to the metrics shows that it has no series.
fn screened_everywhere() -> String {
    let document = EstimateDocument::new("CALM", "hash", screened());
    let json = serde_json::to_string(&document).unwrap();
    let candidate = Candidate { name: "CALM".into(), estimate: Some(Arc::new(document)), ..Candidate::default() };
    let row = serde_json::to_string(&rank(&[candidate], &BTreeMap::new())[0]).unwrap();
    format!("{json}\n{row}")
}

/// Windows of a valve that sticks and then no longer does.
fn no_longer() -> String {
    let window = |k: i64| WindowResult {
        start_ns: k * 3_600_000_000_000,
        end_ns: (k + 1) * 3_600_000_000_000,
        stiction: Some(k < 20),
        s: Some(4.0 + 0.01 * (k % 5) as f64),
        s_interval: Some([3.8, 4.2]),
        ..WindowResult::default()
    };
    over_time(&(0..40).map(window).collect::<Vec<_>>()).sentences.join("\n")
}

/// A file that the browser loads.
fn page(path: &str) -> String {
    fs::read_to_string(path).unwrap()
}

const CASES: &[Case] = &[
    Case {
        claim: "p 0.99 is almost certain",
        read: || [0.5, 0.72, 0.96, 0.996].map(|p| told(&estimate(Verdict::Stiction, p))).join("\n"),
        says: &["Stiction possible (p 0.30, assuming that 30 % of such loops stick)", "p > 0.99, assuming that 30 %"],
        never: &["almost certain", "Stiction very likely (p 0.96"],
    },
    Case {
        claim: "an oscillation of unknown cause is no stiction",
        read: || serde_json::to_string(&Verdict::ALL).unwrap() + &told(&estimate(Verdict::CauseUnknown, 0.1)),
        says: &["\"cause_unknown\"", "\"not_oscillating\"", "the cause was not identified"],
        never: &["no_stiction", "no_oscillation"],
    },
    Case {
        claim: "NE 107 is in order where nothing was found",
        read: || told(&estimate(Verdict::NotOscillating, 0.1)),
        says: &["\"sign\":\"none\"", "\"ne107\":\"none\""],
        never: &["\"ok\"", "\"sign\":\"S\""],
    },
    Case {
        claim: "NE 107 is in order where a loop oscillates for an unknown cause",
        read: || told(&estimate(Verdict::CauseUnknown, 0.1)),
        says: &["\"sign\":\"S\""],
        never: &["\"ok\"", "\"sign\":\"none\""],
    },
    Case {
        claim: "grade A is a very good valve",
        read: || {
            told(&estimate(Verdict::Stiction, 0.96))
                + &page("src/web/assets/tiles.js")
                + &page("src/web/assets/words.js")
        },
        says: &["how well the finding is supported", "grade A: no validity check limits it"],
        never: &["very good", "grade B: good"],
    },
    Case {
        claim: "a verdict without stiction is good",
        read: || page("src/web/assets/workbench-result.js"),
        says: &["not_oscillating: \"none\"", "cause_unknown: \"other\""],
        never: &["\"good\""],
    },
    Case {
        claim: "an alarm is active until the valve moves freely",
        read: || page("src/web/assets/actions.js") + &alarm(&estimate(Verdict::Tuning, 0.1)),
        says: &["until enough windows no longer show stiction"],
        never: &["until the valve moves freely"],
    },
    Case {
        claim: "what is no longer detected was repaired",
        read: || no_longer() + &page("src/web/assets/loop-history.js"),
        says: &["is no longer detected since about", "repaired: \"no longer detected\""],
        never: &["disappeared", "as after a repair", "\"Repaired\""],
    },
    Case {
        claim: "halve the gain, on any loop",
        read: || told(&estimate(Verdict::Tuning, 0.1)),
        says: &["With operations' consent review the tuning: on an integrating loop lengthen the integral time first"],
        never: &["halve the controller gain"],
    },
    Case {
        claim: "above the detection limit there is none",
        read: || told(&estimate(Verdict::Disturbance, 0.1)),
        says: &["Bands below 1.3 OP units could easily be missed"],
        never: &["would not have been found", "no sign of stiction above"],
    },
    Case {
        claim: "10,000 calm loops look like 2,000 that stick",
        read: screened_everywhere,
        says: &["\"p_stiction\":null,\"p_calibrated\":null", "\"confidence\":null"],
        never: &["\"p_stiction\":0"],
    },
    Case {
        claim: "a drive has a valve",
        read: || {
            let params = AssessParams { final_element: FinalElement::Drive, ..AssessParams::default() };
            let wave = |k: usize, by: f64| 50.0 + 3.0 * (0.1 * k as f64 - by).sin();
            let [op, pv] = [0.0, 1.5].map(|by| (0..1_000).map(|k| wave(k, by)).collect());
            told(&assess(&Record::uniform(1.0, pv, op), &params))
        },
        says: &["the final element is declared to be no valve, so stiction is not judged", "\"event\":\"cleared\""],
        never: &["not enough evidence", "the size: no model"],
    },
];

#[test]
fn no_claim_is_stronger_than_its_evidence() {
    let mut faults = Vec::new();
    for case in CASES {
        let text = (case.read)();
        let lacks = case.says.iter().filter(|part| !text.contains(**part)).map(|part| format!("lacks {part:?}"));
        let has = case.never.iter().filter(|part| text.contains(**part)).map(|part| format!("says {part:?}"));
        let all: Vec<String> = lacks.chain(has).collect();
        if !all.is_empty() {
            let shown = if text.len() < 6_000 { text.as_str() } else { "" };
            faults.push(format!("{}: {}\n{shown}", case.claim, all.join("; ")));
        }
    }
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}
