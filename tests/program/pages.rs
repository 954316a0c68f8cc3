//! The lines that the pages tell people to type: every line is run in order and its output compared, or another test runs it
//! ([`elsewhere`]). Slow lines run with small numbers, under `--all`.
//!
//! A fenced block marked `console` shows real output for a shipped recording: if a change is meant to alter it, run the command
//! and paste the output. `...` stands for omitted lines, or for the rest of a line. A block marked `results` shows output that
//! takes too long to repeat here: it is compared with the output that `tests/results.sh` stores in docs/results. Blocks with
//! other marks are not compared.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeSet;
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use crate::elsewhere;
use crate::live::{free_port, program, skipped, wait_for};

/// A line to type, and the lines shown below it.
pub struct Step {
    page: String,
    number: usize,
    pub line: String,
    shown: Vec<String>,
}

pub fn pages() -> Vec<(String, String)> {
    let others = ["README.md", "CONTRIBUTING.md", "crates/stictiond-bridge/README.md", "examples/fleet/README.md"];
    let mut names = others.map(str::to_owned).to_vec();
    names.extend(["packaging/README.md", "recordings/README.md"].map(str::to_owned));
    for folder in ["docs", "docs/dev"] {
        let files = fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
        names.extend(files.filter(|name| name.ends_with(".md")).map(|name| format!("{folder}/{name}")));
    }
    names.sort();
    names.into_iter().map(|name| (name.clone(), fs::read_to_string(name).unwrap())).collect()
}

