//! What the pages tell people to type: every command line is accepted, and those of docs/five-minutes.md work in
//! order, with the output that is shown.
//!
//! A fenced block marked `console` shows real output of a shipped recording: where a change means to alter it, run the
//! command and paste what it prints. `...` stands for lines, or the rest of a line, that are left out. A block marked `results`
//! shows output that takes too long to make again here: it is compared with what `tests/results.sh` keeps in docs/results.
//! Blocks of other marks are not compared.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use crate::live::{free_port, http, program, wait_for};

/// Steps of the five minutes that fetch or build something, or only set the shell up.
const NOT_RUN: [&str; 5] =
    ["cargo build", "export PATH=", "python3 -m venv", "target/venv/bin/pip", "target/venv/bin/python"];

/// One line to type, and the lines that are shown below it.
struct Step {
    page: String,
    number: usize,
    line: String,
    shown: Vec<String>,
}

fn pages() -> Vec<(String, String)> {
    let mut names = ["README.md", "CONTRIBUTING.md", "examples/fleet/README.md"].map(str::to_owned).to_vec();
    let docs = fs::read_dir("docs").unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
    names.extend(docs.filter(|name| name.ends_with(".md")).map(|name| format!("docs/{name}")));
    names.sort();
    names.into_iter().map(|name| (name.clone(), fs::read_to_string(name).unwrap())).collect()
}

/// Every line of a page's fenced blocks that is typed, continued lines joined; blocks marked `marks`, all if empty.
fn steps(page: &str, text: &str, marks: &[&str]) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::new();
    let (mut block, mut continued) = (None, false);
    for (at, line) in text.lines().enumerate() {
        if let Some(mark) = line.strip_prefix("```") {
            block = if block.is_some() { None } else { Some(mark) };
            continue;
        }
        let Some(mark) = block.filter(|mark| marks.is_empty() || marks.contains(mark)) else { continue };
        let prompt = line.strip_prefix("$ ");
        if continued {
            let last = &mut steps.last_mut().unwrap().line;
            last.push_str(line.trim_end_matches('\\'));
        } else if let Some(typed) = prompt.or((mark == "sh" && !line.is_empty()).then_some(line)) {
            let line = typed.trim_end_matches('\\').to_owned();
            steps.push(Step { page: page.to_owned(), number: at + 1, line, shown: Vec::new() });
        } else if let Some(last) = steps.last_mut().filter(|_| ["console", "results"].contains(&mark)) {
            last.shown.push(line.to_owned());
        }
        continued = line.ends_with('\\') && (continued || prompt.is_some() || mark == "sh");
    }
    steps
}

/// The words of a line as a shell has them, up to a comment, pipe or redirection.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for c in line.chars() {
        match quote {
            Some(q) if q == c => quote = None,
            None if c == '\'' || c == '"' => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            None if c == ' ' => words.extend(word.take()),
            _ => word.get_or_insert_default().push(c),
        }
    }
    words.extend(word);
    words.into_iter().take_while(|w| !["#", "|", ">"].contains(&w.as_str())).collect()
}

/// The other programs of the package: built beside the program under test, but not by its own tests.
const OTHERS: [&str; 2] = ["stiction-lab", "stictiond-bridge"];

/// Program and arguments of a line that calls one of the package; `None` for other lines.
fn call(line: &str) -> Option<(PathBuf, Vec<String>)> {
    let words = words(line);
    match words.first()?.as_str() {
        "stictiond" => Some((program().into(), words[1..].to_vec())),
        "cargo" if words.get(1).is_some_and(|w| w == "run") => {
            words.iter().position(|w| w == "--").map(|at| (program().into(), words[at + 1..].to_vec()))
        }
        other if OTHERS.contains(&other) => Some((Path::new(&program()).with_file_name(other), words[1..].to_vec())),
        _ => None,
    }
}

/// The arguments of a line that calls the program itself.
fn arguments(line: &str) -> Option<Vec<String>> {
    call(line).filter(|(called, _)| *called == Path::new(&program())).map(|(_, arguments)| arguments)
}

/// What a reader puts something in place of: capitals alone, such as SECONDS.
fn is_placeholder(word: &str) -> bool {
    word.len() > 1 && word.chars().all(|c| c.is_ascii_uppercase() || c == '_')
}

