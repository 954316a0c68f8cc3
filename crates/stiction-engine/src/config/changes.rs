//! Differences between two configurations: loops, settings that can change at run time, and settings that need a restart.

use std::collections::{BTreeMap, HashMap};
use std::fmt;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::loops::setting_of;
use super::{Config, LoopConfig};
use stiction::core::record::Signal;
use stiction::core::units::LoopKind;

/// Settings outside `[[loop]]` that can change at run time; all others need a restart.
const AT_ONCE: [&str; 11] = [
    "window",
    "verdict",
    "alarm",
    "gap",
    "commands.enabled",
    "commands.per_minute",
    "commands.runs_per_hour",
    "retention",
    "summary",
    "recording.max_bytes",
    "recording.max_s",
];
/// Most names listed in one line.
const LISTED: usize = 20;

/// Differences between the configuration in force and a new one.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct ConfigChanges {
    /// Loops that are new.
    pub added: Vec<String>,
    /// Loops in both, with different settings.
    pub changed: Vec<ChangedLoop>,
    /// Loops that are no longer in it.
    pub removed: Vec<String>,
    /// Settings outside `[[loop]]` that can change at run time, by their dotted keys.
    pub settings: Vec<String>,
    /// Settings that need a restart of the daemon.
    pub restart: Vec<String>,
}

/// A loop with different settings.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct ChangedLoop {
    /// Its name.
    #[serde(rename = "loop")]
    pub name: String,
    /// The keys that differ, including those inherited from `[window]` and `[alarm]`.
    pub keys: Vec<String>,
    /// Whether its window starts empty.
    pub window_starts_empty: bool,
}

impl ChangedLoop {
    /// Whether its signals have different keys.
    #[must_use]
    pub fn is_remapped(&self) -> bool {
        self.keys.iter().any(|key| Signal::ALL.iter().any(|signal| setting_of(*signal) == key))
    }
}

impl ConfigChanges {
    /// Whether nothing differs.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Why a running daemon cannot adopt the new configuration, and the remedy; `None` if it can.
    #[must_use]
    pub fn refusal(&self) -> Option<String> {
        (!self.restart.is_empty()).then(|| {
            let settings = listed(self.restart.iter().cloned());
            format!("cannot change while the daemon runs: {settings}; restart the daemon, or undo these changes")
        })
    }
}

/// One line for each kind of change.
impl fmt::Display for ConfigChanges {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let changed = self.changed.iter().map(|one| {
            let anew = if one.window_starts_empty { "; its window starts empty" } else { "" };
            format!("{} ({}{anew})", one.name, one.keys.join(", "))
        });
        let lines = [
            ("added", listed(self.added.iter().cloned())),
            ("changed", listed(changed)),
            ("removed", listed(self.removed.iter().cloned())),
            ("settings", listed(self.settings.iter().cloned())),
            ("need a restart", listed(self.restart.iter().cloned())),
        ];
        let lines: Vec<String> = lines
            .into_iter()
            .filter(|(_, names)| !names.is_empty())
            .map(|(what, names)| format!("{what}: {names}"))
            .collect();
        f.write_str(if lines.is_empty() { "no changes" } else { "" })?;
        f.write_str(&lines.join("\n"))
    }
}

/// The first names, and the number of further ones.
fn listed(names: impl ExactSizeIterator<Item = String>) -> String {
    let more = names.len().saturating_sub(LISTED);
    let first: Vec<String> = names.take(LISTED).collect();
    if more == 0 { first.join(", ") } else { format!("{} and {more} more", first.join(", ")) }
}

