//! The loops of a plant together: which windows are compared and when, and the result for each loop.
//!
//! [`PlantWatch`] keeps the newest window of every oscillating loop. A comparison is due once each of them has a new window, or
//! one of them has a second one, and no window that ends at that instant waits for its answer; so the order of the answers does
//! not matter. The caller computes the [`Comparison`] elsewhere, and gives the engine each member's result as a
//! [`GroupStanding`]. The recording contains both moments, and a replay compares the windows that it has at the first.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::misplaced::{Misplaced, misplaced};
use super::{LoopSettings, neighbours};
use crate::alarm::LoopContext;
use crate::hash::short_hash;
use stiction::core::record::Record;
use stiction::core::units::ns_from_s;
use stiction::core::verdict::{Assessment, MemberJudgement, for_prevalence};
use stiction::plantwide::{GroupDocument, PlantLoop, SourceKind, assess_plant, is_near};

/// Hops after which the window of a silent loop is no longer compared.
const KEPT_HOPS: f64 = 3.0;
/// Windows for which a group's result holds without confirmation by another comparison.
const ANSWER_HOLDS: u8 = 3;
/// Most bytes of kept windows; further loops are not compared. Comparisons under way may hold as much again, twice.
const MAX_BYTES: usize = 256 << 20;

/// A loop's newest window, with its separate assessment.
#[derive(Debug, Clone)]
pub struct LoopWindow {
    /// The window.
    pub record: Arc<Record>,
    /// Its assessment, before any group's result.
    pub own: Arc<Assessment>,
    place: LoopContext,
    hop_s: f64,
}

impl LoopWindow {
    pub(super) fn new(record: Arc<Record>, own: Assessment, settings: &LoopSettings) -> Self {
        Self { record, own: Arc::new(own), place: settings.place.clone(), hop_s: settings.window.hop_s }
    }

    fn end_ns(&self) -> i64 {
        self.own.window.end_ns
    }

    fn oscillates(&self) -> bool {
        self.own.oscillation.oscillating
    }

    fn of_plant<'a>(&'a self, name: &'a str) -> PlantLoop<'a> {
        PlantLoop {
            name,
            record: &self.record,
            assessment: &self.own,
            area: self.place.area.as_deref(),
            upstream: &self.place.upstream,
        }
    }

    /// Bytes that it occupies.
    fn bytes(&self) -> usize {
        self.record.bytes() + size_of::<Assessment>()
    }
}

#[derive(Debug)]
struct Kept {
    window: LoopWindow,
    /// Whether it came after the last comparison.
    is_new: bool,
}

/// The newest windows of all oscillating loops.
#[derive(Debug, Default)]
pub struct PlantWatch {
    kept: BTreeMap<Arc<str>, Kept>,
    bytes: usize,
    /// Number of windows since the last comparison.
    new: usize,
    /// Whether a loop has left since the last comparison.
    has_lost: bool,
    /// Whether a window has changed anything since the last check for a due comparison.
    has_changed: bool,
    /// Earliest end of a loop's second window since the last comparison, ns.
    second_ns: Option<i64>,
    /// Number of unanswered windows, by their ends.
    awaited: BTreeMap<i64, usize>,
}

impl PlantWatch {
    /// A window with this end came due; its answer is still to come.
    pub fn expect(&mut self, end_ns: i64) {
        *self.awaited.entry(end_ns).or_default() += 1;
    }

    /// A window with this end was answered or skipped.
    pub fn answered(&mut self, end_ns: i64) {
        let Some(left) = self.awaited.get_mut(&end_ns) else { return };
        *left -= 1;
        if *left == 0 {
            self.awaited.remove(&end_ns);
        }
    }

    /// Keeps a loop's newest window while the loop oscillates.
    pub fn keep(&mut self, name: &Arc<str>, window: LoopWindow) {
        let (oscillates, end_ns, bytes) = (window.oscillates(), window.end_ns(), window.bytes());
        if oscillates && self.kept.get(name).is_some_and(|kept| kept.is_new) {
            self.second_ns = Some(self.second_ns.map_or(end_ns, |first_ns| first_ns.min(end_ns)));
        }
        let was_kept = self.remove(name);
        self.has_lost |= was_kept && !oscillates;
        let is_kept = oscillates && self.bytes + bytes <= MAX_BYTES;
        self.has_changed |= was_kept || is_kept;
        if is_kept {
            self.bytes += bytes;
            self.new += 1;
            self.kept.insert(name.clone(), Kept { window, is_new: true });
        }
    }