/// `--help` at the end ends the parse before anything is run, and after every word before it was read.
fn fault_of(called: &Path, arguments: &[String]) -> Option<String> {
    let mut said: Vec<&str> = Vec::new();
    for word in arguments {
        // A placeholder stands for a value that this test does not know: its flag is looked up in the help below.
        let value = is_placeholder(word) && said.last().is_some_and(|last| last.starts_with("--"));
        if value {
            said.pop();
        } else {
            said.push(word);
        }
    }
    said.push("--help");
    let output = Command::new(called).args(&said).output().unwrap();
    let help = String::from_utf8(output.stdout).unwrap();
    if !output.status.success() {
        let text = String::from_utf8(output.stderr).unwrap();
        return Some(text.lines().next().unwrap_or_default().to_owned());
    }
    let known = |flag: &str| help.split_whitespace().any(|w| w == flag);
    let flags = arguments.iter().filter(|w| w.starts_with("--"));
    flags.map(|f| f.split('=').next().unwrap()).find(|f| !known(f)).map(|f| format!("{f} is not in the help"))
}

/// Whether a build of the bridge has the OPC UA client.
fn has_opcua(bridge: &Path) -> bool {
    let help = Command::new(bridge).args(["opcua", "--help"]).output().unwrap();
    help.status.success()
}

#[test]
fn every_command_line_is_accepted() {
    let (mut faults, mut seen) = (Vec::new(), 0);
    for (page, text) in pages() {
        for step in steps(&page, &text, &[]) {
            let Some((called, arguments)) = call(&step.line) else { continue };
            if !called.exists() {
                crate::common::skipped("every_command_line_is_accepted", &format!("no {}", called.display()));
                continue;
            }
            // Off by default: the build that has OPC UA reads these lines, too.
            let of_opcua = arguments.first().is_some_and(|word| ["opcua", "discover"].contains(&word.as_str()));
            if called.ends_with("stictiond-bridge") && of_opcua && !has_opcua(&called) {
                continue;
            }
            seen += 1;
            let fault =
                fault_of(&called, &arguments).map(|why| format!("{page}: line {}: {}: {why}", step.number, step.line));
            faults.extend(fault);
        }
    }
    assert!(seen > 30, "only {seen} command lines were found");
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}

#[test]
fn a_wrong_command_line_is_not_accepted() {
    let fault = |line: &str| fault_of(program().as_ref(), &arguments(line).unwrap());
    for wrong in ["stictiond analyse x.csv", "stictiond gap x.csv --base", "stictiond demo --for ever"] {
        assert!(fault(wrong).is_some(), "{wrong}");
    }
    for wrong in ["stictiond analyze x.csv --fast", "stictiond replay x.mcap --seed SEED", "stictiond check --speed 3"]
    {
        assert!(fault(wrong).is_some(), "{wrong}");
    }
    for right in ["stictiond demo --for SECONDS  # so long", "cargo run --release -- demo --for 5 | head"] {
        assert_eq!(fault(right), None, "{right}");
    }
}

/// A daemon that the five minutes start, ended as they say.
struct Running(Child);

impl Running {
    fn start(folder: &Path, arguments: &[String]) -> Self {
        let mut command = Command::new(program());
        let mut child = command.args(arguments).current_dir(folder).stderr(Stdio::piped()).spawn().unwrap();
        let mut log = BufReader::new(child.stderr.take().unwrap());
        let (mut line, mut before) = (String::new(), String::new());
        while !line.contains("watching") {
            before.push_str(&line);
            line.clear();
            assert!(log.read_line(&mut line).unwrap() > 0, "it ended early:\n{before}");
        }
        // Nobody waits for what it logs later, but its pipe must not fill up.
        std::thread::spawn(move || log.read_to_end(&mut Vec::new()));
        Self(child)
    }

