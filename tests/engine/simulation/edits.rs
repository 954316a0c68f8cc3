//! Edits of the configuration under load: loops that are not edited give identical documents, and recordings replay across
//! every edit.
//!
//! `STICTIOND_LONG=1` makes a thousand edits instead of a hundred.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde_json::Value;
use stiction_engine::alarm::{AlarmAction, Command, State};
use stiction_engine::codec::topic::Kind;
use stiction_engine::config::{Config, ConfigChanges};
use stiction_files::disk::{Disk, SystemDisk};
use stictiond::daemon::sim_daemon::{SimDaemon, no_receiver};
use stictiond::runtime::clock::Clock;

use super::leavers::{CALM, STICKS, play, shown};
use super::plant::{below, one_in};
use super::refill::{chains_replay_to_the_byte, replays_to_the_byte};

/// Loops that are not edited, two of them configured, and the number of loops that are added, changed and removed.
const UNEDITED: [&str; 4] = ["U0", "U1", "U2", "U3"];
const EDITED: u32 = 6;
/// Edits in a run, and the most seconds between two.
const EDITS: usize = 10;
const APART_S: u32 = 40;

/// Documents of the unedited loops, by key.
type Said = BTreeMap<String, Vec<Vec<u8>>>;

/// A plant and its daemon. One seed determines the plant, another the edits.
struct Site {
    stage: SimDaemon,
    clock: Clock,
    dir: String,
    /// Entries of the edited loops, and a setting of `[commands]`.
    entries: BTreeMap<u32, String>,
    per_minute: u32,
    second: i64,
    plant: ChaCha8Rng,
    editor: ChaCha8Rng,
    said: Said,
    edits: BTreeMap<&'static str, usize>,
}

impl Site {
    fn start(dir: &Path, seed: u64) -> Self {
        let (clock, dir) = (Clock::standing(super::START_NS), dir.to_str().unwrap().to_owned());
        let text = text_of(&dir, &BTreeMap::new(), 300);
        let disk = Arc::new(SystemDisk) as Arc<dyn Disk>;
        let stage = SimDaemon::start(Config::parse(&text).unwrap(), &text, &clock, &disk, no_receiver).unwrap();
        Self {
            stage,
            clock,
            dir,
            entries: BTreeMap::new(),
            per_minute: 300,
            second: super::START_NS / 1_000_000_000,
            plant: ChaCha8Rng::seed_from_u64(seed),
            editor: ChaCha8Rng::seed_from_u64(seed + 1_000_000),
            said: Said::new(),
            edits: BTreeMap::new(),
        }
    }

