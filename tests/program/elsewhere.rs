//! Lines of the pages that are too slow or too invasive for a test of this program, and the code that runs them instead.

use std::fs;

use crate::pages::{pages, steps};

/// A file, and a piece of code in it.
type Code = (&'static str, &'static str);

const BY_INTEROP: Code = ("tests/run.sh", "bash tests/interop/run.sh");
const INTEROP: [Code; 2] = [("tests/interop/run.sh", "exec \"$python\" tests/interop/test_interop.py"), BY_INTEROP];
const PACKAGE: Code = ("tests/run.sh", "bash tests/package/run.sh");
const INSTALLED: [Code; 2] = [("tests/package/run.sh", "python3 tests/package/install.py"), PACKAGE];
const PYTHON: [Code; 2] = [("python/test.sh", "-m pytest --quiet -p no:cacheprovider python/tests"), BY_PYTHON];
const BY_PYTHON: Code = ("tests/run.sh", "bash python/test.sh");

/// The start of the line, the code that does what it says, and the code that runs that, up to `tests/run.sh`. Code that reads
/// the line from its page (`typed`) cannot run a different one.
const ELSEWHERE: &[(&str, &[Code], &[Code])] = &[
    ("cargo build --release", &[("tests/run.sh", "cargo check --locked --quiet -p stictiond")], &[]),
    (
        "cargo build --profile dist",
        &[("Cargo.toml", "[profile.dist]"), ("tests/package/run.sh", "cargo build --locked --quiet --features full")],
        &[PACKAGE],
    ),
    ("packaging/deb.sh", &[("tests/package/run.sh", "packaging/deb.sh --binary")], &[PACKAGE]),
    ("apt-get install ./target/package", &[("tests/package/install.py", "dpkg(\"--install\", FIRST)")], &INSTALLED),
    ("editor /etc/stictiond/monitor.toml", &[("tests/package/install.py", "CONFIG.write_text(mine)")], &INSTALLED),
    ("stictiond check /etc", &[("tests/package/install.py", "\"check\", \"/etc/stictiond/monitor.toml\"")], &INSTALLED),
    // By hand, since it boots a system: `tests/package/run.sh --boot`.
    (
        "systemctl enable --now stictiond",
        &[("tests/package/boot.sh", "systemctl enable --now stictiond")],
        &[("tests/package/run.sh", "ExecStart=/bin/bash /boot.sh"), PACKAGE],
    ),
    ("stictiond-bridge discover", &[("tests/interop/opcua.py", "typed(\"stictiond-bridge discover\"")], &INTEROP),
    ("stictiond-bridge opcua", &[("tests/interop/opcua.py", "typed(\"stictiond-bridge opcua\"")], &INTEROP),
    ("stictiond-bridge mqtt", &[("tests/interop/bridge.py", "typed(\"stictiond-bridge mqtt\"")], &INTEROP),
    ("pip install ./python", &[("python/test.sh", "-m pip install")], &[BY_PYTHON]),
    ("python examples/fleet/make.py", &[("python/tests/test_fleet.py", "typed(\"make.py\"")], &PYTHON),
    ("python examples/fleet/pool_fleet.py", &[("python/tests/test_fleet.py", "typed(\"pool_fleet.py\"")], &PYTHON),
    ("python examples/fleet/dask_fleet.py", &[("python/tests/test_fleet.py", "typed(\"dask_fleet.py\"")], &PYTHON),
];

/// The tests themselves: this test is run by one of them, and the other one runs that.
const THIS: [&str; 2] = ["bash tests/run.sh", "bash .ci/run"];

/// Whether other code runs a line of a page.
pub fn runs(line: &str) -> bool {
    THIS.iter().any(|start| line.starts_with(start)) || ELSEWHERE.iter().any(|(start, ..)| line.starts_with(start))
}

/// Whether a file has the code, outside of comments.
fn has(file: &str, code: &str) -> bool {
    let text = fs::read_to_string(file).unwrap_or_default();
    let comment = |line: &str| ["#", "//", "\"\"\""].iter().any(|mark| line.trim_start().starts_with(mark));
    text.lines().any(|line| line.contains(code) && !comment(line))
}

#[test]
fn lines_that_other_code_runs_are_run_there() {
    let typed: Vec<String> =
        pages().iter().flat_map(|(page, text)| steps(page, text, &["sh", "console"])).map(|step| step.line).collect();
    let mut faults = Vec::new();
    for (start, does, chain) in ELSEWHERE {
        if !typed.iter().any(|line| line.starts_with(start)) {
            faults.push(format!("no page has a line that begins with {start}: take it off the list"));
        }
        let lacks = does.iter().chain(*chain).filter(|(file, code)| !has(file, code));
        faults.extend(lacks.map(|(file, code)| format!("{start}: {file} does not run {code}")));
        let last = chain.last().or(does.last()).map(|(file, _)| *file);
        if last != Some("tests/run.sh") {
            faults.push(format!("{start}: nothing leads from tests/run.sh to {last:?}"));
        }
        // A test in Python counts only if the one that is run knows it.
        for (file, _) in does.iter().filter(|(file, _)| file.starts_with("tests/interop/")) {
            let module = file.trim_start_matches("tests/interop/").trim_end_matches(".py");
            if !has("tests/interop/test_interop.py", &format!("from {module} import ")) {
                faults.push(format!("{start}: tests/interop/test_interop.py does not run {file}"));
            }
        }
    }
    for line in THIS {
        let script = line.trim_start_matches("bash ");
        let parses = std::process::Command::new("bash").args(["-n", script]).status().unwrap().success();
        if !parses || !typed.iter().any(|typed| typed.starts_with(line)) {
            faults.push(format!("{line}: is not a script, or no page has it"));
        }
    }
    if !has(".ci/run", "bash tests/run.sh") {
        faults.push(".ci/run does not run tests/run.sh".to_owned());
    }
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}

#[test]
fn code_in_a_comment_does_not_count() {
    assert!(has("tests/run.sh", "bash tests/package/run.sh") && has("Cargo.toml", "[profile.dist]"));
    assert!(!has("tests/run.sh", "--all adds what takes long"));
    assert!(!has("tests/no-such-file", ""));
}
