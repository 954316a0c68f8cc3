//! The configuration: parses TOML text to a [`Config`] or to all its faults. Reads no files.

mod alarm;
mod bundle;
mod changes;
mod deliver;
mod engine;
mod input;
mod loops;
pub(crate) mod reader;
mod scale;
mod service;
mod zenoh;

use serde::Serialize;
use toml::de::DeTable;

use alarm::read_alarm;
pub use bundle::{BundleKey, NAME_MARK};
pub use changes::{ChangedLoop, ConfigChanges};
pub use deliver::{Address, Deliver};
pub use input::Input;
pub use loops::{Action, setting_of};
pub use reader::{Fault, Places};
use reader::{Lines, TableReader, subtable, syntax_fault};
pub use scale::{Daemon, is_id};
pub use service::{Commands, Plant, RawForm, Recording, Retention, Summary, VerdictParams};
pub use zenoh::{Zenoh, ZenohMode};

use crate::alarm::AlarmParams;
use crate::engine::{GapParams, WindowParams};
use crate::hash::short_hash;
use crate::shard::Shard;
use stiction::core::record::Signal;
use stiction::core::units::{FinalElement, LoopKind, is_loop_name};
use stiction::samples::history::{LEAST_BYTES, fitting};

/// Whether the settings have their defaults.
fn is_default<T: Default + PartialEq>(settings: &T) -> bool {
    *settings == T::default()
}

/// Tables that occur once.
const TABLES: [&str; 15] = [
    "site",
    "zenoh",
    "input",
    "window",
    "verdict",
    "alarm",
    "gap",
    "recording",
    "retention",
    "commands",
    "web",
    "daemon",
    "shard",
    "plant",
    "summary",
];

/// All settings of the daemon. Field names are the keys in the text.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Config {
    /// Key prefix of the plant.
    pub site: Site,
    /// Connections of the bus.
    pub zenoh: Zenoh,
    /// Accepted data.
    pub input: Input,
    /// Windows; loops may override.
    pub window: WindowParams,
    /// Assumptions of probabilities. Omitted from [`Config::hash`] while not set.
    #[serde(skip_serializing_if = "is_default")]
    pub verdict: VerdictParams,
    /// Alarms; loops may override.
    pub alarm: AlarmParams,
    /// The gap diagnosis. Omitted from [`Config::hash`] while not set, so that older recordings still verify.
    #[serde(skip_serializing_if = "is_default")]
    pub gap: GapParams,
    /// Recording.
    pub recording: Recording,
    /// How long recordings are kept. Like the next one omitted from [`Config::hash`] while not set.
    #[serde(skip_serializing_if = "is_default")]
    pub retention: Retention,
    /// Accepted commands.
    #[serde(skip_serializing_if = "is_default")]
    pub commands: Commands,
    /// Metrics, health and the page over HTTP.
    pub web: Web,
    /// Identity of this daemon. Like the next not part of [`Config::hash`], because it changes no answer.
    #[serde(skip_serializing)]
    pub daemon: Daemon,
    /// Its fixed part of all loops.
    #[serde(skip_serializing)]
    pub shard: Shard,
    /// Groups of loops. Omitted from [`Config::hash`] while not set.
    #[serde(skip_serializing_if = "is_default")]
    pub plant: Plant,
    /// The summary of data health. Like the next not part of [`Config::hash`], because it changes no other document.
    #[serde(skip_serializing)]
    pub summary: Summary,
    /// Receivers outside the bus. Not part of [`Config::hash`], because delivery changes no document.
    #[serde(skip_serializing)]
    pub deliver: Vec<Deliver>,
    /// Keys with several signals per payload. Omitted from [`Config::hash`] while there are none.
    #[serde(rename = "bundle", skip_serializing_if = "Vec::is_empty")]
    pub bundles: Vec<BundleKey>,
    /// Loops with mapped keys or their own settings.
    #[serde(rename = "loop")]
    pub loops: Vec<LoopConfig>,
}

/// `[site]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Site {
    /// Prefix of every key.
    pub prefix: String,
}

/// `[web]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Web {
    /// Whether to serve HTTP.
    pub enabled: bool,
    /// Address and port; port 0 takes any free one.
    pub listen: String,
    /// Whether `/metrics` has series per loop. Like the next one not part of [`Config::hash`].
    #[serde(skip_serializing)]
    pub loop_series: bool,
    /// Most loops with series.
    #[serde(skip_serializing)]
    pub max_loop_series: usize,
    /// The web page. Like all below not part of [`Config::hash`].
    #[serde(skip_serializing)]
    pub page: Page,
}

