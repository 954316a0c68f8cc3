//! The program `stictiond`.

fn main() {}
