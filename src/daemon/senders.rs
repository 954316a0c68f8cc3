//! Detects two sensors that write to one key, which mixes two signals unnoticed.
//!
//! | what shows it | needs |
//! |---|---|
//! | two senders that alternate, by the id in Zenoh's source information or time stamp | publishers that send an id |
//! | a second, different value for the same time | two sensors sampled at the same instants |
//! | times that jump back and forth by the same amount | clocks that differ by more than a sampling time |
//!
//! A single gateway does none of these: after a restart it has a new id and never the old one again, repeated samples have the
//! same values, and a backlog comes faster than live data. Two sensors without ids, whose times fall between each other, look
//! like one that is sampled twice as often.

use std::collections::HashSet;

use stiction::core::record::{Sample, Signal, Value};
use stiction_engine::engine::LoopId;

/// How often senders must alternate to be a fault, and the most messages between two changes.
const RETURNS: u8 = 4;
const WITHIN: u8 = 100;
/// A second value adds this to a score, and each new time subtracts 1, since corrections are rare; the second number is the
/// score that is a fault.
const SECOND_VALUE: u8 = 4;
const ENOUGH: u8 = 32;
/// Number of jumps back by the same amount that is a fault.
const JUMPS: u8 = 16;

/// Evidence that a key has two sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Doubt {
    /// Two senders alternate.
    Senders,
    /// Two values for one time.
    Values,
    /// Times that alternate between two clocks, this many ns apart.
    Clocks(i64),
}

/// State of one signal.
#[derive(Debug, Clone, Copy, Default)]
struct Heard {
    /// The sender of the last message and the previous sender; 0 for none.
    senders: [u64; 2],
    /// Messages since the last change of sender.
    since: u8,
    returns: u8,
    /// Last time and value.
    t_ns: i64,
    value: Option<f64>,
    second_values: u8,
    /// The last jump back, ns, and how much further forward the next step went.
    back_ns: i64,
    gain_ns: i64,
    jumped: bool,
    jumps: u8,
}

/// OP and PV of each loop, by handle.
#[derive(Debug, Default)]
pub struct Senders {
    heard: Vec<[Heard; 2]>,
}

impl Senders {
    /// Takes a sample; `sender` is the publisher's id, if it sends one.
    pub fn hear(&mut self, id: LoopId, sender: Option<u64>, sample: &Sample) -> Option<Doubt> {
        let signal = [Signal::Op, Signal::Pv].iter().position(|signal| *signal == sample.signal)?;
        if self.heard.len() <= id.index() {
            self.heard.resize(id.index() + 1, Default::default());
        }
        let heard = &mut self.heard[id.index()][signal];
        let by_turns = sender.is_some_and(|sender| heard.hear_sender(sender));
        let found = heard.hear_sample(sample);
        if by_turns { Some(Doubt::Senders) } else { found }
    }

    /// Forgets these loops.
    pub fn forget(&mut self, gone: &HashSet<LoopId>) {
        for id in gone {
            self.heard.get_mut(id.index()).into_iter().for_each(|heard| *heard = Default::default());
        }
    }
}

impl Heard {
    fn hear_sender(&mut self, sender: u64) -> bool {
        let [last, before] = self.senders;
        if sender == last {
            self.since = self.since.saturating_add(1);
        } else {
            let back = sender == before && self.since < WITHIN;
            self.returns = if back { self.returns.saturating_add(1) } else { 0 };
            (self.senders, self.since) = ([sender, last], 0);
        }
        self.returns >= RETURNS && self.since < WITHIN
    }

