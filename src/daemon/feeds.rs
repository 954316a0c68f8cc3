//! Chooses the source of a signal where there are several: redundant gateways, or a name that occurs twice.
//!
//! A signal is taken from the source that brought it first. Another source is ignored and counted while the first is heard, and
//! takes over once the first has been silent for [`INTERVALS`] of the signal's usual intervals, measured by the stamps of the
//! waiting source; so the clocks of two gateways may differ, and played history is taken as it was. It then keeps the signal
//! until it falls silent. The loop's other signals from the same gateway change over at the same time, however rarely they
//! come. Another name from the same gateway never takes over: OP and OUT of one controller may differ.
//!
//! Only stamps and the order of messages decide, not the clock. What is taken is recorded, so replay needs no such rule.

use std::collections::{HashMap, HashSet};

use stiction::core::record::Signal;
use stiction_engine::config::{Config, NAME_MARK};
use stiction_engine::engine::LoopId;

/// Usual intervals without the source after which another takes over.
const INTERVALS: f64 = 5.0;
/// The shortest such silence, ns: two gateways never send at exactly the same moment.
const LEAST_NS: f64 = 2e9;
/// The silence required if the signal came only once, so that its interval is unknown, ns.
const UNKNOWN_NS: f64 = 60e9;
/// Messages that the waiting source must have sent meanwhile.
const MESSAGES: u32 = 3;
/// Alternations between the two sources that count as a fault: around a change-over their messages may cross.
const IN_TURN: u8 = 3;
/// Usual intervals after which the alternations are forgotten.
const FORGOTTEN: f64 = 1000.0;
/// A new interval enters the usual one with a weight of one over this.
const FOLLOW: f64 = 8.0;
/// Longest interval that is averaged, in usual intervals: a night without data does not change the pace.
const LONGEST: f64 = 4.0;
/// Messages of a third source after which it replaces a waiting source that has fallen silent.
const QUEUED: u32 = 20;

/// What happens to a value.
#[derive(Debug, PartialEq, Eq)]
pub enum Feed {
    /// It is taken.
    Taken,
    /// It is taken; the source that fed the signal before is silent.
    TakenOver {
        /// The previous source.
        from: Box<str>,
    },
    /// It is taken, while another source keeps sending the same signal.
    Contested {
        /// The other source.
        other: Box<str>,
    },
    /// It is ignored: another source feeds the signal.
    Ignored,
}

/// A source waiting to take over.
#[derive(Debug)]
struct Waiting {
    source: Box<str>,
    /// Number of its last message.
    message: u64,
    /// Stamp of its first message since the owner was last heard, ns.
    since_ns: i64,
    messages: u32,
    /// Messages of third sources since its last one.
    passed: u32,
}

#[derive(Debug)]
struct Owner {
    source: Box<str>,
    /// Its last message, and the first stamp in that message, ns.
    message: u64,
    t_ns: i64,
    /// Usual time between its messages, ns; 0 while unknown.
    interval_ns: f64,
    waiting: Option<Waiting>,
    /// How often both sources were heard in turn, and the stamp of the last time.
    in_turn: u8,
    turn_ns: i64,
}

/// The source of each signal.
#[derive(Debug)]
pub struct Feeds {
    /// Whether a signal can have several sources at all.
    is_on: bool,
    owners: HashMap<(LoopId, Signal), Owner>,
}

