//! Loops that leave the plant: they are forgotten, return with their alarms, and a replay does the same byte for byte.

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use stiction::core::record::Sample;
use stiction::simulated::scenario::Scenario;
use stiction_engine::alarm::{AlarmAction, Command, State};
use stiction_engine::codec::encode_recorded;
use stiction_engine::config::Config;
use stiction_files::disk::{Disk, SystemDisk};
use stictiond::daemon::replay::chains_of;
use stictiond::daemon::replay::parallel::ParallelReplay;
use stictiond::daemon::sim_daemon::{SimDaemon, no_receiver};
use stictiond::runtime::clock::Clock;

const FOUR: &str = include_str!("../../../recordings/scenarios/four-loops.toml");
pub const STICKS: &str = "FIC201";
pub const CALM: &str = "PIC203";

/// Delivers all samples of a loop, shifted by `later_ns`, and does the fits.
pub fn play(stage: &mut SimDaemon, name: &str, later_ns: i64) {
    let scenario = Scenario::parse(FOUR).unwrap();
    let names: Vec<String> = scenario.loop_names().map(str::to_owned).collect();
    let mut json = Vec::new();
    for simulated in scenario.stream().filter(|s| names[s.loop_index] == name) {
        let sample = Sample { t_ns: simulated.sample.t_ns + later_ns, ..simulated.sample };
        json.clear();
        encode_recorded(&sample, &mut json);
        stage.deliver(&format!("p/{name}/{}", sample.signal.name()), &json);
        stage.turn();
        while stage.work(1, |_, request| Some(crate::answers::compute(request).assessment)) > 0 {}
        stage.compare();
    }
    stage.record();
}

fn silence(stage: &mut SimDaemon, clock: &Clock) {
    clock.advance(Duration::from_secs(601));
    stage.health();
    stage.record();
    assert!(stage.keep());
}

pub fn shown(stage: &SimDaemon, name: &str) -> Option<State> {
    let id = stage.engine().find(name)?;
    Some(stage.engine().checkpoint(id).alarm.shown())
}

fn start(dir: &Path, clock: &Clock) -> (SimDaemon, Config) {
    let text = format!(
        "[site]\nprefix = \"p\"\n[input]\nforget_after_s = 600.0\n[window]\nhop_s = 300.0\nmax_points = 400\n[alarm]\nraise = [1, 1]\n\
         [gap]\nenabled = false\n[recording]\ndir = {:?}\n",
        dir.to_str().unwrap()
    );
    let config = Config::parse(&text).unwrap();
    let disk = Arc::new(SystemDisk) as Arc<dyn Disk>;
    (SimDaemon::start(config.clone(), &text, clock, &disk, no_receiver).unwrap(), config)
}

#[test]
fn loops_that_left_are_forgotten_and_come_back_and_replay_says_the_same() {
    let (dir, clock) = (tempfile::tempdir().unwrap(), Clock::standing(super::START_NS));
    let (mut stage, config) = start(dir.path(), &clock);
    play(&mut stage, STICKS, 0);
    play(&mut stage, CALM, 0);
    assert_eq!((shown(&stage, STICKS), shown(&stage, CALM)), (Some(State::Unack), Some(State::Normal)));
    silence(&mut stage, &clock);
    assert_eq!((stage.engine().count(), stage.metrics().loops_forgotten.get(), stage.health().loops), (0, 2, 0));
    // The alarm of a loop that has left can still be found.
    let answered = Arc::new(Mutex::new(None));
    let (told, command) =
        (answered.clone(), Command { action: AlarmAction::Ack, by: Some("ann".into()), why: None, for_s: None });
    assert!(stage.command(STICKS, command, Box::new(move |answer| *told.lock().unwrap() = Some(answer))));
    stage.turn();
    assert!(stage.keep());
    assert!(answered.lock().unwrap().take().unwrap().is_ok());
    silence(&mut stage, &clock);
    assert_eq!((shown(&stage, STICKS), stage.metrics().loops_forgotten.get()), (None, 3));
    let later_ns = 86_400_000_000_000;
    play(&mut stage, CALM, later_ns);
    play(&mut stage, STICKS, later_ns);
    assert_eq!((shown(&stage, STICKS), stage.engine().places()), (Some(State::Acked), 2));
    stage.finish();
    drop(stage);
    let mut replay = ParallelReplay::new(&config, Some("stage"), false);
    let chains = chains_of(dir.path()).unwrap();
    // A file ends when the last of its loops leaves: after the first silence, and after the acknowledged loop has left again.
    assert_eq!((chains.len(), chains[0].len()), (1, 3));
    let mut compared = 0;
    for (at, file) in chains[0].iter().enumerate() {
        let report = replay.file(file, "p", at == 0, true).unwrap();
        assert_eq!((report.difference, report.cut), (None, None), "{}", file.display());
        compared += report.compared;
    }
    assert!(compared > 20, "{compared}");
    // The next run knows the alarm, and of the other loop only its last answer.
    let (stage, _) = start(dir.path(), &clock);
    assert_eq!(shown(&stage, STICKS), Some(State::Acked));
}