/// Keys of `[web]` for the page.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Page {
    /// Whether the page is served: `page`.
    #[serde(rename = "page")]
    pub enabled: bool,
    /// Address of a `stictiond workbench` to link to: `workbench`; empty: none.
    pub workbench: String,
    /// Time zone for displayed times: `time_zone`, an IANA name such as `Europe/Berlin`.
    pub time_zone: String,
    /// File with the token that every command then needs: `token_file`; empty: only this machine may send commands.
    pub token_file: String,
    /// Whether connections come through a proxy, so that a loopback peer may be anyone: `behind_proxy`.
    pub behind_proxy: bool,
    /// Path of a Unix socket to serve as well: `socket`; empty: none.
    pub socket: String,
    /// Names by which browsers may call it, in addition to its address: `hosts`.
    pub hosts: Vec<String>,
}

impl Default for Page {
    fn default() -> Self {
        Self {
            enabled: true,
            workbench: String::new(),
            time_zone: "UTC".into(),
            token_file: String::new(),
            behind_proxy: false,
            socket: String::new(),
            hosts: Vec::new(),
        }
    }
}

/// `[[loop]]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LoopConfig {
    /// Name in every topic.
    pub name: String,
    /// Foreign keys by signal.
    pub keys: Vec<(Signal, String)>,
    /// Range of OP, for sizes in % of travel.
    pub op_range: Option<[f64; 2]>,
    /// Controlled quantity, if the first letters of the name do not give it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kind: Option<LoopKind>,
    /// Its final element; omitted from [`Config::hash`] while it is a valve.
    #[serde(skip_serializing_if = "is_default")]
    pub final_element: FinalElement,
    /// Action of its controller; omitted from [`Config::hash`] while not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action: Option<Action>,
    /// Importance of the loop, 1 to 5.
    pub criticality: u8,
    /// Plant area; empty: not given. Like the next two omitted from [`Config::hash`] while not given.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub area: String,
    /// Name of the valve in the maintenance system.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub equipment: String,
    /// Unit of OP.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub op_unit: String,
    /// Names of the loops upstream; omitted from [`Config::hash`] while there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub upstream: Vec<String>,
    /// Its windows.
    pub window: WindowParams,
    /// Its alarms.
    pub alarm: AlarmParams,
}

impl Config {
    /// Reads a configuration.
    ///
    /// # Errors
    /// All faults of syntax, type, range and meaning, in order of the text.
    pub fn parse(text: &str) -> Result<Self, Vec<Fault>> {
        let (root, syntax) = DeTable::parse_recoverable(text);
        let lines = &Lines::new(text);
        let mut faults: Vec<Fault> = syntax.iter().map(|e| syntax_fault(lines, e)).collect();
        let root = root.get_ref();
        let config = Self::read(lines, root, &mut faults);
        refuse_unknown_tables(lines, root, &mut faults);
        faults.sort_by_key(|f| f.line);
        faults.dedup();
        if faults.is_empty() { Ok(config) } else { Err(faults) }
    }

    fn read(lines: &Lines, root: &DeTable<'_>, faults: &mut Vec<Fault>) -> Self {
        let mut open = |key: &str| subtable(lines, root, key, faults);
        let [
            site,
            zenoh,
            input,
            window,
            verdict,
            alarm,
            gap,
            recording,
            retention,
            commands,
            web,
            daemon,
            shard,
            plant,
            summary,
        ] = TABLES.map(|key| (key, open(key)));
        macro_rules! read {
            ($entry:expr, $read:expr) => {{
                let mut reader = TableReader::new(lines, $entry.0, $entry.1.1, $entry.1.0, faults);
                let value = $read(&mut reader);
                reader.close();
                value
            }};
        }
        let window = read!(window, |r: &mut TableReader<'_, '_>| read_window(r, WindowParams::default()));
        let alarm = read!(alarm, |r: &mut TableReader<'_, '_>| read_alarm(r, AlarmParams::default()));
        let config = Self {
            site: read!(site, read_site),
            zenoh: read!(zenoh, zenoh::read_zenoh),
            input: read!(input, input::read_input),
            window,
            verdict: read!(verdict, service::read_verdict),
            alarm,
            gap: read!(gap, read_gap),
            recording: read!(recording, service::read_recording),
            retention: read!(retention, service::read_retention),
            commands: read!(commands, service::read_commands),
            web: read!(web, read_web),
            daemon: read!(daemon, scale::read_daemon),
            shard: read!(shard, scale::read_shard),
            plant: read!(plant, service::read_plant),
            summary: read!(summary, service::read_summary),
            deliver: deliver::read_delivers(lines, root, faults),
            bundles: bundle::read_bundles(lines, root, faults),
            loops: loops::read_loops(lines, root, window, alarm, faults),
        };
        faults.extend(deliver::never_made(lines, root, &config.summary, &config.deliver));
        faults.extend(input::too_few_places(lines, root, config.input.max_loops, config.loops.len()));
        config
    }

