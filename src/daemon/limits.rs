//! Limits on what one publisher may use: samples a second per key, stamps ahead of the others, new loops an hour.
//!
//! They apply before the recorder: the engine never sees what is refused here, so replay need not know of it. Everything
//! refused is counted, and is a fault while it lasts.

use std::time::Duration;

use crate::runtime::queue::Rate;
use stiction::core::record::{Sample, Signal};
use stiction::core::units::ns_from_s;
use stiction_engine::config::Input;
use stiction_engine::engine::LoopId;

/// Seconds of the rate that may come in one burst: by default a million samples, or eleven days at one a second, played at full
/// speed.
const BURST_S: f64 = 1000.0;
/// Divisor: the next look at all loops' stamps comes after as many samples as there are loops, divided by this.
const LOOK_AGAIN: usize = 8;

/// Why a sample was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refused {
    /// Its key exceeds the rate.
    OverRate,
    /// Its stamp is too far ahead.
    Ahead,
}

/// The limits and what has been used of them.
#[derive(Debug)]
pub struct Limits {
    max_rate_hz: f64,
    max_ahead_ns: i64,
    new_loops: Rate,
    /// By loop, then by signal.
    rates: Vec<Option<Box<[Rate; Signal::ALL.len()]>>>,
    /// Median stamp of all loops at the last look, and samples until the next look.
    others_ns: Option<i64>,
    look_in: usize,
}

impl Limits {
    /// The limits of a configuration.
    #[must_use]
    pub fn new(input: &Input) -> Self {
        let new_loops = f64::from(input.new_loops_per_hour);
        Self {
            max_rate_hz: input.max_rate_hz,
            max_ahead_ns: ns_from_s(input.max_ahead_s),
            new_loops: Rate::new(new_loops / 3600.0, new_loops),
            rates: Vec::new(),
            others_ns: None,
            look_in: 0,
        }
    }

    /// Whether a loop that is not configured may appear now.
    pub fn new_loop(&mut self, now: Duration) -> bool {
        self.new_loops.allow(now.as_secs_f64())
    }

    /// Number of loops with rates.
    #[cfg(test)]
    #[must_use]
    pub fn count(&self) -> usize {
        self.rates.iter().flatten().count()
    }

    /// Forgets a loop.
    pub fn forget(&mut self, id: LoopId) {
        if let Some(rates) = self.rates.get_mut(id.index()) {
            *rates = None;
        }
    }

    /// Whether a sample may be taken. `greatest` gives every loop's greatest stamp; it is called rarely.
    ///
    /// # Errors
    /// The limit that it exceeds.
    pub fn sample(
        &mut self,
        (id, sample, arrival_ns): (LoopId, &Sample, i64),
        now: Duration,
        greatest: impl FnOnce() -> Vec<i64>,
    ) -> Result<(), Refused> {
        if self.max_rate_hz > 0.0 {
            if self.rates.len() <= id.index() {
                self.rates.resize(id.index() + 1, None);
            }
            let max_rate_hz = self.max_rate_hz;
            let fresh = || Box::new([Rate::new(max_rate_hz, BURST_S * max_rate_hz); Signal::ALL.len()]);
            let rates = self.rates[id.index()].get_or_insert_with(fresh);
            if !rates[sample.signal as usize].allow(now.as_secs_f64()) {
                return Err(Refused::OverRate);
            }
        }
        if self.max_ahead_ns > 0 && self.is_ahead(sample.t_ns, arrival_ns, greatest) {
            return Err(Refused::Ahead);
        }
        Ok(())
    }

