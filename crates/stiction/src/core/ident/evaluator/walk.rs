//! One pass over a valve signal's steps and the counted stretches of points.

use super::square::Halves;
use super::tables::View;
use crate::core::sim::steps::Step;

/// Accumulator of the pass. States are those before the current sample.
pub(super) trait Visitor {
    /// `length` samples without a step pass.
    fn pass(&mut self, length: usize);
    /// A sample with a step passes.
    fn step(&mut self, by: Halves);
    /// `length` samples count, from the current one up to the next step; the first is `late` points after the first counted
    /// point.
    fn stretch(&mut self, length: usize, late: usize);
    /// The current sample has a step and counts.
    fn at_step(&mut self, by: Halves, late: usize);
    /// A counted stretch begins (`sign` 1) or ends (-1) at the current sample.
    fn edge(&mut self, late: usize, sign: f64);
}

/// The steps that matter to a view if their response comes `delay` whole points late: steps before the first counted point
/// leave only a level and a memory, which are fitted anyway.
pub(super) fn heard<'s>(view: &View, steps: &'s [Step], delay: usize) -> &'s [Step] {
    let first = steps.partition_point(|s| (s.point as usize + delay) < view.from());
    let last = steps.partition_point(|s| (s.point as usize + delay) < view.points());
    &steps[first..last]
}

/// Passes over the steps that matter.
#[inline(always)]
pub(super) fn over(view: &View, steps: &[Step], delay: usize, visitor: &mut impl Visitor) {
    let from = view.from();
    let (mut open, mut at) = (steps, from);
    for &[start, end] in view.counted() {
        while let Some((step, rest)) = open.split_first().filter(|(s, _)| (s.point as usize + delay) < start) {
            let i = step.point as usize + delay;
            visitor.pass(i - at);
            visitor.step([step.level, step.direction]);
            (at, open) = (i + 1, rest);
        }
        visitor.pass(start - at);
        at = start;
        visitor.edge(at - from, 1.0);
        while let Some((step, rest)) = open.split_first().filter(|(s, _)| (s.point as usize + delay) < end) {
            let (i, by) = (step.point as usize + delay, [step.level, step.direction]);
            visitor.stretch(i + 1 - at, at - from);
            visitor.pass(i - at);
            visitor.at_step(by, i - from);
            visitor.step(by);
            (at, open) = (i + 1, rest);
        }
        if at < end {
            visitor.stretch(end - at, at - from);
            visitor.pass(end - at);
            at = end;
        }
        visitor.edge(at - from, -1.0);
    }
}

/// A count of samples as `f64`; through 32 bits the conversion is one instruction.
#[inline(always)]
pub(super) const fn number(count: usize) -> f64 {
    (count as u32 as i32) as f64
}
