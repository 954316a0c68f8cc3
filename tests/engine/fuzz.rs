//! Every reader of outside data, with damaged and random bytes: nothing may panic, hang or grow without limit.
//!
//! Runs on the stable compiler, in this process. Each target gets a fixed number of inputs, so that every run covers the same
//! on every machine; `STICTIOND_FUZZ_TIMES=1000 cargo test --test engine fuzz -- --nocapture` gives it a thousand times as
//! many. A failure names the seed of its input, and `STICTIOND_FUZZ_SEED=N` runs that one alone.

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use stiction::core::record::{Mode, Signal, Value};
use stiction_engine::alarm::{Alarm, Command};
use stiction_engine::codec::topic::Topic;
use stiction_engine::codec::{Bundle, Codec, F64Le, MAX_SAMPLES, Memory, decode, decode_fields};
use stiction_engine::config::Config;
use stiction_files::columns::{self, Columns, Row};
use stiction_files::load_samples;

#[path = "../program/exports/data.rs"]
#[allow(dead_code)]
mod data;

/// Names of the environment variables: factor for the number of inputs, and the one seed to run.
const TIMES: &str = "STICTIOND_FUZZ_TIMES";
const SEED: &str = "STICTIOND_FUZZ_SEED";

/// Fragments that mutations insert.
const WORDS: [&[u8]; 34] = [
    b";",
    b"\t",
    b"1.234,5",
    b"05/01/2026 08:00",
    b"25.10.2026 02:30:00",
    b"46027.5",
    b"Bad Input",
    b"sep=",
    b"PAR1",
    b"A.OP",
    b"NaN",
    b"1e999",
    b"-0",
    b"{",
    b"}",
    b"[",
    b"]",
    b"\"t\":",
    b"\"v\":",
    b",",
    b"\n",
    b"\xff\xff\xff\xff",
    b"\0\0\0\0",
    b"9223372036854775807",
    b"2026-01-01T00:00:00Z",
    b"[[loop]]",
    b"=",
    b"t,op,pv\n",
    b"\x06",
    b"zstd",
    b"@stiction/v1",
    b"\x1b[2J",
    b"\xe2\x80\xae",
    b"MATLAB 5.0",
];

/// A random or damaged input.
fn mutated(random: &mut ChaCha8Rng, corpus: &[Vec<u8>]) -> Vec<u8> {
    let mut below = |n: usize| (random.next_u32() as usize) % n.max(1);
    let mut bytes = corpus[below(corpus.len())].clone();
    for _ in 0..1 + below(6) {
        let at = below(bytes.len() + 1);
        match below(7) {
            0 if !bytes.is_empty() => {
                let at = below(bytes.len());
                bytes[at] ^= 1 << below(8);
            }
            1 => bytes.truncate(at),
            2 => drop(bytes.splice(at..at, WORDS[below(WORDS.len())].iter().copied())),
            3 => {
                let end = (at + below(64)).min(bytes.len());
                bytes.drain(at..end);
            }
            4 => {
                let piece: Vec<u8> = bytes[at..(at + below(200)).min(bytes.len())].to_vec();
                let to = below(bytes.len() + 1);
                bytes.splice(to..to, piece);
            }
            5 => {
                let other = &corpus[below(corpus.len())];
                let from = below(other.len() + 1);
                bytes.truncate(at);
                bytes.extend_from_slice(&other[from..]);
            }
            _ => drop(bytes.splice(at..at, (0..8).map(|k| (k * 37 + at) as u8))),
        }
    }
    bytes.truncate(1 << 20);
    bytes
}

/// Runs one target on `count` inputs, or on the multiple given by [`TIMES`].
fn fuzz(name: &str, count: u64, corpus: &[Vec<u8>], target: impl Fn(&[u8])) {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let seeds = number(SEED).map_or(0..count * number(TIMES).unwrap_or(1), |seed| seed..seed + 1);
    for seed in seeds.clone() {
        let input = mutated(&mut ChaCha8Rng::seed_from_u64(seed), corpus);
        let outcome = catch_unwind(AssertUnwindSafe(|| target(&input)));
        assert!(outcome.is_ok(), "{name}: seed {seed} panics on {} bytes", input.len());
    }
    println!("{name}: {} inputs", seeds.count());
}

fn texts(all: &[&str]) -> Vec<Vec<u8>> {
    all.iter().map(|text| text.as_bytes().to_vec()).collect()
}

