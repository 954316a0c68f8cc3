//! Room for what waits: a limit in bytes beside a queue's limit in messages.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How many bytes may wait in a queue, and how many do. Copies share one count.
#[derive(Debug, Clone)]
pub struct Budget {
    used: Arc<AtomicUsize>,
    limit: usize,
}

/// Bytes of a budget that something on its way holds; given back when it is dropped.
#[derive(Debug)]
pub struct Room {
    used: Arc<AtomicUsize>,
    bytes: usize,
}

impl Budget {
    /// A budget of `limit` bytes.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self { used: Arc::default(), limit }
    }

    /// Room for so many bytes; none where they would exceed the limit.
    #[must_use]
    pub fn take(&self, bytes: usize) -> Option<Room> {
        let fits = |used: usize| used.checked_add(bytes).filter(|sum| *sum <= self.limit);
        self.used.fetch_update(Ordering::AcqRel, Ordering::Acquire, fits).ok()?;
        Some(Room { used: self.used.clone(), bytes })
    }

    /// Bytes that wait.
    #[must_use]
    pub fn used(&self) -> usize {
        self.used.load(Ordering::Relaxed)
    }

    /// Bytes that may wait.
    #[must_use]
    pub const fn limit(&self) -> usize {
        self.limit
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        self.used.fetch_sub(self.bytes, Ordering::AcqRel);
    }
}

/// A token bucket. The caller passes the time, so tests need no clock.
#[derive(Debug, Clone, Copy)]
pub struct Rate {
    per_s: f64,
    burst: f64,
    left: f64,
    at_s: f64,
}

impl Rate {
    /// A rate whose burst is there at once.
    #[must_use]
    pub const fn new(per_s: f64, burst: f64) -> Self {
        Self { per_s, burst, left: burst, at_s: 0.0 }
    }

    /// Whether one more is within the rate, at a time that never goes back.
    pub fn allow(&mut self, now_s: f64) -> bool {
        self.left = (self.left + (now_s - self.at_s).max(0.0) * self.per_s).min(self.burst);
        self.at_s = now_s;
        let allowed = self.left >= 1.0;
        if allowed {
            self.left -= 1.0;
        }
        allowed
    }
}

/// Refusals that are logged a second; more are only counted.
const LOGGED_PER_S: f64 = 1.0;
/// Refusals that are logged at once.
const LOGGED_AT_ONCE: f64 = 10.0;

/// How often one way in logs what it refuses.
#[must_use]
pub const fn logged_rate() -> Rate {
    Rate::new(LOGGED_PER_S, LOGGED_AT_ONCE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_given_back_and_never_exceed_the_limit() {
        let budget = Budget::new(100);
        let (a, b) = (budget.take(60), budget.take(40));
        assert!(a.is_some() && b.is_some() && budget.take(1).is_none());
        drop(a);
        assert!(budget.take(61).is_none() && budget.take(usize::MAX).is_none());
        assert!(budget.take(60).is_some());
        drop(b);
        assert_eq!(budget.used(), 0);
    }

    #[test]
    fn a_rate_allows_its_burst_and_then_its_pace() {
        let mut rate = Rate::new(2.0, 3.0);
        assert_eq!((0..10).filter(|_| rate.allow(0.0)).count(), 3);
        assert_eq!((0..100).filter(|k| rate.allow(f64::from(*k) / 10.0)).count(), 19);
    }
}
