//! From a recording's samples to the answers of `analyze` and `gap`: joins rows, selects and thins a section, fits, and writes
//! the document and its text. Files and arrays give bit-identical numbers for the same samples.
//!
//! | step | in |
//! |---|---|
//! | rows of a table to samples | [`rows::Rows`] |
//! | samples to stretches of points, a section to a record | [`Points`], [`Section`] |
//! | detrending and downsampling | [`Cut`] |
//! | the estimate, and a solver on its error surface | [`estimate()`](estimate::estimate), [`solver`] |
//! | every window of a long record, as in the daemon | [`Due`] |
//! | the gap | [`gap::diagnose`], [`predictions::rows`] |
//! | loops that share an oscillation, judged together | [`plant::judge_together`] |
//! | the estimate as text | [`text::answer`] |

mod cut;
mod due;
pub mod estimate;
pub mod gap;
pub mod plant;
mod points;
pub mod predictions;
pub mod rows;
pub mod solver;
mod still;
pub mod text;

pub use cut::{Cut, Detrend, Downsampled, Taken};
pub use due::Due;
pub use estimate::{Answer, Estimated, FitOverrides, Scored, delay_choice, estimate};
pub use points::{Judgeable, MIN_SAMPLES, Points, Section, repeated_timestamps, usable};
pub use still::repeated_values;

use stiction::core::units::{format_rfc3339, number};
use thiserror::Error;

/// Why a section cannot be analysed.
#[derive(Debug, Error, Clone, PartialEq)]
#[allow(missing_docs)] // the message says what each is
pub enum AnalysisError {
    #[error("{name}: samples {start} to {end} requested, but the loop has {there}")]
    Beyond { name: String, start: usize, end: usize, there: usize },
    #[error("{name}: no samples with both OP and PV in this section; {}", remedy(*joined_ns))]
    Nothing { name: String, joined_ns: Option<[i64; 2]> },
    #[error(
        "{name}: the longest stretch without a data gap has {there} samples, at least {MIN_SAMPLES} are needed; choose a longer section"
    )]
    Few { name: String, there: usize },
    #[error(
        "{name}: {samples} samples downsampled by {ratio} leave fewer than {MIN_SAMPLES} points; use {needed} samples or a \
         smaller ratio"
    )]
    Sparse { name: String, samples: usize, ratio: f64, needed: usize },
    #[error(
        "two loops are named {name}; loops that are judged together need names of their own, so rename one of them"
    )]
    Twice { name: String },
    #[error("{name}: cannot downsample by {ratio}; use a ratio above 1")]
    Ratio { name: String, ratio: f64 },
    #[error(
        "{name}: OP runs from {} to {}, outside its range {} to {}; give the range in the units of OP, such as 0 to 100",
        number(op[0]), number(op[1]), number(range[0]), number(range[1])
    )]
    OutsideRange { name: String, op: [f64; 2], range: [f64; 2] },
    #[error(
        "{name}: OP runs from {} to {}, a fraction of its range {} to {}; give the range as OP is recorded: --op-range 0,1, or \
         op_range = [0, 1] in the configuration",
        number(op[0]), number(op[1]), number(range[0]), number(range[1])
    )]
    Fraction { name: String, op: [f64; 2], range: [f64; 2] },
}

/// The remedy: where the loop has samples with both OP and PV.
fn remedy(joined_ns: Option<[i64; 2]>) -> String {
    match joined_ns.map(|ends| ends.map(format_rfc3339)) {
        Some([first, last]) => format!("the loop has such samples from {first} to {last}"),
        None => "check that both columns have numbers".to_owned(),
    }
}
