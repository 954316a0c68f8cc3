//! The products that a fit needs, gathered step by step.

// Halves and parts are two and three places of several arrays at once, and the loops over them are unrolled by the compiler.
#![allow(clippy::needless_range_loop)]

use super::reduced::{DEPENDENT, PAIRS, PARTS, Reduced};
use super::tables::{Table, View};
use crate::ident::class::{Class, INTEGRATOR_SCALE};
use crate::sim::steps::Step;

/// Columns beside the answer, at most: constant, two memories, loads.
const BESIDE: usize = 3 + MOST_LOADS;
/// Most loads of a view.
const MOST_LOADS: usize = 5;

const FIRST: usize = 0;
const SECOND: usize = 1;
const INTEGRATING: usize = 2;
const LAG_INTEGRATING: usize = 3;

/// What a part of a step response is like from the sample after a step on.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Part {
    Level,
    Decay1,
    Decay2,
    Ramp,
}

const fn part(class: usize, index: usize) -> Part {
    match (class, index) {
        (_, 0) => Part::Level,
        (FIRST, _) | (SECOND, 1) => Part::Decay1,
        (SECOND, _) => Part::Decay2,
        (_, 1) => Part::Ramp,
        _ => Part::Decay1,
    }
}

const fn parts(class: usize) -> usize {
    if class == FIRST || class == INTEGRATING { 2 } else { 3 }
}

const fn pairs(class: usize) -> usize {
    parts(class) * (parts(class) + 1) / 2
}

/// Sums over the samples of one stretch between two steps: of 1, q, q^2, decays and their products, q counted from its
/// start.
struct Stretch {
    count: f64,
    q: f64,
    qq: f64,
    decay: [f64; 2],
    squares: [f64; 2],
    cross: f64,
    q_decay: f64,
}

impl Stretch {
    #[inline(always)]
    fn of<const CLASS: usize>(tables: [&Table; 2], cross: f64, length: usize) -> Self {
        let l = length as f64;
        let mut out = Self { count: l, q: 0.0, qq: 0.0, decay: [0.0; 2], squares: [0.0; 2], cross: 0.0, q_decay: 0.0 };
        if CLASS == INTEGRATING || CLASS == LAG_INTEGRATING {
            out.q = 0.5 * l * (l - 1.0);
            out.qq = (l - 1.0) * l * (2.0 * l - 1.0) / 6.0;
        }
        if CLASS != INTEGRATING {
            let ([one, two], p) = (tables[0].inverse, tables[0].powers[length]);
            out.decay[0] = (1.0 - p) * one;
            out.squares[0] = (1.0 - p * p) * two;
            if CLASS == LAG_INTEGRATING {
                let a = tables[0].a;
                out.q_decay = (a - l * p + (l - 1.0) * p * a) * one * one;
            }
            if CLASS == SECOND {
                let ([one, two], p2) = (tables[1].inverse, tables[1].powers[length]);
                out.decay[1] = (1.0 - p2) * one;
                out.squares[1] = (1.0 - p2 * p2) * two;
                out.cross = (1.0 - p * p2) * cross;
            }
        }
        out
    }
}

/// Sizes of the parts at the start of a stretch, for the level half of the valve signal and the direction half.
#[derive(Clone, Copy, Default)]
struct Sizes {
    level: [f64; 2],
    decay: [[f64; 2]; 2],
    ramp: [f64; 2],
    slope: [f64; 2],
}

impl Sizes {
    /// Sum of the product of two parts over a stretch.
    #[inline(always)]
    fn product(&self, s: &Stretch, (x, h): (Part, usize), (y, z): (Part, usize)) -> f64 {
        use Part::{Decay1, Decay2, Level, Ramp};
        match (x, y) {
            (Level, Level) => self.level[h] * self.level[z] * s.count,
            (Level, Decay1) => self.level[h] * self.decay[0][z] * s.decay[0],
            (Level, Decay2) => self.level[h] * self.decay[1][z] * s.decay[1],
            (Decay1, Decay1) => self.decay[0][h] * self.decay[0][z] * s.squares[0],
            (Decay2, Decay2) => self.decay[1][h] * self.decay[1][z] * s.squares[1],
            (Decay1, Decay2) => self.decay[0][h] * self.decay[1][z] * s.cross,
            (Level, Ramp) => self.level[h] * (self.ramp[z] * s.count + self.slope[z] * s.q),
            (Ramp, Ramp) => {
                self.ramp[h] * self.ramp[z] * s.count
                    + (self.ramp[h] * self.slope[z] + self.slope[h] * self.ramp[z]) * s.q
                    + self.slope[h] * self.slope[z] * s.qq
            }
            (Ramp, Decay1) => self.decay[0][z] * (self.ramp[h] * s.decay[0] + self.slope[h] * s.q_decay),
            _ => self.product(s, (y, z), (x, h)),
        }
    }

