//! `gap` run as a program: its document, arithmetic that anyone can repeat, its outputs and its refusals.

#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

use serde_json::Value;
use stiction::core::gap::document::GapDocument;
use stiction_lab::truth::fixture::Loop;

fn stictiond(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_stictiond")).args(arguments).output().unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

#[track_caller]
fn expect(code: i32, arguments: &[&str]) -> Output {
    let output = stictiond(arguments);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}{}", stdout(&output), stderr(&output));
    output
}

fn folder() -> &'static PathBuf {
    static FOLDER: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let made = FOLDER.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().to_owned();
        (folder, path)
    });
    &made.1
}

fn path(name: &str) -> String {
    folder().join(name).to_str().unwrap().to_owned()
}

/// A sticking loop with set-point moves as a table; a second time constant is a lag that the base lacks.
fn table(name: &str, taus: &[f64], n: usize) -> String {
    let plant = Loop {
        fs: 3.0,
        fd: 1.0,
        tracking: false,
        gain: 2.0,
        taus: taus.to_vec(),
        dead_time: 2.4,
        kc: 0.7,
        ti: 15.0,
        noise: 0.05,
        sp: |k| if k / 230 % 2 == 0 { 0.0 } else { 6.0 },
        n,
        warm_up: 200,
        seed: 3,
    };
    let record = plant.run().record;
    let mut text = "t,op,pv,sp\n".to_owned();
    for (k, (op, pv)) in record.op_path.iter().zip(&record.pv).enumerate() {
        // Here the warm-up precedes the first set-point move.
        let sp = 200.0 + (plant.sp)(k + 200);
        text.push_str(&format!("{},{op},{pv},{sp}\n", 1_700_000_000 + k));
    }
    let path = path(name);
    fs::write(&path, text).unwrap();
    path
}

/// A loop with a lag of 8 s after its valve, diagnosed once for all tests: document, predictions, report.
fn lagging() -> &'static (Value, String, String) {
    static DONE: OnceLock<(Value, String, String)> = OnceLock::new();
    DONE.get_or_init(|| {
        let input = table("lagging.csv", &[20.0, 8.0], 1000);
        let (rows, page) = (path("lagging-rows.csv"), path("lagging.html"));
        let out = expect(0, &["gap", &input, "--predictions", &rows, "--report", &page, "--format", "json"]);
        let line = stdout(&out);
        assert_eq!(line.lines().count(), 1, "{line}");
        fs::write(path("lagging.json"), &line).unwrap();
        (serde_json::from_str(&line).unwrap(), fs::read_to_string(&rows).unwrap(), fs::read_to_string(&page).unwrap())
    })
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Root mean squares of `pv - pv_base` and `pv - pv_after` over the held-out rows.
fn errors_of(rows: &str) -> [f64; 2] {
    let mut lines = rows.lines();
    assert_eq!(lines.next(), Some("t,pv,pv_base,pv_after,held_out"));
    let (mut sums, mut count) = ([0.0; 2], 0.0);
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        if cells[4] == "1" {
            let value = |i: usize| cells[i].parse::<f64>().unwrap();
            for (sum, i) in sums.iter_mut().zip([2, 3]) {
                *sum += (value(1) - value(i)) * (value(1) - value(i));
            }
            count += 1.0;
        }
    }
    assert!(count > 300.0, "{count} held-out rows");
    sums.map(|sum| f64::sqrt(sum / count))
}

