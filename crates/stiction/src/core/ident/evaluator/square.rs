//! A valve signal's two halves and their products: the model's valve position is the level less the kinetic band times the
//! direction, so whatever is linear in it is kept for both, and whatever is quadratic for their products.

// Halves are places of several arrays at once, and the loops over them are unrolled by the compiler.
#![allow(clippy::needless_range_loop)]

/// The level half and the direction half of the valve signal.
pub(super) type Halves = [f64; 2];
/// Products of the halves of one thing with those of another.
pub(super) type Square = [Halves; 2];

/// Adds the products of two things' halves.
#[inline(always)]
pub(super) fn add(into: &mut Square, x: Halves, y: Halves) {
    for h in 0..2 {
        for g in 0..2 {
            into[h][g] += x[h] * y[g];
        }
    }
}

/// The same products with the two things the other way round.
pub(super) fn turned(square: &Square) -> Square {
    [[square[0][0], square[1][0]], [square[0][1], square[1][1]]]
}

/// The weighted sum of squares.
pub(super) fn mixed<const N: usize>(of: [(f64, Square); N]) -> Square {
    core::array::from_fn(|h| core::array::from_fn(|g| of.iter().map(|(factor, square)| factor * square[h][g]).sum()))
}
