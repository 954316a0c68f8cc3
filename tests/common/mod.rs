//! Helpers of the tests at the process boundary.
#![allow(missing_docs, dead_code)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod program;

/// Says that a test was skipped, past the harness, which keeps what passing tests print to itself; `tests/run.sh` counts
/// these lines.
pub fn skipped(test: &str, why: &str) {
    use std::io::Write;
    let _ = std::io::stderr().lock().write_all(format!("\nSKIPPED: {test}: {why}\n").as_bytes());
}
