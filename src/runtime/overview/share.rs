//! The fraction of loops that can be judged over time, and what is stored of it for a restart.

use std::collections::BTreeMap;
use std::sync::PoisonError;

use serde::{Deserialize, Serialize};

use super::obstacles::Since;
use super::{Obstacles, Overview, Survey};
use stiction::core::units::ms_from_ns;

/// Points kept: hourly for a month.
const POINTS: usize = 24 * 31;
/// Most obstacles whose beginning is stored for a restart.
const KEPT: usize = 10_000;

/// The fraction at one time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct SharePoint {
    /// Time, ms since 1970.
    pub t_ms: f64,
    /// Loops that can be judged.
    pub judged: usize,
    /// Total number of loops.
    pub loops: usize,
    /// `judged` over `loops`.
    pub share: f64,
}

/// The data stored for a restart.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct KeptHealth {
    /// The fraction over time, oldest first.
    shares: Vec<SharePoint>,
    /// When each loop's obstacle began.
    since: BTreeMap<String, Since>,
    /// Number of the last summary that was sent.
    pub sent: Option<i64>,
}

impl Overview {
    /// Continues from what an earlier run kept.
    pub fn take_over(&self, kept: KeptHealth) {
        let mut loops = self.0.write().unwrap_or_else(PoisonError::into_inner);
        loops.shares = kept.shares.into();
        loops.earlier = kept.since;
    }

    /// The data to store for a restart.
    #[must_use]
    pub fn kept(&self, survey: &Survey, sent: Option<i64>) -> KeptHealth {
        let loops = self.0.read().unwrap_or_else(PoisonError::into_inner);
        // For a loop without a window so far, the obstacle of an earlier run may still apply.
        let is_known = |name: &str| {
            loops.by_name.contains_key(name) || loops.expected.as_ref().is_some_and(|e| e.awaited(name).is_some())
        };
        let earlier =
            loops.earlier.iter().filter(|(name, _)| is_known(name)).map(|(name, since)| (name.clone(), *since));
        let mut since: BTreeMap<String, Since> = earlier.collect();
        since.extend(survey.since.iter().cloned());
        let since = since.into_iter().take(KEPT).collect();
        KeptHealth { shares: loops.shares.iter().copied().collect(), since, sent }
    }

    /// Adds the current fraction to the trend.
    pub fn add_share(&self, found: &Obstacles, now_ns: i64) {
        let Some(share) = found.share else { return };
        let point = SharePoint { t_ms: ms_from_ns(now_ns), judged: found.judged, loops: found.loops, share };
        let mut loops = self.0.write().unwrap_or_else(PoisonError::into_inner);
        if loops.shares.len() == POINTS {
            loops.shares.pop_front();
        }
        loops.shares.push_back(point);
    }
}
