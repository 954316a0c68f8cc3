//! Takes a message to the engine: finds its loop, decodes it, and checks whether it may pass.

use std::time::Duration;

use super::EngineThread;
use crate::daemon::feeds::Feed;
use crate::daemon::limits::Refused;
use crate::daemon::routes::Route;
use crate::daemon::senders::Doubt;
use crate::daemon::sink::recorder::Item;
use crate::daemon::source::Message;
use crate::runtime::metrics::Label;
use stiction::core::record::{Sample, Signal};
use stiction::core::units::s_from_ns;
use stiction::samples::align::Quality;
use stiction_engine::codec::{self, Bundle, CodecError, ConfiguredCodec};
use stiction_engine::engine::LoopId;

/// How long a change of sources, and two sources of one signal after the last value, remain among the faults.
const CHANGE_SHOWN: Duration = Duration::from_secs(3600);
const CONTEST_SHOWN: Duration = Duration::from_secs(60);
/// A stamp this close to the clock when read in another unit is assumed to be in that unit, ns.
const NEAR_NS: i128 = 30 * 86_400 * 1_000_000_000;
/// One message in this many is timed.
const TIMED: u64 = 8;

impl EngineThread {
    pub(super) fn take_message(&mut self, m: &Message) {
        self.time_intake(m);
        if let Some(codec) = self.inputs.bundles.codec_of(m.buf.key()) {
            return self.take_bundle(m, codec);
        }
        let now = self.clock.since(self.started);
        let route = self.inputs.routes.of(m.buf.key(), &mut self.loops.engine, || self.inputs.limits.new_loop(now));
        let Some((id, signal)) = self.admitted(route) else { return };
        self.register(id);
        let mut samples = std::mem::take(&mut self.inputs.samples);
        samples.clear();
        let fallback_ns = m.bus_ns.unwrap_or(m.arrival_ns);
        let (payload, encoding) = (m.buf.payload(), m.buf.encoding());
        match codec::decode(signal, payload, encoding, self.inputs.codec, fallback_ns, &mut samples) {
            Ok(name) => self.count_codec(name),
            Err(error) => self.count_undecodable(m, &error),
        }
        let feeds = samples.first().is_none_or(|first| {
            self.watch_respelled(id, signal, m.buf.key(), first.t_ns);
            self.is_fed_by(id, signal, m.buf.key(), first.t_ns)
        });
        if !feeds {
            self.metrics.second_source.inc_by(samples.len() as u64);
            samples.clear();
        }
        if let Some(first) = samples.first() {
            self.watch_unit(m, first.t_ns);
        }
        for sample in &samples {
            self.watch_senders(id, m, sample);
            self.take_sample(id, *sample, m.arrival_ns);
        }
        self.inputs.samples = samples;
    }

    fn take_sample(&mut self, id: LoopId, sample: Sample, arrival_ns: i64) {
        self.metrics.samples.inc();
        let now = self.clock.since(self.started);
        if !self.is_within_limits(id, &sample, arrival_ns, now) {
            return;
        }
        if sample.quality.is_some_and(|q| (1..=255).contains(&q)) && self.config.input.quality == Quality::Ua {
            self.metrics.suspicious_quality.inc();
            if !std::mem::replace(&mut self.inputs.warned_quality, true) {
                let name = self.loops.engine.name(id);
                tracing::warn!(%name, quality = ?sample.quality, "this looks like a classic OPC quality: set [input] quality = \"classic\"");
            }
        }
        if let Some(recorder) = &mut self.outputs.recorder {
            let name = self.loops.engine.name(id).clone();
            recorder.record(Item::Raw { id, name, sample, arrival_ns });
        }
        self.loops.registered.mark_heard(id, now);
        self.inputs.arrival_ns = arrival_ns;
        self.loops.engine.push(id, sample, &mut self.loops.events);
        self.handle_events();
    }

    fn is_within_limits(&mut self, id: LoopId, sample: &Sample, arrival_ns: i64, now: Duration) -> bool {
        let engine = &self.loops.engine;
        let greatest = || engine.ids().filter_map(|id| engine.figures(id).greatest_ns).collect();
        match self.inputs.limits.sample((id, sample, arrival_ns), now, greatest) {
            Ok(()) => return true,
            Err(Refused::OverRate) => self.metrics.over_rate.inc(),
            Err(Refused::Ahead) => {
                self.inputs.ahead = Some((id, sample.t_ns.saturating_sub(arrival_ns)));
                self.metrics.stamps_ahead.inc()
            }
        };
        false
    }

    /// Measures how long a message took to get here, for some messages only: clock and histogram cost more than the rest.
    fn time_intake(&mut self, m: &Message) {
        if self.inputs.taken.is_multiple_of(TIMED) {
            let waited_ns = self.clock.now_ns().saturating_sub(m.bus_ns.unwrap_or(m.arrival_ns));
            self.metrics.intake.0.observe(s_from_ns(waited_ns.max(0)));
        }
        self.inputs.taken += 1;
    }

