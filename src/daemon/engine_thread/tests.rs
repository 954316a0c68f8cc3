//! Loops that come, leave, receive commands and come back in any order leave nothing behind.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use proptest::prelude::*;

use super::EngineThread;
use crate::daemon::sim_daemon::{SimDaemon, no_receiver};
use crate::runtime::clock::Clock;
use stiction_engine::alarm::Command;
use stiction_engine::config::Config;
use stiction_files::disk::{Disk, SystemDisk};

const START_NS: i64 = 1_700_000_000_000_000_000;
/// Loops that come and go.
const LOOPS: usize = 12;

impl EngineThread {
    /// Number of entries that each part holds for loops.
    pub(crate) fn remains(&self) -> Vec<(&'static str, usize)> {
        vec![
            ("engine", self.loops.engine.count()),
            ("registered", self.loops.registered.count()),
            ("recordings", self.loops.registered.segments.len()),
            ("routes", self.inputs.routes.count()),
            ("limits", self.inputs.limits.count()),
            ("feeds", self.inputs.feeds.count()),
            ("schedule", self.loops.schedule.count()),
            ("series", self.outputs.board.as_ref().map_or(0, super::LoopMetrics::count)),
            (
                "page",
                self.outputs.overview.as_ref().map_or(0, |overview| overview.rows_after(0, None, usize::MAX, 0).len()),
            ),
            ("diagnoses", self.loops.asking.len()),
            ("stamps ahead", usize::from(self.inputs.ahead.is_some())),
        ]
    }
}

/// A daemon without threads, and what happened to it.
struct Plant {
    stage: SimDaemon,
    clock: Clock,
    config: Config,
    text: String,
    second: i64,
}

impl Plant {
    fn start(dir: &Path) -> Self {
        let text = format!(
            "[site]\nprefix = \"p\"\n[input]\nforget_after_s = 60.0\nnew_loops_per_hour = 1000000\n[window]\nhop_s = 20.0\n\
             [gap]\nenabled = false\n[recording]\ndir = {:?}\n[[bundle]]\nkey = \"gw/**\"\n",
            dir.to_str().unwrap()
        );
        let (config, clock) = (Config::parse(&text).unwrap(), Clock::standing(START_NS));
        let disk = Arc::new(SystemDisk) as Arc<dyn Disk>;
        let stage = SimDaemon::start(config.clone(), &text, &clock, &disk, no_receiver).unwrap();
        Self { stage, clock, config, text, second: START_NS / 1_000_000_000 }
    }

    fn pass(&mut self, seconds: u64) {
        self.clock.advance(Duration::from_secs(seconds));
        self.second += seconds as i64;
    }

