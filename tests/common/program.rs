//! The program as its users call it.

use std::process::{Command, Output};

/// Another build if `STICTIOND_BIN` names one.
fn under_test() -> String {
    std::env::var("STICTIOND_BIN").unwrap_or_else(|_| env!("CARGO_BIN_EXE_stictiond").to_owned())
}

pub fn stictiond(arguments: &[&str]) -> Output {
    Command::new(under_test()).args(arguments).output().unwrap()
}

pub fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Runs it and checks its exit code.
#[track_caller]
pub fn expect(code: i32, arguments: &[&str]) -> Output {
    let output = stictiond(arguments);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}{}", stdout(&output), stderr(&output));
    output
}
