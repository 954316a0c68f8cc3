//! Results for the maintenance list that are computed one at a time, apart from its requests: simulated repairs, and
//! comparisons of a valve before and after work. Each is kept until its loop has newer windows.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::http::StatusCode;
use tokio::sync::Semaphore;

use super::Shared;
use super::curves::recorded_within;
use super::past::windows;
use super::window::simulated;
use crate::runtime::maintenance::{self, Benefit, Done, Measured, Outcome, Removed, SIMULATED, Work};
use crate::runtime::overview::Candidate;
use stiction::core::record::Signal;
use stiction::core::signal::stats::std_dev;
use stiction::core::units::ns_from_s;
use stiction::over_time::WindowResult;
use stiction_engine::analysis::{Points, Section};
use stiction_files::archive::Reach;
use stiction_files::reviews::{Label, Review};

/// Reviewed loops that are compared; those with the newest reviews.
pub(super) const COMPARED: usize = 20;
/// Time compared before and after a review, and most windows on each side.
const STRETCH_S: f64 = 14.0 * 86_400.0;
const WINDOWS: usize = 12;
/// A comparison is repeated once its loop has windows newer by this much.
const AGAIN_S: f64 = 3600.0;

/// Results computed so far.
pub(super) struct Worth {
    known: Mutex<Known>,
    /// Held during a computation.
    busy: Arc<Semaphore>,
}

#[derive(Default)]
struct Known {
    /// By loop: the end of the window, and the benefit of its repair.
    benefits: HashMap<String, (i64, Benefit)>,
    outcomes: HashMap<String, Compared>,
}

/// A finished comparison.
#[derive(Clone)]
pub(super) struct Compared {
    /// When the review was written, ns since 1970.
    at_ns: i64,
    /// End of the newest window, ns since 1970.
    newest_ns: i64,
    pub outcome: Outcome,
    /// Whether all recordings of the time were read.
    pub complete: bool,
}

/// A result to be computed.
enum Task {
    Repair(String, i64),
    Compare(Review, i64),
}

impl Default for Worth {
    fn default() -> Self {
        Self { known: Mutex::default(), busy: Arc::new(Semaphore::new(1)) }
    }
}

