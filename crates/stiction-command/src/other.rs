//! Another program of this package, run in place of this one.

use std::ffi::{OsStr, OsString};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, anyhow};
use clap::ValueEnum;

use crate::{Format, Outcome, OutputArgs};

/// The rest of a command line, which another program reads.
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
pub struct RestArgs {
    /// Arguments of the other program.
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    pub rest: Vec<OsString>,
}

/// A program that the package has beside this one.
#[derive(Debug, Clone, Copy)]
pub struct OtherProgram {
    /// Its file's name.
    pub name: &'static str,
    /// How it is built from the sources.
    pub build: &'static str,
}

impl OtherProgram {
    /// Runs it in place of this process, with `words` and then the rest of the command line.
    ///
    /// # Errors
    /// It is found neither beside this program nor on PATH, or cannot be run.
    pub fn run(&self, output: OutputArgs, words: &[&str], args: &RestArgs) -> anyhow::Result<Outcome> {
        let beside = std::env::current_exe().ok();
        let search = std::env::var_os("PATH").unwrap_or_default();
        let path = self.find(beside.as_deref(), &search).ok_or_else(|| self.missing(beside.as_deref()))?;
        let mut command = Command::new(&path);
        command.args(words);
        for (flag, format) in [("--format", output.format), ("--log", output.log)] {
            if let Some(value) = format.to_possible_value().filter(|_| format != Format::default()) {
                command.args([flag, value.get_name()]);
            }
        }
        // It returns only where the other program cannot be started.
        let error = command.args(&args.rest).exec();
        Err(error).with_context(|| format!("cannot run {}", path.display()))
    }

    fn find(&self, this: Option<&Path>, search: &OsStr) -> Option<PathBuf> {
        let beside = this.and_then(Path::parent).map(Path::to_owned);
        // A relative folder of PATH would run whatever lies where the command is called.
        let folders = std::env::split_paths(search).filter(|folder| folder.is_absolute());
        beside.into_iter().chain(folders).map(|folder| folder.join(self.name)).find(|path| path.is_file())
    }

    fn missing(&self, this: Option<&Path>) -> anyhow::Error {
        let beside =
            this.and_then(Path::parent).map_or_else(String::new, |folder| format!(" in {} or", folder.display()));
        anyhow!("this command is in the program {}, which is not{beside} on PATH; get it by: {}", self.name, self.build)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OTHER: OtherProgram = OtherProgram { name: "other", build: "cargo build -p other" };

    #[test]
    fn the_program_beside_this_one_comes_before_those_on_path() {
        let folder = std::env::temp_dir().join(format!("stiction-command-{}", std::process::id()));
        let [beside, path] = ["beside", "path"].map(|name| folder.join(name));
        for place in [&beside, &path] {
            std::fs::create_dir_all(place).unwrap();
        }
        let this = beside.join("this");
        assert_eq!(OTHER.find(Some(&this), path.as_os_str()), None);
        std::fs::write(path.join("other"), "").unwrap();
        assert_eq!(OTHER.find(Some(&this), path.as_os_str()), Some(path.join("other")));
        std::fs::write(beside.join("other"), "").unwrap();
        assert_eq!(OTHER.find(Some(&this), path.as_os_str()), Some(beside.join("other")));
        assert_eq!(OTHER.find(None, OsStr::new(".")), None);
        std::fs::remove_dir_all(&folder).unwrap();
        let why = OTHER.missing(Some(&this)).to_string();
        assert!(why.contains("cargo build -p other") && why.contains("beside"), "{why}");
    }
}
