//! The pages: README.md, CONTRIBUTING.md and docs. Their links are valid, their tables complete, and the README remains short
//! enough to be read to its end. `tests/program/pages.rs` tests the command lines.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn read(name: &str) -> String {
    fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// Pages outside docs.
const ELSEWHERE: [&str; 8] = [
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "crates/stictiond-bridge/README.md",
    "examples/fleet/README.md",
    "packaging/README.md",
    "recordings/README.md",
];

/// Every page with its text, by its path from the root.
pub fn all() -> Vec<(String, String)> {
    let mut names = ELSEWHERE.map(str::to_owned).to_vec();
    for folder in ["docs", "docs/dev"] {
        for entry in fs::read_dir(root().join(folder)).unwrap() {
            let name = entry.unwrap().file_name().into_string().unwrap();
            if Path::new(&name).extension().is_some_and(|e| e == "md") {
                names.push(format!("{folder}/{name}"));
            }
        }
    }
    names.sort();
    names.into_iter().map(|name| (name.clone(), read(&name))).collect()
}

/// The lines outside fenced blocks, with their numbers.
fn prose(text: &str) -> Vec<(usize, &str)> {
    let mut fenced = false;
    let mut out = Vec::new();
    for (at, line) in text.lines().enumerate() {
        if line.starts_with("```") {
            fenced = !fenced;
        } else if !fenced {
            out.push((at + 1, line));
        }
    }
    out
}

/// The lines of all fenced blocks in a language below a heading.
fn fenced<'t>(text: &'t str, heading: &str, language: &str) -> Vec<&'t str> {
    let (open, mut inside, mut out) = (format!("```{language}"), false, Vec::new());
    let below = text.lines().skip_while(|l| *l != heading).skip(1);
    for line in below.take_while(|l| !l.starts_with("## ")) {
        if line.starts_with("```") {
            inside = line == open;
        } else if inside {
            out.push(line);
        }
    }
    out
}

/// A heading's anchor by GitHub's rules: lower case, spaces as hyphens, only letters, digits, `-` and `_`.
fn anchor(heading: &str) -> String {
    let kept = heading.chars().filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect::<String>().to_lowercase()
}

/// The anchors of a page; a repeated heading gets a number.
fn anchors(text: &str) -> Vec<String> {
    let mut seen = BTreeMap::new();
    let headings = prose(text).into_iter().filter(|(_, l)| l.starts_with('#')).map(|(_, l)| l.trim_start_matches('#'));
    headings
        .map(|heading| {
            let name = anchor(heading.trim());
            let times = seen.entry(name.clone()).or_insert(0);
            *times += 1;
            if *times == 1 { name } else { format!("{name}-{}", *times - 1) }
        })
        .collect()
}

/// Targets of a line's links, without code in backticks.
fn links(line: &str) -> Vec<&str> {
    let prose = line.split('`').enumerate().filter(|(at, _)| at % 2 == 0).map(|(_, part)| part);
    let targets = |part: &'_ str| part.match_indices("](").map(|(at, _)| at + 2).collect::<Vec<_>>();
    prose.flat_map(|part| targets(part).into_iter().filter_map(|at| part[at..].split(')').next())).collect()
}

#[test]
fn every_link_leads_to_a_file_and_a_heading() {
    let (mut faults, mut seen) = (Vec::new(), 0);
    for (name, text) in all() {
        for (at, line) in prose(&text) {
            for link in links(line).into_iter().filter(|l| !l.starts_with("http")) {
                seen += 1;
                let (path, heading) = link.split_once('#').map_or((link, None), |(path, h)| (path, Some(h)));
                let home = root().join(&name);
                let target = if path.is_empty() { home } else { home.parent().unwrap().join(path) };
                if !target.exists() {
                    faults.push(format!("{name}: line {at}: {link}: no such file"));
                } else if let Some(heading) = heading
                    && !anchors(&fs::read_to_string(&target).unwrap_or_default()).contains(&heading.to_owned())
                {
                    faults.push(format!("{name}: line {at}: {link}: no such heading"));
                }
            }
        }
    }
    assert!(seen > 100, "only {seen} links were found");
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}

#[test]
fn links_and_headings_are_read_as_they_are_shown() {
    assert_eq!(links("see [a](b.md#c), `[x](y)` and [`d`](../e)"), ["b.md#c", "../e"]);
    assert_eq!(anchors("# A\n```\n# no\n```\n## B, and `c_d`\n## A"), ["a", "b-and-c_d", "a-1"]);
    assert_eq!(anchor("The engine's contract"), "the-engines-contract");
}