impl Worth {
    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The list as far as it is computed, the comparisons for these reviews, and the number of results still to be computed, which
/// is now started.
pub(super) fn look(live: &Shared, reviews: &[Review]) -> (Vec<Work>, Vec<Option<Compared>>, usize) {
    let candidates = live.overview.candidates();
    let names: HashSet<&str> = candidates.iter().map(|c| c.name.as_str()).collect();
    let mut known = live.worth.known();
    known.benefits.retain(|name, _| names.contains(name.as_str()));
    known.outcomes.retain(|name, _| reviews.iter().any(|review| review.r#loop == *name));
    let benefits: BTreeMap<String, Benefit> =
        known.benefits.iter().map(|(name, (_, benefit))| (name.clone(), benefit.clone())).collect();
    let work = maintenance::rank(&candidates, &benefits);
    let mut tasks = repairs(&candidates, &work, &known);
    tasks.extend(reviews.iter().filter_map(|review| comparison(live, review, &known)));
    // A comparison for an earlier review says nothing about a newer one.
    let of = |review: &Review| known.outcomes.get(&review.r#loop).filter(|c| c.at_ns == review.at.0).cloned();
    let outcomes = reviews.iter().map(of).collect();
    drop(known);
    let pending = tasks.len();
    begin(live, tasks);
    (work, outcomes, pending)
}

/// Loops at the top of the list whose repair was not simulated for their newest window.
fn repairs(candidates: &[Candidate], work: &[Work], known: &Known) -> Vec<Task> {
    let by_name: HashMap<&str, &Candidate> = candidates.iter().map(|c| (c.name.as_str(), c)).collect();
    let task = |work: &Work| {
        let end_ns = maintenance::simulable(by_name.get(work.loop_name.as_str())?)?;
        let done = known.benefits.get(&work.loop_name).is_some_and(|(of_ns, _)| *of_ns == end_ns);
        (!done).then(|| Task::Repair(work.loop_name.clone(), end_ns))
    };
    work.iter().take(SIMULATED).filter_map(task).collect()
}

fn comparison(live: &Shared, review: &Review, known: &Known) -> Option<Task> {
    let newest_ns = live.overview.newest(&review.r#loop)?.estimate?.assessment.window.end_ns;
    let done = known
        .outcomes
        .get(&review.r#loop)
        .is_some_and(|c| c.at_ns == review.at.0 && newest_ns.saturating_sub(c.newest_ns) < ns_from_s(AGAIN_S));
    (!done).then(|| Task::Compare(review.clone(), newest_ns))
}

/// Computes the tasks one after another, unless a computation is under way.
fn begin(live: &Shared, tasks: Vec<Task>) {
    if tasks.is_empty() {
        return;
    }
    let Ok(permit) = live.worth.busy.clone().try_acquire_owned() else { return };
    let live = live.clone();
    tokio::spawn(async move {
        for task in tasks {
            match task {
                Task::Repair(name, end_ns) => {
                    if let Some(benefit) = benefit(&live, &name).await {
                        live.worth.known().benefits.insert(name, (end_ns, benefit));
                    }
                }
                Task::Compare(review, newest_ns) => {
                    let (of, name) = (live.clone(), review.r#loop.clone());
                    if let Ok(compared) = live.looks.run(move || compared(&of, &review, newest_ns)).await {
                        live.worth.known().outcomes.insert(name, compared);
                    }
                }
            }
        }
        drop(permit);
    });
}

/// Benefit of a loop's repair; `None` if it failed and may be tried again.
async fn benefit(live: &Shared, name: &str) -> Option<Benefit> {
    match simulated(live, name).await {
        Ok(Ok(repair)) => Some(Ok(Removed::from(&repair))),
        Ok(Err(why)) => Some(Err(why.to_string())),
        Err(error) if error.status() == StatusCode::NOT_FOUND => Some(Err(error.why().to_owned())),
        Err(_) => None,
    }
}

/// The last windows with an answer that end before a date, and the last ones that start after it.
fn sides(all: &[WindowResult], date_ns: i64) -> [Vec<&WindowResult>; 2] {
    let last = |is_of: &dyn Fn(&WindowResult) -> bool| {
        let side: Vec<&WindowResult> = all.iter().filter(|w| w.stiction.is_some() && is_of(w)).collect();
        side[side.len().saturating_sub(WINDOWS)..].to_vec()
    };
    [last(&|w| w.end_ns <= date_ns), last(&|w| w.start_ns >= date_ns)]
}

/// Compares around the date of the work, or without one around the reviewed window: the clock of the data may differ from that
/// of the reviewer.
fn compared(live: &Shared, review: &Review, newest_ns: i64) -> Compared {
    let (date_ns, stretch_ns) = (review.work_at.unwrap_or(review.window_end).0, ns_from_s(STRETCH_S));
    let range_ns = [date_ns.saturating_sub(stretch_ns), date_ns.saturating_add(stretch_ns)];
    let (all, mut reach) = windows(live, &review.r#loop, range_ns);
    let all: Vec<WindowResult> = all.into_iter().map(|w| w.result).collect();
    let [before, after] = sides(&all, date_ns).map(|side| {
        let (found, of_side) = measure(live, &review.r#loop, &side);
        if of_side != Reach::All {
            reach = of_side;
        }
        found
    });
    let outcome = maintenance::compare(&before, &after, done(review.label));
    Compared { at_ns: review.at.0, newest_ns, outcome, complete: reach == Reach::All }
}

/// What was done at the date of a review with this label.
const fn done(label: Label) -> Done {
    match label {
        Label::Stiction => Done::Found,
        Label::NoStiction => Done::Nothing,
        Label::Repaired => Done::Repaired,
    }
}

/// Windows with the standard deviation of their recorded PV.
fn measure(live: &Shared, name: &str, side: &[&WindowResult]) -> (Vec<Measured>, Reach) {
    let start = side.iter().map(|w| w.start_ns).min();
    let Some((start_ns, end_ns)) = start.zip(side.iter().map(|w| w.end_ns).max()) else {
        return (Vec::new(), Reach::All);
    };
    let (one, reach) = recorded_within(&live.archive, name, &[Signal::Op, Signal::Pv], [start_ns, end_ns]);
    let points = Points::of(name, &one.samples, &live.config.get()).samples(Section::Whole).unwrap_or_default();
    let pv_sd = |w: &WindowResult| {
        let within = points.iter().filter(|p| (w.start_ns..=w.end_ns).contains(&p.t_ns));
        let pv: Vec<f64> = within.map(|p| p.pv).filter(|pv| pv.is_finite()).collect();
        (pv.len() > 1).then(|| std_dev(&pv))
    };
    let of = |w: &&WindowResult| Measured { stiction: w.stiction, p: w.p_stiction, s: w.s, pv_sd: pv_sd(w) };
    (side.iter().map(of).collect(), reach)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_windows_on_each_side_of_a_date_are_compared_and_none_across_it() {
        let window = |k: i64| WindowResult {
            start_ns: 10 * k,
            end_ns: 10 * k + 15,
            stiction: (k != 3).then_some(true),
            ..WindowResult::default()
        };
        let all: Vec<WindowResult> = (0..30).map(window).collect();
        let starts = |side: &[&WindowResult]| side.iter().map(|w| w.start_ns / 10).collect::<Vec<_>>();
        let [before, after] = sides(&all, 55);
        assert_eq!(starts(&before), [0, 1, 2, 4]);
        assert_eq!(starts(&after), (18..30).collect::<Vec<_>>());
    }
}