    fn hear_sample(&mut self, sample: &Sample) -> Option<Doubt> {
        let value = sample.value.as_number();
        let step_ns = sample.t_ns.saturating_sub(self.t_ns);
        let is_first = self.t_ns == 0;
        let differs = matches!((value, self.value), (Some(a), Some(b)) if a.to_bits() != b.to_bits());
        (self.t_ns, self.value) = (sample.t_ns, value);
        if is_first || sample.value == Value::Missing {
            return None;
        }
        if step_ns == 0 {
            self.second_values =
                self.second_values.saturating_add(if differs { SECOND_VALUE } else { 0 }).min(2 * ENOUGH);
            return (differs && self.second_values >= ENOUGH).then_some(Doubt::Values);
        }
        self.second_values = self.second_values.saturating_sub(1);
        if step_ns > 0 {
            if std::mem::take(&mut self.jumped) {
                self.gain_ns = step_ns.saturating_sub(self.back_ns);
            }
            return None;
        }
        let back_ns = step_ns.saturating_neg();
        // A gateway whose threads overtake each other jumps back by less than it gains.
        let is_equal =
            (1..=back_ns).contains(&self.gain_ns) && self.back_ns.abs_diff(back_ns) <= self.gain_ns.unsigned_abs() / 2;
        self.jumps = if is_equal && !self.jumped { self.jumps.saturating_add(1) } else { 0 };
        (self.back_ns, self.gain_ns, self.jumped) = (back_ns, 0, true);
        (self.jumps >= JUMPS).then_some(Doubt::Clocks(back_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: i64 = 1_000_000_000;
    const START: i64 = 1_700_000_000;

    /// Doubts found in messages given as sender, second and value.
    fn found(messages: impl IntoIterator<Item = (Option<u64>, i64, f64)>) -> Vec<Doubt> {
        let config = stiction_engine::config::Config::with_prefix("p");
        let id = stiction_engine::engine::Engine::new(config.engine()).appear("L").unwrap();
        let mut senders = Senders::default();
        let hear = |(sender, t_s, v): (Option<u64>, i64, f64)| {
            let t_ns = (START + t_s) * S + 123;
            senders.hear(id, sender, &Sample { signal: Signal::Pv, t_ns, value: Value::Number(v), quality: None })
        };
        messages.into_iter().filter_map(hear).collect()
    }

    #[test]
    fn two_sensors_on_one_key_are_found() {
        let by_id = found((0..100).map(|k| (Some(1 + k as u64 % 2), k, k as f64)));
        assert!(by_id.len() > 90 && by_id.iter().all(|d| *d == Doubt::Senders));
        // One message in twenty comes from the second sensor.
        let rare = found((0..400).map(|k| (Some(1 + u64::from(k % 20 == 0)), k, k as f64)));
        assert!(rare.len() > 300, "{}", rare.len());
        let same_times = found((0..100).map(|k| (None, k / 2, f64::from(k as u8 % 2) * 7.0)));
        assert!(same_times.len() > 30 && same_times.iter().all(|d| *d == Doubt::Values));
        let clocks = found((0..100).map(|k| (None, k / 2 - 30 * (k % 2), k as f64)));
        assert!(clocks.len() > 25 && clocks.iter().all(|d| *d == Doubt::Clocks(30 * S)), "{clocks:?}");
    }

    #[test]
    fn one_gateway_is_never_two() {
        let steady = |k: i64| (Some(1), k, k as f64);
        // Restarts: each has a new id and repeats the last minute.
        let restarts =
            (0..20).flat_map(|run| (60 * run - 60..60 * run + 60).map(move |k| (Some(run as u64), k, k as f64)));
        assert_eq!(found(restarts), []);
        // Two gateways that alternate every hour.
        assert_eq!(found((0..20_000).map(|k| (Some(1 + (k as u64 / 3600) % 2), k, k as f64))), []);
        // A backlog among live data, sample by sample and in batches.
        let backlog = |batch: i64| {
            (0..400).map(move |k| if k % 4 == 0 { (None, 5000 + k / 4, 1.0) } else { (None, batch * k, 2.0) })
        };
        assert_eq!((found(backlog(1)), found(backlog(10))), (vec![], vec![]));
        // Threads that overtake each other, overlapping messages, repeated rows, and a corrected value.
        assert_eq!(found((0..400).map(|k| steady(k ^ 1))), []);
        assert_eq!(found((0..100).flat_map(|k| (5 * k..5 * k + 10).map(steady))), []);
        assert_eq!(found((0..400).map(|k| steady(k / 2))), []);
        assert_eq!(found((0..400).map(|k| (None, k - i64::from(k % 10 == 0), k as f64))), []);
    }
}
