//! Current problems that a person should look at: raised where they are noticed, cleared when they end, listed in the health
//! document.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::clock::Clock;

/// One fault.
#[derive(Debug)]
struct Fault {
    text: String,
    /// When it ends by itself.
    until: Option<Instant>,
}

/// All faults of a daemon, by a key chosen where they are raised.
#[derive(Debug, Default)]
pub struct Faults {
    active: Mutex<BTreeMap<String, Fault>>,
    clock: Clock,
}

impl Faults {
    /// No faults yet, with this clock.
    #[must_use]
    pub fn new(clock: Clock) -> Self {
        Self { active: Mutex::default(), clock }
    }

    /// Raises a fault until it is cleared. It is logged when new; its text may change.
    pub fn raise(&self, key: &str, text: impl Into<String>) {
        self.put(key, text.into(), None);
    }

    /// Raises a fault that ends after a while, unless it is raised again.
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

    /// Clears a fault.
    pub fn clear(&self, key: &str) {
        let gone = self.active.lock().unwrap_or_else(PoisonError::into_inner).remove(key);
        if let Some(fault) = gone {
            tracing::info!(fault = key, "over: {}", fault.text);
        }
    }

    /// Texts of the current faults.
    #[must_use]
    pub fn list(&self) -> Vec<String> {
        let now = self.clock.now();
        let mut active = self.active.lock().unwrap_or_else(PoisonError::into_inner);
        active.retain(|_, fault| fault.until.is_none_or(|until| now < until));
        active.values().map(|fault| fault.text.clone()).collect()
    }
}

/// A library's message without references to source code, such as `at src/link.rs:388.`, which do not help the user and name
/// folders of the machine that built the program.
#[must_use]
pub fn without_places(message: &str) -> String {
    let mut words: Vec<&str> = Vec::new();
    for word in message.split_whitespace() {
        let is_place = word.split_once(".rs:").is_some_and(|(_, rest)| rest.starts_with(|c: char| c.is_ascii_digit()));
        if !is_place {
            words.push(word);
        } else if words.last() == Some(&"at") {
            words.pop();
        }
    }
    words.join(" ").trim_end_matches('.').to_owned()
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

    #[test]
    fn a_librarys_message_is_told_without_places_in_its_source() {
        let told = "Unable to connect to any of [tcp/h:9]! at /x/net/runtime/orchestrator.rs:388. - Caused by refused at a.rs:7.";
        assert_eq!(without_places(told), "Unable to connect to any of [tcp/h:9]! - Caused by refused");
        assert_eq!(without_places("at tcp/h:9, see main.rs: nothing"), "at tcp/h:9, see main.rs: nothing");
    }
}
