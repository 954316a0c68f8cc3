//! Obstacles that keep loops from being judged, and their remedies; from each loop's newest estimate, the state of its data and
//! the configured loops.

use std::sync::PoisonError;
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::expected::{Awaited, Expected};
use super::{Entry, Loops, Overview, SharePoint};
use stiction::core::people;
use stiction::core::units::{duration, ms_from_ns};
use stiction::core::verdict::{AssessParams, Assessment, Gate, NO_VALVE, Verdict};
use stiction::words;
use stiction::words::action::better_data;

/// Kind of an obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ObstacleKind {
    /// No newer sample comes, or none ever came.
    Silent,
    /// PV or OP does not move.
    Frozen,
    /// OP and PV seem to be exchanged.
    Swapped,
    /// PV or OP seems to be that of another loop.
    Misplaced,
    /// OP, PV or the valve position seems to have the wrong sign.
    WrongSign,
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

impl ObstacleKind {
    /// Whether it is shown in preference to misplaced signals.
    const fn comes_first(self) -> bool {
        matches!(self, Self::Frozen | Self::Swapped | Self::AtLimit | Self::Manual)
    }

    /// In words that follow a number of loops.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Silent => "silent",
            Self::Frozen => "frozen",
            Self::Swapped => "swapped",
            Self::Misplaced => "with a signal of another loop",
            Self::WrongSign => "with a wrong sign",
            Self::AtLimit => "at a limit",
            Self::Manual => "in manual",
            Self::TooSlow => "sampled too slowly",
            Self::Compressed => "compressed",
            Self::Other => "for other reasons",
            Self::Waiting => "waiting for a window",
        }
    }
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
    /// Whether the loop is in the list of loops; false where the configuration names it and no value of it has come.
    pub appeared: bool,
    /// Whether the loop cannot be judged, or can raise no alarm; otherwise its answers are only less sure.
    pub blocks: bool,
    /// When it began, ms since 1970: the newest sample of a silent loop, the start of the daemon where none has come, else the
    /// start of the first window with it; null where that is unknown.
    pub since_ms: Option<f64>,
    /// The obstacle in words.
    pub words: String,
    /// What to do about it.
    pub remedy: String,
}

/// The obstacles of all loops.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Obstacles {
    /// Loops that have appeared, plus configured ones that have not.
    pub loops: usize,
    /// Loops without a blocking obstacle.
    pub judged: usize,
    /// `judged` over `loops`; null without loops.
    pub share: Option<f64>,
    /// Sorted by kind, then by loop.
    pub obstacles: Vec<Obstacle>,
    /// The share over the last month, one point an hour, oldest first.
    pub trend: Vec<SharePoint>,
}

/// The obstacles of all loops at one moment.
#[derive(Debug)]
pub struct Survey {
    /// The obstacles.
    pub found: Obstacles,
    /// When each obstacle began.
    pub(super) since: Vec<(String, Since)>,
}

/// An obstacle that an estimate shows.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Limit {
    kind: ObstacleKind,
    blocks: bool,
    /// Name of the reason or gate.
    name: &'static str,
}

/// When the obstacle of the newest windows began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Since {
    kind: ObstacleKind,
    start_ns: i64,
}

/// The main limit of an estimate; `None` if it has an answer that counts for an alarm and its data are not compressed.
fn limit_of(a: &Assessment) -> Option<Limit> {
    let met = |gate: Gate| a.gates.contains(&gate);
    let (kind, name) = match a.reason.filter(|_| a.stiction.is_none()) {
        // Not meant to be judged.
        Some(NO_VALVE) => return None,
        Some(name @ ("frozen_pv" | "frozen_op" | "stuck_signal" | "no_response")) => (ObstacleKind::Frozen, name),
        Some(name @ "swapped") => (ObstacleKind::Swapped, name),
        Some(name @ "saturated") => (ObstacleKind::AtLimit, name),
        Some(name @ "manual") => (ObstacleKind::Manual, name),
        Some(name @ "rate_too_low") => (ObstacleKind::TooSlow, name),
        Some(name @ "op_held") => (ObstacleKind::Compressed, name),
        // If nothing oscillates, the period is that of the noise.
        None | Some("too_coarse" | "too_few_reversals" | "implausible_model" | "not_fitted")
            if met(Gate::TooCoarse) && a.verdict != Verdict::NotOscillating =>
        {
            (ObstacleKind::TooSlow, Gate::TooCoarse.name())
        }
        None | Some("implausible_model" | "not_fitted") if met(Gate::Compressed) => {
            (ObstacleKind::Compressed, Gate::Compressed.name())
        }
        Some(name) => (ObstacleKind::Other, name),
        None => return None,
    };
    Some(Limit { kind, blocks: a.stiction.is_none(), name })
}

