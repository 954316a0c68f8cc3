//! Compares the slips with the laws themselves and with small steps in time.

use super::by_sample::Sequence;
use super::*;
use crate::core::sim::valve::{Tracking, he_step, tracking_step};

fn path(seed: u64) -> Vec<f64> {
    let mut state = seed;
    let mut slow = 0.0;
    (0..3000)
        .map(|k| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            slow += ((state >> 40) as f64 / f64::from(1 << 24) - 0.5) * 0.5;
            slow + 6.0 * libm::sin(f64::from(k) * 0.05)
        })
        .collect()
}

#[test]
fn slip_coordinates_give_the_laws_themselves() {
    for seed in 1..6 {
        let op = path(seed);
        for (fs, fd) in [(3.0, 1.0), (2.0, 2.0), (4.0, 0.0), (0.5, 0.25)] {
            let (s, j) = (fs + fd, fs - fd);
            // The stem starts so that an upward slip needs OP above `threshold`.
            let threshold = op[0] + 0.4 * fs;
            let first = FirstSlip { direction: 1.0, threshold };
            let sequence = Sequence::of(Stroke::FREE, Law::He, &op, 1, [s, j], first);
            let mut position = threshold - fs;
            let mut state = Tracking { position, direction: 0 };
            for (k, &u) in op.iter().enumerate() {
                position = he_step(position, u, fs, fd);
                assert!((sequence.at[k] - sequence.direction[k] * fd - position).abs() < 1e-9, "he at {k}");
            }
            let sequence = Sequence::of(Stroke::FREE, Law::Tracking, &op, 1, [s, j], first);
            for (k, &u) in op.iter().enumerate() {
                state = tracking_step(state, u, fs, fd);
                let stem = sequence.at[k] - sequence.direction[k] * fd;
                assert!((stem - state.position).abs() < 1e-9, "tracking at {k} of {seed}, {fs} {fd}");
            }
        }
    }
}

#[test]
fn uneven_bands_are_wider_upwards() {
    for (law, uneven) in [(Law::He, 0.4), (Law::He, -0.6), (Law::Tracking, 0.3)] {
        let (op, fs, fd) = (path(4), 3.0, 1.2);
        let band = |x: f64, up: bool| x * if up { 1.0 + uneven } else { 1.0 - uneven };
        let threshold = op[0] + 0.5;
        let mut position = threshold - band(fs, true);
        let mut moving = 0.0;
        let first = FirstSlip { direction: 1.0, threshold };
        let sequence = Sequence::of(Stroke { uneven, ..Stroke::FREE }, law, &op, 1, [fs + fd, fs - fd], first);
        for (k, &u) in op.iter().enumerate() {
            let force = u - position;
            let slides = moving != 0.0 && moving * (u - moving * band(fd, moving > 0.0) - position) >= 0.0;
            let slips = force > band(fs, true) || force < -band(fs, false);
            if slides || slips {
                let up = if slides { moving > 0.0 } else { force > 0.0 };
                position = if up { u - band(fd, true) } else { u + band(fd, false) };
                moving = if law == Law::He {
                    0.0
                } else if up {
                    1.0
                } else {
                    -1.0
                };
            } else {
                moving = 0.0;
            }
            let stem = sequence.at[k] - fd * (sequence.direction[k] + uneven);
            assert!((stem - position).abs() < 1e-9, "{law:?} {uneven} at {k}: {stem} {position}");
        }
    }
}

#[test]
fn a_stem_at_its_stop_turns_back_from_there() {
    for (law, seed) in [(Law::He, 1), (Law::He, 5), (Law::Tracking, 2)] {
        let (op, fs, fd) = (path(seed), 3.0, 1.2);
        let stops = [-3.0, 2.5];
        let first = FirstSlip { direction: 1.0, threshold: op[0] + 0.5 };
        let stroke = Stroke { ends: [stops[0] - fd, stops[1] + fd], ..Stroke::FREE };
        let sequence = Sequence::of(stroke, law, &op, 1, [fs + fd, fs - fd], first);
        let mut state = Tracking { position: op[0] + 0.5 - fs, direction: 0 };
        let mut met = [0, 0];
        for (k, &u) in op.iter().enumerate() {
            state = if law == Law::He {
                Tracking { position: he_step(state.position, u, fs, fd), ..state }
            } else {
                tracking_step(state, u, fs, fd)
            };
            state.position = state.position.clamp(stops[0], stops[1]);
            met[0] += usize::from(state.position == stops[0]);
            met[1] += usize::from(state.position == stops[1]);
            let stem = sequence.at[k] - fd * sequence.direction[k];
            assert!((stem - state.position).abs() < 1e-9, "{law:?} at {k}: {stem} {}", state.position);
        }
        assert!(met.iter().all(|m| *m > 20), "{met:?}");
    }
}

