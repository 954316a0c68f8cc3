//! Builds a report: collects the analysed loops, then computes the detailed pictures.

use super::detail::Detail;
use super::diagram::Tags;
use super::{IN_FULL, LoopReport, Report};
use crate::runtime::cores::{Watch, in_order};
use stiction::core::record::Record;
use stiction::core::verdict::{AssessParams, EstimateDocument};
use stiction::plantwide::GroupDocument;
use stiction_files::About;

/// One loop's or section's part of a report.
#[derive(Debug)]
pub struct Analysed {
    /// The record that was analysed.
    pub record: Record,
    /// The section as recorded, if the analysed one was downsampled.
    pub original: Option<Record>,
    /// The file's description of the loop.
    pub about: Option<About>,
    /// Units of OP and PV, if the file has them.
    pub units: [Option<String>; 2],
    /// Parameters of the fit.
    pub params: AssessParams,
    /// Notes on the data, one line each.
    pub notes: Vec<String>,
}

/// A report being built.
#[derive(Debug, Default)]
pub struct Maker {
    all: bool,
    units: [Option<String>; 2],
    /// Warnings from the analysis.
    pub warnings: Vec<String>,
    /// The groups found, if the loops were compared.
    pub groups: Option<Vec<GroupDocument>>,
    loops: Vec<(LoopReport, AssessParams)>,
}

impl Maker {
    /// A report without loops. `all` draws every loop in full, not only the most urgent ones; `units` of OP and PV override the
    /// file's.
    #[must_use]
    pub fn new(all: bool, units: [Option<String>; 2]) -> Self {
        Self { all, units, ..Self::default() }
    }

    /// Adds one loop or section.
    pub fn add(&mut self, document: EstimateDocument, of: Analysed) {
        let Analysed { record, original, about, units, params, notes } = of;
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
        let one = LoopReport { notes, document, record, original, tags, comment, full: self.all, detail: None };
        self.loops.push((one, params));
    }

    /// Computes the detailed pictures on all cores. `input` and `command` are shown on the page. If `watch` ends it early, the
    /// remaining loops are shown briefly.
    pub fn finish(self, input: String, command: String, watch: &dyn Watch) -> Report {
        let (loops, params): (Vec<LoopReport>, Vec<AssessParams>) = self.loops.into_iter().unzip();
        let mut report = Report { input, command, warnings: self.warnings, loops, groups: self.groups };
        let mut chosen: Vec<usize> =
            report.by_urgency().into_iter().filter(|k| report.loops[*k].document.assessment.s.is_some()).collect();
        chosen.truncate(if self.all { usize::MAX } else { IN_FULL });
        let work = |k: &usize| {
            let one = &report.loops[*k];
            (*k, Detail::of(&one.record, &params[*k], &one.document.assessment))
        };
        let mut details = Vec::with_capacity(chosen.len());
        let keep = |(k, detail): (usize, Option<Detail>)| {
            details.push((k, detail));
            watch.reached(details.len() as u64, chosen.len() as u64, "pictures");
            Ok::<(), std::convert::Infallible>(())
        };
        // Infallible: keeping a result cannot fail.
        let Ok(()) = in_order(&chosen, &|| watch.go_on(), work, keep);
        for (k, detail) in details {
            report.loops[k].detail = detail;
        }
        report
    }
}
