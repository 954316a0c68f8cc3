//! `convert` and `info` run as programs: exit codes, stdout, stderr, files.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::common::program::{expect, stderr, stdout};
use stiction::core::record::{Signal, Value};
use stiction_engine::codec::topic::Kind;
use stiction_files::{RecordingFile, RecordingReader, load_samples};

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    fn write(&self, name: &str, text: impl AsRef<[u8]>) -> String {
        fs::write(self.0.path().join(name), text).unwrap();
        self.path(name)
    }

    fn names(&self) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(self.0.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

const TABLE: &str = "t,op,pv,sp,mv,mode\n\
    1700000000.000000001,40.1,-0,5,,auto\n\
    1700000001,0.30000000000000004,,5,,\n\
    1700000001,1,2,,,manual\n\
    1700000000.5,,0.000000000000000000001,,3,7\n";

/// A recording of two loops with an estimate, as written by the daemon.
fn recording(dir: &Path, scans: i64) -> PathBuf {
    let metadata = BTreeMap::from([("prefix", "p"), ("run_id", "run-7"), ("config", "[site]\nprefix = \"p\"\n")])
        .into_iter()
        .map(|(k, v)| (k.to_owned(), v.to_owned()))
        .collect();
    let mut file = RecordingFile::create(dir, "r", &metadata).unwrap();
    for i in 0..scans {
        let t = i * 2_000_000_000;
        for topic in ["p/A/op", "p/u/B/op", "p/A/pv", "p/u/B/pv"] {
            let v = if i == 3 { "null".to_owned() } else { format!("{}", i as f64 / 3.0) };
            let payload = format!("{{\"t\":{t},\"v\":{v}}}");
            file.write(topic, Kind::Sample, t, t, payload.as_bytes()).unwrap();
        }
        if i % 10 == 9 {
            file.write("p/@stiction/v1/A/estimate", Kind::Estimate, t, t, b"{\"fs\":1.5}").unwrap();
            file.flush().unwrap();
        }
    }
    file.write("p/@stiction/v1/@daemon/d/health", Kind::Health, 0, 0, b"{}").unwrap();
    file.finish().unwrap()
}

#[test]
fn a_table_survives_the_way_through_a_recording() {
    let folder = Folder::new();
    let table = folder.write("FIC101.csv", TABLE);
    let (mcap, back) = (folder.path("x.mcap"), folder.path("back.csv"));
    let output = expect(0, &["convert", &table, &mcap]);
    assert!(stderr(&output).is_empty() && stdout(&output).contains("FIC101"), "{}", stdout(&output));
    expect(0, &["convert", &mcap, &back]);
    assert_eq!(fs::read_to_string(&back).unwrap(), TABLE);
    assert_eq!(folder.names(), ["FIC101.csv", "back.csv", "x.mcap"], "no passing file stays behind");

    let mut reader = RecordingReader::open(Path::new(&mcap)).unwrap();
    assert_eq!(reader.metadata()["origin"], "convert");
    let first = reader.next_message().unwrap().unwrap();
    assert_eq!((first.topic(), first.channel.kind), ("plant/FIC101/op", Some(Kind::Sample)));
    assert_eq!(first.data, br#"{"t":1700000000000000001,"v":40.1}"#);
    let loaded = load_samples(Path::new(&mcap)).unwrap();
    let mut mode = loaded.loops[0].samples.iter().filter(|s| s.signal == Signal::Mode).map(|s| s.value);
    assert_eq!(mode.next_back(), Some(Value::Number(7.0)));
}

#[test]
fn an_existing_output_stays_unless_forced() {
    let folder = Folder::new();
    let table = folder.write("a.csv", "t,op,pv\n0,1,2\n");
    let out = folder.write("out.mcap", "precious");
    let output = expect(1, &["convert", &table, &out]);
    assert!(stderr(&output).contains("--force"));
    assert_eq!(fs::read_to_string(&out).unwrap(), "precious");
    let broken = folder.write("b.csv", "t,op,pv\n0,1,2\nx,1,2\n");
    let output = expect(1, &["convert", &broken, &out, "--force"]);
    assert!(stderr(&output).contains("line 3"), "{}", stderr(&output));
    assert_eq!(fs::read_to_string(&out).unwrap(), "precious", "a failed run replaces nothing");
    expect(0, &["convert", &table, &out, "--force"]);
    assert_eq!(load_samples(Path::new(&out)).unwrap().loops[0].samples.len(), 2);
    expect(2, &["convert", &table, &table, "--force"]);
    assert_eq!(folder.names(), ["a.csv", "b.csv", "out.mcap"]);
}

#[test]
fn several_loops_need_a_name_or_a_folder() {
    let folder = Folder::new();
    let mcap = recording(folder.0.path(), 20);
    let mcap = mcap.to_str().unwrap();
    let output = expect(2, &["convert", mcap, &folder.path("x.csv")]);
    assert!(stderr(&output).contains("A, u/B"), "{}", stderr(&output));
    expect(2, &["convert", mcap, &folder.path("x.csv"), "--loop", "C"]);
    expect(0, &["convert", mcap, &folder.path("x.csv"), "--loop", "u/B"]);
    let text = fs::read_to_string(folder.path("x.csv")).unwrap();
    assert!(text.starts_with("t,op,pv\n0,0,0\n2,0.3333333333333333,0.3333333333333333\n"), "{text}");
    assert!(text.contains("\n6,,\n"), "a null is an empty cell");
    expect(0, &["convert", mcap, &folder.path("all")]);
    assert_eq!(fs::read_to_string(folder.path("all/u_B.csv")).unwrap(), text);
    assert_eq!(fs::read_to_string(folder.path("all/A.csv")).unwrap(), text);
    expect(1, &["convert", mcap, &folder.path("all")]);
    expect(0, &["convert", mcap, &folder.path("all"), "--force"]);
    expect(0, &["convert", mcap, &folder.path("copy.mcap")]);
    let copy = load_samples(Path::new(&folder.path("copy.mcap"))).unwrap();
    assert_eq!(copy.loops, load_samples(Path::new(mcap)).unwrap().loops);
}

#[test]
fn a_cut_recording_is_read_up_to_the_cut() {
    let folder = Folder::new();
    let mcap = recording(folder.0.path(), 40);
    let bytes = fs::read(&mcap).unwrap();
    let cut = folder.write("cut.mcap.part", &bytes[..bytes.len() / 3]);
    let out = folder.path("a.csv");
    let output = expect(3, &["convert", &cut, &out, "--loop", "A"]);
    assert!(stderr(&output).contains("warning") && stderr(&output).contains("cut"), "{}", stderr(&output));
    let rows = fs::read_to_string(&out).unwrap().lines().count();
    assert!((11..41).contains(&rows), "{rows}");
    for verify in [&[][..], &["--verify"][..]] {
        let output = expect(3, &[&["info", "--format", "json", &cut], verify].concat());
        let info: serde_json::Value = serde_json::from_str(&stdout(&output)).unwrap();
        assert_eq!(info["state"], "cut");
        assert_eq!(info["metadata"]["run_id"], "run-7");
    }
    let nothing = folder.write("none.mcap", &bytes[..12]);
    let output = expect(1, &["convert", &nothing, &folder.path("n.csv")]);
    assert!(stderr(&output).contains("no readable sample"), "{}", stderr(&output));
    assert!(!Path::new(&folder.path("n.csv")).exists());
}

#[test]
fn damage_costs_its_chunk_and_exit_code_3() {
    let folder = Folder::new();
    let mcap = recording(folder.0.path(), 40);
    let mut bytes = fs::read(&mcap).unwrap();
    let middle = bytes.len() / 3;
    bytes[middle] ^= 0xff;
    let damaged = folder.write("d.mcap", &bytes);
    expect(3, &["info", "--verify", &damaged]);
    expect(3, &["convert", &damaged, &folder.path("d.csv"), "--loop", "A"]);
    expect(0, &["info", "--verify", mcap.to_str().unwrap()]);
}

#[test]
fn info_tells_what_is_inside() {
    let folder = Folder::new();
    let mcap = recording(folder.0.path(), 20);
    let output = expect(0, &["info", mcap.to_str().unwrap(), "--format", "json"]);
    let text = stdout(&output);
    assert_eq!(text.lines().count(), 1);
    let info: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(info["schema"], "stictiond.info.v1");
    assert_eq!((&info["kind"], &info["state"]), (&"mcap".into(), &"clean".into()));
    assert_eq!(info["bytes"], fs::metadata(&mcap).unwrap().len());
    assert_eq!(info["messages"], 20 * 4 + 3);
    assert_eq!((&info["results"]["estimate"], &info["results"]["health"]), (&2.into(), &1.into()));
    let a = &info["loops"][0];
    assert_eq!((&a["loop"], &a["ts_s"], &a["span_s"]), (&"A".into(), &2.0.into(), &38.0.into()));
    assert_eq!(a["signals"]["pv"], serde_json::json!({"samples": 20, "missing": 1}));
    assert_eq!(a["results"]["estimate"], 2);
    assert_eq!(info["loops"][1]["loop"], "u/B");
    let text = stdout(&expect(0, &["info", mcap.to_str().unwrap()]));
    assert!(text.contains("loop A: op 20 (1 missing)") && text.contains("every 2 s"), "{text}");

    let table = folder.write("T.csv", TABLE);
    let info: serde_json::Value =
        serde_json::from_str(&stdout(&expect(0, &["info", "--format", "json", &table]))).unwrap();
    assert_eq!((&info["kind"], &info["loops"][0]["loop"]), (&"csv".into(), &"T".into()));
    assert_eq!(info["loops"][0]["signals"]["op"], serde_json::json!({"samples": 4, "missing": 1}));
}

#[test]
fn what_cannot_be_done_says_so() {
    let folder = Folder::new();
    let table = folder.write("a.csv", "t,op,pv\n0,1,2\n");
    let mat = folder.write("a.mat", "MATLAB 5.0 MAT-file, Platform: GLNXA64");
    for (code, arguments, part) in [
        (1, vec!["convert", &mat, "x.csv"], "the file ends here"),
        (1, vec!["info", &mat], "the file ends here"),
        (2, vec!["convert", &table, "x.xlsx"], ".xlsx"),
        (2, vec!["convert", &table], "OUT"),
        (2, vec!["frobnicate"], "frobnicate"),
        (1, vec!["convert", "/nonexistent.csv", "x.mcap"], "/nonexistent.csv"),
        (1, vec!["convert", &table, "/nonexistent/x.csv"], "/nonexistent/x.csv"),
    ] {
        let output = expect(code, &arguments);
        assert!(stderr(&output).contains(part), "{arguments:?}: {}", stderr(&output));
        assert!(stdout(&output).is_empty(), "{arguments:?}");
    }
    for command in ["convert", "info"] {
        assert!(stdout(&expect(0, &[command, "--help"])).contains("Usage"));
    }
}

/// A triangle with a square (the picture of a sticking valve), or two sines.
fn wave(sticking: bool) -> String {
    let row = |k: i32| {
        let t = f64::from(k) / 60.0;
        let (t, turn) = (t.fract(), 2.0 * core::f64::consts::PI * t);
        let triangle = if t < 0.5 { 4.0 * t - 1.0 } else { 3.0 - 4.0 * t };
        let square = if (0.1..0.6).contains(&t) { 1.0 } else { -1.0 };
        let noise = 1e-3 * f64::from(k * k % 31);
        let (op, pv) = if sticking { (triangle, square) } else { (turn.sin(), -turn.sin()) };
        format!("{k},{},{}\n", 50.0 + 3.0 * op, 20.0 + pv + noise)
    };
    format!("t,op,pv\n{}", (0..600).map(row).collect::<String>())
}

#[test]
fn a_folder_lists_a_record_on_its_own_clock_and_refuses_a_short_one() {
    let folder = Folder::new();
    let long = "a-name-of-more-than-forty-characters-that-is-shown-whole";
    folder.write(&format!("{long}.csv"), wave(true));
    folder.write("short.csv", "t,op,pv\n0,1,2\n1,2,3\n");
    let done = expect(0, &["analyze", &folder.path("")]);
    let (text, said) = (stdout(&done), stderr(&done));
    assert!(text.contains(long) && !text.contains("1970") && text.contains("1 not analysed"), "{text}");
    assert_eq!(said.matches("short.csv: 2 usable samples at most").count(), 1, "{said}");
}

/// Real tables keep every value through a recording. They are in a folder next to the working copy, if at all.
#[test]
fn real_tables_survive() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let Ok(folders) = fs::read_dir(&data) else {
        crate::common::skipped("real_tables_survive", "no ../shared/data");
        return;
    };
    let folder = Folder::new();
    let mut count = 0;
    for entry in folders.flat_map(|f| fs::read_dir(f.unwrap().path()).into_iter().flatten()) {
        let path = entry.unwrap().path();
        let table = path.to_str().unwrap();
        if path.extension().is_none_or(|e| e != "csv") {
            continue;
        }
        let (mcap, back) = (folder.path("x.mcap"), folder.path("back.csv"));
        let out = expect(0, &["convert", table, &mcap, "--force"]);
        assert!(stderr(&out).is_empty(), "{table}: {}", stderr(&out));
        expect(0, &["convert", &mcap, &back, "--force"]);
        let (before, after) = (load_samples(&path).unwrap(), load_samples(Path::new(&back)).unwrap());
        assert_eq!(before.loops[0].samples, after.loops[0].samples, "{table}");
        count += 1;
    }
    assert!(count > 0, "{} holds no table", data.display());
}

/// A table of a slow wave, with the time of each row in seconds from `time`.
fn slow_wave(time: impl Fn(usize) -> usize) -> String {
    let row = |k: usize| {
        let phase = k as f64 / 20.0;
        format!("{},{:.4},{:.4}\n", 1_700_000_000 + time(k), 50.0 + 5.0 * phase.sin(), 9.0 + phase.cos())
    };
    (0..600).fold("t,op,pv\n".to_owned(), |text, k| text + &row(k))
}

#[test]
fn times_that_were_cut_and_a_range_that_is_not_ops_are_said() {
    let folder = Folder::new();
    let (whole, cut) =
        (folder.write("whole.csv", slow_wave(|k| k)), folder.write("cut.csv", slow_wave(|k| k / 60 * 60)));
    for command in ["info", "analyze"] {
        assert!(stderr(&expect(0, &[command, &whole])).is_empty(), "{command}");
        let said = stderr(&expect(1, &[command, &cut]));
        assert!(said.contains("two values at most of its times"), "{command}: {said}");
    }
    let said = stderr(&expect(1, &["analyze", &whole, "--op-range", "0,1"]));
    assert!(said.contains("OP runs from 45 to 55, outside its range 0 to 1"), "{said}");
    expect(0, &["analyze", &whole, "--op-range", "-50,150"]);
    let said = stderr(&expect(2, &["analyze", &whole, "--op-range", "5"]));
    assert!(said.contains("such as 0,100"), "{said}");
    let said = stderr(&expect(1, &["analyze", &whole, "--window", "0,10"]));
    assert!(said.contains("from 2023-11-14T22:13:20Z to 2023-11-14T22:23:19Z"), "{said}");
    let said = stderr(&expect(2, &["play", &whole, "--prefix", "p", "--connect", "foo"]));
    assert!(said.contains("such as tcp/127.0.0.1:7447"), "{said}");
}

#[test]
fn a_recording_of_which_nothing_can_be_read_is_not_found_equal() {
    let folder = Folder::new();
    let (table, converted) = (folder.write("a.csv", slow_wave(|k| k)), folder.path("converted.mcap"));
    expect(0, &["convert", &table, &converted]);
    assert!(stderr(&expect(2, &["replay", &converted, "--verify"])).contains("no results to compare"));
    let mut bytes = fs::read("recordings/sticking.mcap").unwrap();
    let cut = folder.write("cut.mcap", &bytes[..20]);
    // It has one chunk.
    bytes[10_000] ^= 1;
    let damaged = folder.write("damaged.mcap", bytes);
    let said = stdout(&expect(3, &["replay", &damaged, "--verify"]));
    assert!(said.contains("nothing was compared"), "{said}");
    let said = stderr(&expect(1, &["analyze", &cut]));
    assert!(said.contains("no sample in it can be read"), "{said}");
}
