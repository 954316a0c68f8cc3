//! The clocks of the program: a monotonic one for timers, and the wall clock for arrival stamps and the age of data. No
//! computed result depends on either. In tests both may be set by hand.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// The current time, ns since 1970.
#[must_use]
#[allow(clippy::disallowed_methods)] // the one place that asks the wall clock
pub fn now_ns() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX))
}

/// The time source of a part of the daemon; clones share it.
#[derive(Debug, Clone, Default)]
pub struct Clock(Option<Arc<Virtual>>);

#[derive(Debug)]
struct Virtual {
    origin: Instant,
    passed_ns: AtomicU64,
    wall_ns: AtomicI64,
}

impl Clock {
    /// The system's clocks.
    #[must_use]
    pub const fn system() -> Self {
        Self(None)
    }

    /// Clocks that are advanced by hand.
    #[must_use]
    pub fn standing(wall_ns: i64) -> Self {
        let (passed_ns, wall_ns) = (AtomicU64::new(0), AtomicI64::new(wall_ns));
        Self(Some(Arc::new(Virtual { origin: Instant::now(), passed_ns, wall_ns })))
    }

    /// The monotonic time, for timers.
    #[must_use]
    pub fn now(&self) -> Instant {
        match &self.0 {
            None => Instant::now(),
            Some(v) => v.origin + Duration::from_nanos(v.passed_ns.load(Ordering::Relaxed)),
        }
    }

    /// Time since an instant of this clock.
    #[must_use]
    pub fn since(&self, then: Instant) -> Duration {
        self.now().saturating_duration_since(then)
    }

    /// The wall clock, ns since 1970.
    #[must_use]
    pub fn now_ns(&self) -> i64 {
        self.0.as_ref().map_or_else(now_ns, |v| v.wall_ns.load(Ordering::Relaxed))
    }

    /// Waits; a clock set by hand is advanced instead.
    pub fn sleep(&self, time: Duration) {
        if self.0.is_none() {
            std::thread::sleep(time);
        }
        self.advance(time);
    }

    /// Advances a clock set by hand, monotonic and wall time alike; has no effect on the system's clock.
    pub fn advance(&self, time: Duration) {
        let Some(v) = &self.0 else { return };
        let ns = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        v.passed_ns.fetch_add(ns, Ordering::Relaxed);
        v.wall_ns.fetch_add(i64::try_from(ns).unwrap_or(i64::MAX), Ordering::Relaxed);
    }

    /// Sets the wall time of a clock set by hand, as people and time servers do; timers do not notice.
    pub fn set_wall(&self, wall_ns: i64) {
        if let Some(v) = &self.0 {
            v.wall_ns.store(wall_ns, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_standing_clock_moves_by_hand_alone() {
        let clock = Clock::standing(5);
        let then = clock.now();
        assert_eq!((clock.since(then), clock.now_ns()), (Duration::ZERO, 5));
        clock.clone().sleep(Duration::from_nanos(7));
        assert_eq!((clock.since(then), clock.now_ns()), (Duration::from_nanos(7), 12));
        clock.set_wall(-1);
        assert_eq!((clock.since(then), clock.now_ns()), (Duration::from_nanos(7), -1));
        assert!(Clock::system().now_ns() > 0);
    }
}
