//! What a person should look at now: raised by whoever notices, cleared when it is over, listed in the health document.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::clock::Clock;

/// One fault.
#[derive(Debug)]
struct Fault {
    text: String,
    /// When it is over by itself.
    until: Option<Instant>,
}

/// All faults of a daemon, by a key of whoever raises them.
#[derive(Debug, Default)]
pub struct Faults {
    active: Mutex<BTreeMap<String, Fault>>,
    clock: Clock,
}

impl Faults {
    /// None yet, by this clock.
    #[must_use]
    pub fn new(clock: Clock) -> Self {
        Self { active: Mutex::default(), clock }
    }

    /// A fault that lasts until it is cleared. Logged when it is new; its text may change.
    pub fn raise(&self, key: &str, text: impl Into<String>) {
        self.put(key, text.into(), None);
    }

    /// A fault that is over after a while, unless it is raised again.
    pub fn raise_for(&self, key: &str, text: impl Into<String>, lasting: Duration) {
        self.put(key, text.into(), Some(self.clock.now() + lasting));
    }

    fn put(&self, key: &str, text: String, until: Option<Instant>) {
        let fault = Fault { text, until };
        let mut active = self.active.lock().unwrap_or_else(PoisonError::into_inner);
        let text = fault.text.clone();
        if active.insert(key.to_owned(), fault).is_none() {
            drop(active);
            tracing::error!(fault = key, "{text}");
        }
    }

    /// It is over.
    pub fn clear(&self, key: &str) {
        let gone = self.active.lock().unwrap_or_else(PoisonError::into_inner).remove(key);
        if let Some(fault) = gone {
            tracing::info!(fault = key, "over: {}", fault.text);
        }
    }

    /// What holds now, in words.
    #[must_use]
    pub fn list(&self) -> Vec<String> {
        let now = self.clock.now();
        let mut active = self.active.lock().unwrap_or_else(PoisonError::into_inner);
        active.retain(|_, fault| fault.until.is_none_or(|until| now < until));
        active.values().map(|fault| fault.text.clone()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_stands_until_it_is_cleared_or_over() {
        let faults = Faults::default();
        faults.raise("disk", "no room");
        faults.raise("disk", "no room, 5 lost");
        faults.raise_for("past", "lost", Duration::ZERO);
        assert_eq!(faults.list(), ["no room, 5 lost"]);
        faults.clear("disk");
        faults.clear("disk");
        assert!(faults.list().is_empty());
    }
}
