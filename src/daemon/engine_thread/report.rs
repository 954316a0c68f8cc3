//! Health documents, faults and losses of the daemon.

use std::sync::Arc;
use std::time::Duration;

use prometheus_client::metrics::counter::Counter;

use super::super::gaps;
use super::super::schedule::{LIMIT, LIMIT_BYTES};
use super::{EngineThread, to_json};
use crate::daemon::sink::deliver::Outbox;
use crate::daemon::sink::recorder::{self, Recorder};
use crate::daemon::sink::state_writer::StateWriter;
use crate::daemon::sink::zenoh::{self as bus, Publication};
use crate::runtime::health::{DaemonHealth, QueueHealth};
use crate::runtime::metrics::Label;
use crate::runtime::queue::Budget;
use stiction::core::units::s_from_ns;
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::engine::StateDocument;

/// Number of reports over which the loops' health documents are spread: each loop's comes once a minute.
const LOOP_HEALTH_SLICES: usize = 12;
/// How long a loss remains among the faults after the last one.
const LOSS_SHOWN: Duration = Duration::from_secs(60);
/// Name of the fault while the recording disk hangs or is too slow.
const STALL: &str = "recording stalls";
/// Name of the fault while the disk hangs and documents go to receivers without being stored first.
const UNSTORED: &str = "delivery unstored";
/// Name of the recording among the stopped parts in the health document.
const RECORDING: &str = "recording";

impl EngineThread {
    /// Publishes the daemon's health and, if there are few loops, a share of the loops' health.
    pub fn report(&mut self, input_waiting: usize) {
        let loops = self.loops.engine.count();
        self.metrics.loops.set(loops as i64);
        self.report_losses();
        self.keep_all_again();
        self.watch_stores();
        self.sweep_some(LOOP_HEALTH_SLICES);
        let stopped = self.stopped();
        let health = self.health(loops, input_waiting, stopped);
        for queue in &health.queues {
            self.metrics.queues.get_or_create(&Label { name: queue.name.into() }).set(queue.length as i64);
        }
        let key = topic::plane(&self.config.site.prefix, &format!("@daemon/{}/health", self.daemon_id));
        if let Some(json) = to_json(&health) {
            self.outputs.publisher.publish(Publication { key, kind: Kind::Health, document: Some(json) });
        }
        if let Ok(mut snapshot) = self.outputs.snapshot.write() {
            *snapshot = (self.clock.now(), Arc::new(health));
        }
    }

    /// Raises a fault for losses since the last report; it clears some time after the last loss.
    fn report_losses(&mut self) {
        let m = &self.metrics;
        let now = [
            &m.dropped_input,
            &m.dropped_output,
            &m.recording_lost,
            &m.fits_skipped,
            &m.loops_over_limit,
            &m.over_rate,
            &m.stamps_ahead,
            &m.delivery_dropped,
            &m.birth_names_lost,
        ]
        .map(Counter::get);
        let ahead = self.inputs.ahead.map_or_else(String::new, |(id, by_ns)| {
            let (name, days) = (self.loops.engine.name(id), s_from_ns(by_ns) / 86_400.0);
            format!("; the last of {}, {days:.0} days ahead of this clock", name.escape_debug())
        });
        let stamps = format!("samples were refused whose stamps are beyond [input] max_ahead_s{ahead}");
        let what = [
            ("dropped input", "messages were dropped because they came faster than they can be taken"),
            ("dropped output", "documents could not be published: see the bus"),
            ("recording lost", "messages could not be recorded: see the recording disk"),
            ("fits skipped", "windows got no fit because the machine was too busy or a fit failed"),
            ("loops over limit", "messages of new loops were refused: beyond [input] max_loops or new_loops_per_hour"),
            ("over rate", "samples were refused because their key sends more than [input] max_rate_hz"),
            ("stamps ahead", stamps.as_str()),
            ("delivery dropped", "documents were given up: too many waited for a receiver outside the bus"),
            (
                "birth names",
                "names of Sparkplug B births were not kept: too many nodes, or too many or too long names of one",
            ),
        ];
        for ((key, text), (now, before)) in what.into_iter().zip(now.into_iter().zip(self.outputs.losses)) {
            if now > before {
                self.faults.raise_for(key, format!("{now} {text}"), LOSS_SHOWN);
            }
        }
        self.outputs.losses = now;
    }