    /// A configuration with all defaults and a valid prefix.
    #[must_use]
    pub fn with_prefix(prefix: &str) -> Self {
        let mut faults = Vec::new();
        let (root, _) = DeTable::parse_recoverable("");
        let mut config = Self::read(&Lines::new(""), root.get_ref(), &mut faults);
        config.site.prefix = prefix.to_owned();
        config
    }

    /// SHA-256 over all settings (not comments or order of the text), 16 hex digits.
    #[must_use]
    pub fn hash(&self) -> String {
        // Without JSON, all such configurations would share one hash.
        let canonical = serde_json::to_vec(self).unwrap_or_else(|_| format!("{self:?}").into_bytes());
        short_hash(&canonical)
    }

    /// The settings of one loop by name.
    #[must_use]
    pub fn loop_named(&self, name: &str) -> Option<&LoopConfig> {
        self.loops.iter().find(|l| l.name == name)
    }
}

fn refuse_unknown_tables(lines: &Lines, root: &DeTable<'_>, faults: &mut Vec<Fault>) {
    let known = [&TABLES[..], &["deliver", "bundle", "loop"]].concat();
    for (key, _) in root.iter().filter(|(k, _)| !known.iter().any(|known| known == k.get_ref())) {
        faults.push(Fault {
            line: lines.of(key.span().start),
            key: key.get_ref().to_string(),
            message: "unknown table or key".to_owned(),
            remedy: format!("valid keys: {}", known.join(", ")),
        });
    }
}

fn read_site(r: &mut TableReader<'_, '_>) -> Site {
    let line = r.line().max(1);
    let prefix = match r.text("prefix") {
        Some((prefix, line)) => {
            if !is_loop_name(&prefix) {
                r.refuse(line, "prefix", format!("{prefix:?} is not a valid prefix"), "write one such as plant1/area1");
            }
            prefix
        }
        None => {
            r.refuse(line, "prefix", "is missing", "write prefix = \"plant1/area1\" below [site]");
            String::new()
        }
    };
    Site { prefix }
}

fn read_window(r: &mut TableReader<'_, '_>, d: WindowParams) -> WindowParams {
    let year_s = 366.0 * 86_400.0;
    let mut w = WindowParams {
        min_periods: r.number("min_periods", d.min_periods, 2.0, 1000.0),
        max_periods: r.number("max_periods", d.max_periods, 2.0, 10_000.0),
        min_samples_per_period: r.number("min_samples_per_period", d.min_samples_per_period, 4.0, 10_000.0),
        min_reversals: r.integer("min_reversals", d.min_reversals as u64, 1, 10_000) as usize,
        hop_s: r.number(r.either("every_s", "hop_s"), d.hop_s, 0.001, year_s),
        max_window_s: r.number("max_window_s", d.max_window_s, 0.01, year_s),
        max_gap_s: r.number("max_gap_s", d.max_gap_s, 0.0, year_s),
        lateness_s: r.number("lateness_s", d.lateness_s, 0.0, 86_400.0),
        max_points: r.integer("max_points", d.max_points as u64, 128, 1_000_000) as usize,
        max_bytes: r.integer("max_bytes", d.max_bytes as u64, 0, 1 << 40) as usize,
    };
    if (1..LEAST_BYTES).contains(&w.max_bytes) {
        let line = r.line();
        let said = format!("{} bytes are too few for a window", w.max_bytes);
        r.refuse(line, "max_bytes", said, format!("write 0 or at least {LEAST_BYTES}"));
    } else if w.max_bytes > 0 {
        w.max_points = fitting(w.max_points, w.max_bytes)[0];
    }
    // An inherited contradiction was already refused in `[window]`.
    if w.max_periods < w.min_periods && (w.max_periods, w.min_periods) != (d.max_periods, d.min_periods) {
        let line = r.line();
        r.refuse(line, "max_periods", format!("{} is below min_periods {}", w.max_periods, w.min_periods), "raise it");
    }
    if w.max_window_s < w.hop_s && (w.max_window_s, w.hop_s) != (d.max_window_s, d.hop_s) {
        let line = r.line();
        r.refuse(line, "max_window_s", format!("{} is below every_s {}", w.max_window_s, w.hop_s), "raise it");
    }
    w
}