    /// All loops send, and a person sometimes sends a command. Some fits are left for later.
    fn second(&mut self) {
        let edited = (0..EDITED).map(|k| format!("E{k}"));
        for (place, name) in UNEDITED.map(str::to_owned).into_iter().chain(edited).enumerate() {
            let pv = (self.second + place as i64) % 20;
            for (key, value) in
                [(format!("p/{name}/op"), 50), (format!("p/{name}/pv"), pv), (format!("gw/{name}/pv"), pv + 1)]
            {
                let json = format!(r#"{{"t": {}, "v": {value}}}"#, self.second * 1_000_000_000);
                self.stage.deliver(&key, json.as_bytes());
            }
        }
        if one_in(&mut self.plant, 20) {
            let cmd = if one_in(&mut self.plant, 2) { "out_of_service" } else { "in_service" };
            let name = match below(&mut self.plant, 8) {
                k @ 0..4 => UNEDITED[k as usize].to_owned(),
                k => format!("E{}", k - 4),
            };
            let command = Command { action: cmd.parse().unwrap(), by: Some("ann".into()), why: None, for_s: None };
            assert!(self.stage.command(&name, command, Box::new(|_| ())));
        }
        self.stage.turn();
        let fits = below(&mut self.plant, 3) as usize;
        self.work(fits);
        self.stage.record();
        assert!(self.stage.keep());
        self.clock.advance(Duration::from_secs(1));
        self.second += 1;
    }

    fn work(&mut self, most: usize) {
        self.stage.work(most, |_, request| Some(crate::answers::compute(request).assessment));
        for publication in self.stage.published() {
            let unedited = UNEDITED.iter().any(|name| publication.key.contains(&format!("/{name}/")));
            if unedited && matches!(publication.kind, Kind::Estimate | Kind::Alarm) {
                self.said.entry(publication.key).or_default().extend(publication.document);
            }
        }
    }

    /// Edits the file at random, and reloads it.
    fn edit(&mut self) {
        let random = &mut self.editor;
        for _ in 0..=below(random, 3) {
            let loop_number = below(random, EDITED);
            if one_in(random, 3) {
                self.entries.remove(&loop_number);
                continue;
            }
            let lines = [
                "hop_s = 15.0\n".to_owned(),
                "max_periods = 9.0\n".to_owned(),
                "raise = [1, 1]\n".to_owned(),
                "criticality = 5\narea = \"unit 7\"\n".to_owned(),
                "lateness_s = 2.0\n".to_owned(),
                format!("pv = \"gw/E{loop_number}/pv\"\n"),
            ];
            let chosen: String = lines.into_iter().filter(|_| one_in(random, 3)).collect();
            self.entries.insert(loop_number, format!("[[loop]]\nname = \"E{loop_number}\"\n{chosen}"));
        }
        self.per_minute = 300 + below(random, 3);
        let text = text_of(&self.dir, &self.entries, self.per_minute);
        let hash = self.stage.engine().config_hash().to_owned();
        if one_in(&mut self.editor, 4) {
            let refused = format!("{text}[web]\nlisten = \"127.0.0.1:1\"\n");
            assert!(self.stage.edit(Config::parse(&refused).unwrap(), &refused).is_none());
            self.stage.turn();
            assert_eq!(self.stage.engine().config_hash(), hash, "a file that is refused changes nothing");
        }
        let changes = self.stage.edit(Config::parse(&text).unwrap(), &text).unwrap();
        self.count(&changes);
    }

    fn count(&mut self, changes: &ConfigChanges) {
        let anew = changes.changed.iter().filter(|one| one.window_starts_empty).count();
        for (what, count) in [
            ("added", changes.added.len()),
            ("changed", changes.changed.len()),
            ("emptied", anew),
            ("removed", changes.removed.len()),
        ] {
            *self.edits.entry(what).or_default() += count;
        }
    }
}

fn text_of(dir: &str, entries: &BTreeMap<u32, String>, per_minute: u32) -> String {
    let edited: String = entries.values().map(String::as_str).collect();
    format!(
        "[site]\nprefix = \"p\"\n[window]\nhop_s = 20.0\nmax_window_s = 200.0\nmax_points = 128\n[gap]\nenabled = false\n\
         [plant]\ngroups = false\n[commands]\nper_minute = {per_minute}\n[recording]\ndir = {dir:?}\n\
         [[loop]]\nname = \"U0\"\nhop_s = 30.0\ncriticality = 5\n[[loop]]\nname = \"U1\"\npv = \"gw/U1/pv\"\n{edited}"
    )
}

/// A run with this many edits; returns the documents of the unedited loops.
fn run(dir: &Path, seed: u64, edits: usize) -> (Said, BTreeMap<&'static str, usize>) {
    let mut site = Site::start(dir, seed);
    for round in 0..EDITS {
        let apart_s = 5 + below(&mut site.plant, APART_S);
        (0..apart_s).for_each(|_| site.second());
        if round < edits {
            site.edit();
        }
    }
    (0..APART_S).for_each(|_| site.second());
    site.work(usize::MAX);
    site.stage.finish();
    (site.said, site.edits)
}

#[test]
fn loops_that_nobody_edits_say_the_same_to_the_byte_and_recordings_replay_across_edits() {
    let seeds = if std::env::var_os("STICTIOND_LONG").is_some() { 100 } else { 5 };
    let (mut documents, mut compared, mut edits) = (0, 0, BTreeMap::<&str, usize>::new());
    for seed in 0..seeds {
        let dir = tempfile::tempdir().unwrap();
        // Both in the same folder, whose name is part of the configuration's hash.
        let [without, with] = ["without", "with"].map(|_| dir.path().join("recordings"));
        let (calm, _) = run(&without, seed, 0);
        std::fs::rename(&without, dir.path().join("without")).unwrap();
        let (edited, counts) = run(&with, seed, EDITS);
        assert_eq!(calm.keys().collect::<Vec<_>>(), edited.keys().collect::<Vec<_>>(), "seed {seed}");
        for (key, said) in &calm {
            assert!(*said == edited[key], "seed {seed}: {key} differs from a run without edits");
            documents += said.len();
        }
        // Each file separately, or all of them in sequence.
        compared += if seed == 0 { replays_to_the_byte(&with) } else { chains_replay_to_the_byte(&with) };
        counts.into_iter().for_each(|(what, count)| *edits.entry(what).or_default() += count);
    }
    println!("{} edits: {edits:?}; {documents} documents equal, {compared} replayed", seeds as usize * EDITS);
    assert!(edits.values().all(|count| *count > 4), "{edits:?}");
    assert!(documents > 250 && compared > 500, "{documents} {compared}");
}

fn named(dir: &Path, entries: &str) -> String {
    format!(
        "[site]\nprefix = \"p\"\n[input]\ndiscover = false\nmax_ahead_s = 0.0\n[window]\nhop_s = 600.0\nmax_points = 400\n[alarm]\nraise = [1, 1]\n\
         [gap]\nenabled = false\n[recording]\ndir = {:?}\n{entries}",
        dir.to_str().unwrap()
    )
}

#[test]
fn a_removed_loop_takes_its_alarm_along_and_starts_empty_when_it_is_added_again() {
    let (dir, clock) = (tempfile::tempdir().unwrap(), Clock::standing(super::START_NS));
    let disk = Arc::new(SystemDisk) as Arc<dyn Disk>;
    let entry = |name: &str| format!("[[loop]]\nname = {name:?}\n");
    let text = named(dir.path(), &entry(STICKS));
    let start = |text: &str| SimDaemon::start(Config::parse(text).unwrap(), text, &clock, &disk, no_receiver).unwrap();
    let mut stage = start(&text);
    let edit = |stage: &mut SimDaemon, entries: &str| {
        let text = named(dir.path(), entries);
        let changes = stage.edit(Config::parse(&text).unwrap(), &text).unwrap();
        stage.turn();
        stage.record();
        assert!(stage.keep());
        (changes.to_string(), text)
    };
    play(&mut stage, CALM, 0);
    assert_eq!((stage.engine().count(), stage.metrics().estimates.get()), (0, 0), "not configured");
    play(&mut stage, STICKS, 0);
    assert_eq!(shown(&stage, STICKS), Some(State::Unack));
    let both = format!("{}{}", entry(STICKS), entry(CALM));
    assert_eq!(edit(&mut stage, &both).0, format!("added: {CALM}"));
    play(&mut stage, CALM, 0);
    assert_eq!((shown(&stage, STICKS), shown(&stage, CALM)), (Some(State::Unack), Some(State::Normal)));
    stage.published().for_each(drop);
    assert_eq!(edit(&mut stage, &entry(CALM)).0, format!("removed: {STICKS}"));
    let alarms: Vec<Value> = stage
        .published()
        .filter(|p| p.kind == Kind::Alarm)
        .map(|p| serde_json::from_slice(&p.document.unwrap()).unwrap())
        .collect();
    assert_eq!(alarms.len(), 1);
    assert_eq!(
        [&alarms[0]["loop"], &alarms[0]["event"], &alarms[0]["state"], &alarms[0]["active"]],
        [&Value::from(STICKS), &Value::from("removed"), &Value::from("normal"), &Value::from(false)]
    );
    assert_eq!(stage.overview().rows_after(0, None, usize::MAX, 0).len(), 1, "it is gone from the page");
    let answer = Arc::new(Mutex::new(None));
    let (told, command) =
        (answer.clone(), Command { action: AlarmAction::Ack, by: Some("ann".into()), why: None, for_s: None });
    assert!(stage.command(STICKS, command, Box::new(move |result| *told.lock().unwrap() = Some(result.is_ok()))));
    play(&mut stage, STICKS, 86_400_000_000_000);
    assert_eq!((*answer.lock().unwrap(), shown(&stage, STICKS)), (Some(false), None));
    let (_, text) = edit(&mut stage, &both);
    play(&mut stage, STICKS, 2 * 86_400_000_000_000);
    assert_eq!(shown(&stage, STICKS), Some(State::Unack));
    edit(&mut stage, &entry(CALM));
    edit(&mut stage, &both);
    stage.finish();
    drop(stage);
    assert!(chains_replay_to_the_byte(dir.path()) > 12);
    assert_eq!(shown(&start(&text), STICKS), None, "a start knows nothing of its alarm");
}