    /// Ctrl-C.
    fn stop(mut self) {
        let pid = self.0.id().to_string();
        assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
        assert!(self.0.wait().unwrap().success());
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Copies what the steps read, one folder deep.
fn copied(names: &[&str], to: &Path) {
    for name in names {
        fs::create_dir_all(to.join(name)).unwrap();
        for entry in fs::read_dir(name).unwrap().map(Result::unwrap).filter(|e| e.path().is_file()) {
            fs::copy(entry.path(), to.join(name).join(entry.file_name())).unwrap();
        }
    }
}

/// The first line that is shown and was not printed, in the order in which lines are shown.
fn missing(shown: &[String], printed: &str) -> Option<String> {
    let mut printed = printed.lines();
    let shows = |shown: &str, printed: &str| match shown.strip_suffix("...") {
        Some(start) => printed.starts_with(start),
        None => printed == shown,
    };
    shown.iter().filter(|line| line.trim() != "...").find(|line| !printed.any(|p| shows(line, p))).cloned()
}

#[track_caller]
fn compare(step: &Step, printed: &str) {
    if let Some(line) = missing(&step.shown, printed) {
        panic!("{}: line {}: {}\nshows\n{line}\nand this build prints\n{printed}", step.page, step.number, step.line);
    }
}

/// Runs one line in a folder; the ports are the test's.
#[track_caller]
fn run(step: &Step, arguments: &[String], folder: &Path) {
    let output = Command::new(program()).args(arguments).current_dir(folder).output().unwrap();
    let (printed, told) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    assert!(output.status.success(), "{}: line {}: {}\n{told}", step.page, step.number, step.line);
    compare(step, &printed);
}

#[test]
fn the_five_minutes_work_as_pasted() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    copied(&["recordings", "config", "examples"], folder);
    // The usual ports may be taken on the machine that runs the tests.
    let (bus, web) = (free_port().to_string(), free_port().to_string());
    let moved = |text: &str| text.replace("7447", &bus).replace("8080", &web);
    let config = folder.join("config/demo.toml");
    fs::write(&config, moved(&fs::read_to_string(&config).unwrap())).unwrap();

    let page = "docs/five-minutes.md";
    let text = fs::read_to_string(page).unwrap();
    let mut daemon = None;
    let mut done = 0;
    for step in steps(page, &text, &["sh", "console"]) {
        let line = moved(&step.line);
        if let Some(arguments) = arguments(&line) {
            if arguments[0] == "run" {
                daemon = Some(Running::start(folder, &arguments));
            } else {
                if line.contains("replay recordings/demo") {
                    daemon.take().expect("a daemon to end").stop();
                }
                run(&step, &arguments, folder);
            }
        } else if line.starts_with("curl ") {
            let words = words(&line);
            let (address, path) = words[2].trim_start_matches("http://").split_once('/').unwrap();
            // Estimates take a moment after the last sample; series of one name come in any order.
            wait_for(&step.line, || {
                let metrics = http(address, &format!("/{path}"));
                step.shown.iter().all(|shown| metrics.lines().any(|line| line == shown)).then_some(())
            });
        } else {
            assert!(NOT_RUN.iter().any(|known| line.starts_with(known)), "line {}: {line}", step.number);
            continue;
        }
        done += 1;
    }
    assert!(done >= 9 && daemon.is_none(), "only {done} steps");
}

#[test]
fn outputs_on_the_other_pages_are_those_of_this_build() {
    let folder = tempfile::tempdir().unwrap();
    copied(&["recordings", "config", "examples"], folder.path());
    let mut done = 0;
    let others =
        pages().into_iter().filter(|(page, _)| !["docs/five-minutes.md", "docs/tutorial.md"].contains(&page.as_str()));
    for (page, text) in others {
        for step in steps(&page, &text, &["console"]) {
            run(&step, &arguments(&step.line).unwrap(), folder.path());
            done += 1;
        }
    }
    assert!(done >= 2, "{done}");
}

#[test]
fn the_tutorial_shows_output_of_each_step_and_writes_its_report() {
    let folder = tempfile::tempdir().unwrap();
    copied(&["recordings"], folder.path());
    let text = fs::read_to_string("docs/tutorial.md").unwrap();
    let steps = steps("docs/tutorial.md", &text, &["console"]);
    assert_eq!(steps.len(), text.matches("\n$ ").count(), "a step is in a block of another mark");
    for step in &steps {
        assert!(step.shown.iter().any(|line| line.trim() != "..."), "line {}: no output is shown", step.number);
        run(step, &arguments(&step.line).unwrap(), folder.path());
    }
    let report = fs::read_to_string(folder.path().join("fic501.html")).unwrap();
    assert!(report.contains("41FIC501"));
}

/// Pages whose figures are all quoted from docs/results.
const OF_FIGURES: [&str; 4] = ["docs/compare.md", "docs/evaluation.md", "docs/gap-evaluation.md", "docs/sizing.md"];

/// What is kept, by the last command that printed it.
fn kept() -> Vec<(String, String)> {
    let files = fs::read_dir("docs/results").unwrap().map(|entry| fs::read_to_string(entry.unwrap().path()).unwrap());
    let of = |text: String| {
        let commands = text.lines().take_while(|line| line.starts_with("$ ")).count();
        let last = text.lines().nth(commands.checked_sub(1)?)?;
        let printed: Vec<&str> = text.lines().skip(commands).collect();
        Some((last[2..].to_owned(), printed.join("\n")))
    };
    files.map(|text| of(text).expect("a command at the head of each kept file")).collect()
}

/// The calibrations that a command's figures follow from; its kept output names the hashes of those that it was made with.
fn behind(command: &str) -> &'static [&'static str] {
    let is = |words: &str| command.contains(words);
    match command {
        _ if is("challenge score") => &["gap"],
        _ if is("calibrate --intervals") => &["intervals"],
        // It measures classifiers that it fits itself, not the shipped one.
        _ if is("calibrate --loops") || is("measure.py") || is("bench") => &[],
        _ => &["classifier"],
    }
}

