//! Signals under the name of another loop, on recordings of real loops.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use stiction::core::record::Record;
use stiction_engine::engine::{Misplaced, misplaced};

type Plant = Vec<(Arc<str>, Record)>;

/// All recordings as one plant with equal clocks: the hardest case, as each PV could then belong to any loop. Empty if the
/// recordings are missing.
fn plant() -> Plant {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let Ok(mut index) = csv::Reader::from_path(folder.join("INDEX.csv")) else { return Vec::new() };
    index.records().map(|row| recorded(&folder, &row.unwrap()[0])).collect()
}

fn recorded(folder: &Path, file: &str) -> (Arc<str>, Record) {
    let mut table = csv::Reader::from_path(folder.join(file)).unwrap();
    let names: Vec<String> = table.headers().unwrap().iter().map(|name| name.trim().to_owned()).collect();
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    let column = |name: &str| {
        let at = names.iter().position(|other| other == name)?;
        Some(rows.iter().map(|row| row[at].trim().parse().unwrap_or(f64::NAN)).collect::<Vec<f64>>())
    };
    let [op, pv] = ["op", "pv"].map(|name| column(name).unwrap());
    let mv = column("mv").filter(|mv| mv.iter().all(|v| v.is_finite()));
    let keep: Vec<usize> = (0..op.len()).filter(|k| op[*k].is_finite() && pv[*k].is_finite()).collect();
    let kept = |x: &[f64]| keep.iter().map(|k| x[*k]).collect::<Vec<f64>>();
    let record = Record { mv: mv.as_deref().map(kept), ..Record::uniform(1.0, kept(&op), kept(&pv)) };
    (file.into(), record)
}

fn found(plant: &Plant) -> Vec<(Arc<str>, Misplaced)> {
    misplaced(plant.iter().map(|(name, record)| (name, record)))
}

/// Two loops with their PVs exchanged.
fn exchanged(pair: &[(Arc<str>, Record)]) -> Plant {
    let [(a, of_a), (b, of_b)] = pair else { return pair.to_vec() };
    let n = of_a.len().min(of_b.len());
    let [x, y] = [of_a, of_b].map(|record| record.part(0, n));
    let with = |own: &Record, other: &Record| Record::uniform(1.0, own.op(), other.pv.clone());
    vec![(a.clone(), with(&x, &y)), (b.clone(), with(&y, &x))]
}

#[test]
fn exchanged_pvs_of_real_loops_are_found_and_no_others() {
    let plant = plant();
    if plant.is_empty() {
        let words = "\nSKIPPED: exchanged_pvs_of_real_loops_are_found_and_no_others: no ../shared/data\n";
        let _ = std::io::stderr().lock().write_all(words.as_bytes());
        return;
    }
    let none = found(&plant);
    assert!(none.is_empty(), "{none:?}");
    let crossed: Plant = plant.chunks(2).flat_map(exchanged).collect();
    let named = found(&crossed);
    println!("{} of {} exchanged PVs are found", named.len(), crossed.len());
    let partner =
        |name: &str| crossed.iter().position(|(other, _)| **other == *name).map(|at| crossed[at ^ 1].0.clone());
    let wrong: Vec<_> =
        named.iter().filter(|(name, what)| Some(what) != partner(name).map(Misplaced::AnswersPv).as_ref()).collect();
    assert!(wrong.is_empty() && 5 * named.len() > crossed.len(), "{named:?}");
}
