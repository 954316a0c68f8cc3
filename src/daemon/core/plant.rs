//! Groups of loops that share one oscillation: windows go to the comparer, its answers to the bus, the recording and the
//! loops' own alarms.

use std::collections::BTreeSet;
use std::sync::Arc;

use super::{Core, to_json};
use crate::daemon::plant::{Compared, Comparer};
use crate::sink::zenoh::Publication;
use stiction::plantwide::GroupDocument;
use stiction_monitor::codec::topic::{self, Kind, PLANT};
use stiction_monitor::engine::{Comparison, GroupStanding, LoopId, LoopWindow, PlantWatch, RecordedInput};

/// The newest windows, and who compares them.
pub(super) struct Plant {
    watch: PlantWatch,
    comparer: Comparer,
    /// Keys of the groups that are published.
    shown: BTreeSet<String>,
}

impl Plant {
    pub(super) fn new(comparer: Comparer) -> Self {
        Self { watch: PlantWatch::default(), comparer, shown: BTreeSet::new() }
    }

    pub(super) const fn answers(&self) -> &crossbeam_channel::Receiver<Compared> {
        &self.comparer.answers
    }

    pub(super) fn forget(&mut self, name: &str) {
        self.watch.forget(name);
    }
}

impl Core {
    /// Keeps a window, and hands a comparison that is due to the comparer.
    pub(super) fn watch_window(&mut self, id: LoopId, window: LoopWindow) {
        let Some(plant) = &mut self.plant else { return };
        let due = plant.watch.take(self.engine.name(id), window);
        if due.is_some_and(|comparison| plant.comparer.requests.try_send(comparison).is_err()) {
            self.metrics.comparisons_left_out.inc();
        }
    }

    /// Takes the groups that a comparison found: records and publishes them, and tells each loop.
    pub(super) fn compared(&mut self, compared: Compared) {
        let Compared { comparison, groups, took } = compared;
        self.metrics.comparison.0.observe(took.as_secs_f64());
        let Some(groups) = groups else {
            tracing::error!(loops = comparison.loops().len(), "the comparison of loops failed: no groups are known");
            return;
        };
        self.metrics.groups.set(groups.len() as i64);
        if let Some(first) = comparison.loops().find_map(|name| self.engine.find(name)) {
            self.metrics.comparisons.inc();
            let input = RecordedInput::Compared { windows: comparison.digest(), loops: comparison.loops().len() };
            let at_ns = groups.iter().map(|group| group.window.end_ns).max().unwrap_or(0);
            self.record_of_plant(first, PLANT, Kind::Input, &input, at_ns);
        }
        self.publish_groups(&groups);
        self.tell_members(&comparison, &groups);
        if let Some(overview) = &self.overview {
            overview.show_groups(self.clock.now(), groups.into_iter().map(Arc::new).collect());
        }
    }

    fn publish_groups(&mut self, groups: &[GroupDocument]) {
        let mut shown = BTreeSet::new();
        for group in groups {
            let (name, at_ns) = (format!("{PLANT}/{}", group.key()), group.window.end_ns);
            if let Some(id) = self.engine.find(group.key()) {
                self.record_of_plant(id, &name, Kind::Group, group, at_ns);
            }
            let key = topic::result(&self.config.site.prefix, &name, Kind::Group);
            if let Some(json) = to_json(group) {
                self.publisher.publish(Publication { key: key.clone(), kind: Kind::Group, document: Some(json) });
            }
            self.metrics.group_documents.inc();
            shown.insert(key);
        }
        let Some(plant) = &mut self.plant else { return };
        for key in std::mem::replace(&mut plant.shown, shown.clone()).difference(&shown) {
            self.publisher.publish(Publication { key: key.clone(), kind: Kind::Group, document: None });
        }
    }

    /// Tells the members what their groups say of them, and those that are in no group any more that nothing holds.
    fn tell_members(&mut self, comparison: &Comparison, groups: &[GroupDocument]) {
        let engine = &self.engine;
        let standings = groups.iter().flat_map(|group| GroupStanding::of_members(group, |name| engine.has_alarm(name)));
        let told: Vec<(LoopId, GroupStanding)> =
            standings.filter_map(|s| Some((engine.find(&s.judgement.loop_name)?, s))).collect();
        let members: BTreeSet<LoopId> = told.iter().map(|(id, _)| *id).collect();
        let left = comparison.loops().filter_map(|name| engine.find(name));
        let left: Vec<LoopId> = left.filter(|id| !members.contains(id) && engine.has_standing(*id)).collect();
        for (id, standing) in told {
            self.tell_member(id, Some(standing));
        }
        for id in left {
            self.tell_member(id, None);
        }
    }

    fn tell_member(&mut self, id: LoopId, standing: Option<GroupStanding>) {
        let at_ns = self.engine.figures(id).greatest_ns.unwrap_or(0);
        self.record(id, Kind::Input, &RecordedInput::Group { standing: standing.clone().map(Box::new) }, at_ns);
        self.metrics.group_answers.inc();
        self.engine.stand(id, standing);
    }

    /// Records a document of many loops in the file of one of them.
    fn record_of_plant(&mut self, id: LoopId, name: &str, kind: Kind, document: &impl serde::Serialize, event_ns: i64) {
        let (Some(recorder), Some(json)) = (&mut self.recorder, to_json(document)) else { return };
        recorder.record(crate::sink::recorder::Item::Document { id, name: name.into(), kind, json, event_ns });
    }
}
