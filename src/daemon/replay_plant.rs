//! Groups in a replay: the windows of all lanes in the order of the recording, compared where the recording says so.
//!
//! A file holds up to a thousand loops. Where other files hold loops that were compared with these, the groups cannot be
//! made again from this file: they are counted as not checked.

use super::replay::{Output, PlantEvent};
use super::to_json;
use stiction_monitor::codec::topic::{Kind, PLANT};
use stiction_monitor::engine::{Comparison, PlantWatch};

/// Comparisons that wait for their place, at most: a live daemon has one on its way.
const MOST_PENDING: usize = 1000;

/// The loops of a replay together.
#[derive(Default)]
pub(super) struct ReplayPlant {
    watch: PlantWatch,
    daemon: Option<String>,
    /// Comparisons that came due and whose place has not come.
    pending: Vec<Comparison>,
    /// Whether the groups of the comparison that stands last in the recording could be made again.
    is_made: bool,
}

impl ReplayPlant {
    /// A replay of the daemon of this id.
    pub(super) fn new(daemon: Option<&str>) -> Self {
        Self { daemon: daemon.map(str::to_owned), ..Self::default() }
    }

    /// Takes what a lane made.
    pub(super) fn take(&mut self, event: PlantEvent) {
        match event {
            PlantEvent::Window(name, window) => self.pending.extend(self.watch.take(&name, *window)),
            PlantEvent::Left(name) => self.watch.forget(&name),
        }
        if self.pending.len() > MOST_PENDING {
            self.pending.remove(0);
        }
    }

    /// Does the comparison of these windows, whose place is here.
    pub(super) fn compare(&mut self, windows: &str) -> Vec<Output> {
        let found = self.pending.iter().position(|comparison| comparison.digest() == windows);
        self.is_made = found.is_some();
        let Some(comparison) = found.and_then(|at| self.pending.drain(..=at).next_back()) else { return Vec::new() };
        let groups = comparison.compute(self.daemon.as_deref());
        let output = |group: &stiction::plantwide::GroupDocument| {
            Some(Output { loop_name: format!("{PLANT}/{}", group.key()), kind: Kind::Group, json: to_json(group)? })
        };
        groups.iter().filter_map(output).collect()
    }

    /// Whether recorded groups can be compared with groups that were made again.
    pub(super) const fn is_made(&self) -> bool {
        self.is_made
    }
}
