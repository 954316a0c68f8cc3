//! Loops that a gap diagnosis may find acting on its loop: those upstream, members of its group, and those in its area.
//!
//! Their histories are cut to the time of the diagnosed record when the diagnosis is requested. In a replay their samples may
//! come in a different order, so the recording contains the samples that were used: single precision is enough, and the
//! diagnosis itself uses the recorded values.

use serde::{Deserialize, Serialize};

use super::{Engine, GapRequest};
use stiction::core::gap::Neighbour;

/// Most loops passed to a diagnosis.
pub const MOST: usize = 8;

/// Another loop on the grid of a diagnosed record, as recorded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecordedNeighbour {
    /// Its name.
    pub name: String,
    /// Its PV at each point.
    pub pv: Vec<f32>,
    /// Its OP at each point.
    pub op: Vec<f32>,
}

impl RecordedNeighbour {
    fn of(neighbour: &Neighbour) -> Self {
        let single = |x: &[f64]| x.iter().map(|v| *v as f32).collect();
        Self { name: neighbour.name.clone(), pv: single(&neighbour.pv), op: single(&neighbour.op) }
    }

    /// In the form that a diagnosis takes.
    #[must_use]
    pub fn neighbour(&self) -> Neighbour {
        let double = |x: &[f32]| x.iter().map(|v| f64::from(*v)).collect();
        Neighbour { name: self.name.clone(), pv: double(&self.pv), op: double(&self.op) }
    }
}

impl Engine {
    /// The loops that may act on a request's loop and were recorded during its window; at most [`MOST`].
    #[must_use]
    pub fn neighbours_of(&self, request: &GapRequest) -> Vec<RecordedNeighbour> {
        let mut names: Vec<&str> = Vec::new();
        for name in self.candidates(request) {
            if *name != *request.loop_name && !names.contains(&name) {
                names.push(name);
            }
        }
        names.into_iter().filter_map(|name| self.on_grid(name, request)).take(MOST).collect()
    }

    /// Those upstream first, then the group with its source first, then the area by name.
    fn candidates<'a>(&'a self, request: &GapRequest) -> impl Iterator<Item = &'a str> {
        let own = self.of(request.id);
        let place = &own.settings.place;
        let group = own.group.iter().flat_map(|standing| standing.others.iter());
        let mut area: Vec<&str> = Vec::new();
        if place.area.is_some() {
            let there = self.loops.iter().flatten().filter(|other| other.settings.place.area == place.area);
            area.extend(there.map(|other| &*other.name));
            area.sort_unstable();
        }
        place.upstream.iter().chain(group).map(String::as_str).chain(area)
    }

    /// A loop on the grid of a request's record; `None` if it was not recorded throughout, or does not move.
    fn on_grid(&self, name: &str, request: &GapRequest) -> Option<RecordedNeighbour> {
        let snapshot = self.snapshot(self.find(name)?, Some(request.record.end_ns))?;
        let other = snapshot.since(request.record.start_ns)?;
        let recorded = RecordedNeighbour::of(&Neighbour::of(name, &other, &request.record).ok()?);
        recorded.neighbour().check(request.record.len()).is_ok().then_some(recorded)
    }
}
