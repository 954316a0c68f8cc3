//! The products that a fit needs, gathered step by step.

// Halves and parts are two and three places of several arrays at once, and the loops over them are unrolled by the compiler.
#![allow(clippy::needless_range_loop)]

use super::reduced::Reduced;
use super::tables::{Table, View};
use crate::ident::class::{Class, INTEGRATOR_SCALE};
use crate::sim::steps::Step;

/// Columns that a step response is made of, at most: level, and ramp or decays.
pub(super) const PARTS: usize = 3;
/// Pairs of them: 00 01 11 02 12 22.
pub(super) const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)];
/// Columns beside the answer, at most: constant, two memories, loads.
const BESIDE: usize = 3 + MOST_LOADS;
/// Most loads of a view.
const MOST_LOADS: usize = 5;
/// Share of its own square below which a column depends on those before it.
pub(super) const DEPENDENT: f64 = 1e-9;

const FIRST: usize = 0;
const SECOND: usize = 1;
const INTEGRATING: usize = 2;
const LAG_INTEGRATING: usize = 3;

const fn parts(class: usize) -> usize {
    if class == FIRST || class == INTEGRATING { 2 } else { 3 }
}

const fn pairs(class: usize) -> usize {
    parts(class) * (parts(class) + 1) / 2
}

const fn decays(class: usize) -> usize {
    match class {
        INTEGRATING => 0,
        SECOND => 2,
        _ => 1,
    }
}

const fn has_ramp(class: usize) -> bool {
    class == INTEGRATING || class == LAG_INTEGRATING
}

/// Walks the steps of a valve signal, their answer `delay` whole points late, through a process with one or two time
/// constants (the same table twice where there is one).
#[must_use]
pub fn reduce(class: Class, view: &View, tables: [&Table; 2], steps: &[Step], delay: usize) -> Reduced {
    match class {
        Class::First => walk::<FIRST>(class, view, tables, steps, delay),
        Class::Second => walk::<SECOND>(class, view, tables, steps, delay),
        Class::Integrating => walk::<INTEGRATING>(class, view, tables, steps, delay),
        Class::LagIntegrating => walk::<LAG_INTEGRATING>(class, view, tables, steps, delay),
    }
}

/// The level half and the direction half of the valve signal.
type Halves = [f64; 2];
/// Products of the halves of one thing with those of another.
type Square = [Halves; 2];

/// Adds the products of two things' halves.
#[inline(always)]
fn add(into: &mut Square, x: Halves, y: Halves) {
    for h in 0..2 {
        for g in 0..2 {
            into[h][g] += x[h] * y[g];
        }
    }
}

/// Adds those of `square` with the first thing's halves in the second place.
fn turned(square: &Square) -> Square {
    [[square[0][0], square[1][0]], [square[0][1], square[1][1]]]
}

/// `sum of factor * square` over what is named.
fn mixed<const N: usize>(of: [(f64, Square); N]) -> Square {
    core::array::from_fn(|h| core::array::from_fn(|g| of.iter().map(|(factor, square)| factor * square[h][g]).sum()))
}

/// A part that shrinks to `a` of itself from sample to sample: a decay, or the level, whose `a` is 1. Its state at a sample
/// is made of the steps before it.
#[derive(Clone, Copy, Default)]
struct Pole {
    a: f64,
    /// What the filter of the error makes of the state at a sample, `a - rho`; the sample's own step comes on top.
    gamma: f64,
    state: Halves,
    /// State times step, over the samples with a step: `[half of the state][half of the step]`.
    with_steps: Square,
    /// Steps times the decay (the memory) that starts at the first point that counts.
    memory: Halves,
}

