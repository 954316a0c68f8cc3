//! A group's result for a loop: the estimate names what drives the loop, and the alarm waits for the source's.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use stiction::core::record::{Sample, Signal, Value};
use stiction::core::units::Moment;
use stiction::core::verdict::rule::{Cuts, Opinion};
use stiction::core::verdict::{Assessment, CountedBy, EstimateDocument, MemberJudgement, Oscillation, Verdict, Window};
use stiction::plantwide::{GROUP_SCHEMA, GroupDocument, Source, SourceKind, Span};
use stiction_engine::alarm::Command;
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, Event, GroupStanding, LoopId};

const HOP_NS: i64 = 300_000_000_000;
const PERIOD_S: f64 = 60.0;

/// A window that alone finds stiction of 2 OP units with p 0.8.
fn sticking(end_ns: i64, period_s: f64) -> Assessment {
    let window = Window {
        start_ns: end_ns - HOP_NS,
        end_ns,
        start: Moment(end_ns - HOP_NS),
        end: Moment(end_ns),
        samples: 100,
        ts_s: 1.0,
        box_samples: 1,
    };
    let oscillation = Oscillation {
        oscillating: true,
        period_s: Some(period_s),
        periods: Some(10.0),
        samples_per_period: Some(60.0),
        regularity: Some(5.0),
    };
    let found = Assessment::empty(window, oscillation);
    Assessment {
        verdict: Verdict::Stiction,
        stiction: Some(true),
        p_stiction: Some(0.8),
        p_calibrated: Some(0.8),
        s: Some(2.0),
        grade: Some('B'),
        counted_by: Some(CountedBy::Periods),
        explanation: Some(Opinion { base: 0.0, logit: (0.8_f64 / 0.2).ln(), cuts: Cuts { called: 0.5, alarm: 0.7 } }),
        ..found
    }
}

/// A group of a source and the follower whose p it lowers.
fn group(p_follower: f64) -> GroupDocument {
    let judgement = |name: &str, p_source: f64, p: f64| MemberJudgement {
        loop_name: name.to_owned(),
        p_source,
        p_alone: Some(0.8),
        p_stiction: Some(p),
        p_calibrated: None,
        cause: (p_source < 0.5).then(|| "driven by SOURCE, p 0.95".to_owned()),
        masked: p_source < 0.5,
    };
    GroupDocument {
        same_record: Vec::new(),
        schema: GROUP_SCHEMA,
        members: vec!["SOURCE".to_owned(), "FOLLOWER".to_owned()],
        source: Source {
            kind: SourceKind::Loop,
            loop_name: Some("SOURCE".to_owned()),
            probability: 0.95,
            reasons: Vec::new(),
            next_test: None,
        },
        followers: Vec::new(),
        judgements: vec![judgement("SOURCE", 0.95, 0.98), judgement("FOLLOWER", 0.05, p_follower)],
        period_s: PERIOD_S,
        window: Span { start_ns: 0, end_ns: HOP_NS, start: Moment(0), end: Moment(HOP_NS) },
        p_value: 0.001,
        pairs_compared: 1,
        area: None,
        version: "0",
        daemon: None,
    }
}

/// One loop on an engine, with one window per hop.
struct Rig {
    engine: Engine,
    id: LoopId,
    now_ns: i64,
    period_s: f64,
}

impl Rig {
    fn new() -> Self {
        Self::of("FOLLOWER")
    }

    fn of(name: &str) -> Self {
        let mut engine = Engine::new(Config::with_prefix("p").engine());
        let id = engine.appear(name).unwrap();
        Self { engine, id, now_ns: 0, period_s: PERIOD_S }
    }

    /// The group's result, while the source's alarm is active or not.
    fn stand(&mut self, source_has_alarm: bool) {
        self.stand_at(0.1, source_has_alarm);
    }

    fn stand_at(&mut self, p: f64, source_has_alarm: bool) {
        let standings = GroupStanding::of_members(&group(p), |name| source_has_alarm && name == "SOURCE");
        let own = standings.into_iter().find(|s| s.judgement.loop_name == "FOLLOWER");
        self.engine.stand(self.id, own);
    }

