//! Recordings, complete and damaged: every message can be read back, and no damage makes reading panic or invent data.

#![allow(clippy::unwrap_used, clippy::panic)]

use proptest::prelude::*;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use stiction::core::record::{Mode, Sample, Signal, Value};
use stiction_engine::codec::encode_recorded;
use stiction_engine::codec::topic::Kind;
use stiction_files::{End, METADATA_PREFIX, RecordingFile, RecordingReader, load_samples};

/// Bit flips in the long tests; set higher for long runs.
fn flips(few: usize) -> usize {
    std::env::var("STICTIOND_FLIPS").ok().and_then(|n| n.parse().ok()).unwrap_or(few)
}

type Seen = Vec<(String, Option<Kind>, i64, i64, Vec<u8>)>;

fn metadata() -> BTreeMap<String, String> {
    BTreeMap::from([(METADATA_PREFIX.to_owned(), "p/a".to_owned()), ("run_id".to_owned(), "r".to_owned())])
}

fn sample(i: i64, signal: Signal) -> Sample {
    let value = match (signal, i % 7) {
        (Signal::Mode, _) => Value::Mode(Mode::Auto),
        (_, 3) => Value::Missing,
        _ => Value::Number((i as f64 * 0.37).sin() * 50.0 + 50.0),
    };
    Sample { signal, t_ns: i * 1_000_000_000 - 5, value, quality: (i % 5 == 0).then_some(192) }
}