/// Sums over the samples that count.
///
/// The state `c` of a pole follows `c' = a c + step`. So the products of two poles, summed over a stretch from `s` to `e`,
/// follow from sums over the steps alone: `(1 - a b) sum(c d) = sum(a c step + b step d + step step) + c d (s) - c d (e)`,
/// where the last two are the edges. The level with itself, and what a ramp is in, is summed from step to step instead.
#[derive(Default)]
struct Sums {
    level: Pole,
    decay: [Pole; 2],
    /// The ramp's state, and its products with the steps at their samples.
    ramp: Halves,
    ramp_with_steps: Square,
    /// Steps: products with each other, sum, sum of each times its points since the first that counts.
    steps: Square,
    total: Halves,
    steps_time: Halves,
    level_level: Square,
    level_one: Halves,
    level_time: Halves,
    ramp_one: Halves,
    ramp_time: Halves,
    /// `[half of the ramp][half of the other]`.
    ramp_level: Square,
    ramp_ramp: Square,
    ramp_decay: Square,
    ramp_memory: Halves,
    decay_time: Halves,
    edges: Edges,
}

/// Products of states (and memories) at the starts of stretches less those at their ends.
#[derive(Default)]
struct Edges {
    /// Level with decay, decay with itself, the two decays.
    level_decay: [Square; 2],
    decay_decay: [Square; 2],
    cross: Square,
    decay: [Halves; 2],
    /// Memory with level; with each decay.
    memory_level: [Halves; 2],
    memory_decay: [[Halves; 2]; 2],
}

impl Sums {
    fn new(rho: f64, tables: [&Table; 2]) -> Self {
        let pole = |a: f64| Pole { a, gamma: a - rho, ..Pole::default() };
        Self { level: pole(1.0), decay: tables.map(|t| pole(t.a)), ..Self::default() }
    }

    /// States after `length` samples without a step.
    #[inline(always)]
    fn pass<const CLASS: usize>(&mut self, powers: [&[f64]; 2], length: usize) {
        for k in 0..decays(CLASS) {
            let left = powers[k][length];
            self.decay[k].state = self.decay[k].state.map(|c| c * left);
        }
        if has_ramp(CLASS) {
            let l = length as f64;
            for h in 0..2 {
                self.ramp[h] += self.level.state[h] * l;
            }
        }
    }

    /// States after a sample with a step.
    #[inline(always)]
    fn step<const CLASS: usize>(&mut self, by: Halves) {
        for h in 0..2 {
            if has_ramp(CLASS) {
                self.ramp[h] += self.level.state[h] + by[h];
            }
            self.level.state[h] += by[h];
            for k in 0..decays(CLASS) {
                self.decay[k].state[h] = self.decay[k].a * self.decay[k].state[h] + by[h];
            }
        }
    }

    /// Adds what `length` samples from the present one on make, up to the next step's, `late` points after the first.
    #[inline(always)]
    fn stretch<const CLASS: usize>(&mut self, tables: [&Table; 2], length: usize, late: usize) {
        let (l, level) = (length as f64, self.level.state);
        let held = level.map(|x| x * l);
        add(&mut self.level_level, level, held);
        for h in 0..2 {
            self.level_one[h] += held[h];
        }
        if !has_ramp(CLASS) {
            return;
        }
        let (q, qq, t) = (0.5 * l * (l - 1.0), (l - 1.0) * l * (2.0 * l - 1.0) / 6.0, late as f64);
        let ramp = self.ramp;
        let sum: Halves = core::array::from_fn(|h| ramp[h] * l + level[h] * q);
        add(&mut self.ramp_level, sum, level);
        for h in 0..2 {
            self.level_time[h] += level[h] * (t * l + q);
            self.ramp_one[h] += sum[h];
            self.ramp_time[h] += t * sum[h] + ramp[h] * q + level[h] * qq;
            for g in 0..2 {
                self.ramp_ramp[h][g] += ramp[h] * sum[g] + level[h] * (ramp[g] * q + level[g] * qq);
            }
        }
        if CLASS == LAG_INTEGRATING {
            // A ramp times a decay: sums of the decay's powers, and of these times their places.
            let (a, p, inverse) = (tables[0].a, tables[0].powers[length], tables[0].inverse[0]);
            let one = (1.0 - p) * inverse;
            let placed = (a - l * p + (l - 1.0) * p * a) * inverse * inverse;
            let memory = tables[0].powers[late];
            let of_ramp: Halves = core::array::from_fn(|h| ramp[h] * one + level[h] * placed);
            add(&mut self.ramp_decay, of_ramp, self.decay[0].state);
            for h in 0..2 {
                self.ramp_memory[h] += memory * of_ramp[h];
                self.decay_time[h] += self.decay[0].state[h] * (t * one + placed);
            }
        }
    }

