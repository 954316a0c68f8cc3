//! No circle between modules: of two that know each other, neither can be read, tested or changed by itself.
//!
//! A module may use what stands in its own parents, and these what stands below them: that a folder's front room knows
//! its rooms, and they its words, is how modules are made. Everything else goes one way.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::{BTreeMap, BTreeSet};

use crate::tidy::{CRATES, sources_of};

type Graph = BTreeMap<String, BTreeSet<String>>;

/// The module of a file, from the crate's root: `gap::effects` for `gap/effects/mod.rs`.
fn module_of(path: &str) -> String {
    path.trim_end_matches(".rs").trim_end_matches("/mod").replace('/', "::")
}

/// Where the braces that open at the start of a text close.
fn closing(text: &str) -> usize {
    let mut depth = 0;
    let close = text.char_indices().find(|(_, c)| {
        depth += i32::from(*c == '{') - i32::from(*c == '}');
        depth == 0
    });
    close.map_or(text.len(), |(at, _)| at)
}

/// The parts of a group of paths that no inner group holds together.
fn parts(group: &str) -> Vec<&str> {
    let (mut depth, mut from, mut out) = (0, 0, Vec::new());
    for (at, c) in group.char_indices() {
        depth += i32::from(c == '{') - i32::from(c == '}');
        if c == ',' && depth == 0 {
            out.push(&group[from..at]);
            from = at + 1;
        }
    }
    out.push(&group[from..]);
    out
}

/// Every path that a text begins with: one, or those of a group, however deep.
fn paths_at(text: &str) -> Vec<Vec<String>> {
    let text = text.trim_start();
    if text.starts_with('{') {
        return parts(&text[1..closing(text)]).into_iter().flat_map(paths_at).collect();
    }
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len());
    let (name, rest) = (text[..end].to_owned(), text[end..].trim_start());
    match rest.strip_prefix("::") {
        Some(_) if name.is_empty() => Vec::new(),
        None => vec![vec![name]],
        Some(rest) => {
            let mut tails = paths_at(rest);
            tails.iter_mut().for_each(|tail| tail.insert(0, name.clone()));
            tails
        }
    }
}

/// A path from the crate's root, as seen from a module; `None` for what begins with a name of another crate or a type.
fn absolute(module: &str, path: &[String], modules: &BTreeSet<String>) -> Option<Vec<String>> {
    let mut here: Vec<String> = module.split("::").map(str::to_owned).collect();
    let mut rest = path;
    match path.first()?.as_str() {
        "crate" => (here, rest) = (Vec::new(), &path[1..]),
        "self" => rest = &path[1..],
        "super" => {
            while rest.first().is_some_and(|name| name == "super") {
                here.pop();
                rest = &rest[1..];
            }
        }
        child if modules.contains(&format!("{module}::{child}")) => {}
        _ => return None,
    }
    here.extend(rest.iter().cloned());
    Some(here)
}

/// Which module uses which, by its code.
fn graph_of(files: &[(String, String)]) -> Graph {
    let modules: BTreeSet<String> = files.iter().map(|(module, _)| module.clone()).collect();
    let mut graph = Graph::new();
    for (module, code) in files {
        let uses = graph.entry(module.clone()).or_default();
        let is_path = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
        let starts = code.char_indices().filter(|(at, _)| *at == 0 || !code[..*at].ends_with(is_path));
        for path in starts.filter(|(at, c)| c.is_alphabetic() && code[*at..].contains("::")).flat_map(|(at, _)| {
            // Only names that a path follows are worth the look.
            let end = code[at..].find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(0);
            if code[at + end..].starts_with("::") { paths_at(&code[at..]) } else { Vec::new() }
        }) {
            let Some(path) = absolute(module, &path, &modules) else { continue };
            let longest = (1..=path.len()).rev().map(|n| path[..n].join("::")).find(|m| modules.contains(m));
            let is_parent = |other: &String| module.starts_with(&format!("{other}::"));
            uses.extend(longest.filter(|other| other != module && !is_parent(other)));
        }
    }
    graph
}

/// The modules from which a way leads to another one.
fn reached(graph: &Graph, from: &str) -> BTreeSet<String> {
    let (mut seen, mut open) = (BTreeSet::new(), vec![from.to_owned()]);
    while let Some(module) = open.pop() {
        for next in &graph[&module] {
            if seen.insert(next.clone()) {
                open.push(next.clone());
            }
        }
    }
    seen
}

/// Modules that use each other, with those of the circle that each uses.
fn circles(graph: &Graph) -> Vec<String> {
    let reach: BTreeMap<&String, BTreeSet<String>> = graph.keys().map(|m| (m, reached(graph, m))).collect();
    let in_circle = |m: &String| reach[m].contains(m);
    let uses = |m: &String| -> Vec<&str> {
        graph[m].iter().filter(|other| reach[other].contains(m)).map(String::as_str).collect()
    };
    graph.keys().filter(|m| in_circle(m)).map(|m| format!("{m} uses {}", uses(m).join(", "))).collect()
}

#[test]
fn no_modules_go_round_in_a_circle() {
    let mut faults = Vec::new();
    for home in CRATES {
        let files: Vec<(String, String)> = sources_of(home)
            .into_iter()
            .filter(|s| !["lib.rs", "main.rs"].contains(&s.path.as_str()))
            .map(|s| (module_of(&s.path), s.code))
            .collect();
        faults.extend(circles(&graph_of(&files)).into_iter().map(|circle| format!("{home}: {circle}")));
    }
    assert!(faults.is_empty(), "modules that use each other:\n{}\n", faults.join("\n"));
}

#[test]
fn circles_are_seen_however_they_are_written() {
    let found = |files: &[(&str, &str)]| {
        let files: Vec<_> = files.iter().map(|(m, code)| ((*m).to_owned(), (*code).to_owned())).collect();
        circles(&graph_of(&files)).len()
    };
    assert_eq!(found(&[("a", "use crate::b::B;"), ("b", "fn b() { crate::a::f() }")]), 2);
    assert_eq!(
        found(&[("a", ""), ("a::b", "use super::c::{self, D};"), ("a::c", "use super::{\n    b::{F, g},\n    e,\n};")]),
        2
    );
    assert_eq!(
        found(&[("a", "mod b;\nfn f() { b::g() }"), ("a::b", "use crate::c::C;"), ("c", "use crate::a::A;")]),
        3
    );
    // A folder's own words, and what goes one way.
    assert_eq!(
        found(&[("a", "pub use b::B;"), ("a::b", "use super::A;\nuse super::c::C;"), ("a::c", "use serde::x;")]),
        0
    );
}