#[test]
fn payloads() {
    let corpus = texts(&[
        "1.5",
        r#"{"t":1700000000000000000,"v":50.25,"q":192}"#,
        r#"[{"t":"2026-01-01T00:00:00.5Z","v":1},{"t":2,"v":null},3,"auto"]"#,
        "\u{0}\u{0}\u{0}\u{0}\u{0}\u{0}\u{8}@",
    ]);
    fuzz("payloads", 20000, &corpus, |bytes| {
        for (signal, encoding, codec) in [
            (Signal::Op, None, None),
            (Signal::Mode, Some("application/json"), None),
            (Signal::Pv, Some("\u{1b};;"), Some(&F64Le as &dyn Codec)),
        ] {
            let mut samples = Vec::new();
            let _ = decode(signal, bytes, encoding, codec, 7, &mut samples);
            assert!(samples.len() <= MAX_SAMPLES);
        }
    });
}

/// Every format, with the example on the page and others: named values within bounds, and the same payload on the key of one
/// signal.
#[test]
fn payloads_of_every_format() {
    let page = crate::formats::page();
    for codec in stiction_engine::codec::ALL {
        let name = codec.name();
        let example = page
            .split_once(&format!("\n### {name}\n"))
            .map_or("1.5", |(_, after)| after.split_once("```payload\n").unwrap().1.split_once("\n```").unwrap().0);
        let hex: Option<Vec<u8>> = example
            .split_whitespace()
            .map(|w| (w.len() == 2).then(|| u8::from_str_radix(w, 16).ok()).flatten())
            .collect();
        let mut corpus =
            texts(&[example, r#"[{"name":"a","v":[1]},{"Payload":{"x":{"Value":{}}}}]"#, "m,t=\\ x f=\"\\\"\" 9"]);
        corpus.extend(hex);
        corpus.push(b"\x9f\xa1\x61v\xfb\x7f\xf8\0\0\0\0\0\0\xff".to_vec());
        fuzz(name, 5000, &corpus, |bytes| {
            let (mut memory, mut fields) = (Memory::default(), Vec::new());
            for key in ["p/spBv1.0/g/NBIRTH/n", "p/spBv1.0/g/NDATA/n", "p/x"] {
                let bundle = Bundle { key, payload: bytes, fallback_t_ns: 7 };
                let read = decode_fields(&bundle, None, Some(codec), &mut memory, &mut fields);
                assert!(read.is_ok() || fields.is_empty());
                assert!(fields.len() <= MAX_SAMPLES);
                fields.clear();
            }
            let mut samples = Vec::new();
            let _ = decode(Signal::Op, bytes, None, Some(codec), 7, &mut samples);
            assert!(samples.iter().all(|s| s.value.as_number().is_none_or(f64::is_finite)));
        });
    }
}

#[test]
fn recordings_tables_and_stores() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("input");
    let read = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        let _ = load_samples(&path);
    };
    let recording = fs::read("recordings/awkward.mcap").unwrap();
    let cut = recording[..recording.len() / 3].to_vec();
    fuzz("recordings", 300, &[recording, cut], read);
    let table = "t,op,pv,sp,mode\n0,50,20,20,auto\n2026-01-01T00:00:01Z,51,,20,manual\n2,NaN,1e400,,\n";
    fuzz("tables", 10000, &texts(&[table, "PV;T;OP\n1;2;3\n", "\u{feff}t,pv,op\r\n\"1\",2,3\r\n"]), read);
    let store = dir.path().join("s.mat");
    let csv = dir.path().join("a.csv");
    let rows: String = (0..60).map(|k| format!("{k},{},{}\n", k % 7, k % 5)).collect();
    fs::write(&csv, format!("t,op,pv\n{rows}")).unwrap();
    let made = std::process::Command::new(env!("CARGO_BIN_EXE_stictiond"))
        .args(["convert", csv.to_str().unwrap(), store.to_str().unwrap()])
        .output()
        .unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    fuzz("stores", 1000, &[fs::read(&store).unwrap()], read);
}