    /// Whether a stamp is too far ahead of both the wall clock and the median of all loops. Either alone may be wrong: the wall
    /// clock after a reset, the loops in a simulated plant. A single loop has no others to compare with.
    fn is_ahead(&mut self, t_ns: i64, arrival_ns: i64, greatest: impl FnOnce() -> Vec<i64>) -> bool {
        let beyond = |of_ns: i64| t_ns > of_ns.saturating_add(self.max_ahead_ns);
        self.look_in = self.look_in.saturating_sub(1);
        if !beyond(arrival_ns) || self.others_ns.is_some_and(|others_ns| !beyond(others_ns)) {
            return false;
        }
        if self.look_in > 0 {
            return self.others_ns.is_some();
        }
        let mut stamps = greatest();
        self.look_in = stamps.len() / LOOK_AGAIN;
        self.others_ns = None;
        if stamps.len() > 1 {
            let middle = (stamps.len() - 1) / 2;
            self.others_ns = Some(*stamps.select_nth_unstable(middle).1);
        }
        self.others_ns.is_some_and(beyond)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::record::Value;
    use stiction_engine::config::Config;
    use stiction_engine::engine::Engine;

    const DAY_NS: i64 = 86_400_000_000_000;

    fn limits(input: &str) -> (Limits, LoopId) {
        let config = Config::parse(&format!("[site]\nprefix = \"p\"\n[input]\n{input}")).unwrap();
        let limits = Limits::new(&config.input);
        (limits, Engine::new(config.engine()).appear("A").unwrap())
    }

    fn sample(t_ns: i64) -> Sample {
        Sample { signal: Signal::Pv, t_ns, value: Value::Number(1.0), quality: None }
    }

    #[test]
    fn a_key_has_its_rate_and_a_burst_for_history() {
        let (mut limits, id) = limits("max_rate_hz = 10\n");
        let mut taken = |seconds| {
            let now = Duration::from_secs(seconds);
            (0..12_000).filter(|_| limits.sample((id, &sample(0), 0), now, Vec::new).is_ok()).count()
        };
        assert_eq!((taken(0), taken(7)), (10_000, 70));
        let (mut limits, id) = self::limits("max_rate_hz = 0\n");
        assert!((0..1_100_000).all(|_| limits.sample((id, &sample(0), 0), Duration::ZERO, Vec::new).is_ok()));
    }

    #[test]
    fn a_stamp_ahead_of_clock_and_others_is_refused_and_a_plant_ahead_of_the_clock_is_not() {
        let (mut limits, id) = limits("");
        let mut taken = |t_ns: i64, wall_ns: i64, others: &[i64]| {
            (limits.look_in, limits.others_ns) = (0, None);
            limits.sample((id, &sample(t_ns), wall_ns), Duration::ZERO, || others.to_vec()).is_ok()
        };
        assert!(taken(5 * DAY_NS / 4, DAY_NS, &[DAY_NS; 3]), "hours ahead");
        assert!(!taken(9 * DAY_NS, DAY_NS, &[DAY_NS; 3]), "days ahead of both");
        assert!(taken(9 * DAY_NS, DAY_NS, &[]) && taken(9 * DAY_NS, DAY_NS, &[DAY_NS]), "alone");
        assert!(taken(-900 * DAY_NS, DAY_NS, &[DAY_NS; 3]), "history");
        // The daemon's clock is ten years behind, or the plant is a simulation that runs ahead.
        assert!(taken(3650 * DAY_NS, 0, &[3650 * DAY_NS; 3]));
        // One loop that runs ahead neither takes the others along nor stops them.
        assert!(!taken(3650 * DAY_NS, 0, &[0, 0, 3650 * DAY_NS]));
        assert!(taken(0, 0, &[3650 * DAY_NS; 3]));
    }

    #[test]
    fn a_flood_of_stamps_ahead_looks_at_the_others_seldom() {
        let (mut limits, id) = limits("");
        let mut looks = 0;
        for _ in 0..10_000 {
            let refused = limits.sample((id, &sample(900 * DAY_NS), 0), Duration::ZERO, || {
                looks += 1;
                vec![0; 8000]
            });
            assert_eq!(refused, Err(Refused::Ahead));
        }
        assert_eq!(looks, 10);
    }

    #[test]
    fn new_loops_have_an_hourly_rate() {
        let (mut limits, _) = limits("new_loops_per_hour = 60\n");
        assert_eq!((0..1000).filter(|_| limits.new_loop(Duration::ZERO)).count(), 60);
        assert_eq!((0..1000).filter(|_| limits.new_loop(Duration::from_secs(600))).count(), 10);
    }
}
