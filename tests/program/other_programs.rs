//! Commands that other programs of the package carry out: found beside this one or on PATH, and how they are had otherwise.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

/// A folder with the program under test alone, as a package would have it without the others.
struct Installed(tempfile::TempDir);

impl Installed {
    fn new() -> Self {
        let built = Path::new(env!("CARGO_BIN_EXE_stictiond"));
        // On the same file system, so that a second name is enough.
        let folder = tempfile::tempdir_in(built.parent().unwrap()).unwrap();
        fs::hard_link(built, folder.path().join("stictiond")).unwrap();
        Self(folder)
    }

    /// A program that prints its arguments, each on a line, and ends with code 3.
    fn put(&self, folder: &str, name: &str) {
        let folder = self.0.path().join(folder);
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join(name);
        fs::write(&path, format!("#!/bin/sh\nprintf '%s\\n' \"{}\" \"$@\"\nexit 3\n", path.display())).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }

    fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(self.0.path().join("stictiond"));
        command.args(arguments).env("PATH", self.0.path().join("on-path")).output().unwrap()
    }
}

/// A command line, the program that carries it out, and what that is called with.
const CALLS: [(&[&str], &str, &[&str]); 5] = [
    (
        &["gap", "challenge", "new", "--seed", "2", "--out", "x"],
        "stiction-lab",
        &["challenge", "new", "--seed", "2", "--out", "x"],
    ),
    (
        &["--format", "json", "gap", "challenge", "score", "x"],
        "stiction-lab",
        &["challenge", "--format", "json", "score", "x"],
    ),
    (&["bridge", "mqtt", "--from", "mqtt://b"], "stictiond-bridge", &["mqtt", "--from", "mqtt://b"]),
    (&["discover", "opcua", "--from", "opc.tcp://plc"], "stictiond-bridge", &["discover", "--from", "opc.tcp://plc"]),
    (&["calibrate", "--help"], "stiction-lab", &["calibrate", "--help"]),
];

#[test]
fn the_program_beside_carries_out_the_whole_command() {
    let installed = Installed::new();
    for (arguments, name, wanted) in CALLS {
        installed.put("on-path", name);
        installed.put(".", name);
        let output = installed.run(arguments);
        let said = String::from_utf8(output.stdout).unwrap();
        let lines: Vec<&str> = said.lines().collect();
        assert_eq!(output.status.code(), Some(3), "{arguments:?}");
        assert_eq!(lines[1..], *wanted, "{arguments:?}");
        assert!(!lines[0].contains("on-path"), "{}", lines[0]);
    }
}

#[test]
fn the_program_on_path_is_found_and_a_missing_one_says_how_it_is_had() {
    let installed = Installed::new();
    for (arguments, name, _) in CALLS {
        let missing = installed.run(arguments);
        let said = String::from_utf8(missing.stderr).unwrap();
        assert_eq!(missing.status.code(), Some(1), "{arguments:?}");
        assert!(said.contains(&format!("in the program {name}")) && said.contains("get it by"), "{said}");
    }
    for (arguments, name, wanted) in CALLS {
        installed.put("on-path", name);
        let output = installed.run(arguments);
        let said = String::from_utf8(output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(3), "{arguments:?}");
        assert!(said.contains("on-path") && said.lines().skip(1).eq(wanted.iter().copied()), "{said}");
    }
}
