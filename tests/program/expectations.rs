//! `stictiond test`: expectations in a file next to a configuration.

use std::fs;

use serde_json::Value;

use crate::common::program::{expect, stderr, stdout};

const CONFIG: &str = "config/demo.toml";

/// Writes a file of expectations into an empty folder, with absolute paths to inputs; returns the file's path.
fn written(folder: &tempfile::TempDir, cases: &str) -> String {
    let file = folder.path().join("cases.toml");
    let recordings = fs::canonicalize("recordings").unwrap();
    fs::write(&file, cases.replace("RECORDINGS", recordings.to_str().unwrap())).unwrap();
    file.to_str().unwrap().to_owned()
}

fn documents(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn the_shipped_expectations_hold() {
    let output = expect(0, &["test", CONFIG]);
    let text = stdout(&output);
    assert!(text.lines().all(|line| line.starts_with("ok ") || line == "7 hold, 0 do not hold, 0 could not be run"));
    assert_eq!(text.lines().count(), 8, "{text}");
}

#[test]
fn a_case_that_does_not_hold_is_shown_with_the_line_of_its_expectation() {
    let folder = tempfile::tempdir().unwrap();
    let file = written(
        &folder,
        "[[case]]\nname = \"FIC101\"\ninput = \"RECORDINGS/sticking.mcap\"\nverdict = \"tuning\"\ns = [1, 7]\nalarm = true\n",
    );
    let text = stdout(&expect(1, &["test", CONFIG, &file]));
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    assert_eq!(lines[0], "FAIL  FIC101");
    assert_eq!(lines[1], format!("{file}: line 4: verdict: expected tuning, found stiction"));
    assert!(lines[2].starts_with(&format!("{file}: line 5: s: expected 1 to 7, found 8.")), "{text}");
    assert!(lines[3].starts_with("window to 2026-01-05T08:30:00Z: stiction, s 8"), "{text}");
    assert_eq!(lines[4..], ["0 hold, 1 do not hold, 0 could not be run"]);
    let documents = documents(&stdout(&expect(1, &["test", CONFIG, &file, "--format", "json"])));
    let [case, all] = &documents[..] else { panic!("{documents:?}") };
    assert_eq!((&case["schema"], &case["result"]), (&"stictiond.test_case.v1".into(), &"differs".into()));
    assert_eq!(case["differences"][0]["line"], 4);
    assert_eq!(case["estimate"]["verdict"], "stiction");
    assert_eq!((&all["schema"], &all["differ"], &all["hold"]), (&"stictiond.test.v1".into(), &1.into(), &0.into()));
}

/// The result depends on the configuration.
#[test]
fn the_settings_of_the_configuration_are_used() {
    let folder = tempfile::tempdir().unwrap();
    let config = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, format!("[site]\nprefix = \"p\"\n[window]\nhop_s = 300.0\n{text}")).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let case = "[[case]]\nname = \"FIC101\"\ninput = \"RECORDINGS/sticking.mcap\"\nalarm = true\n";
    let file = written(&folder, case);
    expect(0, &["test", &config("a.toml", ""), &file]);
    let deaf = config("b.toml", "[[loop]]\nname = \"FIC101\"\ns_limit_op = 20.0\n");
    let text = stdout(&expect(1, &["test", &deaf, &file]));
    assert!(text.contains("line 4: alarm: expected active, found not active"), "{text}");
    assert!(
        text.contains("alarm not active: 0 of the last ") && text.contains("below the limit of 20 OP units"),
        "{text}"
    );
    let long = config("c.toml", "[[loop]]\nname = \"FIC101\"\nhop_s = 86400.0\n");
    let text = stdout(&expect(1, &["test", &long, &file]));
    assert!(text.contains("found no estimate") && text.contains("every_s"), "{text}");
    let blind = config("d.toml", "[input]\ndiscover = false\n");
    let text = stdout(&expect(2, &["test", &blind, &file]));
    assert!(text.contains("does not watch FIC101") && text.contains("[[loop]]"), "{text}");
    // A table without tags is judged as the loop named in the case.
    expect(0, &["convert", "recordings/sticking.mcap", folder.path().join("june.csv").to_str().unwrap()]);
    let file = written(&folder, &case.replace("RECORDINGS/sticking.mcap\"", "june.csv\"\nloop = \"FIC101\""));
    expect(0, &["test", &config("a.toml", ""), &file]);
    expect(1, &["test", &deaf, &file]);
}

