//! Commands that read exports, run as programs.

use std::fs;
use std::path::Path;

use super::data::{Form, local, utc};
use crate::common::program::{expect, stderr, stdout};

/// A triangle with a square, as produced by a sticking valve.
fn sticking(tag: &str, rows: usize) -> String {
    let row = |k: usize| {
        let t = (k % 60) as f64 / 60.0;
        let triangle = if t < 0.5 { 4.0 * t - 1.0 } else { 3.0 - 4.0 * t };
        let square = if (0.1..0.6).contains(&t) { 1.0 } else { -1.0 };
        let noise = 1e-3 * (k * k % 31) as f64;
        let time = local(k, "Europe/Berlin", "%d.%m.%Y %H:%M:%S");
        format!("{time};{};{}\n", 50.0 + 3.0 * triangle, 20.0 + square + noise).replace('.', ",").replacen(',', ".", 2)
    };
    format!("Zeit;{tag}.OP;{tag}.PV\n{}", (0..rows).map(row).collect::<String>())
}

#[test]
fn a_folder_gives_one_table_and_one_report() {
    let folder = tempfile::tempdir().unwrap();
    let exports = folder.path().join("exports");
    fs::create_dir(&exports).unwrap();
    for tag in ["41FIC101", "41FIC102", "41LIC7"] {
        fs::write(exports.join(format!("{tag}.csv")), sticking(tag, 400)).unwrap();
    }
    fs::write(exports.join("broken.csv"), "Zeit;41TIC9.OP;41TIC9.PV\nsoon;1;2\nlater;1;2\n").unwrap();
    let (place, page) = (exports.to_str().unwrap(), folder.path().join("fleet.html"));
    let output = expect(0, &["analyze", place, "--tz", "Europe/Berlin", "--report", page.to_str().unwrap()]);
    let (table, log) = (stdout(&output), stderr(&output));
    assert_eq!(table.lines().count(), 5, "{table}");
    assert!(table.lines().last().unwrap().contains("3 loops") && table.contains("1 not analysed"), "{table}");
    let read: Vec<&str> = log.lines().filter(|l| l.contains("read as")).collect();
    assert!(read.len() == 1 && read[0].contains("2 more like it") && read[0].contains("decimal comma"), "{log}");
    assert!(log.contains("broken.csv"), "{log}");
    assert!(fs::read_to_string(&page).unwrap().contains("41LIC7"));

    let pattern = exports.join("41F*.csv");
    let arguments = ["analyze", pattern.to_str().unwrap(), "--tz", "Europe/Berlin", "--format", "json"];
    let documents = stdout(&expect(0, &arguments));
    let names: Vec<String> = documents
        .lines()
        .map(|l| serde_json::from_str::<serde_json::Value>(l).unwrap()["loop"].as_str().unwrap().to_owned())
        .collect();
    assert_eq!(names, ["41FIC101", "41FIC102"]);
    let one = stdout(&expect(0, &["analyze", place, "--tz", "Europe/Berlin", "--loop", "41LIC7"]));
    assert!(one.contains("1 loops") && one.contains("41LIC7"), "{one}");
}

#[test]
fn every_command_that_takes_a_file_takes_an_export_and_says_so_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let export = path("june.csv");
    fs::write(&export, sticking("41FIC101", 400)).unwrap();
    let tz = ["--tz", "Europe/Berlin"];
    let one_line = |log: &str| {
        assert_eq!(log.lines().filter(|l| l.contains("read as")).count(), 1, "{log}");
        assert!(log.contains("semicolons, decimal comma, times day first, Europe/Berlin"), "{log}");
    };
    let info = expect(0, &[&["info", &export, "--format", "json"][..], &tz].concat());
    one_line(&stderr(&info));
    let document: serde_json::Value = serde_json::from_str(&stdout(&info)).unwrap();
    assert_eq!((&document["loops"][0]["loop"], &document["loops"][0]["ts_s"]), (&"41FIC101".into(), &10.0.into()));
    assert!(document["recognised"].as_str().unwrap().contains("decimal comma"));

    let out = path("out.csv");
    one_line(&stderr(&expect(0, &[&["convert", &export, &out][..], &tz].concat())));
    assert!(fs::read_to_string(&out).unwrap().starts_with("t,op,pv\n1767600000,47,19\n"));
    one_line(&stderr(&expect(0, &[&["gap", &export, "--budget", "0.2"][..], &tz].concat())));
    // Nothing listens there; by then the file has been read.
    one_line(&stderr(&expect(
        1,
        &[&["play", &export, "--connect", "tcp/127.0.0.1:1", "--prefix", "p"][..], &tz].concat(),
    )));
    let refused = expect(1, &["analyze", &export]);
    assert!(stderr(&refused).contains("line 2") && stderr(&refused).contains("--tz Europe/Berlin"));
    expect(2, &["info", &export, "--tz", "Nowhere/Land"]);
}

#[test]
fn the_hours_that_clocks_are_moved_over_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("autumn.csv");
    // On 2026-10-25, 02:00 to 03:00 comes twice in Berlin. The rows begin at midnight UTC, 292 days and 16 h after `START_S`.
    let shift = |k: usize| (292 * 86_400 + 16 * 3600) / 10 + 12 * k;
    let text = (0..super::ROWS).map(|k| format!("{},1,2\n", local(shift(k), "Europe/Berlin", "%Y-%m-%d %H:%M:%S")));
    let first = local(shift(0), "Europe/Berlin", "%Y-%m-%d %H:%M:%S");
    fs::write(&path, format!("Time,A.OP,A.PV\n{}", text.collect::<String>())).unwrap();
    let place = path.to_str().unwrap();
    let out = folder.path().join("out.csv");
    let rows = |out: &Path| {
        fs::read_to_string(out)
            .unwrap()
            .lines()
            .skip(1)
            .map(|l| l.split(',').next().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    let expected: Vec<String> = (0..super::ROWS).map(|k| super::t_s(shift(k)).to_string()).collect();
    expect(0, &["convert", place, out.to_str().unwrap(), "--tz", "Europe/Berlin"]);
    assert_eq!(rows(&out), expected);
    assert_eq!(first, "2026-10-25 02:00:00");
    // The same clock readings could be in UTC, so the zone must be given.
    let utc_rows: String = Form::with(|k| utc(k, "%Y-%m-%d %H:%M:%S")).table(&["Time", "A.OP", "A.PV"]);
    fs::write(&path, utc_rows).unwrap();
    expect(1, &["convert", place, out.to_str().unwrap(), "--force"]);
    expect(0, &["convert", place, out.to_str().unwrap(), "--force", "--tz", "UTC"]);
    assert_eq!(rows(&out)[0], super::t_s(0).to_string());
}