fn read_gap(r: &mut TableReader<'_, '_>) -> GapParams {
    let d = GapParams::default();
    GapParams {
        enabled: r.boolean("enabled", d.enabled),
        budget_evaluations: r.integer("budget_evaluations", d.budget_evaluations, 1_000, 100_000_000),
    }
}

/// Default of `[web] max_loop_series`: with about eight series for each loop, a collector can take this in one scrape.
const MAX_LOOP_SERIES: u64 = 1000;

fn read_web(r: &mut TableReader<'_, '_>) -> Web {
    let enabled = r.boolean("enabled", true);
    let mut listen = "127.0.0.1:8080".to_owned();
    if let Some((text, line)) = r.text("listen") {
        if text.parse::<core::net::SocketAddr>().is_err() {
            r.refuse(
                line,
                "listen",
                format!("{text:?} is not an address"),
                "write ADDRESS:PORT, such as 127.0.0.1:8080",
            );
        }
        listen = text;
    }
    let loop_series = r.boolean("loop_series", true);
    let max_loop_series = r.integer("max_loop_series", MAX_LOOP_SERIES, 1, 1_000_000) as usize;
    Web { enabled, listen, loop_series, max_loop_series, page: read_page(r) }
}

fn read_workbench(r: &mut TableReader<'_, '_>) -> String {
    let remedy = "the address of a `stictiond workbench`, such as \"http://127.0.0.1:8090\", or remove the key";
    let Some((url, line)) = r.text_or("workbench", remedy) else { return String::new() };
    let web = url.strip_prefix("http://").or_else(|| url.strip_prefix("https://"));
    if !url.is_empty() && web.is_none_or(|rest| rest.is_empty() || rest.contains([' ', '"', '<'])) {
        r.refuse(line, "workbench", format!("{url:?} is not an address"), format!("write {remedy}"));
    }
    url
}