    /// Sums of a part times 1, times the points since `from` (the stretch starting `late` of them after it), and times the
    /// decays.
    #[inline(always)]
    fn moments(&self, s: &Stretch, x: Part, h: usize, late: f64) -> [f64; 4] {
        match x {
            Part::Level => {
                let c = self.level[h];
                [c * s.count, c * (late * s.count + s.q), c * s.decay[0], c * s.decay[1]]
            }
            Part::Decay1 => {
                let c = self.decay[0][h];
                [c * s.decay[0], c * (late * s.decay[0] + s.q_decay), c * s.squares[0], c * s.cross]
            }
            Part::Decay2 => {
                let c = self.decay[1][h];
                [c * s.decay[1], 0.0, c * s.cross, c * s.squares[1]]
            }
            Part::Ramp => {
                let (r, b) = (self.ramp[h], self.slope[h]);
                let sum = r * s.count + b * s.q;
                [sum, late * sum + r * s.q + b * s.qq, r * s.decay[0] + b * s.q_decay, 0.0]
            }
        }
    }
}

/// Walks the steps of a valve signal, their answer `delay` whole points late, through a process with one or two time
/// constants (the same table twice where there is one).
#[must_use]
pub fn reduce(class: Class, view: &View, tables: [&Table; 2], steps: &[Step], delay: usize) -> Reduced {
    let whole = view.loads() == 0 && view.counted() == [[view.from(), view.points()]];
    match (class, whole) {
        (Class::First, true) => walk::<FIRST, true>(class, view, tables, steps, delay),
        (Class::Second, true) => walk::<SECOND, true>(class, view, tables, steps, delay),
        (Class::Integrating, true) => walk::<INTEGRATING, true>(class, view, tables, steps, delay),
        (Class::LagIntegrating, true) => walk::<LAG_INTEGRATING, true>(class, view, tables, steps, delay),
        (Class::First, false) => walk::<FIRST, false>(class, view, tables, steps, delay),
        (Class::Second, false) => walk::<SECOND, false>(class, view, tables, steps, delay),
        (Class::Integrating, false) => walk::<INTEGRATING, false>(class, view, tables, steps, delay),
        (Class::LagIntegrating, false) => walk::<LAG_INTEGRATING, false>(class, view, tables, steps, delay),
    }
}

/// What is gathered on the way.
struct Gathered {
    products: [[f64; 6]; 3],
    with_pv: [[f64; 2]; PARTS],
    with_loads: [[[f64; 2]; PARTS]; MOST_LOADS],
    /// Of the constant and the memories with the parts.
    with_beside: [[[f64; 2]; PARTS]; 3],
}

impl Gathered {
    /// Adds the products of one sample's values.
    #[inline(always)]
    fn sample<const CLASS: usize>(&mut self, x: &[[f64; 2]; PARTS], memories: [f64; 2]) {
        for slot in 0..pairs(CLASS) {
            let (a, b) = PAIRS[slot];
            self.products[0][slot] += x[a][0] * x[b][0];
            self.products[2][slot] += x[a][1] * x[b][1];
            self.products[1][slot] += if a == b { x[a][0] * x[a][1] } else { x[a][0] * x[b][1] + x[b][0] * x[a][1] };
        }
        for b in 0..parts(CLASS) {
            for h in 0..2 {
                self.with_beside[0][b][h] += x[b][h];
                self.with_beside[1][b][h] += memories[0] * x[b][h];
                if CLASS == SECOND || CLASS == LAG_INTEGRATING {
                    self.with_beside[2][b][h] += memories[1] * x[b][h];
                }
            }
        }
    }

