//! The program `stictiond`; the library's first page has the map.

use std::process::ExitCode;

fn main() -> ExitCode {
    stictiond::commands::main()
}
