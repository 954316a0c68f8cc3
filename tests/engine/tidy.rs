//! What must be absent, and what must agree. The compiler checks which crate uses which; clippy checks that the pure crates use
//! no files, clocks, threads or randomness (`crates/pure.clippy.toml`).

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The crates of the workspace.
const CRATES: [&str; 6] = [
    "src",
    "crates/stiction/src",
    "crates/stiction-engine/src",
    "crates/stiction-lab/src",
    "crates/stiction-files/src",
    "crates/stictiond-bridge/src",
];

/// Longest source file, lines.
const MAX_LINES: usize = 600;

struct Source {
    /// One of [`CRATES`].
    home: &'static str,
    /// Path below it, separated by `/`.
    path: String,
    text: String,
}

impl Source {
    fn room(&self) -> &str {
        let first = self.path.split('/').next().unwrap();
        first.strip_suffix(".rs").unwrap_or(first)
    }

    /// Path from the root.
    fn place(&self) -> String {
        format!("{}/{}", self.home, self.path)
    }
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn files_below(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files_below(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// Every source file of a crate, except those that consist of tests.
fn sources_of(home: &'static str) -> Vec<Source> {
    let src = root().join(home);
    let mut paths = Vec::new();
    files_below(&src, &mut paths);
    paths.sort();
    let below = paths.iter().map(|path| (path, path.strip_prefix(&src).unwrap().to_str().unwrap().replace('\\', "/")));
    let code = below.filter(|(_, path)| !path.ends_with("tests.rs") && !path.contains("tests/"));
    let all: Vec<Source> =
        code.map(|(file, path)| Source { home, path, text: fs::read_to_string(file).unwrap() }).collect();
    assert!(all.len() > 3, "{home} was not found");
    all
}

fn fail_on(faults: &[String]) {
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}

/// The challenge judges `gap` from outside: it has a separate model of valve and process, and does not use the diagnosis.
#[test]
fn the_challenge_does_not_see_the_diagnosis() {
    let challenge: Vec<Source> =
        sources_of("crates/stiction-lab/src").into_iter().filter(|s| s.room() == "challenge").collect();
    assert!(!challenge.is_empty());
    let mut faults = Vec::new();
    for source in challenge {
        let code = source.text.lines().enumerate().filter(|(_, line)| !line.trim_start().starts_with("//"));
        let named = code.filter(|(_, line)| line.contains("gap::"));
        faults.extend(named.map(|(at, _)| format!("{}: line {}: gap::", source.place(), at + 1)));
    }
    fail_on(&faults);
}

#[test]
fn the_map_of_a_library_names_its_every_room() {
    let mut missing = Vec::new();
    let homes = [
        ("crates/stiction/src/core", "mod.rs"),
        ("crates/stiction-engine/src", "lib.rs"),
        ("crates/stiction-lab/src", "lib.rs"),
        ("crates/stiction-lab/src/truth", "mod.rs"),
        ("src", "lib.rs"),
    ];
    for (home, root_file) in homes {
        let map = fs::read_to_string(root().join(home).join(root_file)).unwrap();
        let table: String = map.lines().filter(|l| l.starts_with("//! |")).collect();
        let rooms: BTreeSet<String> = sources_of(home).iter().map(|s| s.room().to_owned()).collect();
        let unsaid = rooms
            .iter()
            .filter(|r| !["lib", "mod", "main", "bin"].contains(&r.as_str()) && !table.contains(&format!("`{r}`")));
        missing.extend(unsaid.map(|room| format!("{home}/{root_file}: {room}")));
    }
    assert!(missing.is_empty(), "not in the map: {missing:?}");
}

#[test]
fn files_are_short_and_say_what_they_are_for() {
    let mut paths = Vec::new();
    CRATES.iter().for_each(|home| files_below(&root().join(home), &mut paths));
    let mut faults = Vec::new();
    for path in paths {
        let text = fs::read_to_string(&path).unwrap();
        let lines = text.lines().count();
        if lines > MAX_LINES {
            faults.push(format!("{}: {lines} lines, at most {MAX_LINES}: divide it", path.display()));
        }
        if !text.starts_with("//! ") {
            faults.push(format!("{}: starts without //! and what it is for", path.display()));
        }
    }
    fail_on(&faults);
}

#[test]
fn nothing_is_left_open_and_no_machine_is_named() {
    let machine = ["work", "root", "tmp", "home"].map(|folder| format!("/{folder}/"));
    let open = ["TO-DO", "FIX-ME", "XX-X", "todo-!", "unimple-mented!"].map(|word| word.replace('-', ""));
    let mut texts: Vec<(String, String)> =
        CRATES.into_iter().flat_map(sources_of).map(|s| (s.place(), s.text)).collect();
    for name in ["CHANGELOG.md", "SECURITY.md", "config/monitor.toml", "recordings/README.md"] {
        texts.push((name.to_owned(), fs::read_to_string(root().join(name)).unwrap()));
    }
    texts.extend(crate::pages::all());
    let mut faults = Vec::new();
    for (name, text) in texts {
        for word in machine.iter().chain(&open) {
            let lines = text.lines().enumerate().filter(|(_, l)| l.contains(word.as_str()));
            faults.extend(lines.map(|(at, _)| format!("{name}: line {}: {word}", at + 1)));
        }
    }
    fail_on(&faults);
}

/// Everything specific to an effect is in its file: no other file of the gap, nor of its words, names one.
#[test]
fn no_effect_is_named_outside_its_own_file() {
    let mut folders = ["core/gap", "words"].map(|home| root().join("crates/stiction/src").join(home)).to_vec();
    let mut seen = 0;
    while let Some(folder) = folders.pop() {
        for path in fs::read_dir(&folder).unwrap().flatten().map(|entry| entry.path()) {
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                if name != "effects" {
                    folders.push(path);
                }
                continue;
            }
            if path.extension().is_none_or(|e| e != "rs") || name == "tests" {
                continue;
            }
            let text = fs::read_to_string(&path).unwrap();
            let code = text.split("#[cfg(test)]").next().unwrap();
            let code: String = code.lines().filter(|l| !l.trim_start().starts_with("//")).collect();
            seen += 1;
            for effect in stiction::core::gap::effects::ALL {
                // A model file's flag for a process has the same name as an effect.
                let flag = name == "model_file" && code.contains(&format!("flag(\"{}\")", effect.id));
                assert!(flag || !code.contains(&format!("\"{}\"", effect.id)), "{} in {}", effect.id, path.display());
            }
        }
    }
    assert!(seen > 30, "only {seen} files were found");
}