    /// Raises a fault if a store does not respond. Neither documents nor replies wait for it.
    fn watch_stores(&self) {
        match self.outputs.outbox.as_ref().and_then(Outbox::stall) {
            Some(why) => self.faults.raise(UNSTORED, why),
            None => self.faults.clear(UNSTORED),
        }
        if let Some(state_writer) = &self.outputs.state_writer {
            state_writer.reply_late(self.clock.now());
        }
    }

    /// If the store was replaced while the daemon runs, writes every loop's memory to the new one.
    fn keep_all_again(&self) {
        if !self.outputs.state_writer.as_ref().is_some_and(StateWriter::wants_all) {
            return;
        }
        for id in self.loops.engine.ids() {
            let name = self.loops.engine.name(id);
            self.keep(&StateDocument::new(name, None, self.memory(id)));
        }
        for (name, memory) in self.loops.engine.left() {
            self.keep(&StateDocument { left: true, ..StateDocument::new(name, None, memory.clone()) });
        }
    }

    /// The parts that have stopped; if there are any, `/healthz` answers 503.
    fn stopped(&mut self) -> Vec<&'static str> {
        let Some(recorder) = &mut self.outputs.recorder else { return Vec::new() };
        let stall = recorder.stall();
        let has_stopped = stall.is_some() || recorder.progress().has_stopped();
        match stall {
            Some(why) => self.faults.raise(STALL, why),
            None => self.faults.clear(STALL),
        }
        if has_stopped { vec![RECORDING] } else { Vec::new() }
    }

    fn health(&self, loops: usize, input_waiting: usize, stopped: Vec<&'static str>) -> DaemonHealth {
        let m = &self.metrics;
        let recorder_waiting = self.outputs.recorder.as_ref().map_or(0, Recorder::waiting);
        let queue = |name, [length, limit]: [usize; 2], [bytes, limit_bytes]: [usize; 2], dropped| QueueHealth {
            name,
            length,
            limit,
            bytes,
            limit_bytes,
            dropped,
        };
        let recorder_bytes = self.outputs.recorder.as_ref().map_or([0, 0], Recorder::bytes);
        let published = self.outputs.publisher.bytes();
        let of = |budget: &Budget| [budget.used(), budget.limit()];
        let fits = self.loops.schedule.waiting() + self.loops.workers.jobs.len();
        DaemonHealth {
            schema: topic::DAEMON_HEALTH_SCHEMA,
            daemon: self.daemon_id.clone(),
            version: stiction::core::VERSION,
            config_hash: self.loops.engine.config_hash().to_owned(),
            uptime_s: self.clock.since(self.started).as_secs_f64(),
            loops,
            counters: m.counters(),
            queues: vec![
                queue(
                    "input",
                    [input_waiting, self.inputs.input_limit],
                    of(&self.inputs.budget),
                    m.dropped_input.get(),
                ),
                queue("fits", [fits, LIMIT], [self.loops.schedule.bytes(), LIMIT_BYTES], m.fits_skipped.get()),
                queue("gaps", [self.loops.diagnoser.requests.len(), gaps::QUEUE], [0, 0], m.gaps_skipped.get()),
                queue("recorder", [recorder_waiting, recorder::QUEUE], recorder_bytes, m.recording_lost.get()),
                queue("publisher", [self.outputs.publisher.waiting(), bus::QUEUE], published, m.dropped_output.get()),
            ],
            stopped,
            faults: self.faults.list(),
        }
    }
}