#[test]
fn a_cell_is_one_sequence_and_ends_where_it_says() {
    let op = path(9);
    let first = FirstSlip { direction: 1.0, threshold: op[0] + 1.0 };
    let run = |s: f64, j: f64| Sequence::of(Stroke::FREE, Law::He, &op, 1, [s, j], first);
    let here = run(4.0, 2.0);
    let [s_low, s_high] = here.s_cell;
    let [j_low, j_high] = here.j_cell;
    assert!(s_low <= 4.0 && 4.0 < s_high && j_low <= 2.0 && 2.0 < j_high);
    let tail = |x: &Sequence| x.at[600..].to_vec();
    assert_eq!(tail(&here), tail(&run(s_low, j_low)));
    assert_ne!(tail(&here), tail(&run(s_high, j_low)));
}

/// A stem that moves between OP values, in small time steps: it breaks away beyond `fs` and then moves by `go` (force, step,
/// position, speed) until `go` returns that it rests. Returns the mean position over each value.
fn by_small_steps(
    op: &[f64],
    mut position: f64,
    fs: f64,
    go: &dyn Fn(f64, f64, f64, &mut f64, &mut f64) -> bool,
) -> Vec<f64> {
    const PARTS: usize = 4000;
    let (mut speed, mut along) = (0.0, 0.0);
    let one = |op: &f64| {
        let mut sum = 0.0;
        for _ in 0..PARTS {
            let force = op - position;
            if along == 0.0 && force.abs() > fs {
                along = force.signum();
            }
            if along != 0.0 && !go(along * force, 1.0 / PARTS as f64, along, &mut position, &mut speed) {
                (along, speed) = (0.0, 0.0);
            }
            sum += position;
        }
        sum / PARTS as f64
    };
    op.iter().map(one).collect()
}

/// The worst error of a law with a stroke relative to small steps, except for the few values near which a slip comes slightly
/// earlier or later.
fn apart(stroke: Stroke, law: Law, [fs, fd]: [f64; 2], op: &[f64], small: &[f64]) -> f64 {
    let first = FirstSlip { direction: 1.0, threshold: op[0] + fs };
    let sequence = Sequence::of(stroke, law, op, 1, [fs + fd, fs - fd], first);
    let stem = sequence.at.iter().zip(&sequence.direction).map(|(at, d)| at - fd * d);
    let mut errors: Vec<f64> = stem.zip(small).map(|(a, b)| (a - b).abs()).collect();
    errors.sort_by(f64::total_cmp);
    errors[errors.len() * 98 / 100]
}

#[test]
fn a_heavy_stem_carries_on_by_what_op_was_ahead() {
    // No drag: the stem swings as far beyond the point where friction and spring balance as it was away from it.
    let (op, fs, fc, mass) = (path(3), 3.0, 0.6, 1e-3);
    let small = by_small_steps(&op, op[0], fs, &|force, dt, along, position, speed| {
        *speed += dt / mass * (force - fc);
        *position += along * dt * *speed;
        *speed > 0.0
    });
    let stroke = Stroke { carried: 1.0, ..Stroke::FREE };
    let error = apart(stroke, Law::He, [fs, 2.0 * fc - fs], &op, &small);
    // The swing itself takes a tenth of one value.
    assert!(error < 0.3, "{error}");
    let plain = apart(Stroke::FREE, Law::He, [fs, 2.0 * fc - fs], &op, &small);
    assert!(plain > 3.0 * error, "{plain} {error}");
}

#[test]
fn a_slow_stem_takes_its_time_and_friction_acts_where_it_is() {
    let (op, fs, fd, rate) = (path(4), 3.0, 1.2, 0.4);
    let small = by_small_steps(&op, op[0], fs, &|force, dt, along, position, _| {
        *position += along * (dt * rate).min((force - fd).max(0.0));
        force - fd > dt * rate
    });
    let error = apart(Stroke { rate, ..Stroke::FREE }, Law::He, [fs, fd], &op, &small);
    assert!(error < 2e-3, "{error}");
}

#[test]
fn a_sliding_stem_drags_behind_and_sticks_when_it_gets_slow() {
    let (fs, fc, drag) = (2.0, 0.8, 0.7);
    let op: Vec<f64> = (0..900).map(|k| 5.0 * libm::sin(f64::from(k) * 0.03)).collect();
    for slowest in [0.0, 0.08] {
        let small = by_small_steps(&op, op[0], fs, &|force, dt, along, position, _| {
            let speed = (force - fc) / drag;
            *position += along * dt * speed.max(0.0);
            speed > slowest
        });
        let stroke = Stroke { drag, slowest, ..Stroke::FREE };
        let error = apart(stroke, Law::Tracking, [fs, fc + drag * slowest], &op, &small);
        assert!(error < 5e-3, "{slowest}: {error}");
    }
}
