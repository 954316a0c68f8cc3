//! What decides the order of a process model.

use super::class::{Class, Shape};

/// Share of the error on data not fitted to that it must remove to stay in the answer.
pub(crate) const EARNED: f64 = 0.01;
/// Share of a record that the held-out fit is made to.
pub(crate) const FITTED_SHARE: f64 = 0.6;

/// The simpler class' shape whose lag takes the place of the second lag.
pub fn reduced(class: Class, simpler: Class, shape: &Shape) -> Shape {
    let lost = libm::exp(shape[if class == Class::Second { 1 } else { 0 }]);
    simpler.start(libm::exp(shape[0]), class.lag(shape) + lost)
}