    /// The comparison that is due, if any.
    pub fn due(&mut self) -> Option<Comparison> {
        let is_whole = self.has_changed && self.new == self.kept.len();
        let newest_ns = || self.kept.values().map(|kept| kept.window.end_ns()).max().unwrap_or(i64::MIN);
        let instant_ns = self.second_ns.or_else(|| is_whole.then(newest_ns))?;
        if self.awaited.range(..=instant_ns).next().is_some() {
            return None;
        }
        (self.has_changed, self.second_ns) = (false, None);
        let comparison = self.compare();
        let is_due = comparison.windows.len() > 1 || self.has_lost;
        if is_due {
            (self.has_lost, self.new) = (false, 0);
            self.kept.values_mut().for_each(|kept| kept.is_new = false);
        }
        is_due.then_some(comparison)
    }

    /// Drops a loop that has left.
    pub fn forget(&mut self, name: &str) {
        self.has_lost |= self.remove(name);
    }

    fn remove(&mut self, name: &str) -> bool {
        let Some(gone) = self.kept.remove(name) else { return false };
        self.bytes -= gone.window.bytes();
        self.new -= usize::from(gone.is_new);
        true
    }

    /// Number of loops whose windows are kept.
    #[must_use]
    pub fn count(&self) -> usize {
        self.kept.len()
    }

    /// The comparison of the current windows. Those of silent loops are dropped first.
    pub fn compare(&mut self) -> Comparison {
        self.drop_silent();
        let windows = self.kept.iter().map(|(name, kept)| (name.clone(), kept.window.clone()));
        Comparison { windows: windows.collect() }
    }

    /// Drops windows that are older than those of most loops, since a single loop's clock says nothing about the others.
    fn drop_silent(&mut self) {
        let mut ends: Vec<i64> = self.kept.values().map(|kept| kept.window.end_ns()).collect();
        ends.sort_unstable();
        let Some(median) = ends.get(ends.len() / 2).copied() else { return };
        let is_silent = |kept: &Kept| median - kept.window.end_ns() > ns_from_s(KEPT_HOPS * kept.window.hop_s);
        let silent: Vec<Arc<str>> =
            self.kept.iter().filter(|(_, kept)| is_silent(kept)).map(|(name, _)| name.clone()).collect();
        silent.iter().for_each(|name| self.forget(name));
    }
}

/// Windows of many loops to compare.
#[derive(Debug, Clone)]
pub struct Comparison {
    windows: Vec<(Arc<str>, LoopWindow)>,
}

impl Comparison {
    /// Identifies the compared windows; equal in a live run and its replay.
    #[must_use]
    pub fn digest(&self) -> String {
        let mut text = String::new();
        for (name, window) in &self.windows {
            let _ = writeln!(text, "{name} {}", window.end_ns());
        }
        short_hash(text.as_bytes())
    }

    /// Bytes of its windows.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.windows.iter().map(|(_, window)| window.bytes()).sum()
    }

    /// The compared loops.
    pub fn loops(&self) -> impl ExactSizeIterator<Item = &Arc<str>> {
        self.windows.iter().map(|(name, _)| name)
    }

    /// The groups, which depend on the windows alone.
    #[must_use]
    pub fn compute(&self, daemon: Option<&str>) -> Vec<GroupDocument> {
        let loops: Vec<PlantLoop> = self.windows.iter().map(|(name, window)| window.of_plant(name)).collect();
        let mut groups = assess_plant(&loops);
        for group in &mut groups {
            group.daemon = daemon.map(str::to_owned);
        }
        groups
    }

    /// Loops with a signal under the wrong name or of the wrong sign; they depend on the windows alone.
    #[must_use]
    pub fn misplaced(&self) -> Vec<(Arc<str>, Misplaced)> {
        misplaced(self.windows.iter().map(|(name, window)| (name, &*window.record)))
    }
}

/// A group's last result for a loop, and how long it holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GroupStanding {
    /// The group's judgement of the loop.
    pub judgement: MemberJudgement,
    /// Period of the common oscillation, s.
    pub period_s: f64,
    /// Whether the loop's own finding is suppressed, because it follows another loop whose alarm is active or about to be
    /// raised.
    pub holds: bool,
    /// The other members, source first; as many as a gap diagnosis takes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) others: Vec<String>,
    /// Number of windows for which it still holds.
    windows_left: u8,
}

