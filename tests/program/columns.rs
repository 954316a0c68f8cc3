//! Recordings with raw samples in columns: every reader gives the same as for the same recording as JSON.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use crate::common::program::{expect, stdout};
use stiction::core::record::Signal;
use stiction_engine::codec::topic::{self, Kind};
use stiction_files::archive::{Archive, Reach, Wanted};
use stiction_files::{RecordingReader, load_samples};

/// The shipped scenario of four loops, with results, in both forms: JSON and columns. Recorded once for all tests.
fn both(dir: &Path) -> [String; 2] {
    static MADE: OnceLock<[Vec<u8>; 2]> = OnceLock::new();
    let made = MADE.get_or_init(|| simulated(dir).map(|file| fs::read(file).unwrap()));
    let files = ["json", "columns"].map(|raw| dir.join(format!("{raw}.mcap")));
    files.iter().zip(made).for_each(|(file, bytes)| fs::write(file, bytes).unwrap());
    files.map(|file| file.to_str().unwrap().to_owned())
}

fn simulated(dir: &Path) -> [String; 2] {
    ["json", "columns"].map(|raw| {
        let (config, out) = (dir.join(format!("{raw}.toml")), dir.join(format!("{raw}.mcap")));
        let text = format!(
            "[site]\nprefix = \"area2\"\n[window]\nhop_s = 600.0\nmax_points = 400\n[recording]\nraw = \"{raw}\"\n"
        );
        let scenario = fs::read_to_string("recordings/scenarios/four-loops.toml").unwrap();
        let prefix = scenario.split("prefix = \"").nth(1).unwrap().split('"').next().unwrap();
        fs::write(&config, text.replace("area2", prefix)).unwrap();
        let out = out.to_str().unwrap().to_owned();
        let config = config.to_str().unwrap();
        expect(0, &["simulate", "recordings/scenarios/four-loops.toml", "--config", config, "--out", &out]);
        out
    })
}

type Seen = (String, Option<Kind>, i64, Vec<u8>);

/// Every message in order, and how the file ended.
fn messages(path: &Path) -> (Vec<Seen>, String) {
    let mut reader = RecordingReader::open(path).unwrap();
    let mut seen = Vec::new();
    while let Some(m) = reader.next_message().unwrap() {
        seen.push((m.topic().to_owned(), m.channel.kind, m.publish_time_ns, m.data.to_vec()));
    }
    let end = reader.end().unwrap().word().to_owned();
    (seen, end)
}

#[test]
fn every_reader_gives_of_columns_what_it_gives_of_json() {
    let dir = tempfile::tempdir().unwrap();
    let [json, columns] = both(dir.path());
    let (of_json, of_columns) = (messages(Path::new(&json)), messages(Path::new(&columns)));
    assert!(of_json.0.len() > 1000 && of_json.0.iter().any(|m| m.1 == Some(Kind::Estimate)));
    assert!(of_json == of_columns, "messages, their order, times of the plant and bytes");
    assert_eq!(load_samples(Path::new(&json)).unwrap().loops, load_samples(Path::new(&columns)).unwrap().loops);
    for file in [&json, &columns] {
        assert!(stdout(&expect(0, &["replay", file, "--verify"])).contains("all equal to the byte"));
    }
    let figure = |file: &str, key: &str| -> f64 {
        let text = stdout(&expect(0, &["info", file, "--verify", "--format", "json"]));
        serde_json::from_str::<serde_json::Value>(&text).unwrap()[key].as_f64().unwrap()
    };
    assert_eq!(figure(&json, "messages").to_bits(), figure(&columns, "messages").to_bits());
    let sizes = [&json, &columns].map(|file| figure(file, "bytes_per_sample"));
    assert!(sizes[1] < 24.0 && sizes[1] < sizes[0], "{sizes:?}");
}

#[test]
fn a_look_back_through_the_index_finds_samples_in_columns() {
    let dir = tempfile::tempdir().unwrap();
    let [json, columns] = both(dir.path());
    let prefix = RecordingReader::open(Path::new(&json)).unwrap().metadata()["prefix"].clone();
    let name = load_samples(Path::new(&json)).unwrap().loops[1].name.clone();
    let found = |file: &str| {
        let folder = tempfile::tempdir().unwrap();
        fs::copy(file, folder.path().join("a.mcap")).unwrap();
        let archive = Archive::new(folder.path(), &prefix);
        let wanted = Wanted {
            topics: BTreeSet::from([
                topic::raw(&prefix, &name, Signal::Pv),
                topic::result(&prefix, &name, Kind::Estimate),
            ]),
            range_ns: [0, i64::MAX],
            until: Instant::now() + Duration::from_secs(60),
        };
        let mut all = Vec::new();
        let reach = archive.read(&wanted, &mut |f| all.push((f.topic.to_owned(), f.t_ns, f.data.to_vec())));
        assert_eq!(reach, Reach::All);
        all
    };
    let of_json = found(&json);
    assert!(of_json.len() > 100);
    assert!(of_json == found(&columns));
}