    /// Adds what a step at the present sample makes, `late` points after the first.
    #[inline(always)]
    fn at_step<const CLASS: usize>(&mut self, powers: [&[f64]; 2], by: Halves, late: usize) {
        add(&mut self.steps, by, by);
        add(&mut self.level.with_steps, self.level.state, by);
        for k in 0..decays(CLASS) {
            let memory = powers[k][late];
            let pole = &mut self.decay[k];
            add(&mut pole.with_steps, pole.state, by);
            for h in 0..2 {
                pole.memory[h] += memory * by[h];
            }
        }
        for h in 0..2 {
            self.total[h] += by[h];
        }
        if has_ramp(CLASS) {
            add(&mut self.ramp_with_steps, self.ramp, by);
            for h in 0..2 {
                self.steps_time[h] += late as f64 * by[h];
            }
        }
    }

    /// Adds the start of a stretch, or takes off its end.
    fn edge<const CLASS: usize>(&mut self, powers: [&[f64]; 2], late: usize, sign: f64) {
        let edges = &mut self.edges;
        let level = self.level.state.map(|x| sign * x);
        let state: [Halves; 2] = [self.decay[0].state, self.decay[1].state];
        for k in 0..decays(CLASS) {
            let own = state[k].map(|x| sign * x);
            add(&mut edges.level_decay[k], level, state[k]);
            add(&mut edges.decay_decay[k], own, state[k]);
            let memory = powers[k][late];
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

fn walk<const CLASS: usize>(class: Class, view: &View, tables: [&Table; 2], steps: &[Step], delay: usize) -> Reduced {
    let (from, n) = (view.from(), view.points());
    let powers = [&tables[0].powers[..=n], &tables[1].powers[..=n]];
    // A step before the first point that counts leaves a level and a memory only, and those are fitted anyway.
    let first = steps.partition_point(|s| (s.point as usize + delay) < from);
    let last = steps.partition_point(|s| (s.point as usize + delay) < n);
    let mut sums = Sums::new(view.rho(), tables);
    let mut open = &steps[first..last];
    let mut at = from;
    for &[start, end] in view.counted() {
        while let Some((step, rest)) = open.split_first().filter(|(s, _)| (s.point as usize + delay) < start) {
            let i = step.point as usize + delay;
            sums.pass::<CLASS>(powers, i - at);
            sums.step::<CLASS>([step.level, step.direction]);
            (at, open) = (i + 1, rest);
        }
        sums.pass::<CLASS>(powers, start - at);
        at = start;
        sums.edge::<CLASS>(powers, at - from, 1.0);
        while let Some((step, rest)) = open.split_first().filter(|(s, _)| (s.point as usize + delay) < end) {
            let (i, by) = (step.point as usize + delay, [step.level, step.direction]);
            sums.stretch::<CLASS>(tables, i + 1 - at, at - from);
            sums.pass::<CLASS>(powers, i - at);
            sums.at_step::<CLASS>(powers, by, i - from);
            sums.step::<CLASS>(by);
            (at, open) = (i + 1, rest);
        }
        if at < end {
            sums.stretch::<CLASS>(tables, end - at, at - from);
            sums.pass::<CLASS>(powers, end - at);
            at = end;
        }
        sums.edge::<CLASS>(powers, at - from, -1.0);
    }
    let signals = 1 + view.loads().min(MOST_LOADS);
    let mut with = [[[0.0; 2]; PARTS]; 1 + MOST_LOADS];
    for (column, into) in with.iter_mut().enumerate().take(signals) {
        let of = With::new(view, tables, column);
        for step in &steps[first..last] {
            of.add::<CLASS>(step.point as usize + delay, [step.level, step.direction], into);
        }
    }
    let cross = if CLASS == SECOND { 1.0 / (1.0 - tables[0].a * tables[1].a) } else { 0.0 };
    sums.gathered::<CLASS>(view.rho(), tables, cross, with).take_out::<CLASS>(class, view, tables, cross)
}

/// What the sums come to.
struct Gathered {
    products: [[f64; 6]; 3],
    /// Of PV, then of each load, with the parts.
    with: [[[f64; 2]; PARTS]; 1 + MOST_LOADS],
    /// Of the constant and the memories with the parts.
    with_beside: [[[f64; 2]; PARTS]; 3],
}

impl Gathered {
    /// Takes the products of two parts: the halves' own, and both orders of the mixed ones.
    fn put(&mut self, pair: (usize, usize), of: &Square) {
        let slot = PAIRS.iter().position(|p| *p == pair).unwrap_or(0);
        let mixed = if pair.0 == pair.1 { of[0][1] } else { of[0][1] + of[1][0] };
        for (half, value) in [of[0][0], mixed, of[1][1]].into_iter().enumerate() {
            self.products[half][slot] = value;
        }
    }
}

impl Sums {
    /// Products of the parts, as the filter of the error leaves them, with each other and with what is fitted beside them.
    fn gathered<const CLASS: usize>(
        &self,
        rho: f64,
        tables: [&Table; 2],
        cross: f64,
        with: [[[f64; 2]; PARTS]; 1 + MOST_LOADS],
    ) -> Gathered {
        let mut out = Gathered { products: [[0.0; 6]; 3], with, with_beside: [[[0.0; 2]; PARTS]; 3] };
        let (level, steps) = (&self.level, self.steps);
        let share = level.gamma;
        let held = level.with_steps;
        out.put(
            (0, 0),
            &mixed([(share * share, self.level_level), (share, held), (share, turned(&held)), (1.0, steps)]),
        );
        out.with_beside[0][0] = core::array::from_fn(|h| share * self.level_one[h] + self.total[h]);
        for k in 0..decays(CLASS) {
            let part = if CLASS == LAG_INTEGRATING { 2 } else { 1 + k };
            let level_decay = self.level_with_decay(k, tables);
            let pole = &self.decay[k];
            let (gamma, own) = (pole.gamma, pole.with_steps);
            let of_level = [(share * gamma, level_decay), (share, held), (gamma, turned(&own)), (1.0, steps)];
            out.put((0, part), &mixed(of_level));
            let [one, two] = tables[k].inverse;
            let both = mixed([
                (two * pole.a, own),
                (two * pole.a, turned(&own)),
                (two, steps),
                (two, self.edges.decay_decay[k]),
            ]);
            out.put((part, part), &mixed([(gamma * gamma, both), (gamma, own), (gamma, turned(&own)), (1.0, steps)]));
            out.with_beside[0][part] =
                core::array::from_fn(|h| gamma * (self.total[h] + self.edges.decay[k][h]) * one + self.total[h]);
            let memory = if CLASS == LAG_INTEGRATING { 2 } else { 1 + k };
            for (j, other) in self.decay.iter().enumerate().take(decays(CLASS)) {
                let inverse = if j == k { two } else { cross };
                let place = if CLASS == LAG_INTEGRATING { 2 } else { 1 + j };
                out.with_beside[memory][place] = core::array::from_fn(|h| {
                    let sum = (pole.a * pole.memory[h] + self.edges.memory_decay[k][j][h]) * inverse;
                    other.gamma * sum + pole.memory[h]
                });
            }
            out.with_beside[memory][0] =
                core::array::from_fn(|h| share * self.memory_with_level(k, tables)[h] + pole.memory[h]);
        }
        if CLASS == SECOND {
            let [one, two] = &self.decay;
            let (first, second) = (one.with_steps, turned(&two.with_steps));
            let both =
                mixed([(cross * one.a, first), (cross * two.a, second), (cross, steps), (cross, self.edges.cross)]);
            let of = [(one.gamma * two.gamma, both), (one.gamma, first), (two.gamma, second), (1.0, steps)];
            out.put((1, 2), &mixed(of));
        }
        if has_ramp(CLASS) {
            self.ramps::<CLASS>(rho, tables, &mut out);
        }
        out
    }

    /// Sum of the level's state times a decay's.
    fn level_with_decay(&self, k: usize, tables: [&Table; 2]) -> Square {
        let (one, own) = (tables[k].inverse[0], turned(&self.decay[k].with_steps));
        let of = [
            (one, self.level.with_steps),
            (one * self.decay[k].a, own),
            (one, self.steps),
            (one, self.edges.level_decay[k]),
        ];
        mixed(of)
    }

    /// Sum of a memory times the level's state.
    fn memory_with_level(&self, k: usize, tables: [&Table; 2]) -> Halves {
        let pole = &self.decay[k];
        core::array::from_fn(|h| (pole.a * pole.memory[h] + self.edges.memory_level[k][h]) * tables[k].inverse[0])
    }

    /// The products that a ramp is in, and those with time.
    fn ramps<const CLASS: usize>(&self, rho: f64, tables: [&Table; 2], out: &mut Gathered) {
        let (share, scale) = (self.level.gamma, 1.0 / INTEGRATOR_SCALE);
        let held = self.level.with_steps;
        let level_ramp = turned(&self.ramp_level);
        let of_level = [
            (scale * share * share, level_ramp),
            (scale * share * rho, self.level_level),
            (scale * share, turned(&self.ramp_with_steps)),
            (scale * rho, turned(&held)),
        ];
        out.put((0, 1), &mixed(of_level));
        let square = scale * scale;
        let own = [
            (square * share * share, self.ramp_ramp),
            (square * share * rho, self.ramp_level),
            (square * share * rho, level_ramp),
            (square * rho * rho, self.level_level),
        ];
        out.put((1, 1), &mixed(own));
        for h in 0..2 {
            out.with_beside[0][1][h] = scale * (share * self.ramp_one[h] + rho * self.level_one[h]);
            out.with_beside[1][1][h] = scale * (share * self.ramp_time[h] + rho * self.level_time[h]);
            out.with_beside[1][0][h] = share * self.level_time[h] + self.steps_time[h];
        }
        if CLASS == LAG_INTEGRATING {
            let pole = &self.decay[0];
            let of_decay = [
                (scale * share * pole.gamma, self.ramp_decay),
                (scale * share, self.ramp_with_steps),
                (scale * rho * pole.gamma, self.level_with_decay(0, tables)),
                (scale * rho, held),
            ];
            out.put((1, 2), &mixed(of_decay));
            let with_level = self.memory_with_level(0, tables);
            for h in 0..2 {
                out.with_beside[1][2][h] = pole.gamma * self.decay_time[h] + self.steps_time[h];
                out.with_beside[2][1][h] = scale * (share * self.ramp_memory[h] + rho * with_level[h]);
            }
        }
    }
}

/// Where the products of one signal with a step's answers stand.
struct With<'t> {
    /// Level and first decay.
    first: &'t [[f64; 2]],
    /// Second decay, after the level again.
    second: &'t [[f64; 2]],
    /// Level and ramp, by the view.
    plain: [&'t [f64]; 2],
}

impl<'t> With<'t> {
    fn new(view: &'t View, tables: [&'t Table; 2], column: usize) -> Self {
        let [first, second] = tables.map(|t| &t.steps[column][..]);
        Self { first, second, plain: view.with_step(column) }
    }

    /// Adds the products of one step's answers.
    #[inline(always)]
    fn add<const CLASS: usize>(&self, i: usize, by: [f64; 2], into: &mut [[f64; 2]; PARTS]) {
        let level = if CLASS == INTEGRATING { [self.plain[0][i], 0.0] } else { self.first[i] };
        let second = match CLASS {
            FIRST | SECOND => level[1],
            _ => self.plain[1][i] / INTEGRATOR_SCALE,
        };
        let third = match CLASS {
            SECOND => self.second[i][1],
            LAG_INTEGRATING => level[1],
            _ => 0.0,
        };
        for h in 0..2 {
            into[0][h] += by[h] * level[0];
            into[1][h] += by[h] * second;
            if CLASS == SECOND || CLASS == LAG_INTEGRATING {
                into[2][h] += by[h] * third;
            }
        }
    }
}

impl Gathered {
    /// Takes the constant, the process' own memory and the loads out of everything.
    fn take_out<const CLASS: usize>(self, class: Class, view: &View, tables: [&Table; 2], cross: f64) -> Reduced {
        let Self { mut products, with: [with_pv, with_loads @ ..], with_beside } = self;
        let whole = [products[0][0], products[2][0]];
        let own = class.memory_len();
        let loads = view.loads().min(MOST_LOADS);
        let count = own + loads;
        let (mut gram, mut with) = ([[0.0; BESIDE]; BESIDE], [0.0; BESIDE]);
        let mut rows = [[[0.0; 2]; PARTS]; BESIDE];
        rows[..own].copy_from_slice(&with_beside[..own]);
        rows[own..count].copy_from_slice(&with_loads[..loads]);
        let moments = view.moments();
        gram[0][0] = moments[0];
        let memory = |table: &Table, column: usize| table.with_memory[column];
        let signal = |row: usize, column: usize| match (row, CLASS) {
            (0, _) => view.with_one(column),
            (1, INTEGRATING | LAG_INTEGRATING) => view.with_time(column),
            (2, SECOND) => memory(tables[1], column),
            _ => memory(tables[0], column),
        };
        match CLASS {
            INTEGRATING | LAG_INTEGRATING => {
                (gram[0][1], gram[1][1]) = (moments[1], moments[2]);
                if CLASS == LAG_INTEGRATING {
                    [gram[2][2], gram[0][2], gram[1][2]] = tables[0].memory;
                }
            }
            _ => {
                [gram[1][1], gram[0][1], _] = tables[0].memory;
                if CLASS == SECOND {
                    [gram[2][2], gram[0][2], _] = tables[1].memory;
                    let power = |k: usize| tables[0].powers[k] * tables[1].powers[k];
                    let from = view.from();
                    gram[1][2] =
                        view.counted().iter().map(|[a, b]| power(a - from) - power(b - from)).sum::<f64>() * cross;
                }
            }
        }
        for row in 0..own {
            with[row] = signal(row, 0);
            for load in 0..loads {
                gram[row][own + load] = signal(row, 1 + load);
            }
        }
        for load in 0..loads {
            with[own + load] = view.product(0, 1 + load);
            for other in load..loads {
                gram[own + load][own + other] = view.product(1 + load, 1 + other);
            }
        }
        let used = parts(CLASS);
        let mut halves: [[f64; PARTS]; 2] = core::array::from_fn(|h| core::array::from_fn(|b| with_pv[b][h]));
        let mut rest = view.product(0, 0);
        let squares: [f64; BESIDE] = core::array::from_fn(|r| gram[r][r]);
        for r in 0..count {
            if gram[r][r] <= DEPENDENT * squares[r] {
                continue;
            }
            let pivot = 1.0 / gram[r][r];
            for x in r + 1..count {
                let z = gram[r][x] * pivot;
                for t in x..count {
                    gram[x][t] -= z * gram[r][t];
                }
                with[x] -= z * with[r];
                for b in 0..used {
                    for h in 0..2 {
                        rows[x][b][h] -= z * rows[r][b][h];
                    }
                }
            }
            let row = rows[r];
            for (slot, (a, b)) in PAIRS.into_iter().enumerate().take(pairs(CLASS)) {
                products[0][slot] -= row[a][0] * row[b][0] * pivot;
                products[2][slot] -= row[a][1] * row[b][1] * pivot;
                let both = if a == b { row[a][0] * row[a][1] } else { row[a][0] * row[b][1] + row[b][0] * row[a][1] };
                products[1][slot] -= both * pivot;
            }
            for b in 0..used {
                for h in 0..2 {
                    halves[h][b] -= row[b][h] * with[r] * pivot;
                }
            }
            rest -= with[r] * with[r] * pivot;
        }
        Reduced { class, tau: [tables[0].tau, tables[1].tau], products, with_pv: halves, whole, rest }
    }
}
