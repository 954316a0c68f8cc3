//! One whole report page, compared with a copy that was checked by eye: `tests/golden/page.html`.
//!
//! If the page is meant to change, write a new copy and check the differences: `STICTIOND_GOLDEN=write cargo test --test
//! program golden`.

use std::fs;
use std::process::Command;

use sha2::{Digest, Sha256};

const GOLDEN: &str = "tests/golden/page.html";

/// The page without anything that differs between builds or machines. Long runs of coordinates are replaced by their hash, one
/// tag a line.
fn normalised(page: &str, folder: &str) -> String {
    let page = page.replace(folder, "FOLDER").replace(env!("CARGO_PKG_VERSION"), "VERSION").replace("><", ">\n<");
    let (mut out, mut elapsed) = (String::with_capacity(page.len()), false);
    for line in page.lines() {
        // The run time is in the cell after its name.
        if core::mem::replace(&mut elapsed, line.contains("elapsed_ms")) {
            out.push_str("ELAPSED\n");
            continue;
        }
        let short = line.split('"').enumerate().map(|(at, part)| {
            let digits = part.bytes().filter(u8::is_ascii_digit).count();
            // Odd-numbered parts are inside quotes.
            if at % 2 == 1 && part.len() > 60 && 2 * digits > part.len() { hash(part) } else { part.to_owned() }
        });
        out.push_str(&short.collect::<Vec<_>>().join("\""));
        out.push('\n');
    }
    out
}

fn hash(text: &str) -> String {
    let digest = Sha256::digest(text.as_bytes());
    let hex: String = digest.iter().take(6).map(|byte| format!("{byte:02x}")).collect();
    format!("{} bytes {hex}", text.len())
}

#[test]
fn the_page_is_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("page.html");
    let arguments =
        ["analyze", "recordings/sticking.mcap", "--samples", "1,300", "--valve", "he", "--op-range", "0,100"];
    let output = Command::new(env!("CARGO_BIN_EXE_stictiond")).args(arguments).arg("--report").arg(&page).output();
    let output = output.unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let found = normalised(&fs::read_to_string(&page).unwrap(), folder.path().to_str().unwrap());
    if std::env::var("STICTIOND_GOLDEN").is_ok_and(|wish| wish == "write") {
        fs::write(GOLDEN, &found).unwrap();
        return;
    }
    let wanted = fs::read_to_string(GOLDEN).unwrap();
    let first = wanted.lines().zip(found.lines()).position(|(a, b)| a != b);
    let at = first.unwrap_or_else(|| wanted.lines().count().min(found.lines().count()));
    let line = |text: &str| text.lines().nth(at).unwrap_or("(end)").to_owned();
    assert!(
        wanted == found,
        "line {}: was\n  {}\nis\n  {}\nIf that is meant: STICTIOND_GOLDEN=write cargo test --test program golden",
        at + 1,
        line(&wanted),
        line(&found)
    );
}
