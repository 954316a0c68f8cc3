//! Plants of 8 to 60 loops of known truth: sticking valves that disturb their neighbours, external loads that disturb several
//! loops, and loops that oscillate independently at nearly the same period.
//!
//! The loops are those of [`crate::challenge`]: force-balance valves, processes with pipes, at sub-sample steps, so that they
//! match neither He's law nor the library's process model. Followers are connected through lag and dead time, in chains and
//! with recycle; every loop is archived at its own sampling time (1 to 60 s), some through a historian.

mod disturbed;
mod fleet;
mod generator;
mod network;

pub use disturbed::{Disturbed, Relation, disturbed, unrelated_loops};
pub use fleet::{FleetLoop, fleet};

use stiction::core::record::Record;
use stiction::core::units::ns_from_s;

/// Difficulty of a plant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Difficulty {
    /// 20 periods, lagged followers, sines as often as other loads.
    Easy,
    /// 6 to 20 periods, followers nearly without lag and with slow processes, little noise, loads mostly of squares and
    /// triangles, two loops of five through a historian.
    Hard,
}

impl Difficulty {
    /// Both difficulties.
    pub const ALL: [Self; 2] = [Self::Easy, Self::Hard];

    /// The name in random streams and tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Easy => "easy",
            Self::Hard => "hard",
        }
    }
}

/// Role of a loop in its plant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Role {
    /// Its sticking valve causes the group's oscillation.
    Source,
    /// The source of its group drives it.
    Follower,
    /// An external load drives it.
    Driven,
    /// It does not oscillate.
    Calm,
    /// Its valve sticks, and it drives no other loop.
    Sticking,
    /// Its controller is tuned too tight, and it drives no other loop.
    Tight,
}

impl Role {
    /// All roles.
    pub const ALL: [Self; 6] = [Self::Source, Self::Follower, Self::Driven, Self::Calm, Self::Sticking, Self::Tight];

    /// The name in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Source => "source",
            Self::Follower => "follower",
            Self::Driven => "driven from outside",
            Self::Calm => "calm",
            Self::Sticking => "sticking alone",
            Self::Tight => "tuned too tight",
        }
    }
}

/// A loop of a plant as archived, with its truth.
#[derive(Debug, Clone, PartialEq)]
pub struct CaseLoop {
    /// The loop's name.
    pub name: String,
    /// The loop's last window.
    pub record: Record,
    /// The loop's role.
    pub role: Role,
    /// Index of the oscillation that it shares with others.
    pub group: Option<usize>,
    /// Whether its valve sticks.
    pub sticks: bool,
}

/// A plant: the stream (such as a half's name), the seed and the difficulty determine every bit of it.
#[must_use]
pub fn plant(stream: &str, seed: u64, difficulty: Difficulty) -> Vec<CaseLoop> {
    generator::plant(stream, seed, difficulty)
}

/// The record with its time stretched by `by`, ending at `end_ns`.
pub(crate) fn stretched(record: &Record, by: f64, end_ns: i64) -> Record {
    let (ts_s, recorded_ts_s) = (record.ts_s * by, record.recorded_ts_s * by);
    let length = ns_from_s(ts_s * (record.raw_samples.saturating_sub(1)) as f64);
    Record { ts_s, recorded_ts_s, start_ns: end_ns - length, end_ns, ..record.clone() }
}
