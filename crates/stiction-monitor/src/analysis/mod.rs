//! A recording's samples to the answers of `analyze` and `gap`: rows joined, a section chosen, its density, the fit, the
//! document and its words. Whoever reads files or arrays hands samples in and gets the same numbers, to the bit.
//!
//! | step | by |
//! |---|---|
//! | a table's rows to samples | [`rows::Rows`] |
//! | samples to stretches of points, a section to a record | [`Points`], [`Section`] |
//! | its trend and density | [`Cut`] |
//! | the estimate, and a solver set on its error surface | [`estimate()`](estimate::estimate), [`solver`] |
//! | every window of a long record, as the daemon would cut it | [`Due`] |
//! | the gap | [`gap::diagnose`], [`predictions::rows`] |
//! | the estimate in words | [`text::answer`] |

mod cut;
mod due;
pub mod estimate;
pub mod gap;
mod points;
pub mod predictions;
pub mod rows;
pub mod solver;
pub mod text;

pub use cut::{Cut, Detrend, Downsampled, Taken};
pub use due::Due;
pub use estimate::{Answer, Asked, Estimated, Scored, delay_choice, estimate};
pub use points::{MIN_SAMPLES, Points, Section, usable};

use thiserror::Error;

/// Why nothing can be analysed.
#[derive(Debug, Error, Clone, PartialEq)]
#[allow(missing_docs)] // the message says what each is
pub enum AnalysisError {
    #[error("{name}: samples {start} to {end} are wanted, the loop has {there}")]
    Beyond { name: String, start: usize, end: usize, there: usize },
    #[error("{name}: no samples with both OP and PV in this section; see that both columns hold numbers there")]
    Nothing { name: String },
    #[error("{name}: {there} samples in one piece in this section, at least {MIN_SAMPLES} are needed")]
    Few { name: String, there: usize },
    #[error(
        "{name}: {samples} samples downsampled by {ratio} leave under {MIN_SAMPLES} points; take {needed} samples or a \
         smaller ratio"
    )]
    Sparse { name: String, samples: usize, ratio: f64, needed: usize },
    #[error("{name}: cannot be downsampled by {ratio}")]
    Ratio { name: String, ratio: f64 },
}