#[test]
fn the_document_reads_back_and_its_shares_sum_to_one() {
    let (d, _, _) = lagging();
    assert_eq!((&d["schema"], &d["loop"]), (&"stictiond.gap.v1".into(), &"lagging".into()));
    let text = d.to_string();
    let document: GapDocument = serde_json::from_str(&text).unwrap();
    assert_eq!(&serde_json::to_value(&document).unwrap(), d, "the document does not survive being read");
    let sum = |values: Vec<&Value>| values.into_iter().filter_map(Value::as_f64).sum::<f64>();
    let place = &d["where"];
    for list in ["segments", "bands", "level"] {
        let shares = place[list].as_array().unwrap().iter().map(|x| &x["share"]).collect();
        assert!((sum(shares) - 1.0).abs() < 1e-9, "{list}: {}", place[list]);
    }
    for pair in ["phases", "direction"] {
        let shares = place[pair].as_object().unwrap().values().collect();
        assert!((sum(shares) - 1.0).abs() < 1e-9, "{pair}: {}", place[pair]);
    }
    assert_eq!(place["segments"].as_array().unwrap().len(), 16);
    assert!(place["excitation"]["setpoint_moves"].as_u64().unwrap() >= 3, "{}", place["excitation"]);
    assert!(d["evaluations"].as_u64().unwrap() > 0);
}

#[test]
fn anyone_can_compute_the_gap_and_the_closure_from_the_rows() {
    let (d, rows, _) = lagging();
    assert_eq!(rows.lines().count(), 1001, "a row per sample and a header");
    let [before, after] = errors_of(rows);
    let close = |a: f64, b: f64, what: &str| assert!((a - b).abs() <= 1e-6 * b.abs(), "{what}: {a} is not {b}");
    close(before, number(&d["gap"]["rmse"]), "rmse");
    let floor = d["gap"]["noise_floor"].as_f64().unwrap_or(0.0);
    let gap = |rmse: f64| (rmse * rmse - floor * floor).max(0.0).sqrt();
    close(gap(before), number(&d["gap"]["gap"]), "gap");
    let named =
        d["effects"].as_array().unwrap().iter().find(|e| e["id"] == d["cause"]["id"]).expect("a cause is named");
    close(gap(before), number(&named["gap_before"]), "gap_before");
    close(gap(after), number(&named["gap_after"]), "gap_after");
    close(100.0 * (1.0 - gap(after) / gap(before)), number(&named["closed_pct"]), "closed_pct");
}

#[test]
fn a_lag_behind_the_valve_is_named_and_closes_the_gap() {
    let (d, _, _) = lagging();
    assert_eq!(d["cause"]["id"], "extra_lag", "{}", d["cause"]);
    assert_eq!(d["where"]["stage"], "process");
    let named = &d["effects"].as_array().unwrap()[0];
    assert!(number(&named["closed_pct"]) > 50.0, "{named}");
    let after = &d["model_after"];
    assert!(
        after["process"]["time_constants_s"].as_array().unwrap().len() == 2 && number(&after["s"]) > 0.0,
        "{after}"
    );
}

#[test]
fn the_text_can_be_read_aloud() {
    let (d, _, _) = lagging();
    let document: GapDocument = serde_json::from_value(d.clone()).unwrap();
    let text = stiction::words::gap_text::paragraph(&document);
    for part in ["an extra lag of", "what is left is", "of PV's movement"] {
        assert!(text.contains(part), "{part:?} is missing: {text}");
    }
    assert!(text.ends_with('.') && text.chars().next().unwrap().is_uppercase() | text.starts_with(char::is_numeric));
    let short = stdout(&expect(0, &["gap", &path("lagging.csv"), "--budget", "1"]));
    assert!(short.starts_with("lagging: ") && short.lines().count() == 4, "{short}");
    let analyzed = stdout(&expect(0, &["analyze", &path("lagging.csv")]));
    let sentence = document.valve.map(|valve| valve.sentence).unwrap_or_default();
    assert!(analyzed.lines().next().unwrap().ends_with(&sentence) && short.contains(&sentence), "{analyzed}{short}");
    let all = stdout(&expect(0, &["gap", &path("lagging.csv"), "--budget", "1", "--verbose"]));
    assert!(all.contains("excitation") && all.contains("budget"), "{all}");
}

#[test]
fn the_page_stands_alone_and_holds_the_sentence_and_the_command() {
    let (_, _, page) = lagging();
    for address in ["http://", "https://", "src=\"/", "url("] {
        assert!(!page.contains(address), "the page asks for {address}");
    }
    assert!(page.matches("<svg class=\"plot\"").count() >= 7);
    assert!(page.contains("an extra lag of") && page.contains("stictiond gap") && page.contains("--report"));
    let again = expect(1, &["gap", &path("lagging.csv"), "--report", &path("lagging.html")]);
    assert!(stderr(&again).contains("--force"));
}

