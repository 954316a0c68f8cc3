//! A valve signal's two halves and their products: the modelled valve position is the level minus the kinetic band times the
//! direction, so linear quantities are kept for both halves, and quadratic ones for their products.

// Halves index several arrays at once; the compiler unrolls these loops.
#![allow(clippy::needless_range_loop)]

/// The level half and the direction half of the valve signal.
pub(super) type Halves = [f64; 2];
/// Products of one quantity's halves with another's.
pub(super) type Square = [Halves; 2];

/// Adds the products of the halves of `x` and `y`.
#[inline(always)]
pub(super) fn add(into: &mut Square, x: Halves, y: Halves) {
    for h in 0..2 {
        for g in 0..2 {
            into[h][g] += x[h] * y[g];
        }
    }
}

/// The transposed products.
pub(super) fn turned(square: &Square) -> Square {
    [[square[0][0], square[1][0]], [square[0][1], square[1][1]]]
}

/// The weighted sum of squares.
pub(super) fn mixed<const N: usize>(of: [(f64, Square); N]) -> Square {
    core::array::from_fn(|h| core::array::from_fn(|g| of.iter().map(|(factor, square)| factor * square[h][g]).sum()))
}
