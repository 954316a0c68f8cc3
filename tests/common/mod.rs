//! Helpers for tests of the programs.
#![allow(missing_docs, dead_code)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod program;

/// Reports a skipped test past the harness, which hides the output of passing tests; `tests/run.sh` counts these lines.
pub fn skipped(test: &str, why: &str) {
    use std::io::Write;
    let _ = std::io::stderr().lock().write_all(format!("\nSKIPPED: {test}: {why}\n").as_bytes());
}
