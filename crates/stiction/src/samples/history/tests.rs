//! A loop's history returns the same windows however it was built.

use super::*;
use crate::core::units::NS_PER_S;
use proptest::prelude::*;

fn point(k: usize) -> Point {
    let x = k as f64;
    Point {
        t_ns: k as i64 * NS_PER_S,
        op: 50.0 + (x * 0.7).sin() + 0.1 * (x * 12.9).sin(),
        pv: (x * 0.07).cos() / 3.0,
        sp: Some(1.0),
        mv: None,
        manual: false,
        filled: false,
        bad: 0,
    }
}

#[test]
fn a_box_keeps_means_and_extremes() {
    let points: Vec<Point> = (0..64).map(point).collect();
    let record = record_of(&points, 16).unwrap();
    assert_eq!((record.box_samples, record.len(), record.op_path.len()), (4, 16, 64));
    let mean = points[..4].iter().map(|p| p.pv).sum::<f64>() / 4.0;
    assert!((record.pv[0] - mean).abs() < 1e-12);
    let max = points[..4].iter().map(|p| p.op).fold(f64::MIN, f64::max);
    assert!(record.op_path[..4].contains(&max));
    assert_eq!((record.op_path[0], record.op_path[3]), (points[0].op, points[3].op));
    assert!(record.sp.is_some() && record.mv.is_none());
}

proptest! {
    #[test]
    fn a_window_from_memory_equals_the_window_from_the_recording(
        n in 1_usize..6000, max_points in 8_usize..100, from in 0_usize..6000
    ) {
        let mut history = History::new(2 * max_points);
        let points: Vec<Point> = (0..n).map(point).collect();
        for p in &points {
            history.push(p, i64::MIN);
        }
        let from = from.min(n - 1);
        let end_ns = points[n - 1].t_ns;
        if let Some(live) = history.now().record(points[from].t_ns, end_ns) {
            prop_assert!(live.len() <= 2 * max_points.max(8));
            let first = (live.start_ns / NS_PER_S) as usize;
            prop_assert!(first >= from && first < from + live.box_samples.max(2) * 2);
            let mut again = record_of(&points[first..], 2 * max_points).unwrap();
            // Repeats refer to the previous point, which a cut recording does not have.
            again.facts = live.facts;
            prop_assert_eq!(live, again);
        }
    }

    #[test]
    fn a_resumed_memory_gives_the_same_windows(start in 0_usize..2000, tail in 2000_usize..3000) {
        let (mut whole, mut resumed) = (History::new(64), History::resumed(64, start as u64));
        let n = start + tail;
        for k in 0..n {
            let keep = (k as i64 - 900) * NS_PER_S;
            whole.push(&point(k), keep);
            if k >= start {
                resumed.push(&point(k), keep);
            }
        }
        for back in [10, 63, 64, 65, 130, 500, 899] {
            let from = point(n - 1 - back).t_ns;
            prop_assert_eq!(whole.now().record(from, 0), resumed.now().record(from, 0));
        }
    }

    #[test]
    fn memory_stays_bounded(n in 100_usize..20_000) {
        let mut history = History::new(64);
        for k in 0..n {
            history.push(&point(k), (k as i64 - 3000) * NS_PER_S);
        }
        prop_assert!(history.raw.op.len() <= 67);
        prop_assert!(history.levels.len() <= 7);
        prop_assert!(history.levels.iter().all(|l| l.pv.len() <= 36));
    }

    #[test]
    fn a_window_cut_later_from_a_clone_is_the_one_that_was_due(
        n in 1_usize..4000, later in 0_usize..3000, max_points in 8_usize..60, reach in 50_i64..5000
    ) {
        let (mut history, mut plain) = (History::new(2 * max_points), History::new(2 * max_points));
        let keep = |k: usize| (k as i64 - reach) * NS_PER_S;
        for k in 0..n {
            history.push(&point(k), keep(k));
            plain.push(&point(k), keep(k));
        }
        let clone = history.clone();
        (n..n + later).for_each(|k| history.push(&point(k), keep(k)));
        for back in [1, 3, 50, 333, 1000, 2048, reach] {
            let (from, now) = ((n as i64 - back.min(reach)) * NS_PER_S, plain.now());
            prop_assert_eq!(clone.now().record(from, 5), now.record(from, 5));
            for level in [0, 1, 2, 5] {
                prop_assert_eq!(clone.now().latest(level, from, 5), now.latest(level, from, 5));
            }
            prop_assert_eq!(clone.now().latest_raw(), now.latest_raw());
        }
        // The history itself continues as if no window had been taken.
        (n..n + later).for_each(|k| plain.push(&point(k), keep(k)));
        for back in [1, 50, 333, 1000, 2048, reach] {
            let from = ((n + later) as i64 - back.min(reach)) * NS_PER_S;
            prop_assert_eq!(history.now().record(from, 5), plain.now().record(from, 5));
        }
    }

    #[test]
    fn memory_is_what_the_columns_say(n in 5000_usize..20_000) {
        let mut history = History::new(1000);
        for k in 0..n {
            history.push(&Point { sp: None, ..point(k) }, 0);
        }
        // 21 bytes per raw point and 44 per bin, if neither SP nor MV is sent and nothing is flagged.
        let boxes: usize = history.levels.iter().map(|l| l.pv.len()).sum();
        let needed = 21 * history.raw.op.len() + 44 * boxes;
        prop_assert!(history.bytes() >= needed && history.bytes() <= needed * 5 / 4 + 4000, "{} {needed}", history.bytes());
    }
}

#[test]
fn a_memory_of_so_many_bytes_takes_no_more_whatever_is_sent() {
    for max_bytes in [LEAST_BYTES, 32_768, 100_000, 1_000_000] {
        let [max_points, sizes] = fitting(2000, max_bytes);
        let mut history = History::new(max_points).with_sizes(sizes);
        for k in 0..200_000 {
            let sent = Point { mv: Some(2.0), bad: 1, manual: k % 2 == 0, ..point(k) };
            history.push(&sent, i64::MIN);
        }
        assert!(max_points >= 128 && (LEAST_SIZES..=ALL_SIZES).contains(&sizes), "{max_bytes} {max_points} {sizes}");
        assert!(history.bytes() <= max_bytes, "{} of {max_bytes}", history.bytes());
        assert!(max_points == 2000 || 2 * history.bytes() > max_bytes, "{} of {max_bytes}", history.bytes());
    }
}

#[test]
fn windows_within_reach_do_not_depend_on_what_lies_beyond() {
    let (mut whole, mut short) = (History::new(64), History::new(64).with_sizes(3));
    for k in 0..5000 {
        [&mut whole, &mut short].into_iter().for_each(|h| h.push(&point(k), i64::MIN));
    }
    for back in [10, 64, 130, 400] {
        let from = point(4999 - back).t_ns;
        assert_eq!(whole.now().record(from, 0), short.now().record(from, 0));
    }
}
