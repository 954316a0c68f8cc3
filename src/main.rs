//! The program `stictiond`; the map is in the documentation of the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    stictiond::commands::main()
}
