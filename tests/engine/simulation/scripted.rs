//! Assessments drawn from the seed instead of fits, so that days of a hundred loops take seconds.

use stiction::core::ident::region::Size;
use stiction::core::units::Moment;
use stiction::core::verdict::{Assessment, CountedBy, Oscillation, Verdict, Window};
use stiction_engine::engine::Request;
use stiction_engine::short_hash;

use super::DAY_STEPS;
use super::plant::STEP_NS;

const CLASSES: [Size; 3] = [Size::Weak, Size::Moderate, Size::Strong];

/// One loop in ten sticks for days; the others never do.
pub fn scripted(seed: u64, name: &str, request: &Request) -> Assessment {
    let draw = |what: &str| {
        let hash = short_hash(format!("{seed} {name} {what}").as_bytes());
        u64::from_str_radix(&hash[..12], 16).unwrap() % 100
    };
    let (index, spell) = (name[1..].parse::<u64>().unwrap_or(1), request.end_ns / (5 * DAY_STEPS * STEP_NS));
    let sticks = index % 10 == 0 && draw(&format!("spell {spell}")) < 60;
    let chance = draw(&format!("window {}", request.end_ns));
    let (verdict, s) = match (sticks, chance) {
        (_, 90..) => (Verdict::Inconclusive, 0.0),
        (true, 10..) => (Verdict::Stiction, 2.0),
        (true, _) => (Verdict::Stiction, 0.9),
        (false, _) => (Verdict::Tuning, 0.0),
    };
    let (start_ns, end_ns) = (request.record().start_ns, request.end_ns);
    let window = Window {
        start_ns,
        end_ns,
        start: Moment(start_ns),
        end: Moment(end_ns),
        samples: 100,
        ts_s: 600.0,
        box_samples: 1,
    };
    let (period_s, periods, samples_per_period, regularity) = (None, None, None, None);
    let oscillation = Oscillation { oscillating: sticks, period_s, periods, samples_per_period, regularity };
    let mut a = Assessment::empty(window, oscillation);
    (a.verdict, a.stiction, a.s) = (verdict, verdict.stiction(), Some(s));
    a.counted_by = Some(CountedBy::Periods);
    a.strength_by_span = Some(CLASSES[(draw(&format!("class {}", request.end_ns)) % 3) as usize]);
    a
}