impl Config {
    /// Changes from this configuration, which is in force, to another one.
    #[must_use]
    pub fn changes_to(&self, other: &Self) -> ConfigChanges {
        let [old, new] = [self, other].map(settings);
        let keys = old.keys().chain(new.keys().filter(|key| !old.contains_key(*key)));
        let differing = keys.filter(|key| old.get(*key) != new.get(*key)).cloned();
        let at_once = |key: &String| AT_ONCE.iter().any(|known| key == known || key.starts_with(&format!("{known}.")));
        let (settings, restart) = differing.partition(at_once);
        let [before, after] = [self, other].map(by_name);
        let changed = other.loops.iter().filter_map(|new| {
            let old = before.get(new.name.as_str()).filter(|old| **old != new)?;
            let [held, next] = [(self, *old), (other, new)]
                .map(|(config, one)| config.of_loop(Some(one), LoopKind::of_tag(&one.name)));
            let window_starts_empty = !held.window_continues_under(&next);
            Some(ChangedLoop { name: new.name.clone(), keys: differing_keys(old, new), window_starts_empty })
        });
        let only_in = |loops: &[LoopConfig], there: &HashMap<&str, &LoopConfig>| {
            loops.iter().map(|one| &one.name).filter(|name| !there.contains_key(name.as_str())).cloned().collect()
        };
        ConfigChanges {
            added: only_in(&other.loops, &before),
            changed: changed.collect(),
            removed: only_in(&self.loops, &after),
            settings,
            restart,
        }
    }
}

fn by_name(config: &Config) -> HashMap<&str, &LoopConfig> {
    config.loops.iter().map(|one| (one.name.as_str(), one)).collect()
}

/// The keys of `[[loop]]` in which two entries differ.
fn differing_keys(old: &LoopConfig, new: &LoopConfig) -> Vec<String> {
    let key_of = |one: &LoopConfig, signal| one.keys.iter().find(|(s, _)| *s == signal).map(|(_, key)| key.clone());
    let mapped =
        Signal::ALL.into_iter().filter(|s| key_of(old, *s) != key_of(new, *s)).map(|s| setting_of(s).to_owned());
    let [before, after] = [old, new].map(|one| {
        let mut flat = BTreeMap::new();
        flatten("", &serde_json::to_value(one).unwrap_or_default(), &mut flat);
        flat
    });
    let names = before.keys().chain(after.keys().filter(|key| !before.contains_key(*key)));
    let differing = names.filter(|key| *key != "keys" && before.get(*key) != after.get(*key));
    // A loop entry has the keys of [window] and [alarm] at its top level.
    let own = differing.map(|key| key.rsplit('.').next().unwrap_or(key).to_owned());
    mapped.chain(own).collect()
}

