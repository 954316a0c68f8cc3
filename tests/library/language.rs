//! What people read is plain English and short: pages, comments of configurations and packages, and the strings of the web page.
//! `tests/program/language.rs` looks at the program's help.

use std::fs;
use std::path::PathBuf;

#[path = "../common/phrases.rs"]
mod phrases;

/// Most words of all pages of `docs`, and of one.
const MAX_WORDS: usize = 28_000;
const MAX_PAGE: usize = 1_700;
/// Pages that a test writes, which may be of any length.
const GENERATED: [&str; 1] = ["docs/export-shapes.md"];
/// Texts that are not looked at, and why.
const EXCEPT: [(&str, &str); 1] = [("docs/export-shapes.md", "what the program prints, written by a test")];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Files of a folder with one of these endings, by their path from the root.
fn files(folder: &str, ends: &[&str]) -> Vec<String> {
    let entries = fs::read_dir(root().join(folder)).unwrap_or_else(|e| panic!("{folder}: {e}"));
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut out: Vec<String> =
        names.filter(|n| ends.iter().any(|e| n.ends_with(e))).map(|n| format!("{folder}/{n}")).collect();
    out.sort();
    out
}

/// What a script shows: the text of its strings, each a clause of its own, on the lines where they are.
fn strings(script: &str) -> String {
    let (mut out, mut open, mut comment, mut last) = (String::new(), None::<char>, None::<char>, ' ');
    for c in script.chars() {
        let escaped = open.is_some() && last == '\\';
        match (open, comment) {
            (None, None) if last == '/' && (c == '/' || c == '*') => comment = Some(c),
            (None, None) if ['"', '\'', '`'].contains(&c) => open = Some(c),
            (None, Some('*')) if last == '*' && c == '/' => comment = None,
            (None, Some('/')) if c == '\n' => comment = None,
            (Some(quote), _) if (c == quote && !escaped) || (c == '\n' && quote != '`') => {
                open = None;
                out.push_str(" . ");
            }
            (Some(_), _) if c != '\n' => out.push(c),
            _ => (),
        }
        if c == '\n' {
            out.push(c);
        }
        // A backslash that is escaped escapes nothing, and the slash that ends a comment begins none.
        last = if (escaped && c == '\\') || (last == '*' && c == '/') { ' ' } else { c };
    }
    out
}

#[test]
fn only_the_strings_of_a_script_are_searched() {
    let text = strings("// stands in\nlet holes = `a ${b}\nno`; /* \"x\" */ say('it\\'s', \"c\"); // 'd'\n");
    assert_eq!(text.split_whitespace().collect::<Vec<_>>(), ["a", "${b}", "no", ".", "it\\'s", ".", "c", "."]);
    assert_eq!(text.lines().position(|l| l.contains('c')), Some(2));
}

/// Everything that is searched.
fn texts() -> Vec<String> {
    let pages =
        ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "recordings/README.md", "python/README.md"];
    let mut out: Vec<String> = pages.map(str::to_owned).to_vec();
    out.extend(files("docs", &[".md"]));
    out.extend(files("docs/history", &[".md"]));
    out.extend(["crates/stiction/README.md", "examples/fleet/README.md"].map(str::to_owned));
    out.extend(files("examples", &[".py", ".rs"]));
    out.extend(files("examples/fleet", &[".py"]).into_iter().filter(|name| !name.ends_with("measure.py")));
    out.extend(files("crates/stiction-web/src/assets", &[".js", ".html"]));
    out.push("crates/stiction-report/src/page.js".to_owned());
    out.extend(files("config", &[".toml", ".json5", ".service", ".yaml", ".yml"]));
    out.extend(files("packaging", &[".toml", ".sh", "Containerfile"]));
    out.extend(files("packaging/debian", &[""]).into_iter().filter(|name| root().join(name).is_file()));
    out
}

#[test]
fn no_phrase_comes_back() {
    let texts = texts();
    assert!(texts.len() > 40, "{texts:?}");
    for (name, _) in EXCEPT {
        assert!(root().join(name).exists(), "{name} is excepted and not there");
    }
    let mut faults = Vec::new();
    for name in texts.iter().filter(|name| EXCEPT.iter().all(|(except, _)| *except != name.as_str())) {
        let text = fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        let text = if name.ends_with(".js") { strings(&text) } else { text };
        faults.extend(phrases::found(&text).into_iter().map(|(line, what)| format!("{name}: line {line}: {what}")));
    }
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}

/// Words of a page, those of its tables, programs and quoted output included; a mark without a letter or digit is none.
fn words(page: &str) -> usize {
    page.split_whitespace().filter(|word| word.contains(char::is_alphanumeric)).count()
}

#[test]
fn the_pages_stay_within_what_is_read() {
    assert_eq!(words("# One two\n```sh\nand these\n```\n| five | - |"), 6);
    let mut sum = 0;
    for name in files("docs", &[".md"]).into_iter().filter(|n| !GENERATED.contains(&n.as_str())) {
        let count = words(&fs::read_to_string(root().join(&name)).unwrap());
        sum += count;
        assert!(count <= MAX_PAGE, "{name} has {count} words, at most {MAX_PAGE}");
    }
    assert!(sum <= MAX_WORDS, "the pages of docs have {sum} words, at most {MAX_WORDS}");
}
