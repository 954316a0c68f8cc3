//! The products that a fit needs, and their remainder after projecting out constant, memories and loads.

// Two halves and three parts index several arrays at once; the compiler unrolls these loops.
#![allow(clippy::needless_range_loop)]

use super::reduced::{DEPENDENT, PAIRS, PARTS, Reduced};
use super::square::{Halves, Square};
use super::tables::{Table, View};
use crate::core::ident::class::{Class, INTEGRATOR_SCALE};

/// Most columns in addition to the response: constant, two memories, loads.
const BESIDE: usize = 3 + MOST_LOADS;
/// Most loads of a view.
pub(super) const MOST_LOADS: usize = 5;

pub(super) const FIRST: usize = 0;
pub(super) const SECOND: usize = 1;
pub(super) const INTEGRATING: usize = 2;
pub(super) const LAG_INTEGRATING: usize = 3;

pub(super) const fn parts(class: usize) -> usize {
    if class == FIRST || class == INTEGRATING { 2 } else { 3 }
}

pub(super) const fn pairs(class: usize) -> usize {
    parts(class) * (parts(class) + 1) / 2
}

pub(super) const fn decays(class: usize) -> usize {
    match class {
        INTEGRATING => 0,
        SECOND => 2,
        _ => 1,
    }
}

pub(super) const fn has_ramp(class: usize) -> bool {
    class == INTEGRATING || class == LAG_INTEGRATING
}

/// Collected products.
pub(super) struct Gathered {
    pub(super) products: [[f64; 6]; 3],
    /// Products of PV, then of each load, with the parts.
    pub(super) with: [[[f64; 2]; PARTS]; 1 + MOST_LOADS],
    /// Products of the constant and the memories with the parts.
    pub(super) with_beside: [[[f64; 2]; PARTS]; 3],
}

impl Gathered {
    /// Stores the products of two parts: those of each half with itself, and the sum of both mixed orders.
    pub(super) fn put(&mut self, pair: (usize, usize), of: &Square) {
        let slot = PAIRS.iter().position(|p| *p == pair).unwrap_or(0);
        let mixed = if pair.0 == pair.1 { of[0][1] } else { of[0][1] + of[1][0] };
        for (half, value) in [of[0][0], mixed, of[1][1]].into_iter().enumerate() {
            self.products[half][slot] = value;
        }
    }
}

/// Products of one signal with a step's responses.
pub(super) struct With<'t> {
    /// Level and first decay.
    first: &'t [[f64; 2]],
    /// Second decay, after the level again.
    second: &'t [[f64; 2]],
    /// Level and ramp, from the view.
    plain: [&'t [f64]; 2],
}

impl<'t> With<'t> {
    pub(super) fn new(view: &'t View, tables: [&'t Table; 2], column: usize) -> Self {
        let [first, second] = tables.map(|t| &t.steps[column][..]);
        Self { first, second, plain: view.with_step(column) }
    }

    /// Adds the products of one step's responses.
    #[inline(always)]
    pub(super) fn add<const CLASS: usize>(&self, i: usize, by: [f64; 2], into: &mut [[f64; 2]; PARTS]) {
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

/// The columns in addition to the response (constant, memories, loads): their products with each other, with PV and with the
/// parts.
struct Beside {
    count: usize,
    gram: [[f64; BESIDE]; BESIDE],
    with_pv: [f64; BESIDE],
    with_parts: [[[f64; 2]; PARTS]; BESIDE],
}

impl Beside {
    #[inline(always)]
    fn of<const CLASS: usize>(
        class: Class,
        view: &View,
        tables: [&Table; 2],
        cross: f64,
        with_own: &[[[f64; 2]; PARTS]; 3],
        with_loads: &[[[f64; 2]; PARTS]],
    ) -> Self {
        let own = class.memory_len();
        let loads = view.loads().min(MOST_LOADS);
        let count = own + loads;
        let mut with_parts = [[[0.0; 2]; PARTS]; BESIDE];
        with_parts[..own].copy_from_slice(&with_own[..own]);
        with_parts[own..count].copy_from_slice(&with_loads[..loads]);
        let (mut gram, mut with_pv) = ([[0.0; BESIDE]; BESIDE], [0.0; BESIDE]);
        own_products::<CLASS>(&mut gram, view, tables, cross);
        let signal = |row: usize, column: usize| match (row, CLASS) {
            (0, _) => view.with_one(column),
            (1, INTEGRATING | LAG_INTEGRATING) => view.with_time(column),
            (2, SECOND) => tables[1].with_memory[column],
            _ => tables[0].with_memory[column],
        };
        for row in 0..own {
            with_pv[row] = signal(row, 0);
            for load in 0..loads {
                gram[row][own + load] = signal(row, 1 + load);
            }
        }
        for load in 0..loads {
            with_pv[own + load] = view.product(0, 1 + load);
            for other in load..loads {
                gram[own + load][own + other] = view.product(1 + load, 1 + other);
            }
        }
        Self { count, gram, with_pv, with_parts }
    }
}

/// Products of constant and memories with each other; `cross` is the sum of the product of both decays from one point on.
#[inline(always)]
fn own_products<const CLASS: usize>(gram: &mut [[f64; BESIDE]; BESIDE], view: &View, tables: [&Table; 2], cross: f64) {
    let moments = view.moments();
    gram[0][0] = moments[0];
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
                gram[1][2] = view.counted().iter().map(|[a, b]| power(a - from) - power(b - from)).sum::<f64>() * cross;
            }
        }
    }
}

impl Gathered {
    /// Projects constant, the process's memory and the loads out of all products.
    pub(super) fn take_out<const CLASS: usize>(
        self,
        class: Class,
        view: &View,
        tables: [&Table; 2],
        cross: f64,
        moved: Halves,
    ) -> Reduced {
        let Self { mut products, with: [with_pv, with_loads @ ..], with_beside } = self;
        let whole = [products[0][0].max(moved[0]), products[2][0].max(moved[1])];
        let Beside { count, mut gram, with_pv: mut with, with_parts: mut rows } =
            Beside::of::<CLASS>(class, view, tables, cross, &with_beside, &with_loads);
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