/// Messages of columns, as a file with correct checksums may contain them.
#[test]
fn messages_of_columns() {
    let mut columns = Columns::default();
    for k in 0..40 {
        let value = if k % 9 == 0 { Value::Mode(Mode::Manual) } else { Value::number(f64::from(k) / 3.0) };
        let t_ns = 1_700_000_000_000_000_000 + i64::from(k / 4) * 10_000_000_000;
        let quality = (k % 5 == 0).then_some(192);
        columns.push(Row { channel: k as u16 % 4, t_ns, arrival_ns: t_ns + 7_000_000, value, quality });
    }
    fuzz("columns", 20000, &[columns.take(), Vec::new(), vec![0xff; 32 + 31 * 3]], |bytes| {
        let mut rows = Vec::new();
        let read = columns::decode(bytes, &mut rows);
        assert_eq!(read.is_ok(), !rows.is_empty());
        assert!(rows.len() <= bytes.len() / columns::ROW);
    });
}

#[test]
fn exports() {
    use stiction_files::export::{ReadOptions, Zone};
    use stiction_files::load;

    let dir = tempfile::tempdir().unwrap();
    let options = ReadOptions { zone: Zone::parse("Europe/Berlin").ok(), ..ReadOptions::default() };
    let (from, to) = (631_152_000_000_000_000, 4_102_444_800_000_000_000);
    let target = |name: &'static str| {
        let path = dir.path().join(name);
        let options = &options;
        move |bytes: &[u8]| {
            fs::write(&path, bytes).unwrap();
            if let Ok(loaded) = load(&path, options) {
                let samples = loaded.loops.iter().flat_map(|one| &one.samples);
                // Seconds may count from any start if their heading says that they are seconds.
                let counted = loaded.recognised.is_none_or(|found| found.form.contains("since 1970"));
                assert!(counted || samples.clone().all(|s| (from..to).contains(&s.t_ns)));
            }
        }
    };
    let german = |k: usize| data::local(k, "Europe/Berlin", "%d.%m.%Y %H:%M:%S");
    let tags = ["Time", "41FIC101.OP", "41FIC101.PV"];
    let table = data::Form::german(german).table(&tags);
    let us = data::Form::with(|k| data::utc(k, "%-m/25/%Y %-I:%M:%S %p")).table(&tags);
    let days = data::Form::with(|k| format!("{}", data::t_s(k) as f64 / 86_400.0 + 25_569.0)).table(&tags);
    let long =
        "tag;timestamp;value;quality\nA.OP;2026-01-05T08:00:00Z;1,5;192\nA.PV;2026-01-05T08:00:00Z;Bad Input;0\n";
    let wide = "\u{feff}# r\nDate,Time,A.OP (%),A.PV [m3/h]\n,,%,m3/h\n2026-10-25,02:59:59,\"1,234.5\",2\n2026-10-25,02:00:00,1,2\n";
    let mut corpus = texts(&[&table, &us, &days, long, wide, "sep=;\nt;op;pv\n1e9;NaN;1'000\n"]);
    corpus.push(table.encode_utf16().flat_map(u16::to_le_bytes).collect());
    fuzz("exports", 200, &corpus, target("x.csv"));
    let cell = |k: usize| {
        use data::XlsxCell::{Date, Number};
        vec![Date(data::t_s(k) as f64 / 86_400.0 + 25_569.0), Number(data::op(k)), Number(data::pv(k))]
    };
    let head = tags.map(|t| data::XlsxCell::Text(t.to_owned()));
    let book = data::xlsx(&std::iter::once(Vec::from(head)).chain((0..data::ROWS).map(cell)).collect::<Vec<_>>());
    fuzz("workbooks", 100, &[book], target("x.xlsx"));
    #[cfg(feature = "parquet")]
    for (name, bytes) in [("x.parquet", data::parquet(&data::wide(true))), ("x.arrow", data::arrow(&data::wide(true)))]
    {
        fuzz(name, 200, &[bytes], target(name));
    }
}

#[test]
fn configurations() {
    let corpus = ["monitor", "demo", "broken"].map(|name| fs::read(format!("config/{name}.toml")).unwrap());
    fuzz("configurations", 2000, &corpus, |bytes| {
        if let Err(faults) = Config::parse(&String::from_utf8_lossy(bytes)) {
            assert!(!faults.is_empty());
        }
    });
}

#[test]
fn expectations() {
    let corpus = [fs::read("config/expectations.toml").unwrap()];
    fuzz("expectations", 2000, &corpus, |bytes| {
        if let Err(faults) = stiction_engine::expectations::parse(&String::from_utf8_lossy(bytes)) {
            assert!(!faults.is_empty());
        }
    });
}

