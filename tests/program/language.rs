//! The help of every command is plain English, as the pages are (`tests/library/language.rs`).

use crate::common::program::stictiond;

#[path = "../common/phrases.rs"]
mod phrases;

/// The commands that a help lists.
fn commands(help: &str) -> Vec<String> {
    let rows = help.lines().skip_while(|l| *l != "Commands:").skip(1).take_while(|l| !l.is_empty());
    let names =
        rows.filter(|l| l.starts_with("  ") && !l.starts_with("   ")).filter_map(|l| l.split_whitespace().next());
    names.filter(|name| *name != "help").map(str::to_owned).collect()
}

/// The help below some commands, that of every command below them included.
fn helps(path: &[String]) -> Vec<(String, String)> {
    let mut arguments: Vec<&str> = path.iter().map(String::as_str).collect();
    arguments.push("--help");
    let output = stictiond(&arguments);
    // A command that the bridge's build leaves out has no help of its own.
    if String::from_utf8_lossy(&output.stderr).contains("this build has no OPC UA client") {
        return Vec::new();
    }
    assert!(output.status.success(), "{arguments:?}");
    let help = String::from_utf8(output.stdout).unwrap();
    let below: Vec<Vec<String>> = commands(&help).into_iter().map(|name| [path, &[name]].concat()).collect();
    let mut out = vec![(arguments.join(" "), help)];
    out.extend(below.iter().flat_map(|path| helps(path)));
    out
}

#[test]
fn no_phrase_is_in_the_help() {
    let helps = helps(&[]);
    assert!(helps.len() > 25, "{}", helps.len());
    let mut faults = Vec::new();
    for (name, help) in helps {
        faults.extend(phrases::found(&help).into_iter().map(|(line, what)| format!("{name}: line {line}: {what}")));
    }
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}