/// Writes `chunks` chunks of `each` scans of two loops, with one estimate in each chunk.
fn record(dir: &Path, chunks: i64, each: i64) -> RecordingFile {
    let mut file = RecordingFile::create(dir, "r", &metadata()).unwrap();
    let mut payload = Vec::new();
    for chunk in 0..chunks {
        for i in chunk * each..(chunk + 1) * each {
            for name in ["FIC101", "u1/TIC2"] {
                for signal in [Signal::Op, Signal::Mode, Signal::Pv] {
                    let sample = sample(i, signal);
                    payload.clear();
                    encode_recorded(&sample, &mut payload);
                    let topic = format!("p/a/{name}/{}", signal.name());
                    let kind = Kind::of_signal(signal);
                    file.write(&topic, kind, sample.t_ns + 3, sample.t_ns, &payload).unwrap();
                }
            }
        }
        let topic = "p/a/@stiction/v1/FIC101/estimate";
        file.write(topic, Kind::Estimate, chunk, chunk, br#"{"schema":"stictiond.estimate.v1","fs":null}"#).unwrap();
        file.flush().unwrap();
    }
    file
}

fn read(path: &Path) -> (Seen, End) {
    let mut reader = RecordingReader::open(path).unwrap();
    assert_eq!(reader.metadata().get("run_id").map(String::as_str), Some("r"));
    let mut seen = Vec::new();
    while let Some(m) = reader.next_message().unwrap() {
        seen.push((m.topic().to_owned(), m.channel.kind, m.log_time_ns, m.publish_time_ns, m.data.to_vec()));
    }
    let end = reader.end().cloned().unwrap();
    assert!(reader.next_message().unwrap().is_none());
    (seen, end)
}

fn finished(chunks: i64, each: i64) -> (tempfile::TempDir, PathBuf, Vec<u8>) {
    let dir = tempfile::tempdir().unwrap();
    let path = record(dir.path(), chunks, each).finish().unwrap();
    let bytes = fs::read(&path).unwrap();
    (dir, path, bytes)
}

#[test]
fn a_whole_file_gives_every_message_in_order() {
    let (_dir, path, bytes) = finished(3, 20);
    let (seen, end) = read(&path);
    assert_eq!(end, End::Clean);
    assert_eq!(seen.len(), 3 * (20 * 6 + 1));
    assert_eq!(seen[0].0, "p/a/FIC101/op");
    assert_eq!((seen[1].1, seen[120].1), (Some(Kind::Mode), Some(Kind::Estimate)));
    let loaded = load_samples(&path).unwrap();
    assert!(!loaded.data_loss && loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    assert_eq!(loaded.loops.iter().map(|l| l.name.as_str()).collect::<Vec<_>>(), ["FIC101", "u1/TIC2"]);
    let expected: Vec<Sample> =
        (0..60).flat_map(|i| [Signal::Op, Signal::Mode, Signal::Pv].map(|signal| sample(i, signal))).collect();
    for one in &loaded.loops {
        assert_eq!(one.samples, expected);
    }
    assert!(bytes.len() > 1000);
}

#[test]
fn an_open_file_is_readable_up_to_its_last_flush() {
    let dir = tempfile::tempdir().unwrap();
    let mut file = record(dir.path(), 2, 10);
    file.write("p/a/FIC101/op", Kind::Sample, 0, 0, b"{\"t\":0,\"v\":1}").unwrap();
    let (seen, end) = read(file.part_path());
    assert_eq!(seen.len(), 2 * 61);
    assert!(matches!(end, End::Cut { .. }), "{end:?}");
    let loaded = load_samples(file.part_path()).unwrap();
    assert!(loaded.data_loss && loaded.warnings[0].contains("cut"), "{:?}", loaded.warnings);
}

#[test]
fn other_files_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("x.mcap");
    fs::write(&path, "MATLAB 5.0 MAT-file").unwrap();
    assert!(load_samples(&path).unwrap_err().to_string().contains("109 more bytes expected"));
    fs::write(&path, "t,op,pv\n0,1,2\n").unwrap();
    assert_eq!(load_samples(&path).unwrap().loops[0].name, "x");
    assert!(RecordingReader::open(&path).is_err());
    assert!(load_samples(dir.path()).unwrap_err().to_string().contains("folder"));
    assert!(load_samples(&dir.path().join("none")).is_err());
}

/// At every cut, the messages are a prefix of the whole file's, and the cut is reported.
#[test]
fn cut_at_every_byte() {
    let (dir, path, bytes) = finished(3, 2);
    let (whole, _) = read(&path);
    let cut = dir.path().join("cut.mcap");
    let mut lengths = Vec::new();
    for length in 8..bytes.len() {
        fs::write(&cut, &bytes[..length]).unwrap();
        let mut reader = RecordingReader::open(&cut).unwrap();
        let mut count = 0;
        while let Some(message) = reader.next_message().unwrap() {
            assert_eq!(message.data, whole[count].4);
            count += 1;
        }
        assert!(matches!(reader.end(), Some(End::Cut { .. })), "{length}: {:?}", reader.end());
        lengths.push(count);
    }
    assert!(lengths.is_sorted());
    assert_eq!(lengths.last(), Some(&whole.len()));
    for length in 0..8 {
        fs::write(&cut, &bytes[..length]).unwrap();
        assert!(RecordingReader::open(&cut).is_err());
    }
}

/// One flipped byte costs at most its chunk (channels that only this chunk declares are taken from the index).
#[test]
fn a_flipped_byte_is_noticed_and_costs_one_chunk() {
    let (dir, path, bytes) = finished(3, 2);
    let (whole, _) = read(&path);
    let damaged = dir.path().join("damaged.mcap");
    let per_chunk = whole.len() / 3;
    for at in 8..bytes.len() {
        let mut copy = bytes.clone();
        copy[at] ^= 0x10;
        fs::write(&damaged, &copy).unwrap();
        let Ok(mut reader) = RecordingReader::open(&damaged) else { panic!("byte {at}: refused") };
        let mut seen = 0;
        while let Some(message) = reader.next_message().unwrap() {
            assert!(whole.iter().any(|m| m.4 == message.data), "byte {at}: invented data");
            seen += 1;
        }
        let end = reader.end().cloned().unwrap();
        assert!(!end.is_clean(), "byte {at} of {} unnoticed", bytes.len());
        assert!(seen + per_chunk >= whole.len(), "byte {at}: {seen} of {}: {end:?}", whole.len());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn no_damage_panics(
        edits in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..30),
        cut in any::<prop::sample::Index>(),
        keep in any::<bool>(),
    ) {
        let (dir, _, mut bytes) = finished(2, 3);
        for (at, value) in edits {
            let at = at.index(bytes.len() - 8) + 8;
            bytes[at] = value;
        }
        if !keep {
            bytes.truncate(cut.index(bytes.len()));
        }
        let path = dir.path().join("d.mcap");
        fs::write(&path, &bytes).unwrap();
        if let Ok(loaded) = load_samples(&path) {
            prop_assert!(loaded.loops.len() <= 8);
        }
    }

    #[test]
    fn no_bytes_after_the_mark_panic(tail in proptest::collection::vec(any::<u8>(), 0..300)) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.mcap");
        let mut bytes = b"\x89MCAP0\r\n".to_vec();
        bytes.extend_from_slice(&tail);
        fs::write(&path, &bytes).unwrap();
        let loaded = load_samples(&path).unwrap();
        prop_assert!(loaded.data_loss);
    }
}

