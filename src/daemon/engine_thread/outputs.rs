//! Passes on what the engine produces: to workers, recorder, publisher, receivers and page.

use std::sync::Arc;

use super::{EngineThread, to_json};
use crate::daemon::sink::deliver::Item as Outgoing;
use crate::daemon::sink::recorder::{Item, LOOPS_PER_FILE};
use crate::daemon::sink::zenoh::Publication;
use crate::runtime::metrics::Label;
use stiction_engine::alarm::AlarmDocument;
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::engine::{Event, LoopId, StateDocument};

impl EngineThread {
    pub(super) fn handle_events(&mut self) {
        while !self.loops.events.is_empty() {
            for event in std::mem::take(&mut self.loops.events) {
                match event {
                    Event::Request(request) => self.schedule_window(*request),
                    Event::GapRequest(request) => self.request_gap(*request),
                    Event::Gap(id, document) => {
                        self.metrics.gaps.inc();
                        if let Some(overview) = &self.outputs.overview {
                            let (name, place) = (self.loops.engine.name(id), &self.loops.engine.settings(id).place);
                            overview.cause(name, place, self.clock.now(), &document.document.cause.id);
                        }
                        self.record(id, Kind::Gap, &document, document.end_ns());
                        self.publish_result(id, Kind::Gap, document.end_ns(), &document);
                    }
                    Event::Window(id, window) => self.watch_window(id, *window),
                    Event::Estimate(id, document) => {
                        self.metrics.estimates.inc();
                        let a = &document.assessment;
                        self.metrics.verdicts.get_or_create(&Label { name: a.verdict.name().into() }).inc();
                        for gate in &a.gates {
                            self.metrics.gates.get_or_create(&Label { name: gate.name().into() }).inc();
                        }
                        if let Some(board) = &mut self.outputs.board {
                            let (name, place) = (self.loops.engine.name(id), &self.loops.engine.settings(id).place);
                            board.estimate(&self.metrics.series, name, place, a);
                        }
                        self.record(id, Kind::Estimate, &document, a.window.end_ns);
                        self.publish_result(id, Kind::Estimate, a.window.end_ns, &document);
                        if let Some(overview) = &self.outputs.overview {
                            let (name, place) = (self.loops.engine.name(id), &self.loops.engine.settings(id).place);
                            overview.estimate(name, place, self.clock.now(), Arc::from(document));
                        }
                    }
                    Event::Alarm(id, document) => self.alarm_changed(id, &document),
                    Event::State(id, document) => {
                        let at_ns = document.window_end_ns.unwrap_or(0);
                        self.record(id, Kind::State, &document, at_ns);
                        self.keep(&document);
                    }
                }
            }
        }
        self.compare_when_due();
    }

    pub(super) fn alarm_changed(&mut self, id: LoopId, document: &AlarmDocument) {
        self.metrics.alarms.inc();
        if document.active {
            tracing::warn!(target: "stiction_engine::alarm", "{}", document.line());
        } else {
            tracing::info!(target: "stiction_engine::alarm", "{}", document.line());
        }
        self.show_alarm(document);
        self.record(id, Kind::Alarm, document, document.changed_ns);
        let Some(json) = to_json(document) else { return };
        if let Some(outbox) = self.outputs.outbox.as_ref().filter(|outbox| outbox.wants(Kind::Alarm)) {
            outbox.offer(Outgoing::alarm(&self.config.site.prefix, document, &json));
        }
        self.publish_json(&document.loop_name, Kind::Alarm, json);
    }

    pub(super) fn show_alarm(&mut self, document: &AlarmDocument) {
        let name: Arc<str> = document.loop_name.as_str().into();
        let there = self.loops.engine.find(&name).map(|id| self.loops.engine.settings(id));
        let place = &there.unwrap_or_else(|| self.loops.engine.engine_settings().of(&name)).place;
        if let Some(overview) = &self.outputs.overview {
            overview.alarm(&name, place, self.clock.now(), document);
        }
        let Some(board) = &mut self.outputs.board else { return };
        board.alarm(&self.metrics.series, &name, place, document);
    }

    /// Publishes the result of a window, also to receivers outside the bus.
    pub(super) fn publish_result(&self, id: LoopId, kind: Kind, end_ns: i64, document: &impl serde::Serialize) {
        let Some(json) = to_json(document) else { return };
        if let Some(outbox) = self.outputs.outbox.as_ref().filter(|outbox| outbox.wants(kind)) {
            outbox.offer(Outgoing::result(&self.config.site.prefix, self.loops.engine.name(id), kind, end_ns, &json));
        }
        self.publish_json(self.loops.engine.name(id), kind, json);
    }

    pub(super) fn record(&mut self, id: LoopId, kind: Kind, document: &impl serde::Serialize, event_ns: i64) {
        let (Some(recorder), Some(json)) = (&mut self.outputs.recorder, to_json(document)) else { return };
        let name = self.loops.engine.name(id).clone();
        recorder.record(Item::Document { id, name, kind, json, event_ns });
    }

    pub(super) fn publish(&self, name: &str, kind: Kind, document: &impl serde::Serialize) {
        if let Some(json) = to_json(document) {
            self.publish_json(name, kind, json);
        }
    }

    pub(super) fn publish_json(&self, name: &str, kind: Kind, json: Vec<u8>) {
        let key = topic::result(&self.config.site.prefix, name, kind);
        self.outputs.publisher.publish(Publication { key, kind, document: Some(json) });
    }

    /// Stores a loop's state for the next start.
    pub(super) fn keep(&self, state: &StateDocument) {
        if let (Some(state_writer), Some(json)) = (&self.outputs.state_writer, to_json(state)) {
            state_writer.keep(&state.loop_name, json);
        }
    }

    /// Starts a new file for each segment that has loops.
    pub(super) fn reopen_segments(&mut self) {
        self.loops.registered.segments.clone().into_iter().for_each(|segment| self.open_segment(segment));
    }

    /// Starts a new file for a segment, unless all of its loops have left.
    pub(super) fn open_segment(&mut self, segment: usize) {
        let Some(recorder) =
            self.outputs.recorder.as_mut().filter(|_| self.loops.registered.segments.contains(&segment))
        else {
            return;
        };
        let (from, to) = (segment * LOOPS_PER_FILE, (segment + 1) * LOOPS_PER_FILE);
        let states = self.loops.engine.ids_in(from, to).filter_map(|id| {
            let name = self.loops.engine.name(id);
            Some((name.clone(), to_json(&StateDocument::new(name, None, self.loops.engine.checkpoint(id)))?))
        });
        let states = states.collect();
        recorder.record(Item::Open { segment, states });
    }
}
