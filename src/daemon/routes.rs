//! Finds the loop and signal of a key: from the mapped keys first, else from the key below the prefix.

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};

use crate::daemon::source::shares::Shares;
use stiction::core::record::Signal;
use stiction_engine::codec::topic::{Leaf, Topic, leaf};
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, LoopId};
use stiction_engine::shard::Shard;

/// Longest name of a discovered loop, bytes.
const NAME_BYTES: usize = 256;

/// Where a key leads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Route {
    /// A signal of a loop.
    To(LoopId, Signal),
    /// It names no signal.
    Foreign,
    /// A loop that is not configured, or a name that no loop can have.
    Refused,
    /// A new loop that exceeds the limit.
    Full,
    /// A loop of another shard.
    Elsewhere,
}

/// The table of keys, filled as they appear.
#[derive(Debug)]
pub struct Routes {
    prefix: String,
    discover: bool,
    mapped: HashMap<String, (String, Signal)>,
    /// The configured loops.
    configured: HashSet<String>,
    /// Keys that name a signal. Others are not kept, however many come.
    known: HashMap<Box<str>, Route>,
    /// Informed of each known key.
    shares: Shares,
    /// The part of the loops that this daemon serves.
    shard: Shard,
}

impl Routes {
    /// The routes that the configuration fixes.
    #[must_use]
    pub fn new(config: &Config, shares: Shares) -> Self {
        let mapped = config
            .loops
            .iter()
            .flat_map(|l| l.keys.iter().map(|(signal, key)| (key.clone(), (l.name.clone(), *signal))))
            .collect();
        let configured = config.loops.iter().map(|l| l.name.clone()).collect();
        let (prefix, discover) = (config.site.prefix.clone(), config.input.discover);
        Self { prefix, discover, mapped, configured, known: HashMap::new(), shares, shard: config.shard }
    }

    /// The route of a key. A new loop is created; one that is not configured only if `may_appear` agrees.
    pub fn of(&mut self, key: &str, engine: &mut Engine, may_appear: impl FnOnce() -> bool) -> Route {
        if let Some(route) = self.known.get(key) {
            return *route;
        }
        let route = match self.meaning(key) {
            None => Route::Foreign,
            Some((name, signal)) => self.to_loop(name, signal, engine, may_appear),
        };
        if matches!(route, Route::To(..)) && (is_usual(leaf(key)) || self.mapped.contains_key(key)) {
            self.known.insert(key.into(), route);
            self.shares.learn(key);
        }
        route
    }

    /// If the key is not in its usual spelling: another known key that names the same signal and differs only in the upper and
    /// lower case of its last chunk.
    #[must_use]
    pub fn respelled<'k>(&self, key: &'k str) -> Option<Cow<'k, str>> {
        let last = leaf(key);
        if !last.bytes().any(|b| b.is_ascii_uppercase()) {
            return None;
        }
        let usual = format!("{}{}", &key[..key.len() - last.len()], last.to_ascii_lowercase());
        Some(if self.known.contains_key(usual.as_str()) { Cow::Owned(usual) } else { Cow::Borrowed(key) })
    }

    /// The loop and signal that a key names.
    fn meaning<'a>(&'a self, key: &'a str) -> Option<(&'a str, Signal)> {
        let mapped = self.mapped.get(key).map(|(name, signal)| (name.as_str(), *signal));
        mapped.or_else(|| match Topic::parse(Some(&self.prefix), key)? {
            Topic { loop_name, leaf: Leaf::Raw(signal), .. } => Some((loop_name, signal)),
            Topic { .. } => None,
        })
    }

    /// The route of a loop's signal that came under a name in a payload or under a key.
    pub fn to_loop(&self, name: &str, signal: Signal, engine: &mut Engine, may_appear: impl FnOnce() -> bool) -> Route {
        if !(self.configured.contains(name) || self.discover && is_sound(name)) {
            return Route::Refused;
        }
        if !self.shard.owns(name) {
            return Route::Elsewhere;
        }
        let known = self.configured.contains(name) || engine.find(name).is_some();
        let appeared = (known || engine.has_room() && may_appear()).then(|| engine.appear(name)).flatten();
        appeared.map_or(Route::Full, |id| Route::To(id, signal))
    }

    /// Forgets the keys of these loops.
    pub fn forget(&mut self, gone: &HashSet<LoopId>) {
        let shares = &self.shares;
        self.known.retain(|key, route| {
            let stays = !matches!(route, Route::To(id, _) if gone.contains(id));
            if !stays {
                shares.unlearn(key);
            }
            stays
        });
    }

    /// Adopts new mappings and loop names; keys whose meaning has changed are forgotten.
    pub fn reconfigure(&mut self, config: &Config, engine: &Engine) {
        let before = std::mem::replace(self, Self::new(config, self.shares.clone()));
        for (key, route) in before.known {
            let is_same = match (route, self.meaning(&key)) {
                (Route::To(id, signal), Some(meant)) => meant == (&**engine.name(id), signal),
                _ => false,
            };
            if is_same {
                self.known.insert(key, route);
            } else {
                self.shares.unlearn(&key);
            }
        }
    }

    /// Number of known keys.
    #[cfg(test)]
    #[must_use]
    pub fn count(&self) -> usize {
        self.known.len()
    }

    /// Gives a key its own share of the queue.
    pub fn learn(&self, key: &str) {
        self.shares.learn(key);
    }
}