    /// A loop sends for a while; the worker gives up its windows.
    fn send(&mut self, name: &str) {
        for _ in 0..30 {
            for signal in ["op", "pv"] {
                let sample = format!(r#"{{"t": {}, "v": {}}}"#, self.second * 1_000_000_000, self.second % 7);
                self.stage.deliver(&format!("p/{name}/{signal}"), sample.as_bytes());
            }
            self.stage.turn();
            self.pass(1);
        }
        let count =
            |held: &str| self.stage.remains().iter().find(|(what, _)| *what == held).map_or(0, |(_, count)| *count);
        assert!(count("feeds") > 0 && count("limits") > 0 && count("routes") > 0, "{:?}", self.stage.remains());
        self.stage.work(usize::MAX, |_, _| None);
        self.settle();
    }

    fn command(&mut self, name: &str, cmd: &str) {
        let command = Command { action: cmd.parse().unwrap(), by: Some("ann".into()), why: None, for_s: None };
        assert!(self.stage.command(name, command, Box::new(|_| ())));
        self.stage.turn();
        self.settle();
    }

    /// Reads the same configuration again.
    fn reload(&mut self) {
        assert!(self.stage.edit(self.config.clone(), &self.text).unwrap().is_empty());
        self.stage.turn();
        self.settle();
    }

    fn settle(&mut self) {
        self.stage.record();
        assert!(self.stage.keep());
    }

    /// All loops are silent for longer than the daemon remembers them.
    fn silence(&mut self) {
        self.pass(61);
        self.stage.health();
        self.stage.turn();
        self.settle();
    }

    fn recordings(&self) -> usize {
        std::fs::read_dir(&self.config.recording.dir)
            .unwrap()
            .flatten()
            .filter(|e| e.path().to_string_lossy().contains(".mcap"))
            .count()
    }
}

#[derive(Debug, Clone, Copy)]
enum Step {
    Send(usize),
    Silence,
    PutAside(usize),
    PutBack(usize),
    Reload,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (0..LOOPS).prop_map(Step::Send),
        1 => Just(Step::Silence),
        1 => (0..LOOPS).prop_map(Step::PutAside),
        1 => (0..LOOPS).prop_map(Step::PutBack),
        1 => Just(Step::Reload),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn loops_that_left_leave_nothing_behind(steps in proptest::collection::vec(step(), 1..30)) {
        let dir = tempfile::tempdir().unwrap();
        let mut plant = Plant::start(dir.path());
        let name = |k: usize| format!("L{k}");
        for step in steps {
            match step {
                Step::Send(k) => plant.send(&name(k)),
                Step::Silence => plant.silence(),
                Step::PutAside(k) => plant.command(&name(k), "out_of_service"),
                Step::PutBack(k) => plant.command(&name(k), "in_service"),
                Step::Reload => {
                    plant.reload();
                }
            }
            prop_assert!(plant.stage.engine().places() <= LOOPS);
        }
        // Loops out of service remain on display until somebody returns them to service.
        (0..LOOPS).for_each(|k| plant.command(&name(k), "in_service"));
        plant.send("last");
        plant.silence();
        let remains: Vec<_> = plant.stage.remains().into_iter().filter(|(_, count)| *count > 0).collect();
        prop_assert!(remains.is_empty(), "{:?}", remains);
        let files = plant.recordings();
        for _ in 0..5 {
            plant.reload();
        }
        prop_assert_eq!(plant.recordings(), files, "a reload opens no file of loops that left");
    }
}

#[test]
fn two_gateways_that_spell_a_signal_differently_are_two_sources() {
    let dir = tempfile::tempdir().unwrap();
    let text = format!("[site]\nprefix = \"p\"\n[recording]\ndir = {:?}\n", dir.path().to_str().unwrap());
    let (clock, disk) = (Clock::standing(START_NS), Arc::new(SystemDisk) as Arc<dyn Disk>);
    let mut stage = SimDaemon::start(Config::parse(&text).unwrap(), &text, &clock, &disk, no_receiver).unwrap();
    for k in 0..20 {
        for (signal, v) in [("op", 50), ("OP", 10)] {
            let sample = format!(r#"{{"t": {}, "v": {v}}}"#, START_NS + k * 1_000_000_000);
            stage.deliver(&format!("p/L/{signal}"), sample.as_bytes());
        }
    }
    stage.turn();
    assert_eq!(stage.metrics().second_source.get(), 20);
    let named = "L op comes from two sources at once: p/L/op is taken, p/L/OP is ignored";
    assert!(stage.faults().iter().any(|fault| fault.contains(named)), "{:?}", stage.faults());
}

#[test]
fn two_sensors_on_one_key_are_a_fault_that_names_it() {
    let dir = tempfile::tempdir().unwrap();
    let text = format!("[site]\nprefix = \"p\"\n[recording]\ndir = {:?}\n", dir.path().to_str().unwrap());
    let (clock, disk) = (Clock::standing(START_NS), Arc::new(SystemDisk) as Arc<dyn Disk>);
    let mut stage = SimDaemon::start(Config::parse(&text).unwrap(), &text, &clock, &disk, no_receiver).unwrap();
    let named = "p/L/pv: pv comes with other values for times that came already";
    let mut found = |times: i64| {
        for (k, v) in (0..40).flat_map(|k| (0..times).map(move |v| (k + 100 * times, v))) {
            stage.deliver("p/L/pv", format!(r#"{{"t": {}, "v": {v}}}"#, START_NS + k * 1_000_000_000).as_bytes());
        }
        stage.turn();
        stage.faults().iter().any(|fault| fault.contains(named))
    };
    assert_eq!([found(1), found(2)], [false, true]);
}

#[test]
fn times_in_another_unit_than_ns_are_a_fault_that_names_it() {
    let dir = tempfile::tempdir().unwrap();
    let text = format!("[site]\nprefix = \"p\"\n[recording]\ndir = {:?}\n", dir.path().to_str().unwrap());
    let (clock, disk) = (Clock::standing(START_NS), Arc::new(SystemDisk) as Arc<dyn Disk>);
    let mut stage = SimDaemon::start(Config::parse(&text).unwrap(), &text, &clock, &disk, no_receiver).unwrap();
    stage.deliver("p/L/op", format!(r#"{{"t": {START_NS}, "v": 1}}"#).as_bytes());
    stage.turn();
    assert!(!stage.faults().iter().any(|fault| fault.contains("sends times")), "{:?}", stage.faults());
    for (key, t, unit) in
        [("p/L/op", START_NS / 1_000_000, "milliseconds"), ("p/L/pv", START_NS / 1_000_000_000, "seconds")]
    {
        stage.deliver(key, format!(r#"{{"t": {t}, "v": 1}}"#).as_bytes());
        stage.turn();
        let named = format!("{key} sends times in {unit}");
        assert!(stage.faults().iter().any(|fault| fault.contains(&named)), "{:?}", stage.faults());
    }
}
