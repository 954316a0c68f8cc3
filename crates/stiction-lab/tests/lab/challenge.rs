//! The gap challenge at the process boundary: the contents of the folder, the effect of a changed truth, and that neither side
//! can see the other.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use super::{lab, text};
use stiction::core::gap::effects;
use stiction_lab::challenge::Kind;

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_challenge_is_made_run_without_its_truth_and_scored_with_it() {
    let home = tempfile::tempdir().unwrap();
    let dir = home.path().join("check");
    let at = dir.to_str().unwrap();
    let made = lab(&["challenge", "new", "--seed", "5", "--cases", "1", "--out", at]);
    assert!(made.status.success(), "{}", text(&made.stderr));
    assert_eq!(names(&dir), ["recordings", "truth.json", "truth.sha256"]);
    let sealed = fs::read_to_string(dir.join("truth.sha256")).unwrap();
    assert!(text(&made.stdout).contains(sealed.trim()));

    // The recordings reveal nothing: consecutive neutral names, the same header except for MV, numbers only.
    let recordings = names(&dir.join("recordings"));
    assert_eq!(recordings.len(), 47);
    let mut headers = BTreeSet::new();
    for (k, name) in recordings.iter().enumerate() {
        assert_eq!(*name, format!("loop-{:04}.csv", k + 1));
        let table = fs::read_to_string(dir.join("recordings").join(name)).unwrap();
        let (header, rows) = table.split_once('\n').unwrap();
        headers.insert(header.to_owned());
        assert!(rows.bytes().all(|b| b.is_ascii_digit() || b",.-e\n".contains(&b)), "{name}");
        assert!(rows.starts_with("1700000000,"), "{name}");
    }
    assert!(headers.iter().all(|h| h == "t,op,pv,sp" || h == "t,op,pv,sp,mv"), "{headers:?}");

    // A second challenge with the same seed is identical, byte for byte; an existing folder is refused.
    let twin = home.path().join("twin");
    lab(&["challenge", "new", "--seed", "5", "--cases", "1", "--out", twin.to_str().unwrap()]);
    for name in recordings.iter().map(|n| format!("recordings/{n}")).chain(["truth.json".to_owned()]) {
        assert_eq!(fs::read(dir.join(&name)).unwrap(), fs::read(twin.join(&name)).unwrap(), "{name}");
    }
    assert_eq!(lab(&["challenge", "new", "--seed", "5", "--out", at]).status.code(), Some(1));

    // The diagnosis needs no truth, and resumes where it stopped.
    let truth = fs::read(dir.join("truth.json")).unwrap();
    fs::remove_file(dir.join("truth.json")).unwrap();
    let run = |first: &str| lab(&["challenge", "run", at, "--first", first, "--evaluations", "3000"]);
    let ran = run("1");
    assert!(ran.status.success(), "{}", text(&ran.stderr));
    let one = fs::read_to_string(dir.join("answers.jsonl")).unwrap();
    assert!(run("2").status.success());
    let two = fs::read_to_string(dir.join("answers.jsonl")).unwrap();
    assert!(two.starts_with(&one) && two.lines().count() == 2);
    let other = lab(&["challenge", "run", at, "--evaluations", "4000"]);
    assert!(!other.status.success() && text(&other.stderr).contains("--force"));

    // The scorer requires every answer, and the sealed truth.
    fs::write(dir.join("truth.json"), &truth).unwrap();
    let score = |more: &[&str]| lab(&[&["challenge", "score", at], more].concat());
    let missing = score(&[]);
    assert!(!missing.status.success() && text(&missing.stderr).contains("45 of 47"), "{}", text(&missing.stderr));
    let scored = score(&["--partial", "--format", "json"]);
    assert!(scored.status.success(), "{}", text(&scored.stderr));
    let figures: serde_json::Value = serde_json::from_slice(&scored.stdout).unwrap();
    assert_eq!(figures["groups"][0]["cases"], 2);
    let picture = fs::read_to_string(dir.join("confusion.svg")).unwrap();
    assert!(picture.starts_with("<svg xmlns=") && picture.trim_end().ends_with("</svg>"));
    // The calibration decides again from the answers alone, and reports the seeds.
    let rule = home.path().join("rule.json");
    let calibrate = |dir: &str| lab(&["challenge", "calibrate", dir, "--out", rule.to_str().unwrap()]);
    let calibrated = calibrate(at);
    assert!(calibrated.status.success(), "{}", text(&calibrated.stderr));
    let words = text(&calibrated.stdout);
    assert!(words.contains("seed 5 (2 cases)") && words.contains("left out of the fit"), "{words}");
    let made: serde_json::Value = serde_json::from_slice(&fs::read(&rule).unwrap()).unwrap();
    assert!(made["temperature"].as_f64().is_some_and(|t| t >= 1.0));
    assert!(made["trace"].as_f64().is_some_and(|p| p > 0.0 && p < 1.0));
    assert!(made["from"].as_str().unwrap().contains("split A, seed 5") && !words.contains(at), "{made}");
    assert!(text(&calibrate(at).stderr).contains("--force"));
    let changed = text(&truth).replacen("\"none\"", "\"ramp\"", 1);
    assert_ne!(changed.as_bytes(), truth);
    fs::write(dir.join("truth.json"), changed).unwrap();
    let refused = score(&["--partial"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(text(&refused.stderr).contains("SHA-256") && text(&refused.stderr).contains(sealed.trim()));
}

#[test]
fn nothing_is_calibrated_on_the_split_that_is_reported() {
    let home = tempfile::tempdir().unwrap();
    let dir = home.path().join("b");
    let at = dir.to_str().unwrap();
    lab(&["challenge", "new", "--seed", "6", "--cases", "1", "--out", at]);
    let refused = lab(&["challenge", "calibrate", at]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(text(&refused.stderr).contains("split B is the test set"), "{}", text(&refused.stderr));
}

#[test]
fn the_generator_makes_every_effect_of_the_catalogue() {
    let made: BTreeSet<&str> = Kind::CATALOGUE.iter().chain(&[Kind::FILTER]).map(|k| k.id()).collect();
    // Stiction is an effect only relative to a base without it, a neighbour only if other loops are offered.
    let own = |id: &&str| !matches!(*id, "stiction" | "neighbour");
    let known: BTreeSet<&str> = effects::ALL.iter().map(|e| e.id).filter(own).collect();
    assert_eq!(made, known);
    assert!(Kind::FOREIGN.iter().all(|k| effects::by_id(k.id()).is_none()));
}
