//! `analyze --report`: gathers what was analysed, computes the detailed pictures, writes the page or the sheet.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

use super::{UsageError, on_all_cores};
use crate::files::About;
use crate::report::detail::Detail;
use crate::report::diagram::Tags;
use crate::report::{IN_FULL, LoopReport, Report, page, sheet};
use stiction::record::Record;
use stiction::verdict::{AssessParams, EstimateDocument};

/// The kinds of report, by the file's ending.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Html,
    Svg,
}

/// One loop's or section's part of a report.
#[derive(Debug)]
pub struct Subject {
    /// The record that was analysed.
    pub record: Record,
    /// The section as recorded, where the analysed one was downsampled.
    pub original: Option<Record>,
    /// What the file says of the loop.
    pub about: Option<About>,
    /// Units of OP and PV, where the file says them.
    pub units: [Option<String>; 2],
    /// What the fit was told.
    pub params: AssessParams,
}

/// A report in the making.
#[derive(Debug)]
pub(super) struct Maker {
    path: PathBuf,
    kind: Kind,
    all: bool,
    /// Units of OP and PV, where they were said.
    units: [Option<String>; 2],
    loops: Vec<(LoopReport, AssessParams)>,
    warnings: Vec<String>,
}

impl Maker {
    /// Checks where a report shall go before any work is done. `all` asks for every loop in full.
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
        Ok(Self { path: path.to_owned(), kind, all, units, loops: Vec::new(), warnings: Vec::new() })
    }

    /// Adds what was made of one loop or section.
    pub(super) fn add(&mut self, document: EstimateDocument, subject: Subject) {
        let Subject { record, original, about, units, params } = subject;
        let mut tags = Tags::of_loop(&document.loop_name, record.sp.is_some(), record.mv.is_some());
        let mut comment = None;
        if let Some(About { tags: [op, pv], comment: noted, .. }) = about {
            (tags.op, tags.pv) = (op, pv);
            comment = Some(noted).filter(|c| !c.trim().is_empty());
        }
        for ((unit, said), found) in tags.units.iter_mut().zip(&self.units).zip(&units) {
            if let Some(known) = said.as_ref().or(found.as_ref()) {
                unit.clone_from(known);
            }
        }
        let op_range = params.op_range;
        let one = LoopReport { op_range, document, record, original, tags, comment, full: self.all, detail: None };
        self.loops.push((one, params));
    }

    /// Adds a remark to the page.
    pub(super) fn warn(&mut self, text: String) {
        self.warnings.push(text);
    }

    /// Computes the detailed pictures and writes the file.
    pub(super) fn finish(self, input: &Path) -> anyhow::Result<()> {
        let Self { path, kind, all, loops, warnings, .. } = self;
        let (loops, params): (Vec<LoopReport>, Vec<AssessParams>) = loops.into_iter().unzip();
        let mut report =
            Report { input: input.display().to_string(), command: command_line(std::env::args()), warnings, loops };
        let mut chosen: Vec<usize> =
            report.by_urgency().into_iter().filter(|k| report.loops[*k].document.assessment.s.is_some()).collect();
        chosen.truncate(if all { usize::MAX } else { IN_FULL });
        let name = |k: &usize| format!("pictures of {}", report.loops[*k].document.loop_name);
        let details = on_all_cores(&chosen, name, |k| {
            let one = &report.loops[*k];
            Detail::of(&one.record, &params[*k], &one.document.assessment)
        });
        for (k, detail) in chosen.into_iter().zip(details) {
            report.loops[k].detail = detail;
        }
        let text = match kind {
            Kind::Html => page(&report)?,
            Kind::Svg => sheet(&report)?,
        };
        std::fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))?;
        tracing::info!("the report is in {}", path.display());
        Ok(())
    }
}

/// The command as it can be pasted into a shell.
pub(super) fn command_line(arguments: impl Iterator<Item = String>) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:=+@%".contains(c);
    let quoted = arguments.enumerate().map(|(k, text)| {
        // The program by its name: where it stands differs between machines.
        let text = if k == 0 { text.rsplit('/').next().unwrap_or("stictiond").to_owned() } else { text };
        if !text.is_empty() && text.chars().all(plain) { text } else { format!("'{}'", text.replace('\'', "'\\''")) }
    });
    quoted.collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_can_be_pasted() {
        let given = ["/usr/bin/stictiond", "analyze", "my file.csv", "--loop", "it's", ""].map(str::to_owned);
        assert_eq!(command_line(given.into_iter()), "stictiond analyze 'my file.csv' --loop 'it'\\''s' ''");
    }

    const fn units() -> [Option<String>; 2] {
        [None, None]
    }

    #[test]
    fn reports_go_to_pages_or_pictures_that_are_not_there_yet() {
        let folder = tempfile::tempdir().unwrap();
        assert!(Maker::new(&folder.path().join("a.pdf"), false, false, units()).unwrap_err().is::<UsageError>());
        let page = folder.path().join("a.HTML");
        assert_eq!(Maker::new(&page, false, false, units()).unwrap().kind, Kind::Html);
        std::fs::write(&page, "mine").unwrap();
        let refused = Maker::new(&page, false, false, units()).unwrap_err().to_string();
        assert!(refused.contains("--force"), "{refused}");
        assert!(Maker::new(&page, false, true, units()).is_ok());
    }
}