#[test]
fn the_model_after_is_a_base_for_later_and_closes_the_structural_gap() {
    lagging();
    let out =
        expect(0, &["gap", &path("lagging.csv"), "--base", &path("lagging.json"), "--budget", "2", "--format", "json"]);
    let d: Value = serde_json::from_str(&stdout(&out)).unwrap();
    assert_eq!(d["base"]["source"], "given");
    let (given, refitted) = (number(&d["given"]["gap"]), number(&d["gap"]["gap"]));
    // The given model, which includes the lag, is better than the refitted base without it.
    assert!(given < 0.6 * refitted, "given {given}, refitted {refitted}");
    assert!((number(&d["parametric"]) - (given - refitted)).abs() < 1e-12);
}

#[test]
fn what_is_wrong_is_refused_with_its_place_and_remedy() {
    let input = table("short.csv", &[20.0], 60);
    let out = expect(1, &["gap", &input]);
    assert!(stderr(&out).contains("60 points") && stderr(&out).contains("longer"), "{}", stderr(&out));
    let out = expect(2, &["gap", &input, "--without", "extra_lug"]);
    assert!(stderr(&out).contains("extra_lug") && stderr(&out).contains("extra_lag"), "{}", stderr(&out));
    let still = path("still.csv");
    fs::write(&still, (0..300).fold("t,op,pv\n".to_owned(), |text, k| text + &format!("{k},50,{}\n", k % 7))).unwrap();
    assert!(stderr(&expect(1, &["gap", &still])).contains("is constant"));
    for (name, json, part) in [
        (
            "a.json",
            "{\"fs\":1,\"fd\":2,\"process\":{\"gain\":1,\"time_constants_s\":[5],\"dead_time_s\":0}}",
            "fd is 2",
        ),
        (
            "b.json",
            "{\"fs\":1,\"fd\":0,\"process\":{\"time_constants_s\":[5],\"dead_time_s\":0}}",
            "process.gain is missing",
        ),
        ("c.json", "fs = 1", "not JSON"),
        ("d.json", "{\"schema\":\"stictiond.alarm.v1\"}", "stictiond.alarm.v1"),
    ] {
        let file = path(name);
        fs::write(&file, json).unwrap();
        let out = expect(1, &["gap", &input, "--base", &file]);
        assert!(stderr(&out).contains(part) && stderr(&out).contains(name), "{}", stderr(&out));
    }
    assert!(stderr(&expect(1, &["gap", &input, "--base", &path("none.json")])).contains("none.json"));
    expect(2, &["gap", &input, "--budget", "0"]);
    expect(2, &["gap"]);
}

#[test]
fn odd_data_never_panics() {
    let odd = [("huge.csv", 1e300_f64, 1e-300_f64), ("tiny.csv", 1e-300, 1e-300), ("steps.csv", 1e6, 1.0)];
    for (name, big, small) in odd {
        let mut text = "t,op,pv\n".to_owned();
        for k in 0..400_u32 {
            let hole = k % 37 == 5;
            let op = if k / 20 % 2 == 0 { big } else { -small };
            let pv = if hole { String::new() } else { format!("{}", f64::from(k % 13) * small - big) };
            text.push_str(&format!("{k},{op},{pv}\n"));
        }
        let input = path(name);
        fs::write(&input, text).unwrap();
        let out = stictiond(&["gap", &input, "--budget", "0.2", "--format", "json"]);
        assert!(matches!(out.status.code(), Some(0 | 1)), "{name}: {:?} {}", out.status, stderr(&out));
        assert!(!stderr(&out).contains("panicked"), "{name}: {}", stderr(&out));
    }
}

