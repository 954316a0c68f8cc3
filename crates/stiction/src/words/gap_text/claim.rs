//! How strongly an answer is put into words: one rule for all sentences, from the numbers beside them.

use crate::core::gap::document::{EffectNote, GapDocument};
use crate::core::gap::effects;
use crate::core::gap::enough::STATED;
use crate::core::gap::sizes::percent;
use crate::core::gap::types::{AT_FLOOR, LITTLE_PCT};
use crate::core::units::probability;

/// Per cent closed from which an effect explains a gap.
const EXPLAINS: f64 = 50.0;
/// Per cent below which nothing is said to be closed.
const NOTHING: f64 = 0.5;
/// Gap over PV's deviation up to which the base explains most of a record.
const MOST: f64 = 0.45;

/// What may be said of an effect that is named.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Claim {
    /// It closes half of the gap or more.
    Explains,
    /// It closes some of it.
    Part,
    /// It closes some of it, or nothing, as the interval says.
    May,
    /// It shows, but makes next to nothing of the gap.
    Hardly,
    /// Held-out data or the run forward do not bear it out.
    Suspected,
    /// It shows where no simulation can close anything.
    Shows,
}

impl Claim {
    /// Of the named effect.
    pub(super) fn of(d: &GapDocument, e: &EffectNote) -> Self {
        let Some(closed) = e.closed_pct else {
            return if d.cause.confirmed { Self::Shows } else { Self::Suspected };
        };
        // What leaves a trace in PV, or acts in both halves, is there, however little it closes; what was fitted is only there
        // if it closes.
        let acts = d.neighbours.as_ref().and_then(|n| n.acts.as_deref()).map(effects::neighbour::id_of);
        if closed < LITTLE_PCT && (e.at_floor.is_none() || acts.as_ref() == Some(&e.id)) {
            return Self::Hardly;
        }
        if !d.cause.confirmed || closed < LITTLE_PCT {
            return Self::Suspected;
        }
        match e.closed_interval {
            Some([low, _]) if low <= 0.0 => Self::May,
            _ if closed < EXPLAINS => Self::Part,
            _ => Self::Explains,
        }
    }

    /// With its probability.
    pub(super) fn words(self, p: f64) -> String {
        let p = probability(p);
        match self {
            Self::Explains => format!("explains it (p {p})"),
            Self::Part => format!("explains a part of it (p {p})"),
            Self::May => format!("may explain it (p {p})"),
            Self::Hardly => format!("shows in the record (p {p}), but makes next to nothing of the gap"),
            Self::Suspected => format!("is suspected, not confirmed (p {p})"),
            Self::Shows => format!("shows in the record (p {p})"),
        }
    }
}

/// Per cent closed, or that it is nothing.
pub(super) fn closed(pct: f64) -> String {
    if pct < NOTHING { "nothing".to_owned() } else { percent(pct) }
}

/// Per cent closed forward in time; of a passing effect such a run says nothing.
pub(super) fn closed_forward(d: &GapDocument) -> Option<f64> {
    let local = effects::parts(&d.cause.id).any(|id| effects::by_id(id).is_some_and(|e| e.local));
    d.forward.and_then(|f| f.closed_pct).filter(|_| !local)
}

/// Whether the base leaves nothing but noise on held-out data.
pub(super) fn nothing_left(d: &GapDocument) -> bool {
    d.gap.noise_floor.is_some_and(|floor| d.gap.rmse < AT_FLOOR * floor)
}

/// What the base does with a record, by what it leaves of it.
pub(super) fn of_base(d: &GapDocument) -> &'static str {
    match d.gap.relative {
        _ if nothing_left(d) => "explains this record",
        Some(left) if left <= STATED => "explains this record",
        Some(left) if left <= MOST => "explains most of this record",
        _ => "is as much as can be said of this record",
    }
}

/// Whether an effect explains so much of the gap that it cannot be said to explain nothing.
pub(super) fn explains(e: &EffectNote) -> bool {
    e.closed_pct.is_some_and(|c| c >= EXPLAINS)
}
