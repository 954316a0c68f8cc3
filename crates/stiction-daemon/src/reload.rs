//! Settings that change while the daemon runs, and those that cannot.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError, RwLock};

use serde_json::Value;

use stiction_monitor::config::{Commands, Config, Retention};
use stiction_runtime::faults::Faults;

/// Settings that take effect at once; all others do at the next start.
const AT_ONCE: [&str; 6] = [
    "commands.enabled",
    "commands.per_minute",
    "commands.runs_per_hour",
    "retention",
    "recording.max_bytes",
    "recording.max_s",
];
/// Name of the fault while the file cannot be used.
const FAULT: &str = "config";

/// A configuration file that is read again when somebody asks for it.
pub struct Reload {
    path: PathBuf,
    current: Config,
    retention: Arc<Mutex<Retention>>,
    commands: Arc<RwLock<Commands>>,
}

impl Reload {
    /// The file, what was read from it at the start, and where the retention worker and the web server look.
    #[must_use]
    pub const fn new(
        path: PathBuf,
        current: Config,
        retention: Arc<Mutex<Retention>>,
        commands: Arc<RwLock<Commands>>,
    ) -> Self {
        Self { path, current, retention, commands }
    }

    /// Reads the file again. Gives the configuration whose changeable settings hold from now on; says which cannot
    /// change. A file with faults changes nothing, and is a fault until it is mended and read again.
    pub fn read(&mut self, faults: &Faults) -> Option<Config> {
        let path = self.path.display();
        let text = std::fs::read_to_string(&self.path).map_err(|error| format!("{path}: {error}"));
        let parsed = text.and_then(|text| {
            Config::parse(&text).map_err(|faults| {
                let list: Vec<String> = faults.iter().map(ToString::to_string).collect();
                format!("{path}: {}", list.join("; "))
            })
        });
        match parsed {
            Ok(config) => {
                faults.clear(FAULT);
                let (now, later) = changes(&self.current, &config);
                if !later.is_empty() {
                    tracing::warn!(settings = later.join(", "), "changed in the file, but held until the next start");
                }
                tracing::info!(settings = now.join(", "), "configuration reloaded; these settings are in force");
                self.current.commands = config.commands.clone();
                *self.commands.write().unwrap_or_else(PoisonError::into_inner) = config.commands;
                self.current.retention = config.retention;
                *self.retention.lock().unwrap_or_else(PoisonError::into_inner) = config.retention;
                self.current.recording.max_bytes = config.recording.max_bytes;
                self.current.recording.max_s = config.recording.max_s;
                Some(self.current.clone())
            }
            Err(why) => {
                faults.raise(FAULT, format!("the changed configuration is not used, the old one holds: {why}"));
                None
            }
        }
    }
}

/// What differs: settings that can change at once, and those that cannot.
fn changes(old: &Config, new: &Config) -> (Vec<String>, Vec<String>) {
    let (old, new) = (settings(old), settings(new));
    let keys = old.keys().chain(new.keys().filter(|key| !old.contains_key(*key)));
    let differing = keys.filter(|key| old.get(*key) != new.get(*key)).cloned();
    let at_once = |key: &String| AT_ONCE.iter().any(|known| key == known || key.starts_with(&format!("{known}.")));
    differing.partition(at_once)
}

/// Every setting by its dotted key. What is left out of the hash at its default stands here too.
fn settings(config: &Config) -> BTreeMap<String, Value> {
    let mut root = serde_json::to_value(config).unwrap_or_default();
    for (key, table) in [
        ("commands", serde_json::to_value(&config.commands)),
        ("signing", serde_json::to_value(&config.signing)),
        ("retention", serde_json::to_value(config.retention)),
        ("gap", serde_json::to_value(config.gap)),
        ("deliver", serde_json::to_value(&config.deliver)),
        ("daemon", serde_json::to_value(&config.daemon)),
        ("shard", serde_json::to_value(config.shard)),
    ] {
        root[key] = table.unwrap_or_default();
    }
    root["web"]["loop_series"] = config.web.loop_series.into();
    root["web"]["max_loop_series"] = config.web.max_loop_series.into();
    if let (Value::Object(web), Ok(Value::Object(page))) = (&mut root["web"], serde_json::to_value(&config.web.page)) {
        web.extend(page);
    }
    root["input"]["queue_bytes"] = config.input.queue_bytes.into();
    root["input"]["new_loops_per_hour"] = config.input.new_loops_per_hour.into();
    root["input"]["forget_after_s"] = config.input.forget_after_s.into();
    root["input"]["max_rate_hz"] = config.input.max_rate_hz.into();
    root["input"]["max_ahead_s"] = config.input.max_ahead_s.into();
    let mut flat = BTreeMap::new();
    flatten("", &root, &mut flat);
    flat
}

fn flatten(key: &str, value: &Value, out: &mut BTreeMap<String, Value>) {
    let Value::Object(table) = value else {
        out.insert(key.to_owned(), value.clone());
        return;
    };
    for (name, value) in table {
        let dotted = if key.is_empty() { name.clone() } else { format!("{key}.{name}") };
        flatten(&dotted, value, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_changed_file_says_what_holds_now_and_a_broken_one_changes_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.toml");
        let first = "[site]\nprefix = \"p\"\n";
        let commands: Arc<RwLock<Commands>> = Arc::default();
        let mut reload = Reload::new(path.clone(), Config::parse(first).unwrap(), Arc::default(), commands.clone());
        let faults = Faults::default();
        let changed = format!(
            "{first}[web]\npage = false\n[window]\nhop_s = 60\n[commands]\nper_minute = 7\n[recording]\nmax_s = 9\n"
        );
        let new = Config::parse(&changed).unwrap();
        let (now, later) = changes(&reload.current, &new);
        assert_eq!(now, ["commands.per_minute", "recording.max_s"]);
        assert_eq!(later, ["web.page", "window.hop_s"]);
        std::fs::write(&path, changed).unwrap();
        let held = reload.read(&faults).unwrap();
        assert_eq!((held.commands.per_minute, held.recording.max_s, held.window.hop_s), (7, 9.0, 600.0));
        assert_eq!(commands.read().unwrap().per_minute, 7);
        std::fs::write(&path, "[site]\nprefx = 1\n").unwrap();
        assert!(reload.read(&faults).is_none());
        assert!(faults.list()[0].contains("the old one holds"), "{:?}", faults.list());
        std::fs::write(&path, first).unwrap();
        assert_eq!(reload.read(&faults).unwrap().commands.per_minute, 300);
        assert!(faults.list().is_empty());
    }
}
