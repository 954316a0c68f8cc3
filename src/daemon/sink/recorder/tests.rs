//! Tests of the recorder, mostly of what it leaves behind at the end.

use std::sync::atomic::{AtomicBool, Ordering};

use super::*;
use stiction::core::record::Value;
use stiction_engine::config::{Config, RawForm};
use stiction_files::disk::{DiskFile, SystemDisk};

fn run() -> RunInfo {
    RunInfo {
        prefix: "p".to_owned(),
        run_id: "r".to_owned(),
        started_ns: 0,
        run_number: None,
        origin: "run",
        config: RecordedConfig::default(),
        daemon: String::new(),
        raw: RawForm::Json,
        continued: BTreeMap::new(),
    }
}

#[test]
fn every_file_is_whole_at_the_end() {
    let dir = tempfile::tempdir().unwrap();
    let mut config = Config::with_prefix("p");
    config.recording.dir = dir.path().to_str().unwrap().to_owned();
    let mut engine = stiction_engine::engine::Engine::new(config.engine());
    let ids: Vec<LoopId> = (0..2001).map(|k| engine.appear(&format!("L{k}")).unwrap()).collect();
    let metrics = Arc::<Metrics>::default();
    let (mut recorder, thread) =
        Recorder::start(run(), config.recording, Arc::new(SystemDisk), metrics.clone(), Arc::default()).unwrap();
    (0..3).for_each(|segment| recorder.record(Item::Open { segment, states: Vec::new() }));
    for id in &ids {
        let sample = Sample { signal: Signal::Op, t_ns: 0, value: Value::number(1.0), quality: None };
        recorder.record(Item::Raw { id: *id, name: engine.name(*id).clone(), sample, arrival_ns: 0 });
    }
    let progress = recorder.progress();
    drop(recorder);
    thread.join().unwrap();
    // Both items and files count as progress, so that the end can be seen to advance.
    assert_eq!((metrics.recorded.get(), progress.steps()), (2001, [3 + 2001, 3]));
    assert!(progress.unfinished().is_empty());
    let names = std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
    assert_eq!(names.filter(|name| name.ends_with(".mcap")).count(), 3);
}

#[test]
fn each_alarm_is_repeated_as_a_log_message_on_one_topic() {
    let dir = tempfile::tempdir().unwrap();
    let mut config = Config::with_prefix("p");
    config.recording.dir = dir.path().to_str().unwrap().to_owned();
    let mut engine = stiction_engine::engine::Engine::new(config.engine());
    let metrics = Arc::<Metrics>::default();
    let (mut recorder, thread) =
        Recorder::start(run(), config.recording, Arc::new(SystemDisk), metrics.clone(), Arc::default()).unwrap();
    recorder.record(Item::Open { segment: 0, states: Vec::new() });
    for name in ["A", "B"] {
        let id = engine.appear(name).unwrap();
        let document = stiction_engine::alarm::Alarm::default().restored(name);
        let json = serde_json::to_vec(&document).unwrap();
        recorder.record(Item::Document { id, name: name.into(), kind: Kind::Alarm, json, event_ns: 5 });
    }
    drop(recorder);
    thread.join().unwrap();
    assert_eq!((metrics.recorded.get(), metrics.recording_lost.get()), (2, 0), "a repeated alarm does not count");
    let file = std::fs::read_dir(dir.path())
        .unwrap()
        .map(|e| e.unwrap().path())
        .find(|p| p.extension().is_some_and(|e| e == "mcap"))
        .unwrap();
    let mut reader = stiction_files::RecordingReader::open(&file).unwrap();
    let mut logged = Vec::new();
    while let Some(item) = reader.next_item().unwrap() {
        let stiction_files::Item::Message(message) = item else { continue };
        if message.topic() == stiction_files::log_topic("p") {
            let log: serde_json::Value = serde_json::from_slice(message.data).unwrap();
            logged.push((log["name"].as_str().unwrap().to_owned(), log["level"].as_u64().unwrap()));
        }
    }
    assert_eq!(logged, [("A".to_owned(), 2), ("B".to_owned(), 2)]);
}

/// A disk that is full while the flag is set.
#[derive(Clone, Default)]
struct FillingDisk(Arc<AtomicBool>);

struct FillingFile(Arc<dyn DiskFile>, Arc<AtomicBool>);

impl DiskFile for FillingFile {
    fn append(&self, bytes: &[u8]) -> std::io::Result<usize> {
        if self.1.load(Ordering::Relaxed) { Err(std::io::ErrorKind::StorageFull.into()) } else { self.0.append(bytes) }
    }

    fn sync(&self, all: bool) -> std::io::Result<()> {
        self.0.sync(all)
    }

    fn is_at(&self, path: &std::path::Path) -> bool {
        self.0.is_at(path)
    }
}

impl Disk for FillingDisk {
    fn create_new(&self, path: &std::path::Path) -> std::io::Result<Arc<dyn DiskFile>> {
        Ok(Arc::new(FillingFile(SystemDisk.create_new(path)?, self.0.clone())))
    }

    fn create_folder(&self, path: &std::path::Path) -> std::io::Result<()> {
        SystemDisk.create_folder(path)
    }

