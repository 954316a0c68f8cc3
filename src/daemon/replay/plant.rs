//! Groups in a replay: takes the windows of all lanes in recorded order, and compares them where the recording says so.
//!
//! A file holds up to a thousand loops. If loops of other files took part in a comparison, its groups cannot be computed from
//! this file: they are counted as unchecked.

use std::collections::VecDeque;

use crate::daemon::replay::{Output, PlantEvent};
use crate::daemon::to_json;
use stiction::plantwide::GroupDocument;
use stiction_engine::codec::topic::{Kind, PLANT};
use stiction_engine::engine::{Comparison, PlantWatch, RecordedInput};

/// Most unanswered comparisons that are kept: a live daemon has one under way.
const MOST_PENDING: usize = 16;

/// All loops of a replay, for comparison.
#[derive(Default)]
pub(in crate::daemon) struct ReplayPlant {
    watch: PlantWatch,
    daemon: Option<String>,
    pending: VecDeque<(String, Comparison)>,
    /// Whether the groups of the last recorded comparison could be computed.
    is_made: bool,
}

impl ReplayPlant {
    /// A replay for the daemon of this id.
    pub(in crate::daemon) fn new(daemon: Option<&str>) -> Self {
        Self { daemon: daemon.map(str::to_owned), ..Self::default() }
    }

    /// Takes an event from a lane.
    pub(in crate::daemon) fn take(&mut self, event: PlantEvent) {
        match event {
            PlantEvent::Window(name, window) => self.watch.keep(&name, *window),
            PlantEvent::Left(name) => self.watch.forget(&name),
        }
    }

    /// Repeats what the daemon did with all loops at this point; returns the groups found.
    pub(in crate::daemon) fn handle(&mut self, input: RecordedInput) -> Vec<Output> {
        match input {
            RecordedInput::Comparing { windows } => {
                let comparison = self.watch.compare();
                if comparison.digest() == windows {
                    self.pending.push_back((windows, comparison));
                }
                if self.pending.len() > MOST_PENDING {
                    self.pending.pop_front();
                }
                Vec::new()
            }
            RecordedInput::Compared { windows, failed } => self.compare(&windows, failed),
            _ => Vec::new(),
        }
    }

    /// The groups of a comparison; empty if the comparison failed in the daemon.
    fn compare(&mut self, windows: &str, failed: bool) -> Vec<Output> {
        let found = self.pending.iter().position(|(digest, _)| digest == windows);
        self.is_made = found.is_some();
        let Some((_, comparison)) = found.and_then(|at| self.pending.drain(..=at).next_back()) else {
            return Vec::new();
        };
        if failed {
            return Vec::new();
        }
        let output = |group: &GroupDocument| {
            Some(Output { loop_name: format!("{PLANT}/{}", group.key()), kind: Kind::Group, json: to_json(group)? })
        };
        comparison.compute(self.daemon.as_deref()).iter().filter_map(output).collect()
    }

    /// Whether recorded groups can be compared with computed ones.
    pub(in crate::daemon) const fn is_made(&self) -> bool {
        self.is_made
    }
}
