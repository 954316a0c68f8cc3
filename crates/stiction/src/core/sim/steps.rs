//! A valve signal as a list of steps, computed without visiting every sample.
//!
//! Between two slips the stem rests, so its signal is a staircase: some hundred steps represent thousands of samples, and
//! [`crate::core::ident`] computes a free run from them in time proportional to their number. A sliding stem makes a step at
//! every sample on which it moves.

use super::slips::{FirstSlip, Law, Stem, Stroke};

/// OP values per block with common extremes.
const BLOCK: usize = 16;

/// OP path, prepared for [`Steps::run`].
#[derive(Debug, Clone)]
pub struct Path {
    values: Vec<f64>,
    /// Minimum and maximum from each value to the end of its block.
    ahead: Vec<[f64; 2]>,
    per_point: usize,
}

impl Path {
    /// `values` holds `per_point` (at least 1) OP values for every point.
    #[must_use]
    pub fn new(values: Vec<f64>, per_point: usize) -> Self {
        let mut ahead = vec![[0.0; 2]; values.len()];
        for (block, out) in values.chunks(BLOCK).zip(ahead.chunks_mut(BLOCK)) {
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            for (value, slot) in block.iter().zip(out).rev() {
                (low, high) = (low.min(*value), high.max(*value));
                *slot = [low, high];
            }
        }
        Self { values, ahead, per_point: per_point.max(1) }
    }

    /// OP values, in order.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// OP values per point.
    #[must_use]
    pub(crate) const fn per_point(&self) -> usize {
        self.per_point
    }

    /// Number of points.
    #[must_use]
    pub const fn points(&self) -> usize {
        self.values.len() / self.per_point
    }

    /// The stem of a valve with bands `[s, j]` and kinetic band `fd`, averaged over each point, and its steps.
    #[must_use]
    pub fn stem(&self, law: Law, [s, j]: [f64; 2], fd: f64, first: FirstSlip) -> (Vec<f64>, Steps) {
        let mut steps = Steps::default();
        steps.run(self, self.points(), Stroke::FREE, law, [s, j], first);
        let (level, direction) = Stem::before(first, [s, j], Stroke::FREE, self.per_point).signal();
        let mut samples = [Vec::new(), Vec::new()];
        steps.sample([level, direction], self.points(), &mut samples);
        let [level, direction] = samples;
        (level.iter().zip(&direction).map(|(level, direction)| level - fd * direction).collect(), steps)
    }
}

/// One step of a valve signal `level - fd direction`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// First point at which the step counts.
    pub point: u32,
    /// Change of the level.
    pub level: f64,
    /// Change of the direction.
    pub direction: f64,
}

/// The steps of a valve model on an OP path, sorted by point, at most one per point.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Steps {
    /// The steps.
    pub list: Vec<Step>,
    /// Values of s, from the first up to but excluding the second, that give the same steps.
    pub s_cell: [f64; 2],
    /// The same for j.
    pub j_cell: [f64; 2],
    /// Movements of the stem.
    pub slips: usize,
    /// Movements against the previous one.
    pub reversals: usize,
}

impl Steps {
    /// Runs a valve model with bands `[s, j]` over the first `points` points of a path.
    pub fn run(&mut self, path: &Path, points: usize, stroke: Stroke, law: Law, [s, j]: [f64; 2], first: FirstSlip) {
        let m = path.per_point;
        let values = &path.values[..(points * m).min(path.values.len())];
        let mut stem = Stem::before(first, [s, j], stroke, m);
        let mut collector = Collector::new(core::mem::take(&mut self.list), m, values.len() / m);
        let mut last = stem.signal();
        let mut k = 0;
        if stroke.is_plain() {
            self.list = collector.list;
            return self.run_plain(path, values.len(), law, [s, j], stem);
        }
        while k < values.len() {
            let end = (k / BLOCK + 1) * BLOCK;
            // The extremes cover the rest of the block, which may extend beyond the requested values.
            if end <= values.len() && stem.rests_between(path.ahead[k], [s, j]) {
                last = put(&mut collector, k, last, stem.signal());
                k = end;
                continue;
            }
            let slips = stem.slips();
            while k < values.len() {
                stem.meet(law, values[k], [s, j], stroke);
                last = put(&mut collector, k, last, stem.signal());
                k += 1;
                if stem.slips() != slips && !stem.is_moving() || k % BLOCK == 0 && !stem.is_moving() {
                    break;
                }
            }
        }
        self.list = collector.finish();
        [self.s_cell, self.j_cell] = stem.cells();
        (self.slips, self.reversals) = (stem.slips(), stem.reversals());
    }

