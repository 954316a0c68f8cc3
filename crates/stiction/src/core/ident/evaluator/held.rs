//! The part of the sums over a valve signal that does not depend on the time constants.

// Halves index several arrays at once; the compiler unrolls these loops.
#![allow(clippy::needless_range_loop)]

use super::square::{Halves, Square, add};
use super::tables::View;
use super::walk::{Visitor, heard, number, over};
use crate::core::sim::steps::Step;

/// Products of level, ramp and steps with each other, their sums, and sums of each times the distance from the first counted
/// point.
#[derive(Debug, Clone, Copy, Default)]
pub struct Held {
    /// Squares of all steps' halves, including points that do not count: anything far below them is rounding.
    pub(super) moved: Halves,
    pub(super) steps: Square,
    pub(super) total: Halves,
    pub(super) steps_time: Halves,
    /// `[half of the level][half of the other]`.
    pub(super) level_with_steps: Square,
    pub(super) level_level: Square,
    pub(super) level_one: Halves,
    pub(super) level_time: Halves,
    /// `[half of the ramp][half of the other]`.
    pub(super) ramp_with_steps: Square,
    pub(super) ramp_level: Square,
    pub(super) ramp_ramp: Square,
    pub(super) ramp_one: Halves,
    pub(super) ramp_time: Halves,
}

/// [`Held`] for the dead times used so far, of one valve signal.
#[derive(Debug, Clone, Default)]
pub struct HeldSums {
    from: usize,
    points: usize,
    counted: Vec<[usize; 2]>,
    of: Vec<(usize, bool, Held)>,
}

impl HeldSums {
    /// Discards them before another valve signal.
    pub(crate) fn clear(&mut self) {
        self.of.clear();
    }

    /// [`Held`] for a dead time of `delay` whole points; `steps` must stay the same until the next [`HeldSums::clear`].
    pub(crate) fn get(&mut self, view: &View, steps: &[Step], delay: usize, ramp: bool) -> Held {
        if self.from != view.from() || self.points != view.points() || self.counted != view.counted() {
            (self.from, self.points) = (view.from(), view.points());
            self.counted.clear();
            self.counted.extend_from_slice(view.counted());
            self.of.clear();
        }
        if let Some((.., held)) = self.of.iter().find(|(d, r, _)| *d == delay && *r == ramp) {
            return *held;
        }
        let held = Held::of(view, steps, delay, ramp);
        self.of.push((delay, ramp, held));
        held
    }
}

impl Held {
    /// Sums for the steps of a valve signal whose response comes `delay` whole points late; `ramp` includes the products of
    /// ramps.
    #[must_use]
    pub(crate) fn of(view: &View, steps: &[Step], delay: usize, ramp: bool) -> Self {
        let moved = steps
            .iter()
            .fold([0.0; 2], |[level, direction], s| [level + s.level * s.level, direction + s.direction * s.direction]);
        let steps = heard(view, steps, delay);
        let held = if ramp { Walk::<true>::over(view, steps, delay) } else { Walk::<false>::over(view, steps, delay) };
        Self { moved, ..held }
    }
}

#[derive(Default)]
struct Walk<const RAMP: bool> {
    level: Halves,
    ramp: Halves,
    held: Held,
}

impl<const RAMP: bool> Walk<RAMP> {
    fn over(view: &View, steps: &[Step], delay: usize) -> Held {
        let mut walk = Self::default();
        over(view, steps, delay, &mut walk);
        walk.held
    }
}

impl<const RAMP: bool> Visitor for Walk<RAMP> {
    #[inline(always)]
    fn pass(&mut self, length: usize) {
        if RAMP {
            for h in 0..2 {
                self.ramp[h] += self.level[h] * number(length);
            }
        }
    }

    #[inline(always)]
    fn step(&mut self, by: Halves) {
        for h in 0..2 {
            if RAMP {
                self.ramp[h] += self.level[h] + by[h];
            }
            self.level[h] += by[h];
        }
    }

    #[inline(always)]
    fn stretch(&mut self, length: usize, late: usize) {
        let (l, level, held) = (number(length), self.level, &mut self.held);
        let sum = level.map(|x| x * l);
        add(&mut held.level_level, level, sum);
        for h in 0..2 {
            held.level_one[h] += sum[h];
        }
        if !RAMP {
            return;
        }
        let (q, qq, t) = (0.5 * l * (l - 1.0), (l - 1.0) * l * (2.0 * l - 1.0) / 6.0, number(late));
        let ramp = self.ramp;
        let sum: Halves = core::array::from_fn(|h| ramp[h] * l + level[h] * q);
        add(&mut held.ramp_level, sum, level);
        for h in 0..2 {
            held.level_time[h] += level[h] * (t * l + q);
            held.ramp_one[h] += sum[h];
            held.ramp_time[h] += t * sum[h] + ramp[h] * q + level[h] * qq;
            for g in 0..2 {
                held.ramp_ramp[h][g] += ramp[h] * sum[g] + level[h] * (ramp[g] * q + level[g] * qq);
            }
        }
    }

    #[inline(always)]
    fn at_step(&mut self, by: Halves, late: usize) {
        let held = &mut self.held;
        add(&mut held.steps, by, by);
        add(&mut held.level_with_steps, self.level, by);
        for h in 0..2 {
            held.total[h] += by[h];
        }
        if RAMP {
            add(&mut held.ramp_with_steps, self.ramp, by);
            for h in 0..2 {
                held.steps_time[h] += number(late) * by[h];
            }
        }
    }

    fn edge(&mut self, _: usize, _: f64) {}
}