fn read_page(r: &mut TableReader<'_, '_>) -> Page {
    let d = Page::default();
    let mut time_zone = d.time_zone;
    if let Some((name, line)) = r.text("time_zone") {
        let word =
            |part: &str| !part.is_empty() && part.chars().all(|c| c.is_ascii_alphanumeric() || "_+-".contains(c));
        if !name.split('/').all(word) {
            let remedy = "write a name such as Europe/Berlin, or UTC";
            r.refuse(line, "time_zone", format!("{name:?} is not a time zone"), remedy);
        }
        time_zone = name;
    }
    let hosts = r.texts("hosts");
    for (host, line) in &hosts {
        if host.is_empty() || host.contains(['/', ' ', '@']) {
            let remedy = "write a host name as in the browser's address bar, such as stiction.plant1.example";
            r.refuse(*line, "hosts", format!("{host:?} is not a host name"), remedy);
        }
    }
    Page {
        enabled: r.boolean("page", d.enabled),
        workbench: read_workbench(r),
        time_zone,
        token_file: r.text("token_file").map(|(t, _)| t).unwrap_or_default(),
        behind_proxy: r.boolean("behind_proxy", d.behind_proxy),
        socket: r.text("socket").map(|(t, _)| t).unwrap_or_default(),
        hosts: hosts.into_iter().map(|(host, _)| host).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_prefix_alone_is_enough() {
        let config = Config::parse("[site]\nprefix = \"plant1/area1\"\n").unwrap();
        assert_eq!(config, Config::with_prefix("plant1/area1"));
        assert_eq!(config.window, WindowParams::default());
        assert_eq!(config.hash().len(), 16);
    }

    #[test]
    fn every_fault_is_told_at_once_with_line_and_remedy() {
        let text = "[site]\nprefx = \"a\"\n[window]\nevery_s = \"x\"\nmin_periods = 1\n[alarm]\nraise = [5, 4]\n[nonsense]\n\
                    [[loop]]\nname = \"A\"\nevery_s = 1\n[[loop]]\nname = \"A\"\nop_range = [5, 5]\n";
        let faults = Config::parse(text).unwrap_err();
        let seen: Vec<(usize, &str)> = faults.iter().map(|f| (f.line, f.key.as_str())).collect();
        for wanted in [
            (2, "site.prefx"),
            (4, "window.every_s"),
            (5, "window.min_periods"),
            (7, "alarm.raise"),
            (8, "nonsense"),
            (12, "loop[1].name"),
            (14, "loop[1].op_range"),
        ] {
            assert!(seen.contains(&wanted), "{wanted:?} not in {seen:?}");
        }
        assert!(seen.iter().any(|(_, key)| *key == "site.prefix"));
        assert!(faults.iter().filter(|f| !f.key.is_empty()).all(|f| !f.remedy.is_empty()));
    }

    #[test]
    fn the_workbench_is_an_address_and_no_longer_a_switch() {
        let parse = |value: &str| Config::parse(&format!("[site]\nprefix = \"p\"\n[web]\nworkbench = {value}\n"));
        let url = "https://tools.example:8090/";
        assert_eq!(parse(&format!("{url:?}")).unwrap().web.page.workbench, url);
        assert_eq!(parse("\"\"").unwrap(), Config::with_prefix("p"));
        for wrong in ["true", "false", "\"javascript:alert(1)\"", "\"tools.example\"", "\"http://\""] {
            let faults = parse(wrong).unwrap_err();
            assert_eq!((faults.len(), faults[0].line, faults[0].key.as_str()), (1, 4, "web.workbench"));
            assert!(faults[0].remedy.contains("stictiond workbench") && faults[0].remedy.contains("remove the key"));
        }
    }

    #[test]
    fn broken_syntax_is_told_with_its_line() {
        let faults = Config::parse("[site]\nprefix = \"a\"\nx = = 3\n").unwrap_err();
        assert!(faults.iter().any(|f| f.line == 3), "{faults:?}");
    }

    #[test]
    fn a_loop_overrides_windows_and_alarms() {
        let text =
            "[site]\nprefix = \"p\"\n[window]\nevery_s = 60\n[[loop]]\nname = \"A\"\nevery_s = 30\ns_limit_op = 2\n";
        let config = Config::parse(text).unwrap();
        let a = config.loop_named("A").unwrap();
        assert_eq!((a.window.hop_s, a.alarm.s_limit_op, config.window.hop_s), (30.0, 2.0, 60.0));
        // Recordings contain configurations with the older key.
        assert_eq!(Config::parse(&text.replace("every_s", "hop_s")).unwrap(), config);
        let both = Config::parse(&text.replace("every_s = 60", "every_s = 60\nhop_s = 70")).unwrap_err();
        assert_eq!((both.len(), both[0].key.as_str()), (1, "window.hop_s"));
    }

    #[test]
    fn an_older_key_names_the_new_one() {
        let text = "[site]\nprefix = \"p\"\n[[loop]]\nname = \"A\"\nmv = \"gw/a\"\n";
        let faults = Config::parse(text).unwrap_err();
        assert_eq!(faults[0].to_string(), "line 5: loop[0].mv: is called position now; write position = …");
        let config = Config::parse(&text.replace("mv =", "position =")).unwrap();
        assert_eq!(config.loops[0].keys, [(Signal::Mv, "gw/a".to_owned())]);
    }

    #[test]
    fn the_hash_hangs_on_the_gap_only_where_it_is_set() {
        let hash = |gap: &str| Config::parse(&format!("[site]\nprefix = \"p\"\n{gap}")).unwrap().hash();
        // The hash also changes with the meaning of a default, as for the alarm's limit: recordings state under which they were
        // made.
        assert_eq!(hash(""), "ada9e54cf146250a");
        assert_eq!(hash("[gap]\nenabled = true\n"), hash(""));
        assert_ne!(hash("[gap]\nenabled = false\n"), hash(""));
        assert_ne!(hash("[gap]\nbudget_evaluations = 5000\n"), hash(""));
    }

    #[test]
    fn backslashes_in_double_quotes_are_a_fault() {
        let faults = Config::parse("[site]\nprefix = \"p\"\n[recording]\ndir = \"C:\\recordings\\new\"\n").unwrap_err();
        let told: Vec<String> = faults.iter().map(ToString::to_string).collect();
        assert!(told[0].contains("line 4: recording.dir") && told[0].contains("single quotes"), "{told:?}");
        assert!(Config::parse("[site]\nprefix = \"p\"\n[recording]\ndir = 'C:\\recordings\\new'\n").is_ok());
    }

    proptest! {
        #[test]
        fn any_text_is_answered(text in "[\\[\\]a-z_=\"0-9\\.\\n ,{}#-]{0,200}") {
            let _ = Config::parse(&text);
        }
    }
}