    /// The same for even bands and a stem without mass, stops or delay, by thresholds: most of a search uses this case.
    fn run_plain(&mut self, path: &Path, count: usize, law: Law, [s, j]: [f64; 2], stem: Stem) {
        let m = path.per_point;
        let (values, ahead) = (&path.values[..count], &path.ahead[..count]);
        let mut collector = Collector::new(core::mem::take(&mut self.list), m, count / m);
        let (mut at, mut direction) = stem.signal();
        let (mut s_cell, mut j_cell) = ([0.0_f64, f64::INFINITY], [0.0_f64, f64::INFINITY]);
        let (mut slips, mut reversals, mut k) = (0, 0, 0);
        loop {
            let up = direction > 0.0;
            let [low, high] = if up { [at - s, at + j] } else { [at - j, at + s] };
            let (mut least, mut most) = (at, at);
            let mut value = None;
            while k < count {
                let end = (k / BLOCK + 1) * BLOCK;
                let [l, h] = ahead[k];
                if l >= low && h <= high && end <= count {
                    (least, most) = (least.min(l), most.max(h));
                    k = end;
                    continue;
                }
                let stop = end.min(count);
                while k < stop && values[k] >= low && values[k] <= high {
                    (least, most) = (least.min(values[k]), most.max(values[k]));
                    k += 1;
                }
                if k < stop {
                    value = Some(values[k]);
                    break;
                }
            }
            if slips > 0 {
                let [on, back] = if up { [most - at, at - least] } else { [at - least, most - at] };
                j_cell[0] = j_cell[0].max(on);
                s_cell[0] = s_cell[0].max(back);
            }
            let Some(op) = value else { break };
            let way = (op - at).abs();
            let turns = (op > at) != up;
            if turns {
                if slips > 0 {
                    s_cell[1] = s_cell[1].min(way);
                    reversals += 1;
                }
                direction = -direction;
            } else {
                j_cell[1] = j_cell[1].min(way);
            }
            slips += 1;
            collector.step(k, [op - at, if turns { 2.0 * direction } else { 0.0 }]);
            at = op;
            k += 1;
            if law == Law::Tracking {
                while k < count && direction * (values[k] - at) >= 0.0 {
                    if values[k] != at {
                        collector.step(k, [values[k] - at, 0.0]);
                        at = values[k];
                    }
                    k += 1;
                }
            }
        }
        self.list = collector.finish();
        (self.s_cell, self.j_cell, self.slips, self.reversals) = (s_cell, j_cell, slips, reversals);
    }

    /// Level and direction at each of `points` points, starting from the values before the first step.
    pub(crate) fn sample(
        &self,
        [mut level, mut direction]: [f64; 2],
        points: usize,
        [levels, directions]: &mut [Vec<f64>; 2],
    ) {
        levels.clear();
        directions.clear();
        for step in self.list.iter().filter(|step| (step.point as usize) < points) {
            levels.resize(step.point as usize, level);
            directions.resize(step.point as usize, direction);
            level += step.level;
            direction += step.direction;
        }
        levels.resize(points, level);
        directions.resize(points, direction);
    }

    /// Converts a signal given point by point; `direction` has the same length or is empty. Cells and counts do not change.
    pub(crate) fn of_signal(&mut self, level: &[f64], direction: &[f64]) {
        self.list.clear();
        for k in 1..level.len() {
            let turn = if direction.is_empty() { 0.0 } else { direction[k] - direction[k - 1] };
            let step = Step { point: k as u32, level: level[k] - level[k - 1], direction: turn };
            if step.level != 0.0 || turn != 0.0 {
                self.list.push(step);
            }
        }
    }
}

/// Records the change at an OP value; returns the new signal.
#[inline]
fn put(collector: &mut Collector, value: usize, last: (f64, f64), now: (f64, f64)) -> (f64, f64) {
    if now != last {
        collector.step(value, [now.0 - last.0, now.1 - last.1]);
    }
    now
}

/// Merges steps at OP values into steps at points: a step within a point counts there by the remaining share of the point, and
/// by the rest from the next point on.
struct Collector {
    list: Vec<Step>,
    per_point: usize,
    points: usize,
    /// The current point, its step, and the part that it passes to the next point.
    point: usize,
    here: [f64; 2],
    next: [f64; 2],
}

impl Collector {
    fn new(mut list: Vec<Step>, per_point: usize, points: usize) -> Self {
        list.clear();
        Self { list, per_point, points, point: 0, here: [0.0; 2], next: [0.0; 2] }
    }

