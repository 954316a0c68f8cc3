//! History that is played twice has windows with equal ends: a recording distinguishes them by their order.

use std::collections::BTreeMap;
use std::path::Path;

use stiction::simulated::scenario::Scenario;
use stiction_engine::codec::encode_recorded;
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, Event, RecordedInput, Request, SkipReason};
use stiction_files::RecordingFile;
use stictiond::daemon::replay::parallel::ParallelReplay;

const SCENARIO: &str = include_str!("../../recordings/scenarios/sticking.toml");
const TEXT: &str = "[site]\nprefix = \"p\"\n[window]\nhop_s = 300.0\n[alarm]\nraise = [32, 32]\n";

/// Writes the recording of a live run whose first window found no worker and whose last ones were cut short by its end.
fn record(path: &Path) -> usize {
    let metadata = [("prefix", "p"), ("config", TEXT)].map(|(k, v)| (k.to_owned(), v.to_owned()));
    let part = path.with_extension("part");
    let mut file = RecordingFile::create_at(part, path.to_owned(), &BTreeMap::from(metadata)).unwrap();
    let mut engine = Engine::new(Config::parse(TEXT).unwrap().engine());
    let id = engine.appear("A").unwrap();
    let (mut events, mut requests): (Vec<Event>, Vec<Request>) = Default::default();
    let scenario = Scenario::parse(SCENARIO).unwrap();
    let mut json = Vec::new();
    for sample in scenario.stream().chain(scenario.stream()).map(|s| s.sample) {
        json.clear();
        encode_recorded(&sample, &mut json);
        let kind = Kind::of_signal(sample.signal);
        file.write(&topic::raw("p", "A", sample.signal), kind, 0, sample.t_ns, &json).unwrap();
        engine.push(id, sample, &mut events);
        requests.extend(events.drain(..).map(|event| match event {
            Event::Request(request) => *request,
            other => panic!("{other:?}"),
        }));
    }
    let half = requests.len() / 2;
    assert!(half >= 5 && requests[0].end_ns == requests[half].end_ns, "each end stands twice");
    let mut estimates = 0;
    let mut put = |file: &mut RecordingFile, events: &mut Vec<Event>| {
        for event in events.drain(..) {
            let (kind, json) = match event {
                Event::Estimate(_, document) => (Kind::Estimate, serde_json::to_vec(&document).unwrap()),
                Event::State(_, document) => (Kind::State, serde_json::to_vec(&document).unwrap()),
                _ => continue,
            };
            file.write(&topic::result("p", "A", kind), kind, 0, 0, &json).unwrap();
            estimates += usize::from(kind == Kind::Estimate);
        }
    };
    for (place, request) in requests.iter().enumerate() {
        if place > 0 && place < half {
            engine.complete(id, request.seq, request.compute(), &mut events);
        } else {
            let reason = if place == 0 { SkipReason::QueueFull } else { SkipReason::Shutdown };
            let input = RecordedInput::Skip { window_end_ns: request.end_ns, seq: request.seq, reason };
            let json = serde_json::to_vec(&input).unwrap();
            file.write(&topic::result("p", "A", Kind::Input), Kind::Input, 0, 0, &json).unwrap();
            engine.skip(id, request.seq, &mut events);
        }
        put(&mut file, &mut events);
    }
    file.finish().unwrap();
    estimates
}

#[test]
fn skips_among_windows_of_equal_ends_replay_to_the_byte() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("twice.mcap");
    let estimates = record(&path);
    let mut replay = ParallelReplay::new(&Config::parse(TEXT).unwrap(), None, false);
    let report = replay.file(&path, "p", true, true).unwrap();
    assert_eq!((report.difference, report.compared), (None, estimates));
}