#[test]
fn files_that_cannot_be_read_are_named_and_do_not_hide_other_cases() {
    let folder = tempfile::tempdir().unwrap();
    let case = |name: &str, input: &str| format!("[[case]]\nname = \"{name}\"\ninput = \"{input}\"\nalarm = false\n");
    let cases = [
        case("absent", "gone.mcap"),
        case("several", "RECORDINGS/four-loops.mcap"),
        case("other", "RECORDINGS/four-loops.mcap\"\nloop = \"FIC999"),
        case("zone", "RECORDINGS/fic201-export.csv\"\ntz = \"Mars"),
        case("good", "RECORDINGS/sticking.mcap\"\nuntil = \"2026-01-05T08:07:00Z"),
    ];
    let file = written(&folder, &cases.concat());
    let text = stdout(&expect(2, &["test", CONFIG, &file]));
    for part in ["line 1: ", "gone.mcap", "line 5: ", "add loop = ", "FIC999", "LIC202", "tz: ", "Mars", "ok    good"] {
        assert!(text.contains(part), "{part} is not in\n{text}");
    }
    let text = stdout(&expect(0, &["test", CONFIG, &file, "--filter", "good"]));
    assert!(text.contains("1 hold"), "{text}");
    assert!(stderr(&expect(2, &["test", CONFIG, &file, "--filter", "bad"])).contains("--filter"));
}

#[test]
fn a_damaged_recording_is_used_as_far_as_it_can_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let whole = fs::read("recordings/sticking.mcap").unwrap();
    fs::write(folder.path().join("cut.mcap"), &whole[..whole.len() * 9 / 10]).unwrap();
    let case = "[[case]]\nname = \"FIC101\"\ninput = \"cut.mcap\"\nverdict = \"stiction\"\n";
    expect(3, &["test", CONFIG, &written(&folder, case)]);
}

#[test]
fn faults_of_configuration_and_expectations_are_all_named_with_their_lines() {
    let folder = tempfile::tempdir().unwrap();
    let file = written(&folder, "[[case]]\nname = \"a\"\ninput = \"b\"\nverdit = \"stiction\"\ns = [9, 8]\n");
    let text = stderr(&expect(2, &["test", CONFIG, &file]));
    assert!(text.contains("line 4: case[0].verdit: unknown key; did you mean verdict?"), "{text}");
    assert!(text.contains("line 5: case[0].s: [9, 8] is empty; write [LOW, HIGH]"), "{text}");
    assert!(stderr(&expect(2, &["test", "config/broken.toml"])).contains("line 5: site.prefx"), "{text}");
    let alone = folder.path().join("alone.toml");
    fs::write(&alone, "[site]\nprefix = \"p\"\n").unwrap();
    assert!(stderr(&expect(2, &["test", alone.to_str().unwrap()])).contains("expectations.toml"));
}

#[test]
fn expectations_that_were_written_hold_and_are_not_replaced_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cases.toml");
    let write = ["test", CONFIG, "recordings/sticking.mcap", "--write", file.to_str().unwrap()];
    assert!(stdout(&expect(0, &write)).contains("cases for 1 loop"));
    let text = fs::read_to_string(&file).unwrap();
    for part in ["verdict = \"stiction\"", "s = [7.", "alarm = true", "name = \"FIC101 of sticking.mcap\""] {
        assert!(text.contains(part), "{part} is not in\n{text}");
    }
    assert!(stdout(&expect(0, &["test", CONFIG, file.to_str().unwrap()])).contains("1 hold"));
    assert!(stderr(&expect(1, &write)).contains("--force"));
    assert!(stderr(&expect(2, &["test", CONFIG, "--write", "x.toml"])).contains("EXPECTATIONS"));
}
