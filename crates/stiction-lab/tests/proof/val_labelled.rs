//! Verdicts on labelled recordings of real loops, compared with an independent implementation of the published method. The
//! recordings are not part of the project; without them the test is skipped, loudly.
#![allow(missing_docs)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::labelled;
use std::collections::BTreeMap;

/// Correct verdicts of that implementation, by source.
const YARDSTICK: [(&str, usize); 3] = [("isdb", 13), ("plant", 46), ("sacac", 6)];

#[test]
fn no_source_is_judged_worse_than_by_the_published_method() {
    let Some(all) = labelled::assessed_or_skip("no_source_is_judged_worse_than_by_the_published_method") else {
        return;
    };
    let mut table: BTreeMap<String, [usize; 5]> = BTreeMap::new();
    for (item, found) in all {
        let sticks = match item.label.as_str() {
            "stiction" | "deadband" => true,
            "no_stiction" | "tuning" | "disturbance" => false,
            _ => continue,
        };
        let row = table.entry(item.file.split('/').next().unwrap().to_owned()).or_default();
        row[0] += 1;
        row[1] += usize::from(found.stiction == Some(sticks));
        row[2] += usize::from(sticks && found.stiction == Some(false));
        row[3] += usize::from(!sticks && found.stiction == Some(true));
        row[4] += usize::from(found.stiction.is_none());
        if found.stiction != Some(sticks) {
            let gates: Vec<&str> = found.gates.iter().map(|g| g.name()).collect();
            eprintln!("wrong: {} is {}, said {} {gates:?}", item.file, item.label, found.verdict.name());
        }
    }
    for (source, row) in &table {
        eprintln!("{source}: {} of {} right, {} missed, {} false, {} null", row[1], row[0], row[2], row[3], row[4]);
    }
    for (source, right) in YARDSTICK {
        assert!(table.get(source).is_some_and(|row| row[1] >= right), "{source}: fewer than {right} right");
    }
}
