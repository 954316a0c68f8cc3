//! Loops that may need work: their alarm is active or their newest window finds stiction.

use std::sync::{Arc, PoisonError};

use stiction::core::verdict::EstimateDocument;
use stiction_engine::alarm::{AlarmDocument, LoopContext};

use super::{Entry, Overview, trend};

/// A loop that may need work.
#[derive(Debug, Clone, Default)]
pub struct Candidate {
    /// The loop's name.
    pub name: String,
    /// Area, equipment and criticality, as configured.
    pub place: LoopContext,
    /// Its newest estimate.
    pub estimate: Option<Arc<EstimateDocument>>,
    /// Its alarm.
    pub alarm: Option<Arc<AlarmDocument>>,
    /// The driver of the oscillation if the loop follows its group.
    pub driven: Option<String>,
    /// Whether newer samples are missing.
    pub silent: bool,
    /// Trend of s over its newest windows: `rising`, `falling`, `steady`; `None` if too few windows found any.
    pub s_trend: Option<&'static str>,
}

impl Candidate {
    fn of(name: &str, entry: &Entry) -> Option<Self> {
        let active = entry.alarm.as_deref().is_some_and(|alarm| alarm.active);
        let found = entry.estimate.as_deref().is_some_and(|e| e.assessment.stiction == Some(true));
        (active || found).then(|| Self {
            name: name.to_owned(),
            place: entry.place.clone(),
            estimate: entry.estimate.clone(),
            alarm: entry.alarm.clone(),
            driven: entry.driven.clone(),
            silent: entry.silent,
            s_trend: trend(&entry.recent),
        })
    }
}

impl Overview {
    /// Loops whose alarm is active or whose newest window finds stiction, by name.
    #[must_use]
    pub fn candidates(&self) -> Vec<Candidate> {
        let loops = self.0.read().unwrap_or_else(PoisonError::into_inner);
        loops.by_name.iter().filter_map(|(name, entry)| Candidate::of(name, entry)).collect()
    }
}