    /// Adds the products of a stretch of samples.
    #[inline(always)]
    fn stretch<const CLASS: usize>(&mut self, sizes: &Sizes, s: &Stretch, late: f64, decays: [f64; 2]) {
        for slot in 0..pairs(CLASS) {
            let (a, b) = PAIRS[slot];
            let (x, y) = (part(CLASS, a), part(CLASS, b));
            self.products[0][slot] += sizes.product(s, (x, 0), (y, 0));
            self.products[2][slot] += sizes.product(s, (x, 1), (y, 1));
            self.products[1][slot] += if a == b {
                sizes.product(s, (x, 0), (y, 1))
            } else {
                sizes.product(s, (x, 0), (y, 1)) + sizes.product(s, (x, 1), (y, 0))
            };
        }
        for b in 0..parts(CLASS) {
            for h in 0..2 {
                let [one, time, first, second] = sizes.moments(s, part(CLASS, b), h, late);
                self.with_beside[0][b][h] += one;
                match CLASS {
                    INTEGRATING => self.with_beside[1][b][h] += time,
                    LAG_INTEGRATING => {
                        self.with_beside[1][b][h] += time;
                        self.with_beside[2][b][h] += decays[0] * first;
                    }
                    SECOND => {
                        self.with_beside[1][b][h] += decays[0] * first;
                        self.with_beside[2][b][h] += decays[1] * second;
                    }
                    _ => self.with_beside[1][b][h] += decays[0] * first,
                }
            }
        }
    }
}

/// Level, decays and ramp of the two halves' answers.
#[derive(Default)]
struct State {
    level: [f64; 2],
    decay: [[f64; 2]; 2],
    ramp: [f64; 2],
}

/// The walk; `WHOLE`: every point from the first on counts, and nothing is fitted beside the answer.
fn walk<const CLASS: usize, const WHOLE: bool>(
    class: Class,
    view: &View,
    tables: [&Table; 2],
    steps: &[Step],
    delay: usize,
) -> Reduced {
    let (from, n, rho) = (view.from(), view.points(), view.rho());
    let level_share = 1.0 - rho;
    let a = [tables[0].a, tables[1].a];
    let (own, later) = ([rho / a[0], rho / a[1]], [a[0] - rho, a[1] - rho]);
    let cross = if CLASS == SECOND { 1.0 / (1.0 - a[0] * a[1]) } else { 0.0 };
    let scale = 1.0 / INTEGRATOR_SCALE;
    let loads = if WHOLE { 0 } else { view.loads().min(MOST_LOADS) };
    let powers = [&tables[0].powers[..=n], &tables[1].powers[..=n]];
    let mut sums = Gathered {
        products: [[0.0; 6]; 3],
        with_pv: [[0.0; 2]; PARTS],
        with_loads: [[[0.0; 2]; PARTS]; MOST_LOADS],
        with_beside: [[[0.0; 2]; PARTS]; 3],
    };
    let with_pv = With::new(view, tables, 0);
    let mut state = State::default();
    // A step before the first point that counts leaves a level and a memory only, and those are fitted anyway.
    let first = steps.partition_point(|s| (s.point as usize + delay) < from);
    let last = steps.partition_point(|s| (s.point as usize + delay) < n);
    let counted = view.counted();
    let mut at = 0;
    for (m, step) in steps[..last].iter().enumerate().skip(first) {
        let i = step.point as usize + delay;
        let next = steps.get(m + 1).map_or(n, |s| (s.point as usize + delay).min(n));
        let by = [step.level, step.direction];
        with_pv.add::<CLASS>(i, by, &mut sums.with_pv);
        for load in 0..loads {
            With::new(view, tables, 1 + load).add::<CLASS>(i, by, &mut sums.with_loads[load]);
        }
        let x = state.step::<CLASS>(by, [level_share, rho, scale], own);
        let beside = |late: usize| match CLASS {
            INTEGRATING => [late as f64, 0.0],
            LAG_INTEGRATING => [late as f64, powers[0][late]],
            SECOND => [powers[0][late], powers[1][late]],
            _ => [powers[0][late], 0.0],
        };
        let decays = |late: usize| match CLASS {
            INTEGRATING => [0.0; 2],
            SECOND => [powers[0][late], powers[1][late]],
            _ => [powers[0][late], 0.0],
        };
        if WHOLE {
            sums.sample::<CLASS>(&x, beside(i - from));
            if next > i + 1 {
                let sizes = state.sizes::<CLASS>([level_share, scale], later, [1.0; 2], 0.0);
                let stretch = Stretch::of::<CLASS>(tables, cross, next - i - 1);
                let late = i + 1 - from;
                sums.stretch::<CLASS>(&sizes, &stretch, late as f64, decays(late));
            }
        } else {
            while at < counted.len() && counted[at][1] <= i {
                at += 1;
            }
            if at < counted.len() && counted[at][0] <= i {
                sums.sample::<CLASS>(&x, beside(i - from));
            }
            for [start, end] in counted[at..].iter().take_while(|c| c[0] < next) {
                let (start, end) = ((*start).max(i + 1), (*end).min(next));
                if start < end {
                    let (gone, late) = (start - i - 1, start - from);
                    let left = [powers[0][gone], powers[1][gone]];
                    let sizes = state.sizes::<CLASS>([level_share, scale], later, left, gone as f64);
                    let stretch = Stretch::of::<CLASS>(tables, cross, end - start);
                    sums.stretch::<CLASS>(&sizes, &stretch, late as f64, decays(late));
                }
            }
        }
        let length = next - i;
        for h in 0..2 {
            if CLASS != INTEGRATING {
                state.decay[0][h] *= powers[0][length];
            }
            if CLASS == SECOND {
                state.decay[1][h] *= powers[1][length];
            }
            if CLASS == INTEGRATING || CLASS == LAG_INTEGRATING {
                state.ramp[h] += state.level[h] * length as f64;
            }
        }
    }
    sums.take_out::<CLASS>(class, view, tables, cross)
}