#[test]
fn the_readme_is_read_to_its_end() {
    // Programs that try out this repository look for these two.
    let page = read("README.md");
    let two = fenced(&page, "## Two commands", "sh");
    assert_eq!(two, ["cargo run -- demo", "bash tests/run.sh"]);
}

#[test]
fn the_list_of_pages_is_whole() {
    let list = read("docs/README.md");
    for (name, _) in all() {
        let page = name.strip_prefix("docs/").filter(|page| *page != "README.md");
        assert!(page.is_none_or(|page| list.contains(&format!("]({page})"))), "docs/README.md does not list {name}");
    }
}

/// First cells, in code marks, of a page's table whose first heading is `heading`.
fn column(page: &str, heading: &str) -> Vec<String> {
    let text = read(page);
    let head = format!("| {heading} |");
    let mut lines = text.lines().skip_while(|l| !l.starts_with(&head));
    assert!(lines.next().is_some(), "{page} has no table that starts with {head}");
    let rows = lines.skip(1).take_while(|l| l.starts_with('|'));
    rows.map(|l| l.split('`').nth(1).unwrap_or_else(|| panic!("no `name` in {l}")).to_owned()).collect()
}

fn sorted(mut names: Vec<String>) -> Vec<String> {
    names.sort();
    names
}

#[test]
fn tables_list_what_there_is() {
    let names = |all: Vec<&'static str>| all.into_iter().map(str::to_owned).collect::<Vec<_>>();
    let solvers = names(stiction::toolbox::solvers::ALL.iter().map(|s| s.name()).collect());
    assert_eq!(column("docs/commands.md", "solver"), solvers);
    let formats = names(stiction_engine::codec::ALL.iter().map(|c| c.name()).collect());
    assert_eq!(column("docs/formats.md", "format"), formats);
    let gates = names(stiction::core::verdict::Gate::ALL.iter().map(|g| g.name()).collect());
    assert_eq!(column("docs/read-a-result.md", "gate"), gates);
    let effects = names(stiction::core::gap::effects::ALL.iter().map(|e| e.id).collect());
    assert_eq!(column("docs/gap.md", "effect"), effects);
    let indicators = names(stiction::core::verdict::features::names().collect());
    assert_eq!(sorted(column("docs/dev/method.md", "indicator")), sorted(indicators));
}

#[test]
fn every_command_is_listed() {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_stictiond")).arg("--help").output().unwrap();
    let help = String::from_utf8(output.stdout).unwrap();
    let rows = help.lines().skip_while(|l| *l != "Commands:").skip(1).take_while(|l| !l.is_empty());
    // A command is indented by two spaces, the rest of a long description by more.
    let commands: Vec<String> = rows
        .filter(|l| l.starts_with("  ") && !l.starts_with("   "))
        .map(|l| l.split_whitespace().next().unwrap().to_owned())
        .filter(|name| name != "help")
        .collect();
    assert_eq!(column("docs/commands.md", "command"), commands);
}

/// A file or folder of sources, as a module is called.
fn modules(folder: &str) -> Vec<String> {
    let names = fs::read_dir(root().join(folder)).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
    let sources = names.filter(|name| !name.ends_with(".md"));
    let module = |name: String| name.trim_end_matches(".rs").to_owned();
    sources.map(module).filter(|name| !["lib", "main", "mod", "bin", "tests"].contains(&name.as_str())).collect()
}

#[test]
fn the_design_names_what_there_is() {
    let text = read("docs/dev/design.md");
    let quoted: Vec<&str> = text.split('`').skip(1).step_by(2).collect();
    let mut faults = Vec::new();
    let libraries =
        ["crates/stiction/src", "crates/stiction/src/core", "crates/stiction-engine/src", "crates/stiction-lab/src"];
    for home in libraries.into_iter().chain(["src"]) {
        let unnamed = modules(home).into_iter().filter(|name| !quoted.contains(&name.as_str()));
        faults.extend(unnamed.map(|name| format!("{home}/{name} is not named")));
    }
    let homes = ["src/daemon", "crates/stiction-engine/src", "crates/stiction/src/core"];
    let gone = quoted.iter().filter(|name| Path::new(name).extension().is_some_and(|e| e == "rs"));
    let gone = gone.filter(|name| !homes.iter().any(|home| root().join(home).join(name).is_file()));
    faults.extend(gone.map(|name| format!("there is no {name}")));
    assert!(quoted.len() > 50 && faults.is_empty(), "\n{}\n", faults.join("\n"));
}
