//! `analyze --plant` run as a program, on a simulated plant with known truth.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::common::program::{expect, stderr, stdout};
use stiction_lab::plants::{CaseLoop, Difficulty, Role, plant};

/// A seed for a plant with a sticking source, followers, and loops that oscillate independently.
const SEED: u64 = 1;

/// Writes each loop of a plant as a table; returns the truth.
pub fn written(folder: &Path) -> Vec<CaseLoop> {
    let case = plant("program", SEED, Difficulty::Easy);
    for one in &case {
        let record = &one.record;
        let mut text = "t,op,pv,sp\n".to_owned();
        let sp = record.sp.clone().unwrap();
        for (k, ((op, pv), sp)) in record.op().iter().zip(&record.pv).zip(sp).enumerate() {
            let t = 1_767_600_000.0 + stiction::core::units::s_from_ns(record.start_ns) + k as f64 * record.ts_s;
            writeln!(text, "{t},{op},{pv},{sp}").unwrap();
        }
        fs::write(folder.join(format!("{}.csv", one.name)), text).unwrap();
    }
    case
}

/// The documents of each kind.
fn documents(output: &std::process::Output) -> [Vec<Value>; 2] {
    let all = stdout(output).lines().map(|line| serde_json::from_str(line).unwrap()).collect::<Vec<Value>>();
    let (groups, estimates) = all.into_iter().partition(|d: &Value| d["schema"] == "stictiond.group.v1");
    [estimates, groups]
}

#[test]
fn a_plant_gives_its_groups_and_each_follower_its_source() {
    let folder = tempfile::tempdir().unwrap();
    let case = written(folder.path());
    let path = folder.path().to_str().unwrap();
    let [estimates, groups] = documents(&expect(0, &["analyze", path, "--plant", "--format", "json"]));
    assert_eq!(estimates.len(), case.len());
    let truth = |name: &Value| case.iter().find(|l| name.as_str() == Some(l.name.as_str())).unwrap();
    let of_source = |group: &&Value| group["members"].as_array().unwrap().iter().any(|m| truth(m).role == Role::Source);
    let group = groups.iter().find(of_source).unwrap();
    let members = group["members"].as_array().unwrap();
    let source = members.iter().find(|m| truth(m).role == Role::Source).unwrap();
    assert!(members.len() > 1 && members.iter().all(|m| truth(m).group == truth(source).group), "{group}");
    assert_eq!((&group["source"]["kind"], &group["source"]["loop"]), (&"loop".into(), source), "{group}");
    assert_eq!(group["followers"].as_array().unwrap().len(), members.len() - 1);
    assert!(group["p_value"].as_f64().unwrap() < 0.1 && group["window"]["start"].is_string());
    for estimate in &estimates {
        let judged = &estimate["group"];
        let grouped = groups.iter().any(|g| g["members"].as_array().unwrap().contains(&estimate["loop"]));
        assert_eq!(judged.is_object(), grouped, "{}", estimate["loop"]);
        if members.contains(&estimate["loop"]) && estimate["loop"] != *source {
            assert!(
                judged["cause"].as_str().unwrap().starts_with(&format!("driven by {}, p ", source.as_str().unwrap()))
            );
            assert_eq!(judged["p_stiction"], estimate["p_stiction"]);
            assert!(judged["masked"] == true || estimate["stiction"] == true, "{estimate}");
        }
    }

    // A loop in no group has the same answer as without --plant.
    let file_of = |name: &Value| folder.path().join(format!("{}.csv", name.as_str().unwrap())).display().to_string();
    let mut other = estimates.into_iter().find(|estimate| estimate["group"].is_null()).unwrap();
    let [mut alone, none] = documents(&expect(0, &["analyze", &file_of(&other["loop"]), "--format", "json"]));
    assert_eq!((alone.len(), none.len()), (1, 0));
    (alone[0]["elapsed_ms"], other["elapsed_ms"]) = (Value::Null, Value::Null);
    assert_eq!(alone[0], other);

    // As text, for the group alone.
    let files: Vec<String> = members.iter().map(file_of).collect();
    let files = files.iter().map(String::as_str);
    let text = stdout(&expect(0, &["analyze", "--plant"].into_iter().chain(files).collect::<Vec<&str>>()));
    let name = source.as_str().unwrap();
    for said in [format!("{name} causes the oscillation"), "% of its power; stiction p".to_owned()] {
        assert!(text.contains(&said), "{said:?} is not in\n{text}");
    }
}

#[test]
fn sections_and_names_that_do_not_make_a_plant_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let wave = |k: usize| format!("{k},{},{}\n", 50.0 + (k as f64 / 9.0).sin(), (k as f64 / 9.0).cos());
    let table = "t,op,pv\n".to_owned() + &(0..400).map(wave).collect::<String>();
    for name in ["a", "b"] {
        fs::create_dir(folder.path().join(name)).unwrap();
        fs::write(folder.path().join(name).join("FIC101.csv"), &table).unwrap();
    }
    let path = |name: &str| folder.path().join(name).join("FIC101.csv").to_str().unwrap().to_owned();
    let (a, b) = (path("a"), path("b"));
    let twice = expect(1, &["analyze", &a, &b, "--plant"]);
    assert!(stderr(&twice).contains("two loops are named FIC101"), "{}", stderr(&twice));
    let sections = expect(2, &["analyze", &a, "--plant", "--samples", "1,200", "--samples", "201,400"]);
    assert!(stderr(&sections).contains("one section of each loop"), "{}", stderr(&sections));
    // A plant of one loop has no groups, and the text states this.
    let alone = stdout(&expect(0, &["analyze", &a, "--plant"]));
    assert!(alone.contains("no two share an oscillation"), "{alone}");
}