impl State {
    /// Takes a step; the parts' filtered values at its sample.
    #[inline(always)]
    fn step<const CLASS: usize>(
        &mut self,
        by: [f64; 2],
        [level_share, rho, scale]: [f64; 3],
        own: [f64; 2],
    ) -> [[f64; 2]; PARTS] {
        let mut x = [[0.0; 2]; PARTS];
        for h in 0..2 {
            x[0][h] = level_share * self.level[h] + by[h];
            if CLASS == INTEGRATING || CLASS == LAG_INTEGRATING {
                x[1][h] = scale * (level_share * self.ramp[h] + rho * self.level[h]);
            } else {
                x[1][h] = self.decay[0][h] + by[h] - own[0] * self.decay[0][h];
            }
            if CLASS == SECOND {
                x[2][h] = self.decay[1][h] + by[h] - own[1] * self.decay[1][h];
            }
            if CLASS == LAG_INTEGRATING {
                x[2][h] = self.decay[0][h] + by[h] - own[0] * self.decay[0][h];
            }
            self.level[h] += by[h];
            self.decay[0][h] += by[h];
            self.decay[1][h] += by[h];
        }
        x
    }

    /// The parts' filtered sizes `gone` samples after the one behind a step, `left` of the decays then being left.
    #[inline(always)]
    fn sizes<const CLASS: usize>(
        &self,
        [level_share, scale]: [f64; 2],
        later: [f64; 2],
        left: [f64; 2],
        gone: f64,
    ) -> Sizes {
        let mut sizes = Sizes::default();
        for h in 0..2 {
            sizes.level[h] = level_share * self.level[h];
            if CLASS != INTEGRATING {
                sizes.decay[0][h] = later[0] * self.decay[0][h] * left[0];
            }
            if CLASS == SECOND {
                sizes.decay[1][h] = later[1] * self.decay[1][h] * left[1];
            }
            if CLASS == INTEGRATING || CLASS == LAG_INTEGRATING {
                sizes.slope[h] = scale * level_share * self.level[h];
                sizes.ramp[h] = scale * (level_share * self.ramp[h] + self.level[h]) + sizes.slope[h] * gone;
            }
        }
        sizes
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
        let Self { mut products, with_pv, with_loads, with_beside } = self;
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
