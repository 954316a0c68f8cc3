//! A valve's signal, computed OP value by OP value: the reference for the tests of [`crate::core::sim::steps`].

use super::{FirstSlip, Law, Stem, Stroke};

/// The slips of (s, j) on an OP path of `n` points.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Sequence {
    /// OP value at the last slip, averaged over each point.
    pub at: Vec<f64>,
    /// Direction of the last slip, averaged over each point, -1..1.
    pub direction: Vec<f64>,
    pub s_cell: [f64; 2],
    pub j_cell: [f64; 2],
    pub slips: usize,
    pub reversals: usize,
}

impl Sequence {
    /// Runs a law with bands `[s, j]` over `n * per_point` OP values. The stem's position is `at - fd (direction + uneven)`.
    pub(crate) fn of(
        stroke: Stroke,
        law: Law,
        path: &[f64],
        per_point: usize,
        bands: [f64; 2],
        first: FirstSlip,
    ) -> Self {
        let mut stem = Stem::before(first, bands, stroke, per_point);
        let share = 1.0 / per_point as f64;
        let mut made = Self::default();
        for point in path.chunks_exact(per_point) {
            let (mut at, mut direction) = (0.0, 0.0);
            for op in point {
                stem.meet(law, *op, bands, stroke);
                let signal = stem.signal();
                (at, direction) = (at + share * signal.0, direction + share * signal.1);
            }
            made.at.push(at);
            made.direction.push(direction);
        }
        [made.s_cell, made.j_cell] = stem.cells();
        (made.slips, made.reversals) = (stem.slips(), stem.reversals());
        made
    }
}
