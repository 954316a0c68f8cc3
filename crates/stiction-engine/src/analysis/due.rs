//! Every window of a long record, cut as the daemon would.

use std::collections::VecDeque;
use std::slice::Iter;

use crate::config::Config;
use crate::engine::{Engine, Event, LoopId, Request};
use stiction::core::record::Sample;

/// The windows of one loop that come due while its samples are taken, oldest first. Their answers are independent, so they
/// may be computed in any order or not at all. As in the daemon, a window is due once the loop's time has passed its end; a
/// window in which the samples end is not due.
#[derive(Debug)]
pub struct Due<'s> {
    engine: Engine,
    id: Option<LoopId>,
    samples: Iter<'s, Sample>,
    events: Vec<Event>,
    ready: VecDeque<Request>,
}

impl<'s> Due<'s> {
    /// The windows of a loop's samples, in order of arrival.
    #[must_use]
    pub fn of(name: &str, samples: &'s [Sample], config: &Config) -> Self {
        let mut engine = Engine::new(config.engine());
        let id = engine.appear(name);
        Self { engine, id, samples: samples.iter(), events: Vec::new(), ready: VecDeque::new() }
    }

    /// Number of samples not taken yet.
    #[must_use]
    pub fn left(&self) -> usize {
        self.samples.len()
    }
}

impl Iterator for Due<'_> {
    type Item = Request;

    fn next(&mut self) -> Option<Request> {
        let id = self.id?;
        while self.ready.is_empty() {
            self.engine.push(id, *self.samples.next()?, &mut self.events);
            for event in std::mem::take(&mut self.events) {
                if let Event::Request(request) = event {
                    // Answers would only affect alarms, which are not needed here; an unanswered window would be kept for ever.
                    self.engine.skip(id, request.seq, &mut self.events);
                    self.ready.push_back(*request);
                }
            }
            self.events.clear();
        }
        self.ready.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::record::{Signal, Value};
    use stiction::core::units::ns_from_s;

    fn samples(n: usize) -> Vec<Sample> {
        let of =
            |signal, k: usize, v| Sample { signal, t_ns: ns_from_s(k as f64), value: Value::Number(v), quality: None };
        let wave = |k: usize, phase: f64| libm::sin(0.1 * k as f64 + phase);
        (0..n).flat_map(|k| [of(Signal::Op, k, wave(k, 0.0)), of(Signal::Pv, k, wave(k, 1.0))]).collect()
    }

    #[test]
    fn windows_are_those_of_an_engine_that_is_answered() {
        let samples = samples(4000);
        let mut config = Config::with_prefix("p");
        config.window.hop_s = 500.0;
        let due: Vec<Request> = Due::of("A", &samples, &config).collect();
        let mut engine = Engine::new(config.engine());
        let id = engine.appear("A").unwrap();
        let (mut events, mut live) = (Vec::new(), Vec::new());
        for sample in &samples {
            engine.push(id, *sample, &mut events);
            while !events.is_empty() {
                for event in std::mem::take(&mut events) {
                    if let Event::Request(request) = event {
                        engine.complete(id, request.seq, request.compute(), &mut events);
                        live.push(request);
                    }
                }
            }
        }
        assert_eq!(
            due.iter().map(|r| r.end_ns).collect::<Vec<_>>(),
            (0..8).map(|k| ns_from_s(500.0 * f64::from(k))).collect::<Vec<_>>()
        );
        assert_eq!(due.len(), live.len());
        for (due, live) in due.iter().zip(&live) {
            assert_eq!((due.seq, due.end_ns, due.record()), (live.seq, live.end_ns, live.record()));
        }
    }

    #[test]
    fn a_loop_that_may_not_appear_has_no_windows() {
        let mut config = Config::with_prefix("p");
        config.input.max_loops = 0;
        assert_eq!(Due::of("A", &samples(2000), &config).count(), 0);
    }
}
