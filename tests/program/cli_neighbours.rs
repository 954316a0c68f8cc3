//! `gap --neighbours` run as a program: the acting loop explains most, unrelated loops change nothing, and a loop that cannot
//! be offered is refused by name.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use stiction::core::record::Record;
use stiction_lab::plants::{Relation, disturbed, unrelated_loops};

/// A case with a clear driver.
const SEED: u64 = 1;
const NUMBER: u64 = 2;

fn gap(arguments: &[&Path]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    command.arg("gap").args(arguments).args(["--format", "json"]).output().unwrap()
}

fn table(folder: &Path, name: &str, record: &Record) -> PathBuf {
    let mut text = "t,op,pv\n".to_owned();
    for (k, (op, pv)) in record.op_path.iter().zip(&record.pv).enumerate() {
        let t = 1_700_000_000.0 + record.start_ns as f64 * 1e-9 + k as f64 * record.ts_s;
        writeln!(text, "{t},{op},{pv}").unwrap();
    }
    let path = folder.join(format!("{name}.csv"));
    fs::write(&path, text).unwrap();
    path
}

fn document(output: &Output) -> serde_json::Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn the_neighbour_that_acts_tells_most_among_unrelated_loops_which_change_nothing() {
    let home = tempfile::tempdir().unwrap();
    let case = disturbed("A", SEED, NUMBER, Relation::Acts);
    let own = table(home.path(), "loop", &case.record);
    let others = home.path().join("others");
    fs::create_dir(&others).unwrap();
    for (i, unrelated) in unrelated_loops(SEED, NUMBER, 3, &case.record, &case.periods_s).iter().enumerate() {
        table(&others, &format!("S{i}"), unrelated);
    }
    let flag = Path::new("--neighbours");
    let alone = document(&gap(&[&own]));
    let withheld = document(&gap(&[&own, flag, &others]));
    assert_eq!(withheld["neighbours"]["offered"], 3);
    assert!(alone.get("neighbours").is_none());
    assert_eq!(withheld["cause"]["id"], alone["cause"]["id"], "{}", withheld["neighbours"]);
    // If no loop is unlikely enough by chance to be fitted, all other figures are unchanged.
    if withheld["neighbours"]["fitted"] == serde_json::json!([]) {
        let mut rest = withheld.clone();
        rest.as_object_mut().unwrap().remove("neighbours");
        assert_eq!(rest, alone);
    }

    table(&others, "DRIVER", &case.other);
    let revealed = document(&gap(&[&own, flag, &others]));
    let compared = &revealed["neighbours"];
    assert_eq!(compared["offered"], 4, "{compared}");
    assert_eq!(compared["best"], "DRIVER", "{compared}");
    // Fitted loops are listed among the effects with their sizes.
    for name in compared["fitted"].as_array().unwrap() {
        let id = format!("neighbour({})", name.as_str().unwrap());
        let effect = revealed["effects"].as_array().unwrap().iter().find(|e| e["id"] == id).unwrap();
        for size in ["gain", "lag", "dead_time", "from_op", "p_value"] {
            assert!(effect["parameters"][size]["value"].is_number(), "{size}: {effect}");
        }
    }
    // If its effect is withheld, it is not named: one more diagnosis, for the long run.
    if std::env::var_os("STICTIOND_LONG").is_none() {
        return;
    }
    let output = gap(&[&own, flag, &others, Path::new("--without"), Path::new("neighbour")]);
    assert!(!document(&output)["cause"]["id"].as_str().unwrap().starts_with("neighbour"));
}

#[test]
fn a_neighbour_that_cannot_be_offered_is_refused_by_its_name_with_a_remedy() {
    let home = tempfile::tempdir().unwrap();
    let case = disturbed("A", SEED, NUMBER, Relation::Acts);
    let own = table(home.path(), "loop", &case.record);
    let still = |x: &[f64]| vec![50.0; x.len()];
    let mut calm = case.other.clone();
    (calm.op_path, calm.pv) = (still(&calm.op_path), still(&calm.pv));
    let mut late = case.other.clone();
    late.start_ns += 86_400_000_000_000;
    let mut wild = case.other.clone();
    wild.pv.fill(f64::NAN);
    for (name, record) in [("CALM", &calm), ("LATE", &late), ("WILD", &wild)] {
        let path = table(home.path(), name, record);
        let output = gap(&[&own, Path::new("--neighbours"), &path]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains(name) && output.stdout.is_empty(), "{said}");
    }
}