/// Whether a signal's name is all lower or all upper case; other spellings are understood but not stored.
fn is_usual(leaf: &str) -> bool {
    !leaf.bytes().any(|b| b.is_ascii_uppercase()) || !leaf.bytes().any(|b| b.is_ascii_lowercase())
}

/// Whether a name is acceptable for a loop: short, and without control characters, which could steer a terminal.
fn is_sound(name: &str) -> bool {
    !name.is_empty() && name.len() <= NAME_BYTES && !name.chars().any(char::is_control)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setup(text: &str) -> (Engine, Routes) {
        let config = Config::parse(text).unwrap();
        let routes = Routes::new(&config, Shares::default());
        (Engine::new(config.engine()), routes)
    }

    #[test]
    fn loops_are_discovered_below_the_prefix() {
        let (mut engine, mut routes) = setup("[site]\nprefix = \"p\"\n[input]\nmax_loops = 1\n");
        let Route::To(id, Signal::Op) = routes.of("p/A/op", &mut engine, || true) else { panic!() };
        assert_eq!(routes.of("p/A/pv", &mut engine, || true), Route::To(id, Signal::Pv));
        assert_eq!(routes.of("p/A/temperature", &mut engine, || true), Route::Foreign);
        assert_eq!(routes.of("p/B/op", &mut engine, || true), Route::Full);
    }

    #[test]
    fn loops_that_are_named_find_their_place_whoever_came_before() {
        let text = "[site]\nprefix = \"p\"\n[input]\nmax_loops = 3\n[[loop]]\nname = \"A\"\n";
        let (mut engine, mut routes) = setup(text);
        let strangers =
            (0..100_000).filter(|k| matches!(routes.of(&format!("p/x{k}/op"), &mut engine, || true), Route::To(..)));
        assert_eq!(strangers.count(), 2);
        assert!(matches!(routes.of("p/A/op", &mut engine, || false), Route::To(..)));
        assert_eq!((routes.known.len(), engine.ids().len()), (3, 3));
    }

    #[test]
    fn keys_that_mean_nothing_leave_nothing_behind() {
        let (mut engine, mut routes) = setup("[site]\nprefix = \"p\"\n[input]\nmax_loops = 1\n");
        assert!(matches!(routes.of("p/A/op", &mut engine, || true), Route::To(..)));
        for k in 0..1000 {
            assert_eq!(routes.of(&format!("p/A/x{k}"), &mut engine, || true), Route::Foreign);
            assert_eq!(routes.of(&format!("p/L{k}/op"), &mut engine, || true), Route::Full);
        }
        assert_eq!((routes.known.len(), engine.ids().len()), (1, 1));
        let (mut engine, mut routes) = setup("[site]\nprefix = \"p\"\n");
        for name in ["\u{1b}[2J", "a\u{7}b", &"n".repeat(300)] {
            assert_eq!(routes.of(&format!("p/{name}/op"), &mut engine, || true), Route::Refused);
        }
    }

    #[test]
    fn spellings_of_a_signal_are_one_signal_and_few_are_kept() {
        let (mut engine, mut routes) = setup("[site]\nprefix = \"p\"\n");
        let Route::To(id, _) = routes.of("p/A/mode", &mut engine, || true) else { panic!() };
        for k in 0..16 {
            let mode: String = "mode"
                .chars()
                .enumerate()
                .map(|(i, c)| if k >> i & 1 == 1 { c.to_ascii_uppercase() } else { c })
                .collect();
            assert_eq!(routes.of(&format!("p/A/{mode}"), &mut engine, || true), Route::To(id, Signal::Mode));
        }
        assert_eq!(routes.count(), 2);
        assert_eq!(routes.respelled("p/A/mode"), None);
        assert_eq!(routes.respelled("p/A/MODE").as_deref(), Some("p/A/mode"));
        assert_eq!(routes.respelled("p/A/PV").as_deref(), Some("p/A/PV"), "it came first");
    }

    #[test]
    fn foreign_keys_are_mapped_and_nothing_else_is_taken_without_discovery() {
        let text = "[site]\nprefix = \"p\"\n[input]\ndiscover = false\n[[loop]]\nname = \"A\"\nop = \"gw/A.MV\"\n";
        let (mut engine, mut routes) = setup(text);
        assert!(matches!(routes.of("gw/A.MV", &mut engine, || true), Route::To(_, Signal::Op)));
        assert!(matches!(routes.of("p/A/pv", &mut engine, || true), Route::To(_, Signal::Pv)));
        assert_eq!(routes.of("p/B/pv", &mut engine, || true), Route::Refused);
    }
}