    fn step(&mut self, value: usize, by: [f64; 2]) {
        if self.per_point == 1 {
            self.list.push(Step { point: value as u32, level: by[0], direction: by[1] });
            return;
        }
        let (point, within) = (value / self.per_point, value % self.per_point);
        self.go_to(point);
        let late = within as f64 / self.per_point as f64;
        self.here = [self.here[0] + (1.0 - late) * by[0], self.here[1] + (1.0 - late) * by[1]];
        self.next = [self.next[0] + late * by[0], self.next[1] + late * by[1]];
    }

    fn go_to(&mut self, point: usize) {
        while self.point < point {
            if self.here == [0.0; 2] && self.next == [0.0; 2] {
                self.point = point;
                return;
            }
            self.put();
        }
    }

    /// Completes the current point.
    fn put(&mut self) {
        if self.here != [0.0; 2] && self.point < self.points {
            self.list.push(Step { point: self.point as u32, level: self.here[0], direction: self.here[1] });
        }
        (self.here, self.next) = (self.next, [0.0; 2]);
        self.point += 1;
    }

    fn finish(mut self) -> Vec<Step> {
        if self.per_point > 1 {
            self.put();
            self.put();
        }
        self.list
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::slips::by_sample::Sequence;

    fn path(seed: u64, n: usize) -> Vec<f64> {
        let (mut state, mut slow) = (seed, 0.0);
        (0..n)
            .map(|k| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                slow += ((state >> 40) as f64 / f64::from(1 << 24) - 0.5) * 0.5;
                slow + 6.0 * libm::sin(k as f64 * 0.05)
            })
            .collect()
    }

    #[test]
    fn steps_put_together_are_the_signal_of_every_law_and_stroke() {
        let strokes = [
            Stroke::FREE,
            Stroke { uneven: 0.3, ..Stroke::FREE },
            Stroke { ends: [-3.0, 2.5], ..Stroke::FREE },
            Stroke { carried: 0.4, ..Stroke::FREE },
            Stroke { rate: 0.05, ..Stroke::FREE },
            Stroke { drag: 4.0, slowest: 0.01, ..Stroke::FREE },
        ];
        for (stroke, law) in strokes.into_iter().flat_map(|s| [(s, Law::He), (s, Law::Tracking)]) {
            for (m, [s, j]) in [(1, [4.0, 2.0]), (1, [0.3, 0.1]), (4, [5.0, 5.0]), (5, [2.0, 0.4])] {
                let op = path(7 + m as u64, 2003 / m * m);
                let first = FirstSlip { direction: -1.0, threshold: op[0] - 0.6 };
                let sequence = Sequence::of(stroke, law, &op, m, [s, j], first);
                let mut steps = Steps::default();
                let n = op.len() / m;
                let path = Path::new(op, m);
                steps.run(&path, n, stroke, law, [s, j], first);
                let stem = Stem::before(first, [s, j], stroke, m).signal();
                let mut samples = [Vec::new(), Vec::new()];
                steps.sample([stem.0, stem.1], n, &mut samples);
                for (k, (level, direction)) in samples[0].iter().zip(&samples[1]).enumerate() {
                    assert!(
                        (level - sequence.at[k]).abs() < 1e-9 && (direction - sequence.direction[k]).abs() < 1e-9,
                        "{law:?} {stroke:?} {m} at {k}: {level} {}",
                        sequence.at[k]
                    );
                }
                assert_eq!((steps.s_cell, steps.j_cell), (sequence.s_cell, sequence.j_cell), "{law:?} {stroke:?}");
                assert_eq!((steps.slips, steps.reversals), (sequence.slips, sequence.reversals));
            }
        }
    }

    #[test]
    fn the_beginning_of_a_record_has_the_beginning_of_its_steps() {
        let path = Path::new(path(3, 1500), 1);
        let first = FirstSlip { direction: 1.0, threshold: path.values()[0] + 0.3 };
        let (mut whole, mut part) = (Steps::default(), Steps::default());
        whole.run(&path, 1500, Stroke::FREE, Law::He, [2.0, 0.7], first);
        part.run(&path, 701, Stroke::FREE, Law::He, [2.0, 0.7], first);
        let before: Vec<Step> = whole.list.iter().copied().filter(|s| s.point < 701).collect();
        assert_eq!(part.list, before);
        assert!(part.s_cell[0] <= whole.s_cell[0] && part.s_cell[1] >= whole.s_cell[1]);
    }

    #[test]
    fn a_signal_given_point_by_point_steps_where_it_changes() {
        let mut steps = Steps::default();
        steps.of_signal(&[1.0, 1.0, 3.0, 3.0, 2.5], &[-1.0, -1.0, 1.0, 1.0, 1.0]);
        let points: Vec<u32> = steps.list.iter().map(|s| s.point).collect();
        assert_eq!(points, [2, 4]);
        assert_eq!(steps.list[0], Step { point: 2, level: 2.0, direction: 2.0 });
    }
}