#[test]
fn keys_and_commands() {
    let keys = texts(&["plant1/area1/FIC101/op", "p/@stiction/v1/u1/FIC101/alarm", "p/@stiction/v1/@daemon/x/health"]);
    fuzz("keys", 20000, &keys, |bytes| {
        let text = String::from_utf8_lossy(bytes);
        let _ = Topic::parse(Some("plant1/area1"), &text);
        let _ = Topic::parse(None, &text);
    });
    let commands = texts(&["ack ann seen", "shelve bob 3600", "in_service \u{1b}[2J x"]);
    fuzz("commands", 20000, &commands, |bytes| {
        let text = String::from_utf8_lossy(bytes);
        let mut words = text.splitn(3, ' ').map(str::to_owned);
        let (cmd, by, why) = (words.next().unwrap_or_default(), words.next(), words.next());
        let for_s = why.as_deref().and_then(|w| w.parse().ok());
        let Ok(action) = cmd.parse() else { return };
        let command = Command { action, by, why, for_s };
        if command.check().is_ok() {
            let mut alarm = Alarm::default();
            if let Ok(document) = alarm.command("L", &command, i64::MAX) {
                assert!(!document.line().contains('\u{1b}'));
            }
        } else {
            assert!(command.check().unwrap_err().to_string().len() < 400);
        }
    });
}

/// A user's files: scenarios, models, lists of labels, and the options for reading files.
#[test]
fn scenarios_models_labels_and_options() {
    let scenarios =
        ["sticking", "four-loops", "awkward"].map(|n| fs::read(format!("recordings/scenarios/{n}.toml")).unwrap());
    fuzz("scenarios", 1000, &scenarios, |bytes| {
        if let Err(error) = stiction::simulated::scenario::Scenario::parse(&String::from_utf8_lossy(bytes)) {
            assert!(!error.to_string().is_empty());
        }
    });
    let model = r#"{"schema":"stictiond.model.v1","ts_s":1,"valve":{"fs":4,"fd":2},"process":{"gain":2,"time_constants_s":[10,5],"dead_time_s":3,"integrating":false},"rest":{"op":50,"pv":60},"effects":[]}"#;
    fuzz("models", 5000, &texts(&[model, "{}\n[]", r#"{"schema":"stictiond.gap.v1","model_after":{}}"#]), |bytes| {
        let _ = stiction::core::gap::model_file::ModelFile::parse(&String::from_utf8_lossy(bytes));
    });
    let dir = tempfile::tempdir().unwrap();
    let index = dir.path().join("INDEX.csv");
    fuzz(
        "labels",
        1000,
        &texts(&["file,label,valve,loop\na/b.csv,stiction,V1,FIC101\n", "label,file\n,\n"]),
        |bytes| {
            fs::write(&index, bytes).unwrap();
            let _ = stiction_files::labelled::read(&index);
        },
    );
    let options =
        texts(&["map op=Valve, main,pv=41FI101,t=1", "tz CET-1CEST,M3.5.0,M10.5.0/3", "time-format %d/%m/%Y %H:%M:%S"]);
    fuzz("options", 5000, &options, |bytes| {
        let text = String::from_utf8_lossy(bytes);
        let mut given = stiction_files::ReadOptions::default();
        for name in ["map", "tz", "time-format", "time-unit", "decimal", "delimiter", "encoding", "quality", "missing"]
        {
            let value = text.split_once(' ').map_or(&*text, |(_, value)| value);
            if given.set(name, value).is_ok() {
                let _ = stiction_files::export::moment("05/01/2026 08:00", &given);
            }
        }
        let _ = stiction_files::export::moment(&text, &given);
    });
}

/// Documents that come back over the bus, from any version.
#[test]
fn documents_from_the_bus() {
    let estimate = r#"{"schema":"stictiond.estimate.v1","loop":"A","window":{"start_ns":0,"end_ns":9},"verdict":"stiction","gates":["too_coarse"],"s":1.5,"fs_interval":[1,2],"indicators":[{"name":"x","contribution":1.5}]}"#;
    let alarm = r#"{"schema":"stictiond.alarm.v1","loop":"A","active":true,"since_ns":5,"p":0.9,"marks":{}}"#;
    fuzz("documents", 5000, &texts(&[estimate, alarm, "null"]), |bytes| {
        if let Ok(value) = serde_json::from_slice(bytes) {
            let _ = (stictiond::daemon::received::estimate(&value), stictiond::daemon::received::alarm(&value));
        }
    });
}
