//! Compares the published method's index with the one that an industrial implementation printed next to its plant windows. The
//! recordings are not part of the project; without them the test is skipped, loudly.
#![allow(missing_docs)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::labelled;
use std::collections::BTreeMap;

use stiction::core::signal::stats;
use stiction::toolbox::one_step::{Search, toolbox};

const FOLDER: &str = labelled::RECORDINGS;
/// Smallest correlation. The zero in front of the record matters: without it, the correlation is 0.969.
const WANTED: f64 = 0.98;

/// Index and search bound by file.
fn printed() -> BTreeMap<String, [f64; 2]> {
    let Ok(index) = std::fs::read_to_string(format!("{FOLDER}/INDEX.csv")) else { return BTreeMap::new() };
    let rows: Vec<Vec<String>> = index.lines().map(labelled::cells).collect();
    let place = |name: &str| rows[0].iter().position(|h| h == name).unwrap();
    let (file, value, bound) = (place("file"), place("stick_index_plant"), place("fs_max_plant"));
    let number = |row: &[String], at: usize| row[at].parse::<f64>().ok();
    let found = rows[1..].iter().filter_map(|r| Some((r[file].clone(), [number(r, value)?, number(r, bound)?])));
    found.collect()
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (stiction::core::signal::detrend::remove_mean(a), stiction::core::signal::detrend::remove_mean(b));
    stats::dot(&a, &b) / (stats::dot(&a, &a) * stats::dot(&b, &b)).sqrt()
}

#[test]
fn the_printed_index_is_reproduced() {
    let printed = printed();
    if printed.is_empty() {
        labelled::skipped("the_printed_index_is_reproduced", "no plant windows in ../shared/data");
        return;
    }
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for item in labelled::labelled(FOLDER) {
        let Some([value, bound]) = printed.get(&item.file) else { continue };
        let (op, pv) = (item.record.op(), &item.record.pv);
        // The implementation rejects negative gains: it prints 0 for the windows of processes with reverse sign.
        let Some(found) = toolbox(&op, pv, &Search::published(*bound, 1.0)) else {
            eprintln!("aside: {}: printed {value}, PV does not move", item.file);
            continue;
        };
        eprintln!("{:<50} printed {value:.3} found {:.3}", item.file, found.index);
        ours.push(found.index);
        theirs.push(*value);
    }
    let errors: Vec<f64> = ours.iter().zip(&theirs).map(|(a, b)| (a - b).abs()).collect();
    let r = correlation(&ours, &theirs);
    eprintln!("{} windows: correlation {r:.3}, mean error {:.3}", ours.len(), stats::mean(&errors));
    assert!(ours.len() >= 45, "only {} windows", ours.len());
    assert!(r >= WANTED, "correlation {r:.4} < {WANTED}");
}
