//! Groups of loops that share one oscillation. Passes windows to the comparer, and its answers to the bus, the recording and
//! the loops' alarms.

use std::collections::BTreeSet;
use std::sync::Arc;

use super::{EngineThread, to_json};
use crate::daemon::plant::{Compared, Comparer};
use crate::daemon::sink::recorder::Item;
use crate::daemon::sink::zenoh::Publication;
use stiction::plantwide::GroupDocument;
use stiction_engine::codec::topic::{self, Kind, PLANT};
use stiction_engine::engine::{Comparison, GroupStanding, LoopId, LoopWindow, PlantWatch, RecordedInput};

/// The newest windows, and the thread that compares them.
pub(super) struct Plant {
    pub(super) watch: PlantWatch,
    /// The loop whose window came last.
    last: Option<LoopId>,
    comparer: Comparer,
    is_comparing: bool,
    /// The newest comparison that came due while one was running.
    next: Option<Comparison>,
    /// Keys of the published groups.
    shown: BTreeSet<String>,
    /// Loops that carry a group's answer.
    members: BTreeSet<Arc<str>>,
}

impl Plant {
    pub(super) fn new(comparer: Comparer) -> Self {
        let (watch, shown, members) = (PlantWatch::default(), BTreeSet::new(), BTreeSet::new());
        Self { watch, last: None, comparer, is_comparing: false, next: None, shown, members }
    }

    pub(super) const fn answers(&self) -> &crossbeam_channel::Receiver<Compared> {
        &self.comparer.answers
    }

    pub(super) fn forget(&mut self, name: &str) {
        self.watch.forget(name);
        self.members.remove(name);
    }

    /// Starts the comparison that waits, unless one is running.
    fn start_next(&mut self) {
        if !self.is_comparing
            && let Some(next) = self.next.take()
        {
            self.is_comparing = self.comparer.requests.try_send(next).is_ok();
        }
    }
}

impl EngineThread {
    pub(super) fn watch_window(&mut self, id: LoopId, window: LoopWindow) {
        if let Some(plant) = &mut self.loops.plant {
            plant.watch.keep(self.loops.engine.name(id), window);
            plant.last = Some(id);
        }
    }

    /// Requests a comparison if one is due; it starts when the previous one is finished.
    pub(super) fn compare_when_due(&mut self) {
        let Some(plant) = &mut self.loops.plant else { return };
        let Some(due) = plant.watch.due() else { return };
        // A comparison is recorded as a whole in the file of one of its loops.
        let Some(id) = due.loops().find_map(|name| self.loops.engine.find(name)).or(plant.last) else { return };
        let input = RecordedInput::Comparing { windows: due.digest() };
        self.metrics.comparisons_due.inc();
        if plant.next.replace(due).is_some() {
            self.metrics.comparisons_left_out.inc();
        }
        plant.start_next();
        self.record_of_plant(id, PLANT, Kind::Input, &input, 0);
    }

    /// Takes the groups of a finished comparison: records and publishes them, and informs each loop.
    pub(super) fn compared(&mut self, compared: Compared) {
        let Compared { comparison, groups, misplaced, took } = compared;
        self.metrics.comparison.0.observe(took.as_secs_f64());
        let failed = groups.is_none();
        let groups = groups.unwrap_or_else(|| {
            tracing::error!(loops = comparison.loops().len(), "the comparison of loops failed: no groups are known");
            Vec::new()
        });
        self.metrics.groups.set(groups.len() as i64);
        let id = comparison.loops().find_map(|name| self.loops.engine.find(name));
        if let Some(id) = id {
            self.metrics.comparisons.inc();
            let at_ns = groups.iter().map(|group| group.window.end_ns).max().unwrap_or(0);
            let input = RecordedInput::Compared { windows: comparison.digest(), failed };
            self.record_of_plant(id, PLANT, Kind::Input, &input, at_ns);
        }
        self.publish_groups(id, &groups);
        self.give_standings(&groups);
        if let Some(overview) = &self.outputs.overview {
            overview.show_misplaced(misplaced);
            overview.show_groups(self.clock.now(), groups.into_iter().map(Arc::new).collect());
        }
        if let Some(plant) = &mut self.loops.plant {
            plant.is_comparing = false;
            plant.start_next();
        }
    }

    fn publish_groups(&mut self, id: Option<LoopId>, groups: &[GroupDocument]) {
        let mut shown = BTreeSet::new();
        for group in groups {
            let (name, at_ns) = (format!("{PLANT}/{}", group.key()), group.window.end_ns);
            if let Some(id) = id {
                self.record_of_plant(id, &name, Kind::Group, group, at_ns);
            }
            let key = topic::result(&self.config.site.prefix, &name, Kind::Group);
            if let Some(json) = to_json(group) {
                self.outputs.publisher.publish(Publication {
                    key: key.clone(),
                    kind: Kind::Group,
                    document: Some(json),
                });
            }
            self.metrics.group_documents.inc();
            shown.insert(key);
        }
        let Some(plant) = &mut self.loops.plant else { return };
        for key in std::mem::replace(&mut plant.shown, shown.clone()).difference(&shown) {
            self.outputs.publisher.publish(Publication { key: key.clone(), kind: Kind::Group, document: None });
        }
    }

    /// Gives the members their groups' answers, and withdraws them from loops that are no longer members.
    fn give_standings(&mut self, groups: &[GroupDocument]) {
        let engine = &self.loops.engine;
        let standings = groups.iter().flat_map(|group| GroupStanding::of_members(group, |name| engine.alarms(name)));
        let given: Vec<(LoopId, GroupStanding)> =
            standings.filter_map(|s| Some((engine.find(&s.judgement.loop_name)?, s))).collect();
        let members: BTreeSet<Arc<str>> = given.iter().map(|(id, _)| engine.name(*id).clone()).collect();
        let before = self.loops.plant.as_mut().map(|plant| std::mem::replace(&mut plant.members, members.clone()));
        for (id, standing) in given {
            self.give_standing(id, Some(standing));
        }
        for name in before.unwrap_or_default().difference(&members) {
            if let Some(id) = self.loops.engine.find(name) {
                self.give_standing(id, None);
            }
        }
    }

    fn give_standing(&mut self, id: LoopId, standing: Option<GroupStanding>) {
        let at_ns = self.loops.engine.figures(id).greatest_ns.unwrap_or(0);
        self.record(id, Kind::Input, &RecordedInput::Group { standing: standing.clone().map(Box::new) }, at_ns);
        self.metrics.group_answers.inc();
        self.loops.engine.stand(id, standing);
    }

    /// Records a document about many loops in the file of one of them.
    fn record_of_plant(&mut self, id: LoopId, name: &str, kind: Kind, document: &impl serde::Serialize, event_ns: i64) {
        let (Some(recorder), Some(json)) = (&mut self.outputs.recorder, to_json(document)) else { return };
        recorder.record(Item::Document { id, name: name.into(), kind, json, event_ns });
    }
}
