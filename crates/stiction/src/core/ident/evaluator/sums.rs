//! Products of a valve signal's responses, from sums over its steps.

// Two halves and three parts index several arrays at once; the compiler unrolls these loops.
#![allow(clippy::needless_range_loop)]

use super::gathered::{FIRST, Gathered, INTEGRATING, LAG_INTEGRATING, MOST_LOADS, SECOND, With, decays, has_ramp};
use super::held::{Held, HeldSums};
use super::reduced::{PARTS, Reduced};
use super::square::{Halves, Square, add, mixed, turned};
use super::tables::{Table, View};
use super::walk::{Visitor, heard, number, over};
use crate::core::ident::class::{Class, INTEGRATOR_SCALE};
use crate::core::sim::steps::Step;

/// Walks over the steps of a valve signal, whose response comes `delay` whole points late, through a process with one or two
/// time constants (with one, pass the same table twice). `held` caches everything that does not depend on the process: clear it
/// whenever the steps change.
#[must_use]
pub fn reduce(
    class: Class,
    view: &View,
    tables: [&Table; 2],
    steps: &[Step],
    delay: usize,
    held: &mut HeldSums,
) -> Reduced {
    let held = held.get(view, steps, delay, class.integrates());
    let steps = heard(view, steps, delay);
    match class {
        Class::First => of_class::<FIRST>(class, view, tables, steps, delay, &held),
        Class::Second => of_class::<SECOND>(class, view, tables, steps, delay, &held),
        Class::Integrating => of_class::<INTEGRATING>(class, view, tables, steps, delay, &held),
        Class::LagIntegrating => of_class::<LAG_INTEGRATING>(class, view, tables, steps, delay, &held),
    }
}

fn of_class<const CLASS: usize>(
    class: Class,
    view: &View,
    tables: [&Table; 2],
    steps: &[Step],
    delay: usize,
    held: &Held,
) -> Reduced {
    let mut sums = Sums::<CLASS>::new(view, tables);
    if CLASS != INTEGRATING {
        over(view, steps, delay, &mut sums);
    }
    let mut with = [[[0.0; 2]; PARTS]; 1 + MOST_LOADS];
    for (column, into) in with.iter_mut().enumerate().take(1 + view.loads().min(MOST_LOADS)) {
        let (of, mut sum) = (With::new(view, tables, column), [[0.0; 2]; PARTS]);
        for step in steps {
            of.add::<CLASS>(step.point as usize + delay, [step.level, step.direction], &mut sum);
        }
        *into = sum;
    }
    let cross = if CLASS == SECOND { 1.0 / (1.0 - tables[0].a * tables[1].a) } else { 0.0 };
    sums.gathered(held, view.rho(), cross, with).take_out::<CLASS>(class, view, tables, cross, held.moved)
}

/// A decay: its state at a sample contains the steps before it and is multiplied by `a` from sample to sample.
#[derive(Clone, Copy)]
struct Decay {
    a: f64,
    /// Factor of the state at a sample after the filter of the error, `a - rho`; the sample's own step is added.
    gamma: f64,
    state: Halves,
    /// Products of state and step, over the samples with a step: `[half of the state][half of the step]`.
    with_steps: Square,
    /// Products of the steps with the decay (the memory) that starts at the first counted point.
    memory: Halves,
}