/// The remedy, with the figures of the estimate.
fn remedy(limit: Limit, a: &Assessment, needed: f64) -> String {
    match (limit.kind, a.oscillation.period_s) {
        (ObstacleKind::TooSlow, Some(period_s)) => {
            let (now, then) = (duration(a.window.ts_s), people::at_most(period_s / needed));
            format!(
                "record every {then} instead of every {now}: {needed} samples a period of {}",
                people::about(period_s)
            )
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
    /// The beginning, updated by a further estimate.
    pub(super) fn after(before: Option<Self>, a: &Assessment) -> Option<Self> {
        let kind = limit_of(a)?.kind;
        Some(before.filter(|since| since.kind == kind).unwrap_or(Self { kind, start_ns: a.window.start_ns }))
    }
}

/// A loop's obstacle, and its beginning, ns since 1970.
type Found = (Obstacle, Option<i64>);

/// An obstacle; its beginning is set later.
fn obstacle(name: &str, area: Option<String>, kind: ObstacleKind, words: String, remedy: String) -> Obstacle {
    Obstacle { loop_name: name.to_owned(), area, kind, appeared: true, blocks: true, since_ms: None, words, remedy }
}

fn beginning(obstacle: Obstacle, since_ns: Option<i64>) -> Found {
    (Obstacle { since_ms: since_ns.map(ms_from_ns), ..obstacle }, since_ns)
}

/// What to check if no value comes.
fn remedy_of_silence(keys: Option<[String; 2]>) -> String {
    keys.map_or_else(
        || "check the publisher or gateway of its keys".to_owned(),
        |[op, pv]| format!("check that something publishes {op} and {pv}"),
    )
}

impl Entry {
    fn obstacle(&self, name: &str, loops: &Loops) -> Option<Found> {
        let of =
            |kind, words: &str, remedy: String| obstacle(name, self.place.area.clone(), kind, words.into(), remedy);
        let expected = loops.expected.as_ref();
        let awaited = expected.and_then(|expected| expected.awaited(name));
        if self.silent {
            let keys = expected.filter(|_| awaited.is_some()).map(|expected| expected.keys(name));
            let found = of(ObstacleKind::Silent, "no new data", remedy_of_silence(keys));
            let since_ns = self.newest_ns.or_else(|| loops.silent_since(name)).or(awaited.map(|a| a.since_ns));
            return Some(beginning(found, since_ns));
        }
        let Some(estimate) = self.estimate.as_deref() else {
            let remedy = "nothing: the first window needs some periods of data".to_owned();
            return Some(beginning(of(ObstacleKind::Waiting, "waiting for a window", remedy), None));
        };
        let a = &estimate.assessment;
        let limit = limit_of(a);
        if let Some(found) = self.signals.found().filter(|_| limit.is_none_or(|limit| !limit.kind.comes_first())) {
            let (kind, words, remedy, since_ns) = found;
            let found = Obstacle { blocks: kind == ObstacleKind::Misplaced, ..of(kind, &words, remedy) };
            return Some(beginning(found, Some(since_ns)));
        }
        let limit = limit?;
        let words = words::reason(limit.name);
        let usual = AssessParams::default().min_samples_per_period;
        let needed = expected.map_or(usual, |expected| expected.samples_per_period(name));
        let found = Obstacle { blocks: limit.blocks, ..of(limit.kind, &words, remedy(limit, a, needed)) };
        Some(beginning(found, self.limited.map(|since| since.start_ns)))
    }
}

impl Loops {
    /// When a loop fell silent during an earlier run.
    fn silent_since(&self, name: &str) -> Option<i64> {
        self.earlier.get(name).filter(|since| since.kind == ObstacleKind::Silent).map(|since| since.start_ns)
    }

    /// The obstacle of a configured loop without an entry.
    fn missing(&self, name: &str, awaited: &Awaited, expected: &Expected, now: Instant) -> Found {
        let (area, remedy) = (expected.area(name), remedy_of_silence(Some(expected.keys(name))));
        let (kind, words) = match (awaited.is_silent(now), awaited.has_left) {
            (true, true) => (ObstacleKind::Silent, "no new data"),
            (true, false) => (ObstacleKind::Silent, "no value has come"),
            (false, _) => (ObstacleKind::Waiting, "no value has come yet"),
        };
        let found = Obstacle { appeared: false, ..obstacle(name, area, kind, words.to_owned(), remedy) };
        let since_ns = self.silent_since(name).filter(|_| !awaited.has_left).unwrap_or(awaited.since_ns);
        beginning(found, (kind == ObstacleKind::Silent).then_some(since_ns))
    }
}

impl Overview {
    /// The obstacles of all loops.
    #[must_use]
    pub fn obstacles(&self, now: Instant) -> Obstacles {
        self.survey(now).found
    }

    /// The same, with the data that a restart needs.
    #[must_use]
    pub fn survey(&self, now: Instant) -> Survey {
        let loops = self.0.read().unwrap_or_else(PoisonError::into_inner);
        let appeared = loops.by_name.iter().filter_map(|(name, entry)| entry.obstacle(name, &loops));
        let mut found: Vec<Found> = appeared.collect();
        let mut count = loops.by_name.len();
        if let Some(expected) = &loops.expected {
            let missing = expected.loops().filter(|(name, _)| !loops.by_name.contains_key(*name));
            let before = found.len();
            found.extend(missing.map(|(name, awaited)| loops.missing(name, awaited, expected, now)));
            count += found.len() - before;
        }
        let trend = loops.shares.iter().copied().collect();
        drop(loops);
        found.sort_by(|(a, _), (b, _)| (a.kind, &a.loop_name).cmp(&(b.kind, &b.loop_name)));
        let since = found.iter().filter_map(|(obstacle, start_ns)| {
            Some((obstacle.loop_name.clone(), Since { kind: obstacle.kind, start_ns: (*start_ns)? }))
        });
        let since = since.collect();
        let obstacles: Vec<Obstacle> = found.into_iter().map(|(obstacle, _)| obstacle).collect();
        let judged = count - obstacles.iter().filter(|obstacle| obstacle.blocks).count();
        let share = (count > 0).then(|| judged as f64 / count as f64);
        Survey { found: Obstacles { loops: count, judged, share, obstacles, trend }, since }
    }
}
