//! Checks of the aligner: disorder, gaps, clocks that jump, missing values.

use super::align::{AlignParams, Aligner, align_all};
use crate::core::record::{Sample, Signal, Value};
use crate::core::units::{NS_PER_S, ns_from_s};

fn sample(signal: Signal, t_s: f64, v: f64) -> Sample {
    Sample { signal, t_ns: ns_from_s(t_s), value: Value::number(v), quality: None }
}

fn params() -> AlignParams {
    AlignParams { lateness_ns: 5 * NS_PER_S, ..AlignParams::default() }
}

fn scan(n: usize) -> Vec<Sample> {
    (0..n).flat_map(|k| [sample(Signal::Op, k as f64, k as f64), sample(Signal::Pv, k as f64, -(k as f64))]).collect()
}

#[test]
fn a_scan_gives_a_point() {
    let (stretches, counts) = align_all(&scan(40), &params());
    assert_eq!(stretches.len(), 1);
    assert_eq!(stretches[0].len(), 40);
    assert!(stretches[0].iter().all(|p| p.op == -p.pv && !p.filled));
    assert_eq!(counts.taken, 80);
}

#[test]
fn disorder_within_the_lateness_changes_nothing() {
    let ordered = scan(60);
    let mut mixed = ordered.clone();
    for chunk in mixed.chunks_mut(7) {
        chunk.reverse();
    }
    mixed.extend_from_slice(&ordered[100..110]);
    let (a, _) = align_all(&ordered, &params());
    let (b, counts) = align_all(&mixed, &params());
    assert_eq!(a, b);
    assert_eq!(counts.duplicates + counts.late, 10);
}

#[test]
fn op_and_pv_in_batches_are_joined() {
    let ordered = scan(3000);
    for samples_in_batch in [60, 300, 900] {
        let mut batched = Vec::new();
        for chunk in ordered.chunks(2 * samples_in_batch) {
            batched.extend(chunk.iter().filter(|s| s.signal == Signal::Op));
            batched.extend(chunk.iter().filter(|s| s.signal == Signal::Pv));
        }
        let (stretches, counts) = align_all(&batched, &params());
        assert_eq!((counts.late, counts.clock_resets), (0, 0), "{samples_in_batch}");
        assert_eq!(align_all(&ordered, &params()).0, stretches);
    }
}

#[test]
fn a_batch_that_is_sent_again_changes_nothing() {
    let ordered = scan(400);
    let mut again = ordered.clone();
    again.splice(600..600, ordered[400..500].iter().copied());
    let (stretches, counts) = align_all(&again, &params());
    assert_eq!((counts.clock_resets, counts.late + counts.duplicates), (0, 100));
    assert_eq!(stretches, align_all(&ordered, &params()).0);
}

#[test]
fn short_holes_are_filled_and_long_ones_end_the_stretch() {
    let mut samples = scan(100);
    samples.retain(|s| !(20..22).contains(&(s.t_ns / NS_PER_S)) && !(50..70).contains(&(s.t_ns / NS_PER_S)));
    let (stretches, counts) = align_all(&samples, &params());
    assert_eq!(stretches.iter().map(Vec::len).collect::<Vec<_>>(), [50, 30]);
    assert_eq!((counts.filled, counts.gaps), (2, 1));
    assert!(stretches[0][20].filled && stretches[0][20].pv == -20.0 && stretches[0][20].op == 20.0);
    let on_change = AlignParams { max_gap_s: 5.0, ..params() };
    assert_eq!(align_all(&samples, &on_change).0[0][20].op, 19.0);
}

#[test]
fn a_lost_op_lies_between_its_neighbours_unless_op_is_sent_on_change() {
    let mut samples = scan(60);
    samples[50].value = Value::Missing;
    let (stretches, counts) = align_all(&samples, &params());
    assert_eq!((stretches.len(), stretches[0].len(), counts.filled, counts.bad), (1, 60, 1, 1));
    assert!(stretches[0].iter().all(|p| p.op == -p.pv && p.bad == 0));
    samples.remove(50);
    let (absent, counts) = align_all(&samples, &params());
    assert_eq!((absent == stretches, counts.filled, counts.bad), (true, 1, 0));
    samples.insert(50, Sample { value: Value::Missing, ..sample(Signal::Op, 25.0, 0.0) });
    let on_change = AlignParams { max_gap_s: 5.0, ..params() };
    let (held, counts) = align_all(&samples, &on_change);
    assert_eq!((held[0][25].op, held[0][25].bad, counts.filled), (24.0, 1, 0));

    // OP that is sent rarely is held where PV is lost, whatever the setting.
    let stairs = |t: usize| t.is_multiple_of(4).then(|| sample(Signal::Op, t as f64, t as f64));
    let seldom: Vec<Sample> = (0..60)
        .flat_map(|t| stairs(t).into_iter().chain((t != 27).then(|| sample(Signal::Pv, t as f64, 1.0))))
        .collect();
    let (stretches, counts) = align_all(&seldom, &params());
    assert_eq!((stretches[0][27].filled, stretches[0][27].op, counts.filled), (true, 24.0, 1));
}

#[test]
fn one_stamp_from_the_future_is_dropped_and_a_new_clock_is_believed() {
    let mut samples = scan(100);
    samples.insert(80, sample(Signal::Pv, 3e8, 1.0));
    let (stretches, counts) = align_all(&samples, &params());
    assert_eq!((stretches.len(), counts.stamp_outliers), (1, 1));

    let mut ahead = scan(100);
    ahead.extend(scan(100).into_iter().map(|s| Sample { t_ns: s.t_ns + 1_000_000 * NS_PER_S, ..s }));
    assert_eq!(align_all(&ahead, &params()).0.len(), 2);
}

#[test]
fn a_clock_that_was_set_back_starts_a_new_stretch() {
    let mut samples: Vec<Sample> =
        scan(100).into_iter().map(|s| Sample { t_ns: s.t_ns + 1_000_000 * NS_PER_S, ..s }).collect();
    samples.extend(scan(300));
    let (stretches, counts) = align_all(&samples, &params());
    assert_eq!((stretches.len(), counts.clock_resets), (2, 1));
    assert_eq!(stretches[1].len(), 300);
}

#[test]
fn the_last_sample_belongs_to_the_stretch() {
    for n in [18, 40, 41] {
        let slow: Vec<Sample> = scan(n).into_iter().map(|s| Sample { t_ns: s.t_ns * 10, ..s }).collect();
        let (stretches, _) = align_all(&slow, &params());
        assert_eq!(stretches.iter().map(Vec::len).collect::<Vec<_>>(), [n]);
    }
}

#[test]
fn bad_quality_is_missing() {
    let mut samples = scan(60);
    for s in &mut samples[60..64] {
        s.quality = Some(0x8000_0000);
    }
    let (stretches, counts) = align_all(&samples, &params());
    assert_eq!((counts.bad, counts.filled), (4, 2));
    assert_eq!(stretches[0].iter().map(|p| u32::from(p.bad)).sum::<u32>(), 4);
}

#[test]
fn what_was_needed_to_learn_is_given_back() {
    let (mut aligner, mut most) = (Aligner::new(), 0);
    for s in scan(200) {
        aligner.push(Sample { t_ns: 10 * s.t_ns, ..s }, &params());
        most = most.max(aligner.bytes());
        while aligner.next_ready_ns(&params()).is_some() {
            aligner.take_next(&params(), &mut |_| {});
        }
    }
    assert!(
        most >= 34 * size_of::<Sample>() && aligner.bytes() < 20 * size_of::<Sample>(),
        "{most}, {}",
        aligner.bytes()
    );
}
