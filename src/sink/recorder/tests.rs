//! Checks of the recorder: what it leaves behind at the end.

use super::*;
use stiction::record::Value;
use stiction_monitor::config::Config;

#[test]
fn every_file_is_whole_at_the_end() {
    let dir = tempfile::tempdir().unwrap();
    let mut config = Config::with_prefix("p");
    config.recording.dir = dir.path().to_str().unwrap().to_owned();
    let mut engine = stiction_monitor::engine::Engine::new(config.engine());
    let ids: Vec<LoopId> = (0..2001).map(|k| engine.appear(&format!("L{k}")).unwrap()).collect();
    let run = RunInfo {
        prefix: "p".to_owned(),
        run_id: "r".to_owned(),
        started_ns: 0,
        run_number: None,
        origin: "run",
        config_text: String::new(),
        config_hash: String::new(),
        daemon: String::new(),
        loop_map: String::new(),
        raw: "json".to_owned(),
    };
    let metrics = Arc::<Metrics>::default();
    let (mut recorder, thread) = Recorder::start(run, config.recording, metrics.clone(), Arc::default()).unwrap();
    (0..3).for_each(|shard| recorder.record(Item::Open { shard, states: Vec::new() }));
    for id in &ids {
        let sample = Sample { signal: Signal::Op, t_ns: 0, value: Value::number(1.0), quality: None };
        recorder.record(Item::Raw { id: *id, name: engine.name(*id).clone(), sample, arrival_ns: 0 });
    }
    let progress = recorder.progress();
    drop(recorder);
    thread.join().unwrap();
    // Items and files: so it is seen that the thread goes on.
    assert_eq!((metrics.recorded.get(), progress.map(|done| done.load(Ordering::Relaxed))), (2001, [3 + 2001, 3]));
    let names = std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
    assert_eq!(names.filter(|name| name.ends_with(".mcap")).count(), 3);
}
