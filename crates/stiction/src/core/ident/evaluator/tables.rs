//! PV with the filter of the error, and the tables for products of step responses with PV.

use std::sync::{Arc, OnceLock};

/// Distance of two neighbouring time constants on the lattice, in logarithm.
pub(crate) const LATTICE_STEP: f64 = 0.04;
/// Index range of the lattice: time constants from a twelfth of a point to 10 million points.
const PLACES: [i32; 2] = [-62, 403];
/// Power of a decay below which it counts as zero: smaller values become denormal numbers, which are slow.
const NOTHING: f64 = 1e-150;

/// Time constant for a lattice index, points.
#[must_use]
pub(crate) fn lattice_tau(index: i32) -> f64 {
    libm::exp(LATTICE_STEP * f64::from(index))
}

/// Lattice index nearest to a time constant (points, > 0).
#[must_use]
pub(crate) fn lattice_index(tau: f64) -> i32 {
    (libm::log(tau) / LATTICE_STEP).round() as i32
}

/// One signal on the counted points, with the products that do not depend on a time constant.
#[derive(Debug, Clone)]
struct Column {
    /// Filtered; 0 at points that do not count.
    values: Vec<f64>,
    /// Products with the filtered level, and ramp of slope 1, that follow a unit step at each point.
    with_level: Vec<f64>,
    with_ramp: Vec<f64>,
    /// Products with 1 and with the distance from the first counted point.
    with_one: f64,
    with_time: f64,
}

/// PV filtered by `1 - rho q^-1`, on the counted points, and other signals that are fitted in addition to the process's
/// response (loads).
#[derive(Debug, Clone)]
pub struct View {
    rho: f64,
    from: usize,
    points: usize,
    counted: Vec<[usize; 2]>,
    columns: Vec<Arc<Column>>,
    /// Products of the columns with each other.
    products: Vec<Vec<f64>>,
    /// Number of counted points, sum of their distances from the first, and sum of the squares.
    moments: [f64; 3],
    lattice: Vec<OnceLock<Arc<Table>>>,
}

/// Table of a view for one time constant.
#[derive(Debug, Clone)]
pub struct Table {
    /// Time constant, points.
    pub tau: f64,
    /// Decay factor per point.
    pub a: f64,
    /// Powers of `a`.
    pub powers: Arc<Vec<f64>>,
    /// `1 / (1 - a)` and `1 / (1 - a^2)`.
    pub inverse: [f64; 2],
    /// For each column, products with the level and the decay that follow a step at each point.
    pub steps: Vec<Arc<Vec<[f64; 2]>>>,
    /// For each column, products with the decay that starts at the first counted point.
    pub with_memory: Vec<f64>,
    /// Products of that decay with itself, with 1 and with the points since its start.
    pub memory: [f64; 3],
}

impl View {
    /// View of `pv` that counts all points from `from` (at least 1) on.
    #[must_use]
    pub fn new(pv: &[f64], rho: f64, from: usize) -> Self {
        Self::of_stretches(pv, &[], rho, from, &[[from.max(1), pv.len()]])
    }

    /// View of `pv` and `loads` (of equal length) on the stretches `counted`, in order and none before `from`.
    #[must_use]
    pub(crate) fn of_stretches(pv: &[f64], loads: &[&[f64]], rho: f64, from: usize, counted: &[[usize; 2]]) -> Self {
        let (from, points) = (from.max(1), pv.len());
        let within = |[a, b]: &[usize; 2]| [(*a).max(from), (*b).min(points)];
        let counted: Vec<[usize; 2]> = counted.iter().map(within).filter(|[a, b]| a < b).collect();
        let columns: Vec<Arc<Column>> =
            [pv].iter().chain(loads).map(|x| Arc::new(Column::new(x, rho, from, &counted))).collect();
        let mut moments = [0.0; 3];
        for k in counted.iter().flat_map(|[a, b]| *a..*b) {
            let late = (k - from) as f64;
            moments[0] += 1.0;
            moments[1] += late;
            moments[2] += late * late;
        }
        Self { rho, from, points, counted, products: products(&columns), columns, moments, lattice: empty_lattice() }
    }

    /// A view of the same PV with other loads, each as long as PV. Shares PV's tables, which are costly to build.
    #[must_use]
    pub(crate) fn beside(&self, loads: &[&[f64]]) -> Self {
        let column = |x: &&[f64]| Arc::new(Column::new(x, self.rho, self.from, &self.counted));
        let columns: Vec<Arc<Column>> = self.columns.iter().take(1).cloned().chain(loads.iter().map(column)).collect();
        Self { counted: self.counted.clone(), products: products(&columns), columns, lattice: empty_lattice(), ..*self }
    }

    /// Filter of the error, `1 - rho q^-1`.
    #[must_use]
    pub(crate) const fn rho(&self) -> f64 {
        self.rho
    }

    /// First point that can count.
    #[must_use]
    pub(crate) const fn from(&self) -> usize {
        self.from
    }

    /// Number of points, including those that do not count.
    #[must_use]
    pub(crate) const fn points(&self) -> usize {
        self.points
    }

    /// Stretches of points that count.
    #[must_use]
    pub(crate) fn counted(&self) -> &[[usize; 2]] {
        &self.counted
    }

    /// Number of counted points.
    #[must_use]
    pub(crate) const fn count(&self) -> f64 {
        self.moments[0]
    }

    /// Sum of squares of filtered PV minus its mean: the error without any model.
    #[must_use]
    pub(crate) fn nothing(&self) -> f64 {
        let sum = self.columns[0].with_one;
        self.products[0][0] - sum * sum / self.moments[0].max(1.0)
    }

