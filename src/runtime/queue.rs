//! Byte limits for queues, in addition to their limits in messages, and rate limits.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Limit and current number of the bytes in a queue. Clones share one count.
#[derive(Debug, Clone)]
pub struct Budget {
    used: Arc<AtomicUsize>,
    limit: usize,
}

/// Bytes of a budget held by a queued item; given back on drop.
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

    /// Room for this many bytes; `None` if they would exceed the limit.
    #[must_use]
    pub fn take(&self, bytes: usize) -> Option<Room> {
        let fits = |used: usize| used.checked_add(bytes).filter(|sum| *sum <= self.limit);
        self.used.fetch_update(Ordering::AcqRel, Ordering::Acquire, fits).ok()?;
        Some(Room { used: self.used.clone(), bytes })
    }

    /// Bytes in use.
    #[must_use]
    pub fn used(&self) -> usize {
        self.used.load(Ordering::Relaxed)
    }

    /// The limit in bytes.
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

/// A token bucket. The caller passes the time, so that tests need no clock.
#[derive(Debug, Clone, Copy)]
pub struct Rate {
    per_s: f64,
    burst: f64,
    left: f64,
    at_s: f64,
}

impl Rate {
    /// A bucket that starts full.
    #[must_use]
    pub const fn new(per_s: f64, burst: f64) -> Self {
        Self { per_s, burst, left: burst, at_s: 0.0 }
    }

    /// Whether one more event is within the rate. The time must not go back.
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

/// Logged refusals a second; further ones are only counted.
const LOGGED_PER_S: f64 = 1.0;
/// Logged refusals in one burst.
const LOGGED_AT_ONCE: f64 = 10.0;

/// The rate at which one entrance logs refusals.
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
