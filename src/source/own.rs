//! Which loops are this daemon's, and under which keys they come.

use std::sync::{Arc, PoisonError, RwLock};

use zenoh::key_expr::keyexpr;

use stiction_monitor::config::{Config, NAME_MARK};
use stiction_monitor::ownership::{Live, Shard};

#[derive(Debug)]
enum Whose {
    All,
    Part(Shard),
    Shared { id: String, live: RwLock<Live> },
}

/// Which loops are this daemon's, as it stands now. Copies are the same.
#[derive(Debug, Clone)]
pub struct Own(Arc<Whose>);

impl Own {
    /// All loops: there is no other daemon.
    #[must_use]
    pub fn all() -> Self {
        Self(Arc::new(Whose::All))
    }

    /// As the configuration says. A member of a cluster has no loop until it has been told who lives.
    #[must_use]
    pub fn of(config: &Config, daemon_id: &str) -> Self {
        let whose = match config.shard.shard() {
            _ if config.cluster.is_on() => Whose::Shared { id: daemon_id.to_owned(), live: RwLock::default() },
            Some(shard) => Whose::Part(shard),
            None => Whose::All,
        };
        Self(Arc::new(whose))
    }

    /// Whether there is nobody to share with.
    #[must_use]
    pub fn is_all(&self) -> bool {
        matches!(*self.0, Whose::All)
    }

    /// Whether loops come and go as other daemons do.
    #[must_use]
    pub fn is_shared(&self) -> bool {
        matches!(*self.0, Whose::Shared { .. })
    }

    /// Whether a loop is this daemon's.
    #[must_use]
    pub fn has(&self, loop_name: &str) -> bool {
        match &*self.0 {
            Whose::All => true,
            Whose::Part(shard) => shard.owns(loop_name),
            Whose::Shared { id, live } => live.read().unwrap_or_else(PoisonError::into_inner).is_owner(id, loop_name),
        }
    }

    /// From now on these daemons share the loops.
    pub fn share_among(&self, now: Live) {
        if let Whose::Shared { live, .. } = &*self.0 {
            *live.write().unwrap_or_else(PoisonError::into_inner) = now;
        }
    }
}

/// Whether some of these key expressions bring a key already: what another subscription brings would come twice.
pub(super) fn brought(keys: &[String], key: &str) -> bool {
    let includes = |wide: &String| keyexpr::new(wide).is_ok_and(|w| keyexpr::new(key).is_ok_and(|k| w.includes(k)));
    keys.iter().any(includes)
}

/// Keys whose payloads hold several loops: every daemon takes them, and leaves out what is another's.
#[must_use]
pub fn carriers(config: &Config) -> Vec<String> {
    let mut keys: Vec<String> = Vec::new();
    let named = config.loops.iter().flat_map(|l| l.keys.iter()).filter(|(_, key)| key.contains(NAME_MARK));
    let named = named.filter_map(|(_, key)| key.split(NAME_MARK).next().map(str::to_owned));
    for key in config.bundles.iter().map(|bundle| bundle.key.clone()).chain(named) {
        if !brought(&keys, &key) {
            keys.retain(|known| !brought(std::slice::from_ref(&key), known));
            keys.push(key);
        }
    }
    keys
}

/// The keys of one loop alone: those below the prefix, and its foreign ones.
#[must_use]
pub fn keys_of(config: &Config, carriers: &[String], loop_name: &str) -> Vec<String> {
    let below = format!("{}/{loop_name}/*", config.site.prefix);
    let mapped = config.loop_named(loop_name).into_iter().flat_map(|l| l.keys.iter().map(|(_, key)| key.clone()));
    let mut keys = Vec::new();
    for key in std::iter::once(below).chain(mapped.filter(|key| !key.contains(NAME_MARK))) {
        if !brought(carriers, &key) && !brought(&keys, &key) {
            keys.push(key);
        }
    }
    keys
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loops_keys_are_its_own_and_carriers_are_everybodys() {
        let text = "[site]\nprefix = \"p\"\n[[bundle]]\nkey = \"gw/a/**\"\n[[loop]]\nname = \"A\"\nop = \"plc#A.OP\"\n\
                    pv = \"gw/a/pv\"\nsp = \"x/sp\"\nmv = \"p/A/mv\"\n";
        let config = Config::parse(text).unwrap();
        let carriers = carriers(&config);
        assert_eq!(carriers, ["gw/a/**", "plc"]);
        assert_eq!(keys_of(&config, &carriers, "A"), ["p/A/*", "x/sp"]);
        assert_eq!(keys_of(&config, &carriers, "u1/B"), ["p/u1/B/*"]);
    }

    #[test]
    fn a_member_has_nothing_until_it_knows_who_lives_and_then_its_part() {
        let of = |text: &str| Own::of(&Config::parse(&format!("[site]\nprefix = \"p\"\n{text}")).unwrap(), "a");
        let names: Vec<String> = (0..100).map(|k| format!("L{k}")).collect();
        let count = |own: &Own| names.iter().filter(|name| own.has(name)).count();
        assert!(of("").is_all() && count(&of("")) == 100);
        let part = of("[shard]\nindex = 1\ncount = 2\n");
        assert!(!part.is_all() && !part.is_shared() && count(&part).abs_diff(50) < 20);
        let member = of("[cluster]\nname = \"c\"\n");
        assert_eq!(count(&member), 0);
        member.share_among(["a", "b"].into_iter().collect());
        assert!(member.is_shared() && count(&member).abs_diff(50) < 20);
        member.share_among(["a"].into_iter().collect());
        assert_eq!(count(&member), 100);
    }
}