/// The readable messages of a file, if any.
fn rescued(path: &Path) -> Seen {
    let Ok(mut reader) = RecordingReader::open(path) else { return Vec::new() };
    let mut seen = Vec::new();
    while let Some(m) = reader.next_message().unwrap() {
        seen.push((m.topic().to_owned(), m.channel.kind, m.log_time_ns, m.publish_time_ns, m.data.to_vec()));
    }
    assert!(reader.end().is_some());
    seen
}

#[test]
fn a_flipped_bit_costs_no_more_than_its_chunk_in_an_open_file_and_in_a_whole_one() {
    let dir = tempfile::tempdir().unwrap();
    let (chunks, each) = (9, 8);
    // Scans of two loops with three signals, and an estimate.
    let per_chunk = usize::try_from(each).unwrap() * 6 + 1;
    let file = record(dir.path(), chunks, each);
    let open = fs::read(file.part_path()).unwrap();
    let whole = fs::read(file.finish().unwrap()).unwrap();
    for (what, bytes) in [("open", open), ("whole", whole)] {
        let path = dir.path().join("flipped.mcap.part");
        fs::write(&path, &bytes).unwrap();
        let all = rescued(&path);
        assert_eq!(all.len(), per_chunk * usize::try_from(chunks).unwrap());
        let count = flips(120);
        for k in 0..count {
            let bit = (k * 8 * bytes.len() / count + k % 8) % (8 * bytes.len());
            let mut hurt = bytes.clone();
            hurt[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, &hurt).unwrap();
            let left = rescued(&path);
            assert!(left.len() + per_chunk >= all.len(), "{what}, bit {bit}: {} of {} left", left.len(), all.len());
            // The remaining messages are those written, in order.
            let mut rest = all.iter();
            assert!(left.iter().all(|m| rest.any(|w| w.0 == m.0 && w.4 == m.4)), "{what}, bit {bit}: invented");
        }
    }
}

#[test]
fn a_cut_at_every_byte_costs_no_more_than_the_chunk_in_hand() {
    let dir = tempfile::tempdir().unwrap();
    let file = record(dir.path(), 6, 4);
    let bytes = fs::read(file.part_path()).unwrap();
    let path = dir.path().join("cut.mcap.part");
    let mut before = 0;
    // All lengths if flips are tested too.
    let step = if flips(0) > 0 { 1 } else { 7 };
    for length in (0..bytes.len()).step_by(step).chain([bytes.len()]) {
        fs::write(&path, &bytes[..length]).unwrap();
        let left = rescued(&path).len();
        assert!(left >= before && left.is_multiple_of(25), "{length} bytes: {left} messages after {before}");
        before = left;
    }
    assert_eq!(before, 150);
}

#[test]
fn a_seal_holds_until_any_byte_before_it_is_changed() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(dir.path(), 3, 5).finish().unwrap();
    let seal = |path: &Path| {
        let mut reader = RecordingReader::open(path).unwrap();
        while reader.next_message().unwrap().is_some() {}
        reader.seal().cloned().unwrap()
    };
    let sealed = seal(&path);
    assert!(sealed.holds(&path).unwrap() && sealed.bytes > 1000);
    let bytes = fs::read(&path).unwrap();
    for at in (0..usize::try_from(sealed.bytes).unwrap()).step_by(97) {
        let mut hurt = bytes.clone();
        hurt[at] ^= 1;
        let copy = dir.path().join("copy.mcap");
        fs::write(&copy, &hurt).unwrap();
        assert!(!sealed.holds(&copy).unwrap(), "byte {at}");
    }
}