/// Every line of a page's fenced blocks that is typed, continued lines joined; blocks marked `marks`, all if empty.
pub fn steps(page: &str, text: &str, marks: &[&str]) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::new();
    let (mut block, mut continued) = (None, false);
    for (at, line) in text.lines().enumerate() {
        // A block in a list is indented like its fence.
        let indent = block.map_or(0, |(_, indent)| indent);
        let line = line.get(indent..).unwrap_or_default();
        if let Some(mark) = line.trim_start().strip_prefix("```") {
            block = if block.is_some() { None } else { Some((mark, line.len() - line.trim_start().len())) };
            continue;
        }
        let Some((mark, _)) = block.filter(|(mark, _)| marks.is_empty() || marks.contains(mark)) else { continue };
        let prompt = line.strip_prefix("$ ");
        if continued {
            let last = &mut steps.last_mut().unwrap().line;
            last.push_str(line.trim_start().trim_end_matches('\\'));
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

/// The words of a line as a shell splits them, up to a comment, pipe or redirection.
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

/// The other programs of the package, which are built next to the program under test, but not by its tests.
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

/// The arguments of a line that calls the program under test.
fn arguments(line: &str) -> Option<Vec<String>> {
    call(line).filter(|(called, _)| *called == Path::new(&program())).map(|(_, arguments)| arguments)
}

/// Whether a word is a placeholder for the reader to replace: capitals alone, such as SECONDS.
fn is_placeholder(word: &str) -> bool {
    word.len() > 1 && word.chars().all(|c| c.is_ascii_uppercase() || c == '_')
}

/// Parses a line with `--help` appended, which stops before the command runs and after every word was read.
fn fault_of(called: &Path, arguments: &[String]) -> Option<String> {
    let mut said: Vec<&str> = Vec::new();
    for word in arguments {
        // The value of a placeholder is unknown here, so its flag is looked up in the help below.
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
            // Off by default; the build with OPC UA checks these lines too.
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

/// A program that a page starts and leaves running.
struct Running(Child);

impl Running {
    fn start(folder: &Path, arguments: &[String]) -> Self {
        // Here a workbench opens no browser, takes any port, and prints its address on the other channel.
        let quiet: &[&str] = if arguments[0] == "workbench" { &["--no-open", "--listen", "0"] } else { &[] };
        let mut command = Command::new("bash");
        command.args(["-c", "exec \"$0\" \"$@\" 2>&1", &program()]).args(arguments).args(quiet);
        let mut child = command.current_dir(folder).stdout(Stdio::piped()).spawn().unwrap();
        let mut log = BufReader::new(child.stdout.take().unwrap());
        let (mut line, mut before) = (String::new(), String::new());
        while !["watching", "http://"].iter().any(|ready| line.contains(ready)) {
            before.push_str(&line);
            line.clear();
            assert!(log.read_line(&mut line).unwrap() > 0, "{arguments:?} ended early:\n{before}");
        }
        // Its later log is not used, but its pipe must not fill up.
        std::thread::spawn(move || log.read_to_end(&mut Vec::new()));
        Self(child)
    }

    /// Stops it with Ctrl-C.
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

/// A copy of the files that the pages use. Its daemons listen on free ports, since the usual ones may be taken.
struct Place {
    folder: tempfile::TempDir,
    ports: [String; 2],
    running: Vec<Running>,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let place =
            Self { folder, ports: [free_port(), free_port()].map(|port| port.to_string()), running: Vec::new() };
        for name in ["recordings", "recordings/scenarios", "config", "examples"] {
            let to = place.folder.path().join(name);
            fs::create_dir_all(&to).unwrap();
            for path in fs::read_dir(name).unwrap().map(|e| e.unwrap().path()).filter(|path| path.is_file()) {
                fs::copy(&path, to.join(path.file_name().unwrap())).unwrap();
            }
        }
        for path in fs::read_dir(place.folder.path().join("config")).unwrap().map(|e| e.unwrap().path()) {
            fs::write(&path, place.moved(&fs::read_to_string(&path).unwrap())).unwrap();
        }
        place
    }

    fn moved(&self, text: &str) -> String {
        text.replace("7447", &self.ports[0]).replace("8080", &self.ports[1])
    }

    /// Runs a line in a shell that finds the programs under test.
    fn shell(&self, line: &str) -> Output {
        let path = std::env::var("PATH").unwrap_or_default();
        let programs = Path::new(&program()).parent().unwrap().to_owned();
        let mut command = Command::new("bash");
        command.args(["-o", "pipefail", "-c", line]).current_dir(self.folder.path());
        command.env("PATH", format!("{}:{path}", programs.display())).output().unwrap()
    }

    /// Runs one line of a page, and compares its output with the page.
    fn run(&mut self, step: &Step) -> Result<(), String> {
        let line = self.moved(&step.line);
        let arguments = arguments(&line).unwrap_or_default();
        match arguments.first().map(String::as_str) {
            Some(command @ ("run" | "demo" | "workbench")) => {
                // The daemons of a page use the ports one after another.
                if command != "workbench" {
                    self.end();
                }
                self.running.push(Running::start(self.folder.path(), &arguments));
                return Ok(());
            }
            // Publish what the bridge of the previous line would send.
            Some("discover") if line.contains("--connect") => {
                let mut play = Command::new(program());
                play.args(["play", "recordings/sticking.mcap", "--prefix", "plant1/area1/mqtt", "--speed", "50"]);
                play.args(["--connect", &format!("tcp/127.0.0.1:{}", self.ports[0])]).stdout(Stdio::null());
                self.running.push(Running(play.current_dir(self.folder.path()).spawn().unwrap()));
            }
            // The recording is complete once the daemon has ended.
            Some("replay") if line.contains("recordings/demo") => self.end(),
            _ => {}
        }
        let once = || {
            let output = self.shell(&line);
            let [printed, told] =
                [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
            if !output.status.success() {
                return Err(told);
            }
            // Metrics of one name may come in any order.
            let lacks = if line.starts_with("curl ") {
                step.shown.iter().find(|shown| !printed.lines().any(|line| line == *shown)).cloned()
            } else {
                missing(&step.shown, &printed)
            };
            match lacks {
                Some(lacks) => Err(format!("shows\n{lacks}\nand this build prints\n{printed}{told}")),
                None => Ok(()),
            }
        };
        if line.starts_with("curl ") {
            // Estimates come a moment after the last sample.
            wait_for(&line, || once().ok());
            return Ok(());
        }
        once()
    }

    fn end(&mut self) {
        self.running.drain(..).for_each(Running::stop);
    }
}

/// The first shown line that was not printed, with lines in order.
fn missing(shown: &[String], printed: &str) -> Option<String> {
    let mut printed = printed.lines();
    let shows = |shown: &str, printed: &str| match shown.strip_suffix("...") {
        Some(start) => printed.starts_with(start),
        None => printed == shown,
    };
    shown.iter().filter(|line| line.trim() != "...").find(|line| !printed.any(|p| shows(line, p))).cloned()
}

fn is_long(step: &Step) -> bool {
    step.line.starts_with("stiction-lab ")
}

#[test]
fn every_line_of_the_pages_runs_and_prints_what_is_shown() {
    let (mut faults, mut done) = (Vec::new(), 0);
    for (page, text) in pages() {
        let mut here = Place::new();
        let steps = steps(&page, &text, &["sh", "console"]);
        // Pages that query a daemon without starting one assume a daemon that has heard the recording of a sticking valve.
        let starts = |step: &Step| step.line.starts_with("stictiond run");
        if steps.iter().any(|step| step.line.starts_with("curl ")) && !steps.iter().any(starts) {
            for line in ["stictiond run --config config/demo.toml", HEARD] {
                let step = Step { page: page.clone(), number: 0, line: line.to_owned(), shown: Vec::new() };
                faults.extend(here.run(&step).err());
            }
        }
        for step in steps {
            if is_long(&step) || elsewhere::runs(&step.line) {
                continue;
            }
            if let Some(tool) = ["curl", "openssl"].into_iter().find(|tool| step.line.starts_with(*tool))
                && !here.shell(&format!("{tool} --version || {tool} version")).status.success()
            {
                skipped("every_line_of_the_pages_runs", &format!("no {tool} for {page}: line {}", step.number));
                continue;
            }
            done += 1;
            faults
                .extend(here.run(&step).err().map(|why| format!("{page}: line {}: {}: {why}", step.number, step.line)));
        }
        here.end();
    }
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
    assert!(done > 30, "only {done} lines were found");
}

/// Gives the daemon of the pages an answer and an alarm.
const HEARD: &str = "stictiond play recordings/sticking.mcap --connect tcp/127.0.0.1:7447 --prefix demo --speed 200";

/// A line with small numbers, so that it ends in minutes, on shipped recordings.
fn small(line: &str) -> String {
    const COUNTS: [(&str, &str); 8] = [
        ("--loops", "40"),
        ("--simulated", "20"),
        ("--cases", "1"),
        ("--intervals", "4"),
        ("--bump-test", "4"),
        ("--plants", "2"),
        ("--reversals", "8"),
        ("--for", "5"),
    ];
    let mut words: Vec<String> = line.split(' ').map(str::to_owned).collect();
    for at in 1..words.len() {
        if let Some((_, few)) = COUNTS.iter().find(|(flag, _)| *flag == words[at - 1]) {
            words[at] = (*few).to_owned();
        }
    }
    if line.contains("challenge run") {
        words.extend(["--evaluations", "3000"].map(str::to_owned));
    }
    words.join(" ")
}

#[test]
#[ignore = "minutes; --all runs it"]
fn lines_that_take_long_run_with_small_numbers() {
    let (mut faults, mut done) = (Vec::new(), 0);
    for (page, text) in pages() {
        let mut here = Place::new();
        let index = "file,label\nrecordings/sticking.mcap,stiction\nrecordings/physical.mcap,stiction\n";
        fs::write(here.folder.path().join("INDEX.csv"), index).unwrap();
        for step in steps(&page, &text, &["sh", "results"]).into_iter().filter(is_long) {
            let step = Step { line: small(&step.line), shown: Vec::new(), ..step };
            done += 1;
            faults
                .extend(here.run(&step).err().map(|why| format!("{page}: line {}: {}: {why}", step.number, step.line)));
        }
    }
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
    assert!(done > 10, "only {done} lines were found");
}

/// `tests/interop/receivers.py` runs the consumer of alarms.
#[test]
fn the_consumer_on_the_page_is_the_example() {
    let example = fs::read_to_string("examples/alarm_webhook.py").unwrap();
    assert!(fs::read_to_string("docs/alarms.md").unwrap().contains(&format!("```python\n{example}```")));
}

/// Configurations on the pages are files in `config`, and `check` finds faults only in the one that is meant to have them.
#[test]
fn configurations_of_the_pages_are_files_without_faults() {
    let mut shown = BTreeSet::new();
    for (page, text) in pages() {
        for block in text.split("```toml\n").skip(1) {
            let block = block.split("```").next().unwrap();
            let lines: Vec<&str> = block.lines().map(|line| line.strip_prefix("   ").unwrap_or(line)).collect();
            let Some(name) = lines[0].strip_prefix("# ").and_then(|line| line.split(':').next()) else { continue };
            let file = fs::read_to_string(name).unwrap_or_else(|e| panic!("{page}: {name}: {e}"));
            assert_eq!(lines.join("\n").trim_end(), file.trim_end(), "{page} shows another {name}");
            shown.insert(name.to_owned());
        }
    }
    assert!(shown.len() >= 7, "{shown:?}");
    let here = Place::new();
    for path in fs::read_dir("config")
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| p.extension().is_some_and(|e| e == "toml"))
    {
        let name = path.display().to_string();
        // Cases of `stictiond test` are not a configuration.
        if name != "config/expectations.toml" {
            let checked = here.shell(&format!("stictiond check {name}"));
            assert_eq!(
                checked.status.success(),
                name != "config/broken.toml",
                "{}",
                String::from_utf8_lossy(&checked.stderr)
            );
        }
    }
}

/// Pages whose figures are all quoted from docs/results.
const OF_FIGURES: [&str; 2] = ["docs/accuracy.md", "docs/dev/evaluation.md"];

/// Stored output by command, the last one printed.
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

/// The calibrations that a command's figures depend on; its stored output names their hashes.
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

/// Stored output of earlier builds, which pages may quote as such, and the cost of repeating it.
const OLDER: [(&str, &str); 1] =
    [("stiction-lab calibrate --intervals 600 --seed 33000", "28,800 loops, some hours of two cores")];

/// The hash of a calibration in a line of provenance.
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
