//! The alarm compared with a second, simpler model of ISA-18.2, step by step over sequences of windows and commands.

use crate::isa::Model;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use stiction::core::ident::region::Size;
use stiction::core::units::Moment;
use stiction::core::verdict::{Assessment, CountedBy, Oscillation, Verdict, Window};
use stiction_engine::alarm::AlarmParams;
use stiction_engine::alarm::{Alarm, Command, MAX_SHELVE_S};

const STEP_NS: i64 = 600_000_000_000;
const CLASSES: [Size; 3] = [Size::Weak, Size::Moderate, Size::Strong];

fn window(end_ns: i64, vote: Option<char>, class: usize) -> Assessment {
    let window = Window {
        start_ns: end_ns - STEP_NS,
        end_ns,
        start: Moment(end_ns - STEP_NS),
        end: Moment(end_ns),
        samples: 100,
        ts_s: 1.0,
        box_samples: 1,
    };
    let oscillation =
        Oscillation { oscillating: true, period_s: None, periods: None, samples_per_period: None, regularity: None };
    let mut a = Assessment::empty(window, oscillation);
    // The limit is 1: above it, far below it, a little below it, without an answer, or without enough evidence.
    let (verdict, s) = match vote {
        Some('f') => (Verdict::Stiction, 2.0),
        Some('a') => (Verdict::Tuning, 0.0),
        Some(_) => (Verdict::Stiction, 0.9),
        None => [(Verdict::Inconclusive, 0.0), (Verdict::Stiction, 2.0), (Verdict::Tuning, 0.0)][class],
    };
    a.counted_by = vote.map(|_| CountedBy::Reversals);
    (a.verdict, a.stiction, a.s, a.severity_by_range) = (verdict, verdict.stiction(), Some(s), Some(CLASSES[class]));
    a
}

/// One sequence of up to 64 steps by its seed.
fn follow(seed: u64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut below = |n: u32| random.next_u32() % n;
    let n = 1 + below(6) as u8;
    let m = 1 + below(u32::from(n)) as u8;
    let params = AlarmParams { raise: [m, n], s_limit_op: 1.0, s_limit_span: 0.0 };
    let (mut alarm, mut model) = (Alarm::default(), Model::default());
    let mut at_ns = 0;
    for step in 0..1 + below(64) {
        if below(3) > 0 {
            at_ns += STEP_NS;
            let (vote, class) =
                ([Some('f'), Some('f'), Some('a'), Some('-'), None][below(5) as usize], below(3) as usize);
            let said = alarm.window("L", &window(at_ns, vote, class), &params);
            let changed = model.window(at_ns, vote, class, [usize::from(m), usize::from(n)]);
            assert_eq!(said.is_some(), changed, "seed {seed}, step {step}: {model:?}\n{alarm:?}");
            assert!(said.is_none_or(|d| d.state.name() == model.shown() && d.active == model.active));
        } else {
            const ALL: [&str; 8] =
                ["ack", "ack", "shelve", "unshelve", "suppress", "unsuppress", "out_of_service", "in_service"];
            let cmd = ALL[below(8) as usize];
            let for_s = [None, Some(0), Some(601), Some(3000), Some(MAX_SHELVE_S + 1)][below(5) as usize];
            let command = Command { action: cmd.parse().unwrap(), by: Some("ann".into()), why: None, for_s };
            let before = alarm.clone();
            let said = alarm.command("L", &command, at_ns);
            assert_eq!(said.is_ok(), model.command(cmd, for_s, at_ns), "seed {seed}, step {step}, {cmd}: {model:?}");
            assert!(said.is_ok() || alarm == before, "seed {seed}, step {step}: a refused command changes nothing");
        }
        assert_eq!(alarm.shown().name(), model.shown(), "seed {seed}, step {step}: {model:?}");
        assert_eq!(alarm.active, model.active, "seed {seed}, step {step}");
        // A restart in between changes nothing.
        if below(8) == 0 {
            let text = serde_json::to_string(&alarm).unwrap();
            assert_eq!(serde_json::from_str::<Alarm>(&text).unwrap(), alarm);
        }
    }
}

#[test]
fn sequences_agree_with_the_model() {
    let sequences = if std::env::var_os("STICTIOND_LONG").is_some() { 100_000 } else { 15_000 };
    (0..sequences).for_each(follow);
}
