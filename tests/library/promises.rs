//! The page of promises: each row names a test that exists.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::Path;

const PAGE: &str = include_str!("../../docs/robustness.md");

#[test]
fn every_promise_names_a_test_that_exists_and_a_figure() {
    let rows: Vec<&str> = PAGE.lines().filter(|l| l.starts_with("| ") && !l.starts_with("| promise")).collect();
    assert!(rows.len() > 30, "{}", rows.len());
    for row in rows {
        let cells: Vec<&str> = row.trim_matches('|').split(" | ").map(str::trim).collect();
        let [_, tests, figure] = cells[..] else { panic!("three cells: {row}") };
        assert!(!figure.is_empty(), "{row}");
        let named: Vec<(&str, &str)> = tests.split('`').filter_map(|word| word.split_once(".rs::")).collect();
        assert!(!named.is_empty(), "{row}");
        for (file, test) in named {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("{file}.rs"));
            let text = fs::read_to_string(&path).unwrap_or_else(|_| panic!("{file}.rs is missing: {row}"));
            assert!(text.contains(&format!("fn {test}(")), "{file}.rs has no test {test}");
        }
    }
}