impl GroupStanding {
    /// A group's results for its members. `alarms` says whether a loop's alarm is active or its newest window counts towards
    /// it, since source and followers mostly begin to oscillate together.
    pub fn of_members(group: &GroupDocument, alarms: impl Fn(&str) -> bool) -> Vec<Self> {
        let source = group.source.loop_name.as_deref().filter(|_| group.source.kind == SourceKind::Loop);
        let is_active = source.is_some_and(alarms);
        let members = group.judgements.iter().map(|judgement| judgement.loop_name.as_str());
        let all: Vec<&str> = source.into_iter().chain(members.filter(|name| source != Some(*name))).collect();
        let others = |own: &str| {
            let names = all.iter().filter(|name| **name != own).take(neighbours::MOST);
            names.map(|name| (*name).to_owned()).collect()
        };
        let of = |judgement: &MemberJudgement| Self {
            judgement: judgement.clone(),
            period_s: group.period_s,
            holds: judgement.masked && is_active && source != Some(judgement.loop_name.as_str()),
            others: others(&judgement.loop_name),
            windows_left: ANSWER_HOLDS,
        };
        group.judgements.iter().map(of).collect()
    }

    /// The group's judgement for the loop's next window; `None` if that window does not share the oscillation any longer.
    pub(super) fn answer(&self, own: &Assessment) -> Option<MemberJudgement> {
        let period_s = own.oscillation.period_s.filter(|_| own.oscillation.oscillating)?;
        if !is_near(period_s, self.period_s) {
            return None;
        }
        let lowered = self.judgement.calibrated().filter(|_| self.holds);
        let p_calibrated = own.p_calibrated.map(|p| lowered.map_or(p, |lowered| p.min(lowered)));
        let p_stiction = p_calibrated.map(|p| for_prevalence(p, own.prevalence));
        Some(MemberJudgement { p_alone: own.p_stiction, p_stiction, p_calibrated, ..self.judgement.clone() })
    }

