//! Clients who send requests over the bus: limits how many of their queries may wait, and how often they may send commands.
//!
//! Zenoh does not say who sent a query. It reads each link in a separate task and calls queryables from there, so the task
//! identifies the link. Clients behind one router share its link.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::runtime::queue::Rate;
use stiction_engine::config::Commands;

/// Most queries that may wait.
pub const WAITING: usize = 1024;
/// Most queries of one link that may wait.
pub const WAITING_PER_LINK: usize = 256;
/// Fraction of the total command rate that one link may use.
const SHARE_PER_LINK: f64 = 0.5;
/// Number of remembered links beyond which idle ones are dropped.
const REMEMBERED: usize = 256;

/// A link of the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Link(pub u64);

impl Link {
    /// The link whose message the current thread is processing.
    #[must_use]
    pub fn current() -> Self {
        Self(tokio::task::try_id().and_then(|id| id.to_string().parse().ok()).unwrap_or(0))
    }
}

#[derive(Debug)]
struct Asker {
    waiting: usize,
    commands: Rate,
    /// Time of its last command, s; minus infinity before the first.
    at_s: f64,
}

#[derive(Debug, Default)]
struct Inner {
    links: HashMap<Link, Asker>,
    waiting: usize,
    per_minute: f64,
}

/// All links and their limits. Clones share them.
#[derive(Debug, Clone, Default)]
pub struct Askers(Arc<Mutex<Inner>>);

/// A waiting query's place, which is freed on drop.
#[derive(Debug)]
pub struct WaitingSlot {
    askers: Askers,
    link: Link,
}

impl Askers {
    /// No links yet, under these settings.
    #[must_use]
    pub fn new(settings: &Commands) -> Self {
        let askers = Self::default();
        askers.limit(settings);
        askers
    }

    /// New settings, which also apply to links that have not sent a command yet.
    pub fn limit(&self, settings: &Commands) {
        let mut inner = self.lock();
        inner.per_minute = f64::from(settings.per_minute);
        let fresh = inner.rate();
        inner.links.values_mut().for_each(|asker| asker.commands = fresh);
    }

    /// A place for one more query of a link; `None` if the link, or all links together, have the most that may wait.
    #[must_use]
    pub fn admit(&self, link: Link) -> Option<WaitingSlot> {
        let mut inner = self.lock();
        if inner.waiting >= WAITING || inner.asker(link).waiting >= WAITING_PER_LINK {
            return None;
        }
        inner.waiting += 1;
        inner.asker(link).waiting += 1;
        Some(WaitingSlot { askers: self.clone(), link })
    }

    /// Whether a link may send a command at this time since the start.
    pub fn may_command(&self, link: Link, now: Duration) -> bool {
        let mut inner = self.lock();
        let asker = inner.asker(link);
        asker.at_s = now.as_secs_f64();
        asker.commands.allow(asker.at_s)
    }

    /// Number of waiting queries.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.lock().waiting
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn rate(&self) -> Rate {
        let share = SHARE_PER_LINK * self.per_minute;
        Rate::new(share / 60.0, (0.5 * share).max(1.0))
    }

    fn asker(&mut self, link: Link) -> &mut Asker {
        if self.links.len() >= REMEMBERED && !self.links.contains_key(&link) {
            // After a minute a link may use its full rate again, so forgetting it changes nothing.
            let newest_s = self.links.values().map(|asker| asker.at_s).fold(0.0, f64::max);
            self.links.retain(|_, asker| asker.waiting > 0 || asker.at_s > newest_s - 60.0);
        }
        let commands = self.rate();
        self.links.entry(link).or_insert(Asker { waiting: 0, commands, at_s: f64::NEG_INFINITY })
    }
}

impl WaitingSlot {
    /// The link of the query.
    #[must_use]
    pub const fn link(&self) -> Link {
        self.link
    }
}

impl Drop for WaitingSlot {
    fn drop(&mut self) {
        let mut inner = self.askers.lock();
        inner.waiting -= 1;
        inner.asker(self.link).waiting -= 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_link_takes_its_share_of_the_places_and_gives_them_back() {
        let askers = Askers::new(&Commands::default());
        let flood: Vec<WaitingSlot> = (0..5000).filter_map(|_| askers.admit(Link(1))).collect();
        assert_eq!(flood.len(), WAITING_PER_LINK);
        assert!(askers.admit(Link(2)).is_some());
        let others: Vec<WaitingSlot> =
            (3..100).flat_map(|link| (0..50).map(move |_| link)).filter_map(|l| askers.admit(Link(l))).collect();
        assert_eq!((others.len(), askers.waiting()), (WAITING - WAITING_PER_LINK, WAITING));
        drop((flood, others));
        assert_eq!(askers.waiting(), 0);
        (0..10_000).for_each(|link| drop(askers.admit(Link(link))));
        assert!(askers.lock().links.len() <= REMEMBERED);
    }

    #[test]
    fn one_link_commands_at_half_the_pace_of_all_and_leaves_the_rest_to_others() {
        let askers = Askers::new(&Commands { per_minute: 60, ..Commands::default() });
        let taken = |link, at_s| (0..100).filter(|_| askers.may_command(Link(link), Duration::from_secs(at_s))).count();
        assert_eq!((taken(1, 0), taken(1, 10), taken(2, 10)), (15, 5, 15));
        askers.limit(&Commands { per_minute: 120, ..Commands::default() });
        assert_eq!(taken(1, 10), 30);
    }
}