    fn rename(&self, from: &std::path::Path, to: &std::path::Path) -> std::io::Result<()> {
        SystemDisk.rename(from, to)
    }

    fn open_store(&self, builder: &redb::Builder, path: &std::path::Path) -> Result<redb::Database, redb::Error> {
        SystemDisk.open_store(builder, path)
    }
}

#[test]
fn a_disk_that_is_full_or_hangs_has_stopped_the_recorder_until_it_works_again() {
    let dir = tempfile::tempdir().unwrap();
    let mut config = Config::with_prefix("p");
    config.recording.dir = dir.path().to_str().unwrap().to_owned();
    let mut engine = stiction_engine::engine::Engine::new(config.engine());
    let id = engine.appear("L").unwrap();
    let (disk, clock) = (FillingDisk::default(), Clock::standing(0));
    let place = (Arc::new(disk.clone()) as Arc<dyn Disk>, clock.clone());
    let (mut recorder, mut writer) =
        Recorder::pair(run(), config.recording, place, Arc::default(), Arc::<Faults>::default());
    let name = engine.name(id).clone();
    let record = |recorder: &mut Recorder| {
        let sample = Sample { signal: Signal::Op, t_ns: 0, value: Value::number(1.0), quality: None };
        recorder.record(Item::Raw { id, name: name.clone(), sample, arrival_ns: 0 });
    };
    let work = |writer: &mut Writer| {
        clock.advance(Duration::from_secs(6));
        writer.turn();
    };
    let progress = recorder.progress();
    recorder.record(Item::Open { segment: 0, states: Vec::new() });
    work(&mut writer);
    assert_eq!((recorder.stall(), progress.has_stopped()), (None, false));
    // The disk hangs: something waits and nothing is taken.
    record(&mut recorder);
    assert_eq!(recorder.stall(), None);
    clock.advance(Duration::from_secs(11));
    assert!(recorder.stall().unwrap().contains("not answered for 11 s; 1 messages wait"));
    work(&mut writer);
    assert_eq!(recorder.stall(), None);
    // The disk is full.
    disk.0.store(true, Ordering::Relaxed);
    record(&mut recorder);
    work(&mut writer);
    let unfinished = progress.unfinished().join(", ");
    assert!(progress.has_stopped() && unfinished.contains("-s0-00000.mcap"), "{unfinished}");
    writer.finish();
    assert!(progress.has_stopped(), "nothing was finished");
    // There is room again: a new file replaces the failed one.
    disk.0.store(false, Ordering::Relaxed);
    recorder.record(Item::Open { segment: 0, states: Vec::new() });
    work(&mut writer);
    assert!(!progress.has_stopped());
    writer.finish();
    assert!(progress.unfinished().is_empty());
}

#[test]
fn loops_that_come_and_go_cost_a_new_file_and_a_file_that_is_full_goes_on_with_its_channels() {
    let dir = tempfile::tempdir().unwrap();
    let mut config = Config::with_prefix("p");
    config.recording.dir = dir.path().to_str().unwrap().to_owned();
    let id = stiction_engine::engine::Engine::new(config.engine()).appear("A").unwrap();
    let (metrics, faults) = (Arc::<Metrics>::default(), Arc::<Faults>::default());
    let place = (Arc::new(SystemDisk) as Arc<dyn Disk>, Clock::standing(1_000_000_000));
    let (mut recorder, mut writer) = Recorder::pair(run(), config.recording, place, metrics.clone(), faults.clone());
    let names: Vec<Arc<str>> = (0..MAX_CHANNELS + 5).map(|k| format!("L{k}").into()).collect();
    let heard = |recorder: &mut Recorder, some: std::ops::Range<usize>| {
        for name in &names[some] {
            // One handle, used by one loop after another.
            let sample = Sample { signal: Signal::Op, t_ns: 0, value: Value::number(1.0), quality: None };
            recorder.record(Item::Raw { id, name: name.clone(), sample, arrival_ns: 0 });
        }
    };
    recorder.record(Item::Open { segment: 0, states: Vec::new() });
    heard(&mut recorder, 0..MANY_CHANNELS - 1);
    assert!(recorder.rotations.is_empty());
    // The engine notices before the disk has written any of it.
    heard(&mut recorder, MANY_CHANNELS - 1..MANY_CHANNELS);
    assert_eq!(recorder.rotations.try_iter().collect::<Vec<_>>(), [0]);
    // The engine is late with the new file, so the writer asks for it too.
    heard(&mut recorder, MANY_CHANNELS..MAX_CHANNELS + 5);
    writer.turn();
    assert_eq!((recorder.rotations.try_iter().collect::<Vec<_>>(), metrics.recording_lost.get()), (vec![0], 5));
    heard(&mut recorder, 0..3);
    recorder.record(Item::Open { segment: 0, states: Vec::new() });
    heard(&mut recorder, MAX_CHANNELS..MAX_CHANNELS + 5);
    writer.turn();
    writer.finish();
    assert_eq!((metrics.recording_errors.get(), metrics.recording_lost.get()), (0, 5));
    assert_eq!((metrics.recorded.get(), faults.list().len()), (MAX_CHANNELS as u64 + 3 + 5, 0));
}
