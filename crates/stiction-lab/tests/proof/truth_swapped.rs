//! Swapped OP and PV, on real recordings.

use crate::labelled;

use stiction::core::record::Record;
use stiction::core::verdict::swapped::by_controller;

#[test]
fn swapped_signals_of_real_loops_are_found_and_no_others() {
    let Some(all) = labelled::labelled_or_skip("swapped_signals_of_real_loops_are_found_and_no_others") else { return };
    let named_wrongly: Vec<&str> =
        all.iter().filter(|one| by_controller(&one.record)).map(|one| one.file.as_str()).collect();
    let turned = |r: &Record| Record::uniform(r.point_s(), r.pv.clone(), r.op());
    let found = all.iter().filter(|one| by_controller(&turned(&one.record))).count();
    println!("of {} recordings {found} are found when swapped, {} as they are", all.len(), named_wrongly.len());
    assert!(named_wrongly.is_empty(), "{named_wrongly:?}");
    assert!(4 * found > all.len(), "{found}");
}