/// Every setting outside `[[loop]]` by its dotted key, including those that the hash omits.
fn settings(config: &Config) -> BTreeMap<String, Value> {
    let mut root = serde_json::to_value(config).unwrap_or_default();
    if let Value::Object(tables) = &mut root {
        tables.remove("loop");
    }
    for (key, table) in [
        ("commands", serde_json::to_value(&config.commands)),
        ("retention", serde_json::to_value(config.retention)),
        ("gap", serde_json::to_value(config.gap)),
        ("verdict", serde_json::to_value(config.verdict)),
        ("plant", serde_json::to_value(config.plant)),
        ("summary", serde_json::to_value(&config.summary)),
        ("bundle", serde_json::to_value(&config.bundles)),
        ("deliver", serde_json::to_value(&config.deliver)),
        ("daemon", serde_json::to_value(&config.daemon)),
        ("shard", serde_json::to_value(config.shard)),
    ] {
        root[key] = table.unwrap_or_default();
    }
    root["window"]["max_bytes"] = config.window.max_bytes.into();
    root["recording"]["raw"] = config.recording.raw.name().into();
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
        // The field is named as recordings hash it.
        let name = if name == "hop_s" { "every_s" } else { name };
        let dotted = if key.is_empty() { name.to_owned() } else { format!("{key}.{name}") };
        flatten(&dotted, value, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "[site]\nprefix = \"p\"\n";

    fn changes(old: &str, new: &str) -> ConfigChanges {
        let [old, new] = [old, new].map(|text| Config::parse(&format!("{HEAD}{text}")).unwrap());
        old.changes_to(&new)
    }

    fn changed(old: &str, new: &str) -> (Vec<String>, bool) {
        let entry = |text: &str| format!("[[loop]]\nname = \"A\"\n{text}");
        let found = changes(&entry(old), &entry(new));
        assert_eq!((found.changed.len(), found.added.len(), found.removed.len(), found.restart.len()), (1, 0, 0, 0));
        (found.changed[0].keys.clone(), found.changed[0].window_starts_empty)
    }

    #[test]
    fn loops_are_added_changed_and_removed_and_the_others_are_not_named() {
        let old = "[[loop]]\nname = \"A\"\n[[loop]]\nname = \"B\"\n[[loop]]\nname = \"C\"\n";
        let new = "[[loop]]\nname = \"D\"\n[[loop]]\nname = \"C\"\n[[loop]]\nname = \"A\"\ncriticality = 5\n";
        let found = changes(old, new);
        assert_eq!(
            (found.added.as_slice(), found.removed.as_slice()),
            (["D".to_owned()].as_slice(), ["B".to_owned()].as_slice())
        );
        assert_eq!(found.to_string(), "added: D\nchanged: A (criticality)\nremoved: B");
        assert_eq!(found.refusal(), None);
        assert!(changes(new, new).is_empty());
        assert_eq!(changes(new, new).to_string(), "no changes");
    }

    #[test]
    fn a_window_starts_empty_only_where_its_samples_or_its_size_change() {
        for (old, new, key) in [
            ("", "op = \"gw/a\"\n", "op"),
            ("pv = \"gw/a\"\n", "pv = \"gw/b\"\n", "pv"),
            ("", "every_s = 60\n", "every_s"),
            ("", "position = \"gw/a\"\n", "position"),
            ("", "max_window_s = 86400\n", "max_window_s"),
            ("", "max_gap_s = 60\n", "max_gap_s"),
            ("", "lateness_s = 60\n", "lateness_s"),
            ("", "max_points = 500\n", "max_points"),
        ] {
            assert_eq!(changed(old, new), (vec![key.to_owned()], true), "{new}");
        }
        for (new, key) in [
            ("min_periods = 8\n", "min_periods"),
            ("min_reversals = 8\n", "min_reversals"),
            ("max_periods = 30\n", "max_periods"),
            ("min_samples_per_period = 9\n", "min_samples_per_period"),
            ("raise = [1, 1]\n", "raise"),
            ("op_range = [0, 100]\n", "op_range"),
            ("kind = \"level\"\n", "kind"),
            ("final_element = \"drive\"\n", "final_element"),
            ("criticality = 5\n", "criticality"),
            ("area = \"unit 1\"\n", "area"),
            ("upstream = [\"B\"]\n", "upstream"),
        ] {
            assert_eq!(changed("", new), (vec![key.to_owned()], false), "{new}");
        }
    }

    #[test]
    fn a_table_changes_the_loops_that_take_their_settings_from_it() {
        let loops = "[[loop]]\nname = \"A\"\n[[loop]]\nname = \"B\"\nevery_s = 30\n";
        let found = changes(loops, &format!("[window]\nevery_s = 60\n{loops}"));
        assert_eq!(found.settings, ["window.every_s"]);
        let names: Vec<&str> = found.changed.iter().map(|one| one.name.as_str()).collect();
        assert_eq!(names, ["A"]);
    }

    #[test]
    fn settings_outside_loops_are_taken_over_or_need_a_restart() {
        let text = "[web]\npage = false\n[commands]\nper_minute = 7\n[verdict]\nprevalence = 0.1\n[recording]\nmax_s = 9\n\
                    raw = \"columns\"\n[plant]\ngroups = false\n[input]\nmax_loops = 7\n[retention]\nraw_days = 3\n[summary]\nat = \"05:30\"\n\
                    [[bundle]]\nkey = \"gw/**\"\n[shard]\nindex = 0\ncount = 2\n";
        let found = changes("", text);
        assert_eq!(
            found.settings,
            ["commands.per_minute", "recording.max_s", "retention.raw_days", "summary.at", "verdict.prevalence"]
        );
        let restart = ["bundle", "input.max_loops", "plant.groups", "recording.raw", "shard.count", "web.page"];
        assert_eq!(found.restart, restart);
        let refusal = found.refusal().unwrap();
        assert!(refusal.contains("web.page") && refusal.contains("restart the daemon"), "{refusal}");
        let loops: String = (0..30).map(|k| format!("[[loop]]\nname = \"L{k}\"\n")).collect();
        assert!(changes("", &loops).to_string().ends_with("L19 and 10 more"));
    }
}
