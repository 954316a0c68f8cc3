//! Groups in a replay: the windows of all lanes in the order of the recording, compared where the recording says so.
//!
//! A file holds up to a thousand loops. Where loops of other files were compared with these, the groups cannot be made again
//! from this file: they are counted as not checked.

use std::collections::VecDeque;

use crate::daemon::replay::{Output, PlantEvent};
use crate::daemon::to_json;
use stiction::core::plantwide::GroupDocument;
use stiction_engine::codec::topic::{Kind, PLANT};
use stiction_engine::engine::{Comparison, PlantWatch, RecordedInput};

/// Comparisons whose answer has not come, at most: a live daemon has one on its way.
const MOST_PENDING: usize = 16;

/// The loops of a replay together.
#[derive(Default)]
pub(in crate::daemon) struct ReplayPlant {
    watch: PlantWatch,
    daemon: Option<String>,
    pending: VecDeque<(String, Comparison)>,
    /// Whether the groups of the last comparison in the recording could be made again.
    is_made: bool,
}

impl ReplayPlant {
    /// A replay of the daemon of this id.
    pub(in crate::daemon) fn new(daemon: Option<&str>) -> Self {
        Self { daemon: daemon.map(str::to_owned), ..Self::default() }
    }

    /// Takes what a lane made.
    pub(in crate::daemon) fn take(&mut self, event: PlantEvent) {
        match event {
            PlantEvent::Window(name, window) => self.watch.keep(&name, *window),
            PlantEvent::Left(name) => self.watch.forget(&name),
        }
    }

    /// Does what the daemon did with all loops there; gives the groups that it found.
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

    /// Finds the groups of a comparison; none where it failed in the daemon.
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

    /// Whether recorded groups can be compared with groups that were made again.
    pub(in crate::daemon) const fn is_made(&self) -> bool {
        self.is_made
    }
}