impl Feeds {
    /// Without bundles and mapped keys each signal has one key; then only watched signals are remembered.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        Self { is_on: can_have_several(config), owners: HashMap::new() }
    }

    /// Adopts new mappings. The sources of remapped loops are forgotten.
    pub fn reconfigure(&mut self, config: &Config, remapped: &HashSet<LoopId>) {
        self.is_on = can_have_several(config);
        self.forget(remapped);
    }

    /// A value of a signal, with its source, the number of its message and its stamp.
    pub fn feed(&mut self, (id, signal): (LoopId, Signal), source: &str, message: u64, t_ns: i64) -> Feed {
        if !self.is_on && !self.is_watched((id, signal)) {
            return Feed::Taken;
        }
        let new = || Owner::new(source, message, t_ns);
        let owner = self.owners.entry((id, signal)).or_insert_with(new);
        if *owner.source == *source {
            return owner.hear(message, t_ns);
        }
        if !owner.is_silent(source, message, t_ns) {
            return Feed::Ignored;
        }
        let from = std::mem::replace(owner, Owner::new(source, message, t_ns)).source;
        // A signal that comes rarely, such as the mode, cannot be seen to fall silent, so it changes over with the others.
        let gateway = gateway_of(&from);
        if gateway != gateway_of(source) {
            self.owners.retain(|(of, _), owner| *of != id || gateway_of(&owner.source) != gateway);
        }
        Feed::TakenOver { from }
    }

    /// Whether the source of a signal is known.
    #[must_use]
    pub fn is_watched(&self, signal: (LoopId, Signal)) -> bool {
        !self.owners.is_empty() && self.owners.contains_key(&signal)
    }

    /// Watches a signal from now on, with this source as its owner.
    pub fn watch(&mut self, signal: (LoopId, Signal), source: &str, message: u64, t_ns: i64) {
        self.owners.entry(signal).or_insert_with(|| Owner::new(source, message, t_ns));
    }

    /// Number of signals with a known source.
    #[cfg(test)]
    #[must_use]
    pub fn count(&self) -> usize {
        self.owners.len()
    }

    /// Forgets the sources of these loops.
    pub fn forget(&mut self, gone: &HashSet<LoopId>) {
        self.owners.retain(|(id, _), _| !gone.contains(id));
    }
}

/// Whether a signal can have several sources.
fn can_have_several(config: &Config) -> bool {
    !config.bundles.is_empty() || config.loops.iter().any(|one| !one.keys.is_empty())
}

impl Owner {
    fn new(source: &str, message: u64, t_ns: i64) -> Self {
        Self { source: source.into(), message, t_ns, interval_ns: 0.0, waiting: None, in_turn: 0, turn_ns: t_ns }
    }

    /// A message from the owner.
    fn hear(&mut self, message: u64, t_ns: i64) -> Feed {
        if message == self.message {
            return Feed::Taken;
        }
        let interval_ns = t_ns.saturating_sub(self.t_ns) as f64;
        if interval_ns > 0.0 && self.interval_ns > 0.0 {
            self.interval_ns += (interval_ns.min(LONGEST * self.interval_ns) - self.interval_ns) / FOLLOW;
        } else if interval_ns > 0.0 {
            self.interval_ns = interval_ns;
        }
        (self.message, self.t_ns) = (message, t_ns);
        let Some(waiting) = self.waiting.take() else { return Feed::Taken };
        if t_ns.saturating_sub(self.turn_ns) as f64 > FORGOTTEN * self.interval_ns {
            self.in_turn = 0;
        }
        (self.in_turn, self.turn_ns) = (self.in_turn.saturating_add(1), t_ns);
        if self.in_turn < IN_TURN { Feed::Taken } else { Feed::Contested { other: waiting.source } }
    }

    /// A message from another source: whether the owner has been silent long enough for this one to take over.
    fn is_silent(&mut self, source: &str, message: u64, t_ns: i64) -> bool {
        let fresh = || Waiting { source: source.into(), message, since_ns: t_ns, messages: 1, passed: 0 };
        let waiting = self.waiting.get_or_insert_with(fresh);
        if *waiting.source != *source {
            waiting.passed += 1;
            if waiting.passed >= QUEUED {
                *waiting = fresh();
            }
            return false;
        }
        waiting.passed = 0;
        if waiting.message != message {
            waiting.message = message;
            waiting.messages += 1;
        }
        // A key that differs only in upper and lower case comes from another gateway: both mean the same signal.
        if gateway_of(source) == gateway_of(&self.source) && !source.eq_ignore_ascii_case(&self.source) {
            return false;
        }
        let limit_ns = if self.interval_ns > 0.0 { (INTERVALS * self.interval_ns).max(LEAST_NS) } else { UNKNOWN_NS };
        waiting.messages >= MESSAGES && t_ns.saturating_sub(waiting.since_ns) as f64 >= limit_ns
    }
}

