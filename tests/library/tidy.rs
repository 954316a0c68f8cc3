//! What must be absent, and what must agree. The compiler holds which crate uses which; clippy, that the pure ones have no
//! files, clocks, threads or chance (`crates/pure.clippy.toml`).

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The crates of the workspace.
pub const CRATES: [&str; 6] = [
    "src",
    "crates/stiction/src",
    "crates/stiction-engine/src",
    "crates/stiction-lab/src",
    "crates/stiction-files/src",
    "crates/stictiond-bridge/src",
];

/// Longest source file, lines.
const MAX_LINES: usize = 600;

pub struct Source {
    /// One of [`CRATES`].
    home: &'static str,
    /// Path below it, with `/`.
    pub path: String,
    /// As it stands.
    text: String,
    /// Without comments, texts in quotes, and test items.
    pub code: String,
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

/// Every source file but those that are tests as a whole (`#[cfg(test)] mod name;`).
fn sources() -> Vec<Source> {
    CRATES.into_iter().flat_map(sources_of).collect()
}

pub fn sources_of(home: &'static str) -> Vec<Source> {
    let src = root().join(home);
    let mut paths = Vec::new();
    files_below(&src, &mut paths);
    paths.sort();
    let mut test_files = BTreeSet::new();
    let mut all = Vec::new();
    for path in paths {
        let text = fs::read_to_string(&path).unwrap();
        let bare = without_comments_and_texts(&text);
        let (code, test_modules) = without_tests(&bare);
        let folder = path.parent().unwrap();
        let own = if path.file_name().unwrap() == "mod.rs" || folder == src {
            folder.to_owned()
        } else {
            path.with_extension("")
        };
        test_files.extend(test_modules.iter().map(|m| own.join(format!("{m}.rs"))));
        let relative = path.strip_prefix(&src).unwrap().to_str().unwrap().replace('\\', "/");
        all.push((path, Source { home, path: relative, text, code }));
    }
    assert!(all.len() > 3, "{home} was not found");
    all.into_iter().filter(|(path, _)| !test_files.contains(path)).map(|(_, source)| source).collect()
}

/// Blanks comments and the insides of texts, keeping line breaks.
fn without_comments_and_texts(text: &str) -> String {
    let chars: Vec<char> = text.chars().collect();
    let mut out = String::with_capacity(text.len());
    let mut at = 0;
    let starts = |at: usize, with: &str| chars[at..].iter().take(with.len()).copied().eq(with.chars());
    while at < chars.len() {
        if starts(at, "//") {
            while at < chars.len() && chars[at] != '\n' {
                at += 1;
            }
        } else if starts(at, "/*") {
            while at < chars.len() && !starts(at, "*/") {
                if chars[at] == '\n' {
                    out.push('\n');
                }
                at += 1;
            }
            at += 2;
        } else if chars[at] == 'r' && (starts(at, "r\"") || starts(at, "r#")) && !is_word(chars.get(at.wrapping_sub(1)))
        {
            let hashes = chars[at + 1..].iter().take_while(|c| **c == '#').count();
            if chars.get(at + 1 + hashes) != Some(&'"') {
                out.push('r');
                at += 1;
                continue;
            }
            let end = format!("\"{}", "#".repeat(hashes));
            at += 2 + hashes;
            while at < chars.len() && !starts(at, &end) {
                at += 1;
            }
            at += end.len();
            out.push_str("\"\"");
        } else if chars[at] == '"' {
            at += 1;
            while at < chars.len() && chars[at] != '"' {
                at += if chars[at] == '\\' { 2 } else { 1 };
            }
            at += 1;
            out.push_str("\"\"");
        } else if starts(at, "'\\") || (chars[at] == '\'' && chars.get(at + 2) == Some(&'\'')) {
            at += 2;
            while at < chars.len() && chars[at] != '\'' {
                at += 1;
            }
            at += 1;
            out.push_str("' '");
        } else {
            out.push(chars[at]);
            at += 1;
        }
    }
    out
}

fn is_word(c: Option<&char>) -> bool {
    c.is_some_and(|c| c.is_alphanumeric() || *c == '_')
}

/// Takes out items behind `#[cfg(test)]`; names the modules among them that are files of their own.
fn without_tests(code: &str) -> (String, Vec<String>) {
    const MARK: &str = "#[cfg(test)]";
    let (mut out, mut modules) = (String::new(), Vec::new());
    let mut rest = code;
    while let Some(at) = rest.find(MARK) {
        out.push_str(&rest[..at]);
        let item = &rest[at + MARK.len()..];
        let end = item.find(['{', ';']).unwrap();
        if item[end..].starts_with(';') {
            let declared = item[..end].trim();
            let declared = declared.strip_prefix("pub(crate) ").unwrap_or(declared);
            if let Some(name) = declared.strip_prefix("mod ") {
                modules.push(name.to_owned());
            }
            rest = &item[end + 1..];
            continue;
        }
        let mut depth = 0;
        let close = item.char_indices().skip_while(|(i, _)| *i < end).find(|(_, c)| {
            depth += i32::from(*c == '{') - i32::from(*c == '}');
            depth == 0
        });
        rest = &item[close.unwrap().0 + 1..];
    }
    out.push_str(rest);
    (out, modules)
}

/// Lines on which a text stands as a path of its own, not as the end of a longer word.
fn places<'a>(code: &'a str, wanted: &'a str) -> impl Iterator<Item = usize> + 'a {
    code.match_indices(wanted).filter_map(move |(at, _)| {
        let before = code[..at].chars().next_back();
        (!is_word(before.as_ref())).then(|| code[..at].matches('\n').count() + 1)
    })
}

fn fail_on(faults: &[String]) {
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}

/// The challenge judges `gap` from outside: an own model of the valve and the process, and no look at the diagnosis.
#[test]
fn the_challenge_does_not_see_the_diagnosis() {
    let challenge: Vec<Source> =
        sources_of("crates/stiction-lab/src").into_iter().filter(|s| s.room() == "challenge").collect();
    assert!(!challenge.is_empty());
    let mut faults = Vec::new();
    for source in challenge {
        faults.extend(places(&source.code, "gap::").map(|line| format!("{}: line {line}: gap::", source.place())));
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
    let mut texts: Vec<(String, String)> = sources().into_iter().map(|s| (s.place(), s.text)).collect();
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

/// What is known of an effect stands in its file: no other file of the gap names one.
#[test]
fn no_effect_is_named_outside_its_own_file() {
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/stiction/src/core/gap")];
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
                // A process' own flag in a model file has the name of the effect.
                let flag = name == "model_file" && code.contains(&format!("flag(\"{}\")", effect.id));
                assert!(flag || !code.contains(&format!("\"{}\"", effect.id)), "{} in {}", effect.id, path.display());
            }
        }
    }
    assert!(seen > 30, "only {seen} files were found");
}