#[test]
fn cut_and_damaged_columns_give_what_is_whole_and_recover_keeps_them_columns() {
    let dir = tempfile::tempdir().unwrap();
    let [_, columns] = both(dir.path());
    let (whole, end) = messages(Path::new(&columns));
    assert_eq!(end, "clean");
    let bytes = fs::read(&columns).unwrap();
    let hurt = dir.path().join("hurt.mcap");
    for k in 1..40 {
        let mut damaged = bytes.clone();
        let at = damaged.len() * k / 40;
        if k % 2 == 0 {
            damaged.truncate(at);
        } else {
            damaged[at] ^= 1 << (k % 8);
        }
        fs::write(&hurt, &damaged).unwrap();
        let (seen, _) = messages(&hurt);
        let mut left = whole.iter();
        assert!(seen.iter().all(|m| left.any(|w| w == m)), "byte {at}: what is read stood there, in that order");
    }
    fs::write(&hurt, &bytes[..bytes.len() - 60]).unwrap();
    let out = dir.path().join("out.mcap");
    expect(3, &["recover", hurt.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert!(!messages(&out).0.is_empty() && messages(&out).0 == messages(&hurt).0);
    assert_eq!(RecordingReader::open(&out).unwrap().metadata()["raw"], "columns");
}

/// The ten lines in docs/test-a-change.md, if Python has the required packages.
#[test]
fn python_reads_columns_by_the_lines_of_the_page() {
    let page = fs::read_to_string("docs/test-a-change.md").unwrap();
    let lines = page.split("```python\n").nth(1).unwrap().split("```").next().unwrap();
    assert!(lines.lines().count() <= 12, "{lines}");
    let python = ["target/python/bin/python3", "target/venv/bin/python3", "python3"].into_iter().find(|python| {
        let mut asked = Command::new(python);
        asked.args(["-c", "import mcap, zstandard, numpy"]).stderr(Stdio::null());
        asked.status().is_ok_and(|status| status.success())
    });
    let Some(python) = python else {
        return crate::live::skipped("python_reads_columns", "no Python with mcap, zstandard and numpy");
    };
    let dir = tempfile::tempdir().unwrap();
    let [_, columns] = both(dir.path());
    let program = format!("{}\nfor row in samples:\n    print(*row)\n", lines.replace("plant.mcap", &columns));
    let out = Command::new(python).args(["-c", &program]).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let said = String::from_utf8(out.stdout).unwrap();
    let mut said = said.lines();
    let mut reader = RecordingReader::open(Path::new(&columns)).unwrap();
    let mut compared = 0;
    while let Some(message) = reader.next_message().unwrap() {
        if !message.channel.kind.is_some_and(Kind::is_raw) {
            continue;
        }
        let row: Vec<&str> = said.next().unwrap().split(' ').collect();
        let sample: serde_json::Value = serde_json::from_slice(message.data).unwrap();
        assert_eq!((row[0], row[1]), (message.topic(), sample["t"].to_string().as_str()));
        assert_eq!(row[2].parse::<f64>().ok().filter(|v| v.is_finite()), sample["v"].as_f64());
        compared += 1;
    }
    assert!(compared > 1000 && said.next().is_none(), "{compared}");
}

#[test]
fn parquet_by_loop_and_day_reads_back_equal() {
    let dir = tempfile::tempdir().unwrap();
    let name = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let table = "t,op,pv,sp,mode\n1700000000,40.5,1,5,auto\n1700000010,41.25,2,5,manual\n1700090000.5,,3,5,manual\n\
        1700090010.5,42,4,6,auto\n";
    fs::write(name("FIC101.csv"), table).unwrap();
    let [_, recorded] = both(dir.path());
    expect(0, &["convert", &name("FIC101.csv"), &name("data"), "--partition", "loop,day"]);
    let parts = ["day=2023-11-14", "day=2023-11-15"].map(|day| name(&format!("data/loop=FIC101/{day}/part-0.parquet")));
    assert!(parts.iter().all(|part| Path::new(part).is_file()));
    expect(0, &["convert", &name("data"), &name("back.csv")]);
    assert_eq!(fs::read_to_string(name("back.csv")).unwrap(), table);
    // Existing files are kept unless forced, and other loops are added.
    expect(1, &["convert", &name("FIC101.csv"), &name("data"), "--partition", "loop,day"]);
    expect(0, &["convert", &name("FIC101.csv"), &name("data"), "--partition", "loop,day", "--force"]);
    expect(0, &["convert", &recorded, &name("fleet"), "--partition", "loop,day"]);
    expect(0, &["convert", &name("fleet"), &name("back.mcap")]);
    let rows = |file: &str| -> Vec<(String, String)> {
        let folder = tempfile::tempdir().unwrap();
        expect(0, &["convert", file, folder.path().to_str().unwrap()]);
        let mut all: Vec<(String, String)> = fs::read_dir(folder.path())
            .unwrap()
            .map(|e| e.unwrap().path())
            .map(|p| (p.file_name().unwrap().to_str().unwrap().to_owned(), fs::read_to_string(&p).unwrap()))
            .collect();
        all.sort();
        all
    };
    let sorted = |all: Vec<(String, String)>| -> Vec<(String, Vec<String>)> {
        let lines = |text: String| {
            let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
            lines.sort();
            lines
        };
        all.into_iter().map(|(name, text)| (name, lines(text))).collect()
    };
    let (there, back) = (sorted(rows(&recorded)), sorted(rows(&name("back.mcap"))));
    assert!(there.len() == 4 && there == back);
}