    /// Counts a window; true if the result still holds.
    pub(super) const fn count_window(&mut self) -> bool {
        self.windows_left = self.windows_left.saturating_sub(1);
        self.windows_left > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use stiction::core::units::Moment;
    use stiction::core::verdict::{Oscillation, Window};

    const HOP_NS: i64 = 300_000_000_000;

    fn window(hop: i64, oscillating: bool) -> LoopWindow {
        let end_ns = hop * HOP_NS;
        let (start, end) = (Moment(end_ns - HOP_NS), Moment(end_ns));
        let span = Window { start_ns: start.0, end_ns, start, end, samples: 3, ts_s: 1.0, box_samples: 1 };
        let oscillation = Oscillation {
            oscillating,
            period_s: Some(60.0),
            periods: None,
            samples_per_period: None,
            regularity: None,
        };
        let settings = Config::with_prefix("p").engine().common[0].clone();
        let record = Record::uniform(1.0, vec![0.0, 1.0, 0.0], vec![0.0, 1.0, 0.0]);
        LoopWindow::new(Arc::new(record), Assessment::empty(span, oscillation), &settings)
    }

    fn names(comparison: &Comparison) -> Vec<&str> {
        comparison.loops().map(|name| &**name).collect()
    }

    fn take(watch: &mut PlantWatch, name: &str, window: LoopWindow) -> Option<Comparison> {
        watch.keep(&name.into(), window);
        watch.due()
    }

    /// Takes windows given by loop and hop; returns the loops of each comparison.
    fn compared(watch: &mut PlantWatch, windows: &[(&str, i64)]) -> Vec<String> {
        let take = |(name, hop): &(&str, i64)| take(watch, name, window(*hop, true));
        windows.iter().filter_map(take).map(|comparison| names(&comparison).join(" ")).collect()
    }

    /// Hop and loops of each comparison if the windows of an instant are answered in this order.
    fn compared_in_order(instants: &[&[(&str, bool)]], order: impl Fn(usize, usize) -> usize) -> Vec<(usize, String)> {
        let (mut watch, mut all) = (PlantWatch::default(), Vec::new());
        for (hop, instant) in instants.iter().enumerate() {
            let (end_ns, count) = (hop as i64 * HOP_NS, instant.len());
            (0..count).for_each(|_| watch.expect(end_ns));
            for at in 0..count {
                let (name, oscillating) = instant[order(at, count)];
                watch.keep(&name.into(), window(hop as i64, oscillating));
                watch.answered(end_ns);
                all.extend(watch.due().map(|comparison| (hop, comparison.digest())));
            }
        }
        all
    }

    #[test]
    fn the_order_in_which_windows_of_an_instant_are_answered_decides_nothing() {
        // B is silent from the third instant on, D appears in the fourth, C stops oscillating in the sixth.
        let instants: [&[(&str, bool)]; 8] = [
            &[("A", true), ("B", true), ("C", true)],
            &[("A", true), ("B", true), ("C", true)],
            &[("A", true), ("C", true)],
            &[("A", true), ("C", true), ("D", true)],
            &[("A", true), ("C", true), ("D", true)],
            &[("A", true), ("C", false), ("D", true)],
            &[("A", true), ("C", false), ("D", true)],
            &[("A", true), ("C", true), ("D", true)],
        ];
        let usual = compared_in_order(&instants, |at, _| at);
        assert_eq!(usual.iter().map(|(hop, _)| *hop).collect::<Vec<_>>(), [0, 1, 3, 5, 7]);
        for turn in 0..3 {
            assert_eq!(compared_in_order(&instants, |at, count| (at + turn) % count), usual);
            assert_eq!(compared_in_order(&instants, |at, count| (count - 1 - at + turn) % count), usual);
        }
    }

    #[test]
    fn a_window_of_a_later_instant_holds_no_comparison_up_nor_does_a_clock_that_runs_ahead() {
        let mut watch = PlantWatch::default();
        compared(&mut watch, &[("A", 1), ("B", 1), ("A", 2), ("D", 900)]);
        watch.expect(3 * HOP_NS);
        watch.expect(4 * HOP_NS);
        assert_eq!(compared(&mut watch, &[("D", 901), ("A", 3)]), [""; 0]);
        watch.answered(3 * HOP_NS);
        assert_eq!(names(&watch.due().unwrap()), ["A", "B", "D"]);
    }

    #[test]
    fn a_comparison_is_due_once_every_loop_has_a_new_window_or_one_has_a_second() {
        let mut watch = PlantWatch::default();
        assert_eq!(compared(&mut watch, &[("A", 1), ("B", 1)]), ["A B"]);
        assert_eq!(compared(&mut watch, &[("A", 2)]), [""; 0]);
        assert_eq!(compared(&mut watch, &[("C", 2), ("B", 2)]), ["A B C"]);
        // B has no window for a hop.
        assert_eq!(compared(&mut watch, &[("A", 3), ("C", 3), ("A", 4)]), ["A B C"]);
        assert_eq!(compared(&mut watch, &[("B", 4), ("C", 4)]), [""; 0]);
    }

    #[test]
    fn a_loop_that_calms_down_leaves_and_the_others_are_told() {
        let mut watch = PlantWatch::default();
        compared(&mut watch, &[("A", 1), ("B", 1), ("A", 2)]);
        let last = take(&mut watch, "B", window(2, false)).unwrap();
        assert_eq!((names(&last), last.compute(None)), (vec!["A"], Vec::new()));
        assert_eq!(watch.count(), 1);
    }

    #[test]
    fn a_silent_loop_is_dropped_by_the_time_of_the_others_and_not_by_one_clock_that_runs_ahead() {
        let mut watch = PlantWatch::default();
        compared(&mut watch, &[("A", 1), ("B", 1), ("C", 1), ("D", 900)]);
        let later: Vec<(&str, i64)> = (2..16).flat_map(|hop| [("A", hop), ("B", hop), ("D", 900 + hop)]).collect();
        assert_eq!(compared(&mut watch, &later).last().unwrap(), "A B D");
    }

    #[test]
    fn a_digest_names_the_windows() {
        let of = |windows: &[(&str, i64)]| {
            let mut watch = PlantWatch::default();
            let take = |(name, hop): &(&str, i64)| take(&mut watch, name, window(*hop, true));
            windows.iter().filter_map(take).last().unwrap().digest()
        };
        assert_eq!(of(&[("A", 1), ("B", 1)]), of(&[("B", 1), ("A", 1)]));
        assert_ne!(of(&[("A", 1), ("B", 1)]), of(&[("A", 1), ("B", 2)]));
    }
}