/// Kept output of earlier builds, which pages may quote as such, and what it costs to make it again.
const OLDER: [(&str, &str); 2] = [
    ("stiction-lab calibrate --intervals 600 --seed 33000", "28,800 loops, some hours of two cores"),
    ("stiction-lab challenge score b20", "932 loops with a search each, some hours of two cores"),
];

/// The hash that a line of provenance gives to a calibration.
fn hash_of<'a>(line: &'a str, calibration: &str) -> Option<&'a str> {
    line.split([',', ' ']).filter(|word| !word.is_empty()).skip_while(|word| *word != calibration).nth(1)
}

#[test]
fn kept_figures_name_their_build_and_are_of_the_shipped_calibrations() {
    let (shipped, mut faults) = (stiction_engine::provenance(), Vec::new());
    for (command, printed) in kept() {
        let [build, commit] = ["build: ", "commit "].map(|start| printed.lines().find(|line| line.starts_with(start)));
        let older = OLDER.iter().any(|(known, _)| *known == command);
        let (Some(build), Some(_)) = (build, commit) else {
            faults.push(format!("{command}: no build and commit are named; run tests/results.sh again"));
            continue;
        };
        let differs = |name: &&&str| hash_of(build, name).is_none() || hash_of(build, name) != hash_of(&shipped, name);
        let differing: Vec<&&str> = behind(&command).iter().filter(differs).collect();
        if differing.is_empty() == older {
            let what = if older {
                "is of this build after all: take it off OLDER".to_owned()
            } else {
                format!(
                    "{differing:?} changed since; run tests/results.sh again, or put it on OLDER and name it so on its page"
                )
            };
            faults.push(format!("{command}: {what}"));
        }
    }
    for (page, text) in pages() {
        let quoted = steps(&page, &text, &["results"]).into_iter().filter(|step| !step.shown.is_empty());
        let older = quoted.filter(|step| OLDER.iter().any(|(known, _)| *known == step.line));
        let unsaid = older.filter(|_| !text.contains("earlier build"));
        faults.extend(unsaid.map(|step| format!("{page}: line {}: say that this is of an earlier build", step.number)));
    }
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}

/// Lines with a decimal number in blocks marked `text`, which nothing compares.
fn figures_in_text(text: &str) -> impl Iterator<Item = &str> {
    let mut block = None;
    text.lines().filter(move |line| {
        if let Some(mark) = line.strip_prefix("```") {
            block = if block.is_some() { None } else { Some(mark) };
        }
        let digits = |w: &[u8]| w[0].is_ascii_digit() && w[1] == b'.' && w[2].is_ascii_digit();
        block == Some("text") && line.as_bytes().windows(3).any(digits)
    })
}

#[test]
fn quoted_figures_are_those_that_are_kept() {
    let (kept, mut faults, mut seen) = (kept(), Vec::new(), 0);
    for (page, text) in pages() {
        for Step { page, number, line, shown } in steps(&page, &text, &["results"]) {
            if shown.is_empty() {
                continue;
            }
            seen += 1;
            match kept.iter().find(|(command, _)| *command == line) {
                None => faults.push(format!("{page}: line {number}: docs/results keeps nothing of {line}")),
                Some((_, printed)) => {
                    let fault = missing(&shown, printed);
                    faults.extend(fault.map(|shown| format!("{page}: line {number}: {line} did not print\n{shown}")));
                }
            }
        }
        if OF_FIGURES.contains(&page.as_str()) {
            let unmarked = figures_in_text(&text);
            faults.extend(unmarked.map(|line| format!("{page}: mark the block results, its command first: {line}")));
        }
    }
    assert!(seen >= 8, "only {seen} quotations were found");
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}