    /// Number of loads.
    #[must_use]
    pub(crate) const fn loads(&self) -> usize {
        self.columns.len() - 1
    }

    pub(super) fn product(&self, i: usize, k: usize) -> f64 {
        self.products[i][k]
    }

    pub(super) const fn moments(&self) -> [f64; 3] {
        self.moments
    }

    pub(super) fn with_one(&self, column: usize) -> f64 {
        self.columns[column].with_one
    }

    pub(super) fn with_time(&self, column: usize) -> f64 {
        self.columns[column].with_time
    }

    /// Products of a column with the level and with the ramp that follow a step at each point.
    pub(super) fn with_step(&self, column: usize) -> [&[f64]; 2] {
        let column = &self.columns[column];
        [&column.with_level, &column.with_ramp]
    }

    /// The table for a lattice index, computed on first use.
    pub(crate) fn on_lattice(&self, index: i32) -> Arc<Table> {
        let index = index.clamp(PLACES[0], PLACES[1]);
        let slot = &self.lattice[(index - PLACES[0]) as usize];
        Arc::clone(slot.get_or_init(|| Arc::new(self.table(lattice_tau(index)))))
    }

    /// Adds this view's loads to the table of the same PV without loads.
    #[must_use]
    pub(crate) fn extended(&self, of_pv: &Table) -> Table {
        let mut table = of_pv.clone();
        table.steps.truncate(1);
        table.with_memory.truncate(1);
        for column in &self.columns[1..] {
            let (of, memory) = column.steps(table.a, self.rho, self.from);
            table.steps.push(Arc::new(of));
            table.with_memory.push(memory);
        }
        table
    }

    /// The table for any time constant (points, > 0).
    #[must_use]
    pub fn table(&self, tau: f64) -> Table {
        let a = libm::exp(-1.0 / tau);
        let powers = powers(a, self.points + 1);
        let inverse = [1.0 / (1.0 - a), 1.0 / (1.0 - a * a)];
        let (mut steps, mut with_memory) = (Vec::new(), Vec::new());
        for column in &self.columns {
            let (of, memory) = column.steps(a, self.rho, self.from);
            steps.push(Arc::new(of));
            with_memory.push(memory);
        }
        let mut memory = [0.0; 3];
        for [start, end] in &self.counted {
            let [first, last] = [powers[start - self.from], powers[end - self.from]];
            let (late, long) = ((start - self.from) as f64, (end - start) as f64);
            let rest = powers[end - start];
            let sum = (1.0 - rest) * inverse[0];
            let along = (a - long * rest + (long - 1.0) * rest * a) * inverse[0] * inverse[0];
            memory[0] += (first * first - last * last) * inverse[1];
            memory[1] += first * sum;
            memory[2] += first * (late * sum + along);
        }
        Table { tau, a, powers: Arc::new(powers), inverse, steps, with_memory, memory }
    }
}

/// Products of the columns with each other.
fn products(columns: &[Arc<Column>]) -> Vec<Vec<f64>> {
    let product = |a: &Column, b: &Column| a.values.iter().zip(&b.values).map(|(x, y)| x * y).sum::<f64>();
    columns.iter().map(|a| columns.iter().map(|b| product(a, b)).collect()).collect()
}

fn empty_lattice() -> Vec<OnceLock<Arc<Table>>> {
    vec![OnceLock::new(); (PLACES[1] - PLACES[0] + 1) as usize]
}

impl Column {
    fn new(x: &[f64], rho: f64, from: usize, counted: &[[usize; 2]]) -> Self {
        let n = x.len();
        let mut values = vec![0.0; n];
        for k in counted.iter().flat_map(|[a, b]| *a..*b) {
            values[k] = x[k] - rho * x[k - 1];
        }
        let (mut with_level, mut with_ramp) = (vec![0.0; n + 1], vec![0.0; n + 1]);
        let (mut sum, mut sum_of_sums, mut with_one, mut with_time) = (0.0, 0.0, 0.0, 0.0);
        for k in (0..n).rev() {
            // Sum of (i - k) values[i] over i >= k.
            sum_of_sums += sum;
            with_ramp[k] = (1.0 - rho) * sum_of_sums + rho * sum;
            sum += values[k];
            with_level[k] = (1.0 - rho) * sum + rho * values[k];
            if k == from {
                (with_one, with_time) = (sum, sum_of_sums);
            }
        }
        Self { values, with_level, with_ramp, with_one, with_time }
    }

    /// Products with the level and the decay that follow a step at each point, and with the decay from `from` on.
    fn steps(&self, a: f64, rho: f64, from: usize) -> (Vec<[f64; 2]>, f64) {
        let n = self.values.len();
        let mut out = vec![[0.0; 2]; n + 1];
        let (later, own) = (1.0 - rho / a, rho / a);
        let mut decay = 0.0;
        for k in (from.min(n)..n).rev() {
            decay = self.values[k] + a * decay;
            out[k] = [self.with_level[k], later * decay + own * self.values[k]];
        }
        (out, decay)
    }
}

/// `a^0 .. a^(count - 1)`, computed in eight independent chains.
fn powers(a: f64, count: usize) -> Vec<f64> {
    const CHAINS: usize = 8;
    let mut out = vec![0.0; count];
    let mut value = 1.0;
    for slot in out.iter_mut().take(CHAINS) {
        *slot = value;
        value *= a;
    }
    for k in CHAINS..count {
        let next = out[k - CHAINS] * value;
        out[k] = if next > NOTHING { next } else { 0.0 };
    }
    out
}