    /// Sends samples until the next estimate.
    fn next_window(&mut self) -> EstimateDocument {
        loop {
            self.now_ns += 10_000_000_000;
            let mut events = Vec::new();
            for signal in [Signal::Op, Signal::Pv] {
                let sample = Sample { signal, t_ns: self.now_ns, value: Value::number(50.0), quality: None };
                self.engine.push(self.id, sample, &mut events);
            }
            while let Some(event) = events.pop() {
                match event {
                    Event::Request(request) => {
                        let assessment = sticking(request.end_ns, self.period_s);
                        let answer = request.answer(request.record(), assessment);
                        self.engine.complete(request.id, request.seq, answer, &mut events);
                    }
                    Event::Estimate(_, document) => return *document,
                    _ => {}
                }
            }
        }
    }

    fn has_alarm(&self) -> bool {
        self.engine.checkpoint(self.id).alarm.active
    }
}

#[test]
fn a_followers_alarm_waits_for_the_sources_and_is_raised_by_itself_afterwards() {
    let mut rig = Rig::new();
    for _ in 0..10 {
        rig.stand(true);
        let estimate = rig.next_window();
        let group = estimate.group.unwrap();
        assert_eq!((estimate.assessment.verdict, estimate.assessment.reason), (Verdict::Inconclusive, Some("masked")));
        assert_eq!(
            (group.p_alone, group.p_stiction, estimate.assessment.p_stiction),
            (Some(0.8), Some(0.1), Some(0.1))
        );
        assert_eq!(group.cause.unwrap(), "driven by SOURCE, p 0.95");
        assert!(!rig.has_alarm());
    }
    rig.engine.stand(rig.id, None);
    let estimates: Vec<EstimateDocument> = (0..4).map(|_| rig.next_window()).collect();
    assert!(estimates.iter().all(|e| e.assessment.verdict == Verdict::Stiction && e.group.is_none()));
    assert!(rig.has_alarm());
}

#[test]
fn nothing_is_held_back_while_the_sources_alarm_is_not_active() {
    let mut rig = Rig::new();
    for _ in 0..4 {
        rig.stand(false);
        let estimate = rig.next_window();
        assert_eq!((estimate.assessment.verdict, estimate.assessment.p_stiction), (Verdict::Stiction, Some(0.8)));
        assert_eq!(estimate.group.unwrap().cause.unwrap(), "driven by SOURCE, p 0.95");
    }
    assert!(rig.has_alarm());
}

#[test]
fn an_answer_that_no_comparison_confirms_ends_after_three_windows() {
    let mut rig = Rig::new();
    rig.stand(true);
    let held: Vec<bool> = (0..8).map(|_| rig.next_window().group.is_some()).collect();
    assert_eq!(held, [true, true, true, false, false, false, false, false]);
    assert!(rig.has_alarm());
}

#[test]
fn a_p_that_the_group_lowers_below_the_alarms_threshold_raises_nothing() {
    let mut rig = Rig::new();
    for _ in 0..6 {
        rig.stand_at(0.55, true);
        let estimate = rig.next_window().assessment;
        assert_eq!((estimate.stiction, estimate.p_stiction), (Some(true), Some(0.55)));
    }
    assert!(!rig.has_alarm());
}

/// Source and follower begin to stick and to oscillate in the same hop, and are compared after every hop.
#[test]
fn of_two_loops_that_begin_together_only_the_source_raises_its_alarm() {
    let mut source = Rig::of("SOURCE");
    let mut follower = Rig::new();
    for _ in 0..8 {
        source.next_window();
        follower.next_window();
        let standings = GroupStanding::of_members(&group(0.1), |name| source.engine.alarms(name));
        for standing in standings {
            let of = if standing.judgement.loop_name == "SOURCE" { &mut source } else { &mut follower };
            of.engine.stand(of.id, Some(standing));
        }
    }
    assert!(source.has_alarm() && !follower.has_alarm());
}

#[test]
fn a_source_that_is_out_of_service_holds_nothing_back() {
    let mut source = Rig::of("SOURCE");
    for _ in 0..4 {
        source.next_window();
    }
    assert!(source.has_alarm() && source.engine.alarms("SOURCE"));
    let command =
        |cmd: &str| Command { action: cmd.parse().unwrap(), by: Some("ann".to_owned()), why: None, for_s: None };
    source.engine.command(source.id, &command("out_of_service")).unwrap();
    assert!(!source.engine.alarms("SOURCE"));
}

#[test]
fn a_loop_that_oscillates_otherwise_by_now_answers_for_itself() {
    let mut rig = Rig::new();
    rig.period_s = 2.0 * PERIOD_S;
    rig.stand(true);
    let estimate = rig.next_window();
    assert!(estimate.group.is_none() && estimate.assessment.verdict == Verdict::Stiction);
}
