//! `analyze --report`: path and kind of the report, a page or pictures alone.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use indicatif::ProgressBar;

use crate::cli::{UsageError, bar_of};
use crate::report::command::command_line;
use crate::report::maker::Maker;
use crate::report::{page, sheet};
use crate::runtime::cores::Watch;

/// Kind of report, by file extension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Html,
    Svg,
}

/// A report that will be written.
#[derive(Debug)]
pub(super) struct ReportFile {
    path: PathBuf,
    kind: Kind,
    /// Builds its content.
    pub maker: Maker,
}

/// Shows how many loops have their pictures.
struct Bar(ProgressBar);

impl Watch for Bar {
    fn reached(&self, done: u64, of: u64, words: &str) {
        self.0.set_length(of);
        self.0.set_position(done);
        self.0.set_message(words.to_owned());
    }

    fn go_on(&self) -> bool {
        !crate::cli::stop::asked()
    }
}

impl ReportFile {
    /// Checks the path before any work is done. `all` asks for every loop in full.
    pub(super) fn new(path: &Path, all: bool, force: bool, units: [Option<String>; 2]) -> anyhow::Result<Self> {
        let kind = match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
            Some("html" | "htm") => Kind::Html,
            Some("svg") => Kind::Svg,
            _ => {
                let text = format!("{}: a report ends in .html (a page) or .svg (pictures alone)", path.display());
                return Err(UsageError(text).into());
            }
        };
        if path.exists() && !force {
            bail!("{} exists; give another name or --force", path.display());
        }
        Ok(Self { path: path.to_owned(), kind, maker: Maker::new(all, units) })
    }

    /// Computes the detailed pictures and writes the file.
    pub(super) fn finish(self, input: String) -> anyhow::Result<()> {
        let Self { path, kind, maker } = self;
        let bar = Bar(bar_of(0));
        let report = maker.finish(input, command_line(std::env::args()), &bar);
        bar.0.finish_and_clear();
        let text = match kind {
            Kind::Html => page(&report)?,
            Kind::Svg => sheet(&report)?,
        };
        std::fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))?;
        tracing::info!("the report is in {}", path.display());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn units() -> [Option<String>; 2] {
        [None, None]
    }

    #[test]
    fn reports_go_to_pages_or_pictures_that_are_not_there_yet() {
        let folder = tempfile::tempdir().unwrap();
        assert!(ReportFile::new(&folder.path().join("a.pdf"), false, false, units()).unwrap_err().is::<UsageError>());
        let page = folder.path().join("a.HTML");
        assert_eq!(ReportFile::new(&page, false, false, units()).unwrap().kind, Kind::Html);
        std::fs::write(&page, "mine").unwrap();
        let refused = ReportFile::new(&page, false, false, units()).unwrap_err().to_string();
        assert!(refused.contains("--force"), "{refused}");
        assert!(ReportFile::new(&page, false, true, units()).is_ok());
    }
}