    /// Takes a payload with several signals.
    fn take_bundle(&mut self, m: &Message, codec: ConfiguredCodec) {
        let fallback_t_ns = m.bus_ns.unwrap_or(m.arrival_ns);
        let bundle = Bundle { key: m.buf.key(), payload: m.buf.payload(), fallback_t_ns };
        let read = self.inputs.bundles.read(&bundle, m.buf.encoding(), codec);
        self.metrics.birth_names_lost.inc_by(self.inputs.bundles.take_names_lost());
        let (meant, name, left) = match read {
            Ok(read) => read,
            Err(error) => return self.count_undecodable(m, &error),
        };
        self.count_codec(name);
        self.metrics.unmapped_values.inc_by(left);
        if !meant.is_empty() && self.inputs.bundles.is_new_carrier(m.buf.key()) {
            self.inputs.routes.learn(m.buf.key());
        }
        let now = self.clock.since(self.started);
        for one in meant {
            let signal = one.sample.signal;
            let route = self
                .inputs
                .routes
                .to_loop(&one.loop_name, signal, &mut self.loops.engine, || self.inputs.limits.new_loop(now));
            let Some((id, signal)) = self.admitted(route) else { continue };
            if !self.is_fed_by(id, signal, &one.source, one.sample.t_ns) {
                self.metrics.second_source.inc();
                continue;
            }
            self.register(id);
            self.watch_senders(id, m, &one.sample);
            self.take_sample(id, one.sample, m.arrival_ns);
        }
    }

    /// Two keys that differ only in upper and lower case name the same signal, so they count as two sources of it.
    fn watch_respelled(&mut self, id: LoopId, signal: Signal, key: &str, t_ns: i64) {
        if !self.inputs.feeds.is_watched((id, signal))
            && let Some(first) = self.inputs.routes.respelled(key)
        {
            self.inputs.feeds.watch((id, signal), &first, self.inputs.taken, t_ns);
        }
    }

    /// Whether this source feeds the signal. Raises a fault if the source changes or if two sources send at once.
    fn is_fed_by(&mut self, id: LoopId, signal: Signal, source: &str, t_ns: i64) -> bool {
        let feed = self.inputs.feeds.feed((id, signal), source, self.inputs.taken, t_ns);
        let what = || format!("{} {}", self.loops.engine.name(id).escape_debug(), signal.name());
        match feed {
            Feed::Taken => {}
            Feed::Ignored => return false,
            Feed::TakenOver { from } => {
                let changes = self.metrics.source_changes.inc() + 1;
                let (what, from, to) = (what(), from.escape_debug(), source.escape_debug());
                let text = format!("{what}: {from} is silent, now taken from {to} ({changes} such changes so far)");
                self.faults.raise_for("source changed", text, CHANGE_SHOWN);
            }
            Feed::Contested { other } => {
                let (what, taken, other) = (what(), source.escape_debug(), other.escape_debug());
                let text = format!("{what} comes from two sources at once: {taken} is taken, {other} is ignored");
                self.faults.raise_for("two sources", text, CONTEST_SHOWN);
            }
        }
        true
    }

    /// Raises a fault if two sensors write to the same key.
    fn watch_senders(&mut self, id: LoopId, m: &Message, sample: &Sample) {
        let Some(doubt) = self.inputs.senders.hear(id, m.sender, sample) else { return };
        let shown = match doubt {
            Doubt::Senders => "by two publishers in turn".to_owned(),
            Doubt::Values => "with other values for times that came already (or times are too coarse)".to_owned(),
            Doubt::Clocks(ns) => format!("with times that jump back and forth by {:.3} s", s_from_ns(ns)),
        };
        let (key, signal) = (m.buf.key().escape_debug(), sample.signal.name());
        let text = format!("{key}: {signal} comes {shown}: two sensors on one key? Give each its own");
        self.faults.raise_for("two senders", text, CONTEST_SHOWN);
    }

    /// Loop and signal of a route; messages without a route are counted.
    fn admitted(&self, route: Route) -> Option<(LoopId, Signal)> {
        match route {
            Route::To(id, signal) if !self.loops.removed.contains(&id) => return Some((id, signal)),
            Route::Full => {
                self.metrics.refused_loops.inc();
                self.metrics.loops_over_limit.inc();
            }
            Route::Foreign => drop(self.metrics.foreign_keys.inc()),
            Route::Refused | Route::To(..) => drop(self.metrics.refused_loops.inc()),
            Route::Elsewhere => {}
        }
        None
    }

    fn count_codec(&mut self, name: &'static str) {
        // Kept ready, since looking a counter up by its label would allocate for every message.
        if let Some((_, counter)) = self.inputs.codec_counters.iter().find(|(known, _)| *known == name) {
            counter.inc();
            return;
        }
        let counter = self.metrics.codecs.get_or_create(&Label { name: name.into() }).clone();
        counter.inc();
        self.inputs.codec_counters.push((name, counter));
    }

    /// Names the unit if a stamp read in a unit other than ns is close to the clock.
    fn watch_unit(&self, m: &Message, t_ns: i64) {
        let near = |ns: i128| (ns - i128::from(m.arrival_ns)).abs() < NEAR_NS;
        if near(i128::from(t_ns)) || t_ns <= 0 {
            return;
        }
        let units = [("seconds", 1_000_000_000), ("milliseconds", 1_000_000), ("microseconds", 1_000)];
        if let Some((unit, _)) = units.into_iter().find(|(_, per_unit)| near(i128::from(t_ns) * per_unit)) {
            let key = m.buf.key().escape_debug();
            let text = format!("{key} sends times in {unit} ({t_ns}): send ns since 1970, or RFC 3339");
            self.faults.raise_for("unit of times", text, CONTEST_SHOWN);
        }
    }

    fn count_undecodable(&self, m: &Message, error: &CodecError) {
        if let CodecError::Encoding(_) = error {
            self.faults.raise_for("encoding", format!("{}: {error}", m.buf.key().escape_debug()), CONTEST_SHOWN);
        }
        if self.metrics.undecodable.inc() == 0 {
            tracing::warn!(key = m.buf.key(), %error, "a payload could not be read; further ones are only counted");
        }
    }
}