#[test]
fn an_interrupted_search_tells_what_it_knows() {
    let input = table("long.csv", &[20.0, 8.0], 2000);
    let child = Command::new(env!("CARGO_BIN_EXE_stictiond"))
        .args(["gap", &input, "--budget", "3600", "--pairs", "--format", "json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // After some CPU time, its search is under way.
    let stat = format!("/proc/{}/stat", child.id());
    let ticks = || std::fs::read_to_string(&stat).unwrap().split(' ').nth(13).unwrap().parse::<u64>().unwrap();
    crate::live::wait_for("the search", || (ticks() > 30).then_some(()));
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let out = child.wait_with_output().unwrap();
    assert_eq!(out.status.code(), Some(0), "{}", stderr(&out));
    let d: Value = serde_json::from_str(&stdout(&out)).unwrap();
    assert_eq!(d["stopped_early"], true);
}

#[test]
fn a_base_that_is_worse_than_the_mean_of_pv_is_said_and_decides_no_other_window() {
    // PV wanders independently of OP.
    let (mut drawn, mut pv) = (1_u64, 100.0);
    let mut lines = String::from("time,op,pv\n");
    for k in 0..900 {
        drawn = (drawn * 1_103_515_245 + 12_345) % (1 << 31);
        pv += drawn as f64 / f64::from(1_u32 << 31) - 0.5;
        let op = 50.0 + 4.0 * (std::f64::consts::TAU * f64::from(k) / 60.0).sin();
        lines += &format!("{k},{op:.4},{pv:.4}\n");
    }
    let input = path("wanders.csv");
    fs::write(&input, lines).unwrap();
    let out = expect(0, &["gap", &input, "--time-format", "s"]);
    assert!(stdout(&out).contains("more than PV's mean does. Choose a section"), "{}", stdout(&out));
    let out = expect(0, &["gap", &input, "--time-format", "s", "--format", "json"]);
    let d: Value = serde_json::from_str(&stdout(&out)).unwrap();
    assert_eq!(
        (&d["cause"]["confirmed"], &d["cause"]["why"]),
        (&false.into(), &"cannot_be_told".into()),
        "{}",
        d["cause"]
    );
    let sections = ["--samples", "1,900", "--samples", "1,890", "--pool"];
    let refused = expect(1, &[&["gap", &input, "--time-format", "s"], &sections[..]].concat());
    assert!(stderr(&refused).contains("this window can decide nothing; leave it out"), "{}", stderr(&refused));
}

#[test]
fn windows_of_one_valve_are_diagnosed_together_and_what_does_not_fit_is_refused_by_its_file() {
    let input = table("windows.csv", &[20.0], 900);
    let sections = ["--samples", "1,450", "--samples", "451,900"];
    let out = expect(0, &[&["gap", &input, "--pool", "--format", "json"], &sections[..]].concat());
    let d: Value = serde_json::from_str(&stdout(&out)).unwrap();
    assert_eq!(d["pooled"].as_array().map(Vec::len), Some(2), "{}", d["pooled"]);
    assert_eq!(d["cause"]["id"], "none", "{}", d["cause"]);
    let alone = expect(2, &["gap", &input, "--pool"]);
    assert!(stderr(&alone).contains("two windows at least"), "{}", stderr(&alone));
    let shown: Vec<&Value> = d["pooled"].as_array().unwrap().iter().filter(|w| w["shown"] == true).collect();
    assert_eq!(shown.len(), 1, "{}", d["pooled"]);
    assert_eq!(d["window"]["start_ns"], shown[0]["start_ns"]);
    // Two short searches on the same samples may end differently, so the samples are compared.
    let again = path("again.csv");
    fs::copy(&input, &again).unwrap();
    let twice = expect(1, &["gap", &input, &again, "--pool", "--budget", "0.2"]);
    assert!(stderr(&twice).contains("again.csv: the same data as"), "{}", stderr(&twice));
    let text = fs::read_to_string(&input).unwrap();
    let short = path("short.csv");
    fs::write(&short, text.lines().take(30).collect::<Vec<_>>().join("\n")).unwrap();
    let refused = expect(1, &["gap", &short, &input, "--pool"]);
    assert!(stderr(&refused).contains("short.csv") && refused.stdout.is_empty(), "{}", stderr(&refused));
}
