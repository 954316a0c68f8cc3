//! What keeps loops from being judged, and what to do about it: from the newest estimate of each loop and the flow of its data.

use std::sync::PoisonError;

use serde::Serialize;

use super::{Entry, Overview};
use stiction::units::{duration, ms_from_ns};
use stiction::verdict::action::better_data;
use stiction::verdict::{AssessParams, Assessment, Gate, words};

/// Kind of an obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ObstacleKind {
    /// No newer sample comes.
    Silent,
    /// PV or OP does not move.
    Frozen,
    /// OP and PV seem to be exchanged.
    Swapped,
    /// OP is at a limit.
    AtLimit,
    /// The controller is in manual.
    Manual,
    /// A period of the oscillation has too few samples.
    TooSlow,
    /// The historian leaves values out.
    Compressed,
    /// Another reason of the estimate.
    Other,
    /// No window has come due yet.
    Waiting,
}

/// An obstacle of one loop.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Obstacle {
    /// The loop's name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// Part of the plant.
    pub area: Option<String>,
    /// Kind.
    pub kind: ObstacleKind,
    /// Whether the loop cannot be judged, or can raise no alarm; otherwise its answers are only less sure.
    pub blocks: bool,
    /// When it began, ms since 1970: the newest sample of a silent loop, else the start of the first window with it; null
    /// before the first sample. A restart of the daemon loses earlier windows.
    pub since_ms: Option<f64>,
    /// What is wrong, in words.
    pub words: String,
    /// What to do about it.
    pub remedy: String,
}

/// The obstacles of all loops.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Obstacles {
    /// Loops that have appeared.
    pub loops: usize,
    /// Loops without an obstacle that blocks.
    pub judged: usize,
    /// `judged` over `loops`; null without loops.
    pub share: Option<f64>,
    /// By kind, then by loop.
    pub obstacles: Vec<Obstacle>,
}

/// An obstacle that an estimate shows.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Limit {
    kind: ObstacleKind,
    blocks: bool,
    /// Word of the reason or gate.
    name: &'static str,
}

/// When the obstacle of the newest windows began.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Since {
    kind: ObstacleKind,
    start_ns: i64,
}

/// What limits an estimate most; none where it has an answer that counts for an alarm and is not compressed.
fn limit_of(a: &Assessment) -> Option<Limit> {
    let met = |gate: Gate| a.gates.contains(&gate);
    let (kind, name) = match a.reason.filter(|_| a.stiction.is_none()) {
        Some(name @ ("frozen_pv" | "frozen_op" | "stuck_signal")) => (ObstacleKind::Frozen, name),
        Some(name @ "swapped") => (ObstacleKind::Swapped, name),
        Some(name @ "saturated") => (ObstacleKind::AtLimit, name),
        Some(name @ "manual") => (ObstacleKind::Manual, name),
        Some(name @ "op_held") => (ObstacleKind::Compressed, name),
        None | Some("too_coarse" | "implausible_model" | "not_fitted") if met(Gate::TooCoarse) => {
            (ObstacleKind::TooSlow, Gate::TooCoarse.name())
        }
        None | Some("implausible_model" | "not_fitted") if met(Gate::Compressed) => {
            (ObstacleKind::Compressed, Gate::Compressed.name())
        }
        Some(name) => (ObstacleKind::Other, name),
        None => return None,
    };
    Some(Limit { kind, blocks: a.stiction.is_none() || kind == ObstacleKind::TooSlow, name })
}

/// What to do about it, with the figures of the estimate.
fn remedy(limit: Limit, a: &Assessment) -> String {
    match (limit.kind, a.oscillation.period_s) {
        (ObstacleKind::TooSlow, Some(period_s)) => {
            let needed = AssessParams::default().min_samples_per_period;
            let (now, then) = (duration(a.window.ts_s), duration(period_s / needed));
            format!("record every {then} instead of every {now}: {needed} samples a period of {}", duration(period_s))
        }
        (ObstacleKind::Compressed, _) => {
            "set the compression and exception deviations of OP and PV to 0 in the historian, or \
                                          read them from the controller"
                .to_owned()
        }
        (ObstacleKind::AtLimit, _) => {
            "find out why OP stays at its limit: range, demand or size of the valve".to_owned()
        }
        (ObstacleKind::Manual, _) => "put the loop in automatic".to_owned(),
        _ => better_data(limit.name).to_owned(),
    }
}

impl Since {
    /// The beginning after a further estimate.
    pub(super) fn after(before: Option<Self>, a: &Assessment) -> Option<Self> {
        let kind = limit_of(a)?.kind;
        Some(before.filter(|since| since.kind == kind).unwrap_or(Self { kind, start_ns: a.window.start_ns }))
    }
}

impl Entry {
    fn obstacle(&self, name: &str) -> Option<Obstacle> {
        let of = |kind, blocks, since_ns: Option<i64>, words: String, remedy: String| Obstacle {
            loop_name: name.to_owned(),
            area: self.place.area.clone(),
            kind,
            blocks,
            since_ms: since_ns.map(ms_from_ns),
            words,
            remedy,
        };
        if self.silent {
            let (words, remedy) = ("no new data", "check the publisher or gateway of its keys");
            return Some(of(ObstacleKind::Silent, true, self.newest_ns, words.to_owned(), remedy.to_owned()));
        }
        let Some(estimate) = self.estimate.as_deref() else {
            let (words, remedy) = ("waiting for a window", "nothing: the first window needs some periods of data");
            return Some(of(ObstacleKind::Waiting, true, None, words.to_owned(), remedy.to_owned()));
        };
        let a = &estimate.assessment;
        let limit = limit_of(a)?;
        let words = match limit.kind {
            // The estimate's reason may be another one.
            ObstacleKind::TooSlow => words::gate(Gate::TooCoarse).to_owned(),
            _ => words::reason(limit.name),
        };
        let since_ns = self.limited.map(|since| since.start_ns);
        Some(of(limit.kind, limit.blocks, since_ns, words, remedy(limit, a)))
    }
}

impl Overview {
    /// What keeps loops from being judged.
    #[must_use]
    pub fn obstacles(&self) -> Obstacles {
        let loops = self.0.read().unwrap_or_else(PoisonError::into_inner);
        let found = loops.by_name.iter().filter_map(|(name, entry)| entry.obstacle(name));
        let mut obstacles: Vec<Obstacle> = found.collect();
        // Stable: loops of a kind stay sorted by name.
        obstacles.sort_by_key(|obstacle| obstacle.kind);
        let count = loops.by_name.len();
        let judged = count - obstacles.iter().filter(|obstacle| obstacle.blocks).count();
        Obstacles { loops: count, judged, share: (count > 0).then(|| judged as f64 / count as f64), obstacles }
    }
}