/// Sums over the counted samples.
///
/// The state `c` of a decay follows `c' = a c + step`, that of the level the same with `a = 1`. So the products of two states,
/// summed over a stretch from `s` to `e`, follow from sums over the steps alone:
/// `(1 - a b) sum(c d) = sum(a c step + b step d + step step) + c d (s) - c d (e)`; the last two terms are the edges.
struct Sums<'t, const CLASS: usize> {
    tables: [&'t Table; 2],
    powers: [&'t [f64]; 2],
    decay: [Decay; 2],
    level: Halves,
    ramp: Halves,
    ramp_decay: Square,
    ramp_memory: Halves,
    decay_time: Halves,
    edges: Edges,
}

/// Products of states (and memories) at the starts of stretches minus those at their ends.
#[derive(Default)]
struct Edges {
    /// Products of level and decay, of each decay with itself, and of the two decays.
    level_decay: [Square; 2],
    decay_decay: [Square; 2],
    cross: Square,
    decay: [Halves; 2],
    /// Products of the memory with the level, and with each decay.
    memory_level: [Halves; 2],
    memory_decay: [[Halves; 2]; 2],
}

impl<'t, const CLASS: usize> Sums<'t, CLASS> {
    fn new(view: &View, tables: [&'t Table; 2]) -> Self {
        let none = ([0.0; 2], [[0.0; 2]; 2]);
        let decay =
            |t: &Table| Decay { a: t.a, gamma: t.a - view.rho(), state: none.0, with_steps: none.1, memory: none.0 };
        Self {
            tables,
            powers: tables.map(|t| &t.powers[..=view.points()]),
            decay: tables.map(decay),
            level: none.0,
            ramp: none.0,
            ramp_decay: none.1,
            ramp_memory: none.0,
            decay_time: none.0,
            edges: Edges::default(),
        }
    }
}

impl<const CLASS: usize> Visitor for Sums<'_, CLASS> {
    #[inline(always)]
    fn pass(&mut self, length: usize) {
        for k in 0..decays(CLASS) {
            let left = self.powers[k][length];
            self.decay[k].state = self.decay[k].state.map(|c| c * left);
        }
        if has_ramp(CLASS) {
            for h in 0..2 {
                self.ramp[h] += self.level[h] * number(length);
            }
        }
    }

    #[inline(always)]
    fn step(&mut self, by: Halves) {
        for h in 0..2 {
            if has_ramp(CLASS) {
                self.ramp[h] += self.level[h] + by[h];
            }
            self.level[h] += by[h];
            for k in 0..decays(CLASS) {
                self.decay[k].state[h] = self.decay[k].a * self.decay[k].state[h] + by[h];
            }
        }
    }

    /// Products of a ramp and a decay: sums of the decay's powers, and of these times their indices.
    #[inline(always)]
    fn stretch(&mut self, length: usize, late: usize) {
        if CLASS != LAG_INTEGRATING {
            return;
        }
        let (l, of) = (number(length), self.tables[0]);
        let (a, p, inverse) = (of.a, of.powers[length], of.inverse[0]);
        let one = (1.0 - p) * inverse;
        let placed = (a - l * p + (l - 1.0) * p * a) * inverse * inverse;
        let memory = of.powers[late];
        let of_ramp: Halves = core::array::from_fn(|h| self.ramp[h] * one + self.level[h] * placed);
        add(&mut self.ramp_decay, of_ramp, self.decay[0].state);
        for h in 0..2 {
            self.ramp_memory[h] += memory * of_ramp[h];
            self.decay_time[h] += self.decay[0].state[h] * (number(late) * one + placed);
        }
    }

    #[inline(always)]
    fn at_step(&mut self, by: Halves, late: usize) {
        for k in 0..decays(CLASS) {
            let memory = self.powers[k][late];
            let decay = &mut self.decay[k];
            add(&mut decay.with_steps, decay.state, by);
            for h in 0..2 {
                decay.memory[h] += memory * by[h];
            }
        }
    }

    fn edge(&mut self, late: usize, sign: f64) {
        let edges = &mut self.edges;
        let level = self.level.map(|x| sign * x);
        let state: [Halves; 2] = [self.decay[0].state, self.decay[1].state];
        for k in 0..decays(CLASS) {
            let own = state[k].map(|x| sign * x);
            add(&mut edges.level_decay[k], level, state[k]);
            add(&mut edges.decay_decay[k], own, state[k]);
            let memory = self.powers[k][late];
            for h in 0..2 {
                edges.decay[k][h] += own[h];
                edges.memory_level[k][h] += memory * level[h];
                for j in 0..decays(CLASS) {
                    edges.memory_decay[k][j][h] += sign * memory * state[j][h];
                }
            }
        }
        if CLASS == SECOND {
            add(&mut edges.cross, state[0].map(|x| sign * x), state[1]);
        }
    }
}

impl<const CLASS: usize> Sums<'_, CLASS> {
    /// Products of the filtered parts with each other and with the additional columns.
    fn gathered(&self, held: &Held, rho: f64, cross: f64, with: [[[f64; 2]; PARTS]; 1 + MOST_LOADS]) -> Gathered {
        let mut out = Gathered { products: [[0.0; 6]; 3], with, with_beside: [[[0.0; 2]; PARTS]; 3] };
        let (share, steps, of_level) = (1.0 - rho, held.steps, held.level_with_steps);
        let level = [(share * share, held.level_level), (share, of_level), (share, turned(&of_level)), (1.0, steps)];
        out.put((0, 0), &mixed(level));
        out.with_beside[0][0] = core::array::from_fn(|h| share * held.level_one[h] + held.total[h]);
        for k in 0..decays(CLASS) {
            let part = if CLASS == LAG_INTEGRATING { 2 } else { 1 + k };
            let decay = &self.decay[k];
            let (gamma, own) = (decay.gamma, decay.with_steps);
            let [one, two] = self.tables[k].inverse;
            let of_level = [
                (share * gamma, self.level_with_decay(k, held)),
                (share, of_level),
                (gamma, turned(&own)),
                (1.0, steps),
            ];
            out.put((0, part), &mixed(of_level));
            let pole = two * decay.a;
            let both = mixed([(pole, own), (pole, turned(&own)), (two, steps), (two, self.edges.decay_decay[k])]);
            out.put((part, part), &mixed([(gamma * gamma, both), (gamma, own), (gamma, turned(&own)), (1.0, steps)]));
            out.with_beside[0][part] =
                core::array::from_fn(|h| gamma * (held.total[h] + self.edges.decay[k][h]) * one + held.total[h]);
            // The memory of a decay has the index of its part.
            for (j, other) in self.decay.iter().enumerate().take(decays(CLASS)) {
                let (inverse, place) = (if j == k { two } else { cross }, if j == k { part } else { 1 + j });
                out.with_beside[part][place] = core::array::from_fn(|h| {
                    let sum = (decay.a * decay.memory[h] + self.edges.memory_decay[k][j][h]) * inverse;
                    other.gamma * sum + decay.memory[h]
                });
            }
            let with_level = self.memory_with_level(k);
            out.with_beside[part][0] = core::array::from_fn(|h| share * with_level[h] + decay.memory[h]);
        }
        if CLASS == SECOND {
            let [one, two] = &self.decay;
            let (first, second) = (one.with_steps, turned(&two.with_steps));
            let of = [(cross * one.a, first), (cross * two.a, second), (cross, steps), (cross, self.edges.cross)];
            let both = [(one.gamma * two.gamma, mixed(of)), (one.gamma, first), (two.gamma, second), (1.0, steps)];
            out.put((1, 2), &mixed(both));
        }
        if has_ramp(CLASS) {
            self.ramps(held, rho, &mut out);
        }
        out
    }

    /// Sum of the products of the level's and a decay's states.
    fn level_with_decay(&self, k: usize, held: &Held) -> Square {
        let (one, own) = (self.tables[k].inverse[0], turned(&self.decay[k].with_steps));
        let steps = [(one, held.level_with_steps), (one * self.decay[k].a, own), (one, held.steps)];
        mixed([steps[0], steps[1], steps[2], (one, self.edges.level_decay[k])])
    }

    /// Sum of the products of a memory and the level's state.
    fn memory_with_level(&self, k: usize) -> Halves {
        let decay = &self.decay[k];
        core::array::from_fn(|h| {
            (decay.a * decay.memory[h] + self.edges.memory_level[k][h]) * self.tables[k].inverse[0]
        })
    }

    /// The products with a ramp, and those with time.
    fn ramps(&self, held: &Held, rho: f64, out: &mut Gathered) {
        let (share, scale) = (1.0 - rho, 1.0 / INTEGRATOR_SCALE);
        let level_ramp = turned(&held.ramp_level);
        let of_level = [
            (scale * share * share, level_ramp),
            (scale * share * rho, held.level_level),
            (scale * share, turned(&held.ramp_with_steps)),
            (scale * rho, turned(&held.level_with_steps)),
        ];
        out.put((0, 1), &mixed(of_level));
        let square = scale * scale;
        let own = [
            (square * share * share, held.ramp_ramp),
            (square * share * rho, held.ramp_level),
            (square * share * rho, level_ramp),
            (square * rho * rho, held.level_level),
        ];
        out.put((1, 1), &mixed(own));
        for h in 0..2 {
            out.with_beside[0][1][h] = scale * (share * held.ramp_one[h] + rho * held.level_one[h]);
            out.with_beside[1][1][h] = scale * (share * held.ramp_time[h] + rho * held.level_time[h]);
            out.with_beside[1][0][h] = share * held.level_time[h] + held.steps_time[h];
        }
        if CLASS == LAG_INTEGRATING {
            let decay = &self.decay[0];
            let of_decay = [
                (scale * share * decay.gamma, self.ramp_decay),
                (scale * share, held.ramp_with_steps),
                (scale * rho * decay.gamma, self.level_with_decay(0, held)),
                (scale * rho, held.level_with_steps),
            ];
            out.put((1, 2), &mixed(of_decay));
            let with_level = self.memory_with_level(0);
            for h in 0..2 {
                out.with_beside[1][2][h] = decay.gamma * self.decay_time[h] + held.steps_time[h];
                out.with_beside[2][1][h] = scale * (share * self.ramp_memory[h] + rho * with_level[h]);
            }
        }
    }
}
