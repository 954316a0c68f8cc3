//! The configured loops: their keys, since when they are awaited, and the samples per period that they need.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use super::{Overview, SILENT_UNKNOWN_S};
use stiction::core::record::Signal;
use stiction_engine::codec::topic;
use stiction_engine::config::{Action, Config, LoopConfig};

/// A configured loop that has no entry.
#[derive(Debug, Clone, Copy)]
pub(super) struct Awaited {
    /// Its index in the configuration.
    index: usize,
    /// If the loop was forgotten, the stamp of its newest sample; else when the daemon began to wait; ns since 1970.
    pub since_ns: i64,
    since: Instant,
    /// Whether it was heard and then forgotten.
    pub has_left: bool,
}

impl Awaited {
    /// Whether it is overdue.
    pub fn is_silent(&self, now: Instant) -> bool {
        let patience = Duration::from_secs_f64(SILENT_UNKNOWN_S);
        self.has_left || now.saturating_duration_since(self.since) > patience
    }
}

/// The configured loops.
#[derive(Debug)]
pub(super) struct Expected {
    config: Arc<Config>,
    by_name: BTreeMap<Arc<str>, Awaited>,
}

impl Expected {
    pub fn loops(&self) -> impl Iterator<Item = (&Arc<str>, &Awaited)> {
        self.by_name.iter()
    }

    pub fn awaited(&self, name: &str) -> Option<&Awaited> {
        self.by_name.get(name)
    }

    fn entry(&self, name: &str) -> Option<&LoopConfig> {
        self.config.loops.get(self.by_name.get(name)?.index)
    }

    /// Part of the plant.
    pub fn area(&self, name: &str) -> Option<String> {
        self.entry(name).map(|entry| entry.area.clone()).filter(|area| !area.is_empty())
    }

    /// Action of a loop's controller.
    pub fn action(&self, name: &str) -> Option<Action> {
        self.entry(name)?.action
    }

    /// Fewest samples per period that a loop needs.
    pub fn samples_per_period(&self, name: &str) -> f64 {
        self.entry(name).map_or(self.config.window, |entry| entry.window).min_samples_per_period
    }

    /// The keys of a loop's OP and PV.
    pub fn keys(&self, name: &str) -> [String; 2] {
        let entry = self.entry(name);
        [Signal::Op, Signal::Pv].map(|signal| {
            let mapped = entry.and_then(|entry| entry.keys.iter().find(|(of, _)| *of == signal));
            mapped.map_or_else(|| topic::raw(&self.config.site.prefix, name, signal), |(_, key)| key.clone())
        })
    }

    /// Notes the newest sample of a loop that the daemon is forgetting.
    pub fn forget(&mut self, name: &str, newest_ns: Option<i64>) {
        if let (Some(awaited), Some(newest_ns)) = (self.by_name.get_mut(name), newest_ns) {
            (awaited.since_ns, awaited.has_left) = (newest_ns, true);
        }
    }
}

impl Overview {
    /// Sets the configured loops; the wait for new ones starts at `now`.
    pub fn expect(&self, config: Arc<Config>, now: Instant, now_ns: i64) {
        let mut loops = self.0.write().unwrap_or_else(PoisonError::into_inner);
        let before = loops.expected.take();
        let own = config.loops.iter().enumerate().filter(|(_, entry)| config.shard.owns(&entry.name));
        let by_name = own.map(|(index, entry)| {
            let known = before.as_ref().and_then(|expected| expected.awaited(&entry.name));
            let new = Awaited { index, since_ns: now_ns, since: now, has_left: false };
            (Arc::from(entry.name.as_str()), known.map_or(new, |known| Awaited { index, ..*known }))
        });
        let by_name = by_name.collect();
        loops.expected = Some(Expected { config, by_name });
    }
}
