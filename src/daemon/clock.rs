//! The wall clock, for arrival stamps, data age and timers; nothing that is computed depends on it.

use std::time::{SystemTime, UNIX_EPOCH};

/// Nanoseconds since 1970, now.
#[must_use]
#[allow(clippy::disallowed_methods)] // the one place that asks the wall clock
pub fn now_ns() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX))
}