/// The part of a source that falls silent as a whole: the key of a bundle, or a plain key without its last chunk.
fn gateway_of(source: &str) -> &str {
    let end = source.find(NAME_MARK).or_else(|| source.rfind('/'));
    end.map_or(source, |end| &source[..end])
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: i64 = 1_000_000_000;

    struct Loop {
        feeds: Feeds,
        id: LoopId,
        message: u64,
    }

    impl Loop {
        fn new() -> Self {
            let config = Config::parse("[site]\nprefix = \"p\"\n[[bundle]]\nkey = \"gw/**\"\n").unwrap();
            let id = stiction_engine::engine::Engine::new(config.engine()).appear("L").unwrap();
            Self { feeds: Feeds::new(&config), id, message: 0 }
        }

        fn hear(&mut self, signal: Signal, source: &str, t_s: i64) -> Feed {
            self.message += 1;
            self.feeds.feed((self.id, signal), source, self.message, t_s * S)
        }

        fn op(&mut self, gateway: &str, t_s: i64) -> Feed {
            self.hear(Signal::Op, &format!("{gateway}#L.OP"), t_s)
        }
    }

    #[test]
    fn a_silent_source_is_followed_by_the_next_one_after_five_intervals_and_not_before() {
        let mut one = Loop::new();
        assert!((0..100).all(|k| one.op("gw/a", 10 * k) == Feed::Taken));
        // The other gateway's clock is an hour ahead.
        let second: Vec<Feed> = (0..8).map(|k| one.op("gw/b", 4600 + 10 * k)).collect();
        assert!(second[..5].iter().all(|f| *f == Feed::Ignored));
        assert_eq!(second[5], Feed::TakenOver { from: "gw/a#L.OP".into() });
        assert!(second[6..].iter().all(|f| *f == Feed::Taken));
        // The first one comes back: the second keeps the signal as long as it is heard.
        assert_eq!((one.op("gw/a", 1100), one.op("gw/b", 4680)), (Feed::Ignored, Feed::Taken));
        let back: Vec<Feed> = (0..6).map(|k| one.op("gw/a", 1110 + 10 * k)).collect();
        assert_eq!(back[5], Feed::TakenOver { from: "gw/b#L.OP".into() });
    }

    #[test]
    fn two_live_sources_are_named_and_one_is_taken() {
        let mut one = Loop::new();
        let mut contested = 0;
        for k in 0..1000 {
            match one.op("gw/a", k) {
                Feed::Contested { other } => {
                    assert_eq!(&*other, "gw/b#L.OP");
                    contested += 1;
                }
                taken => assert_eq!(taken, Feed::Taken),
            }
            // The other sends in batches of ten seconds.
            if k % 10 == 9 {
                one.message += 1;
                let (key, message) = ((one.id, Signal::Op), one.message);
                assert!((k - 9..k).all(|t| one.feeds.feed(key, "gw/b#L.OP", message, t * S) == Feed::Ignored));
            }
        }
        assert_eq!(contested, 97, "all but the first two of 99 times");
    }

    #[test]
    fn sources_that_cross_at_a_change_are_no_fault() {
        let mut one = Loop::new();
        (0..50).for_each(|k| assert_eq!(one.op("gw/a", k), Feed::Taken));
        for change in 0..5 {
            let (old, new) = if change % 2 == 0 { ("gw/a", "gw/b") } else { ("gw/b", "gw/a") };
            let start = 50 + 1000 * change;
            let heard: Vec<Feed> = (start..start + 900).map(|k| one.op(new, k)).collect();
            assert_eq!(heard.iter().filter(|f| matches!(f, Feed::TakenOver { .. })).count(), 1);
            assert!(!heard.iter().any(|f| matches!(f, Feed::Contested { .. })));
            // A late message from the old source.
            assert_eq!(one.op(old, start + 900), Feed::Ignored);
            assert_eq!(one.op(new, start + 901), Feed::Taken);
        }
    }

    #[test]
    fn rare_signals_of_the_same_gateway_go_over_with_the_others() {
        let mut one = Loop::new();
        assert_eq!(one.hear(Signal::Mode, "gw/a#L.MODE", 0), Feed::Taken);
        (0..100).for_each(|k| assert_eq!(one.op("gw/a", k), Feed::Taken));
        assert_eq!(one.hear(Signal::Mode, "gw/b#L.MODE", 100), Feed::Ignored);
        assert!((100..106).any(|k| matches!(one.op("gw/b", k), Feed::TakenOver { .. })));
        assert_eq!(one.hear(Signal::Mode, "gw/b#L.MODE", 107), Feed::Taken);
    }

    #[test]
    fn a_third_source_takes_over_where_the_second_is_silent_too() {
        let mut one = Loop::new();
        (0..50).for_each(|k| assert_eq!(one.op("gw/a", k), Feed::Taken));
        assert_eq!(one.op("gw/b", 50), Feed::Ignored);
        let third: Vec<Feed> = (51..90).map(|k| one.op("gw/c", k)).collect();
        assert!(third.contains(&Feed::TakenOver { from: "gw/a#L.OP".into() }));
        let mut few = Loop::new();
        assert_eq!(few.op("gw/a", 0), Feed::Taken);
        assert!((1..61).all(|k| few.op("gw/b", k) == Feed::Ignored), "its pace is not known");
        assert_eq!(few.op("gw/b", 61), Feed::TakenOver { from: "gw/a#L.OP".into() });
    }

    #[test]
    fn another_name_of_the_same_gateway_never_takes_over() {
        let mut one = Loop::new();
        (0..50).for_each(|k| assert_eq!(one.op("gw/a", k), Feed::Taken));
        assert!((50..500).all(|k| one.hear(Signal::Op, "gw/a#L.OUT", k) == Feed::Ignored));
        assert_eq!(gateway_of("p/L/op"), "p/L");
    }

    #[test]
    fn without_bundles_and_mapped_keys_nothing_is_remembered() {
        let mut feeds = Feeds::new(&Config::with_prefix("p"));
        let id = stiction_engine::engine::Engine::new(Config::with_prefix("p").engine()).appear("L").unwrap();
        assert_eq!(feeds.feed((id, Signal::Op), "p/L/op", 1, 0), Feed::Taken);
        assert!(feeds.owners.is_empty());
    }

    #[test]
    fn one_key_in_two_spellings_is_two_sources_and_the_one_that_stays_is_taken() {
        let mut one = Loop { feeds: Feeds::new(&Config::with_prefix("p")), ..Loop::new() };
        assert_eq!(one.hear(Signal::Op, "p/L/op", 0), Feed::Taken);
        one.feeds.watch((one.id, Signal::Op), "p/L/op", 1, 0);
        let heard: Vec<[Feed; 2]> =
            (1..9).map(|k| [one.hear(Signal::Op, "p/L/OP", k), one.hear(Signal::Op, "p/L/op", k)]).collect();
        assert!(heard.iter().all(|[second, _]| *second == Feed::Ignored));
        assert_eq!(heard[7][1], Feed::Contested { other: "p/L/OP".into() });
        let alone: Vec<Feed> = (10..30).map(|k| one.hear(Signal::Op, "p/L/OP", k)).collect();
        assert!(alone.contains(&Feed::TakenOver { from: "p/L/op".into() }));
        assert_eq!(one.hear(Signal::Op, "p/L/op", 30), Feed::Ignored, "still watched");
    }
}
