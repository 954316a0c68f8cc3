//! Exports of other systems: every shape is read as it is, or refused with the option that settles it.

#![allow(clippy::unwrap_used, clippy::panic)]

mod cli;
mod columnar;
mod data;
mod doubts;
mod shapes;

use std::fs;

use stiction::core::record::{Signal, Value};
use stiction::core::units::NS_PER_S;
use stiction_files::inputs::units;
use stiction_files::{FileError, Loaded, ReadOptions};

use data::{ROWS, op, pv, t_s};
use shapes::{Must, Shape};

fn read(shape: &Shape, flags: &[&str]) -> Result<Loaded, FileError> {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in &shape.files {
        fs::write(folder.path().join(name), bytes).unwrap();
    }
    let mut options = ReadOptions::default();
    flags.chunks(2).for_each(|flag| options.set(flag[0].trim_start_matches("--"), flag[1]).unwrap());
    let place = match &shape.files[..] {
        [(name, _)] => folder.path().join(name),
        _ => folder.path().to_owned(),
    };
    let units = units(&[place], &options).unwrap();
    assert_eq!(units.len(), 1, "{}", shape.name);
    units[0].load(&options)
}

/// Checks that every value is at its time, in order, and that there are no others.
fn check(loaded: &Loaded, what: &str) -> Result<(), String> {
    let (name, how) = what.split_once(' ').unwrap_or((what, ""));
    let [one] = &loaded.loops[..] else { return Err(format!("{} loops", loaded.loops.len())) };
    if one.name != name {
        return Err(format!("loop {}", one.name));
    }
    let shift_s = match how {
        "in May" => 120 * 86_400 - 3600,
        "twenty days on" => 20 * 86_400,
        "from 1970" => -t_s(0),
        _ => 0,
    };
    let missing: &[usize] = if how == "with 4 missing" { &[50, 52, 54, 56] } else { &[] };
    for (signal, of) in [(Signal::Op, op as fn(usize) -> f64), (Signal::Pv, pv)] {
        let found: Vec<(i64, Value)> =
            one.samples.iter().filter(|s| s.signal == signal).map(|s| (s.t_ns, s.value)).collect();
        let value = |k: usize| if missing.contains(&k) { Value::Missing } else { Value::Number(of(k)) };
        let expected: Vec<(i64, Value)> = (0..ROWS).map(|k| ((t_s(k) + shift_s) * NS_PER_S, value(k))).collect();
        if found != expected {
            let at = found.iter().zip(&expected).position(|(a, b)| a != b).unwrap_or(0);
            return Err(format!("{} {at}: {:?} instead of {:?}", signal.name(), found.get(at), expected.get(at)));
        }
    }
    if one.samples.len() != 2 * ROWS || !one.samples.is_sorted_by_key(|s| s.t_ns) {
        return Err(format!("{} samples, or not in order", one.samples.len()));
    }
    Ok(())
}

/// An error without the path of the file.
fn told(error: &FileError) -> String {
    match error {
        FileError::Export { cause, .. } => cause.to_string(),
        other => panic!("{other}"),
    }
}

fn said(loaded: &Loaded) -> String {
    loaded.recognised.as_ref().map_or_else(|| "its own form: nothing to say".to_owned(), ToString::to_string)
}

#[test]
fn every_shape_is_read_as_it_is_or_refused_with_what_settles_it() {
    let mut shapes = shapes::all();
    if cfg!(not(feature = "xlsx")) {
        shapes.retain(|shape| shape.files.iter().all(|(name, _)| !name.ends_with(".xlsx")));
    }
    let mut faults: Vec<String> = Vec::new();
    for shape in &shapes {
        let found = read(shape, shape.flags);
        match (&shape.must, found) {
            (Must::Read(what), Ok(loaded)) => {
                faults.extend(check(&loaded, what).err().map(|e| format!("{}: {e}", shape.name)));
            }
            (Must::Ask(part, flags, what), Err(error)) => {
                let text = told(&error);
                if !text.contains(part) {
                    faults.push(format!("{}: {text}", shape.name));
                }
                match read(shape, flags) {
                    Ok(loaded) => {
                        faults.extend(check(&loaded, what).err().map(|e| format!("{}: {e}", shape.name)));
                    }
                    Err(error) => faults.push(format!("{} {flags:?}: {error}", shape.name)),
                }
            }
            (Must::Refuse(part), Err(error)) => {
                let text = told(&error);
                if !text.contains(part) {
                    faults.push(format!("{}: {text}", shape.name));
                }
            }
            (_, Ok(loaded)) => faults.push(format!("{}: read as {}", shape.name, said(&loaded))),
            (_, Err(error)) => faults.push(format!("{}: {error}", shape.name)),
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(shapes.len() >= 40, "{}", shapes.len());
}
