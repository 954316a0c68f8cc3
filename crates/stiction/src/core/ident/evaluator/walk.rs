//! The way over a valve signal's steps and the stretches of points that count.

use super::square::Halves;
use super::tables::View;
use crate::core::sim::steps::Step;

/// What is summed on the way. States are those before the sample at hand.
pub(super) trait Visitor {
    /// `length` samples go by without a step.
    fn pass(&mut self, length: usize);
    /// A sample with a step goes by.
    fn step(&mut self, by: Halves);
    /// `length` samples count, from the one at hand to the next step's; the first is `late` points after the first of all.
    fn stretch(&mut self, length: usize, late: usize);
    /// The sample at hand has a step and counts.
    fn at_step(&mut self, by: Halves, late: usize);
    /// A stretch that counts begins (1) or ends (-1) at the sample at hand.
    fn edge(&mut self, late: usize, sign: f64);
}

/// The steps that matter to a view, their answer being `delay` whole points late: what comes before the first point that
/// counts leaves a level and a memory only, and those are fitted anyway.
pub(super) fn heard<'s>(view: &View, steps: &'s [Step], delay: usize) -> &'s [Step] {
    let first = steps.partition_point(|s| (s.point as usize + delay) < view.from());
    let last = steps.partition_point(|s| (s.point as usize + delay) < view.points());
    &steps[first..last]
}

/// Goes over the steps that matter.
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

/// A count of samples as a number: by way of 32 bits, which is one instruction.
#[inline(always)]
pub(super) const fn number(count: usize) -> f64 {
    (count as u32 as i32) as f64
}
