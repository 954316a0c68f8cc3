//! What the toolbox of the University of Alberta shows and does: the error surface over the bands, solvers that search it, the
//! plots of a fit, and its published method. The estimate needs none of it.

pub mod fit_plots;
pub mod one_step;
pub mod solvers;
pub mod surface;
