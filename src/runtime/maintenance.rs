//! Which valves to work on first: loops that may need work, ranked by the cost of leaving them alone.

mod outcome;

use std::collections::BTreeMap;

use serde::Serialize;

use stiction::core::units::{ms_from_ns, probability};
use stiction::core::verdict::{Assessment, answer};
use stiction::repair::Repair;
use stiction::words::action::{Action, Confirm, what_to_do};
use stiction::words::{self, capital};
use stiction_engine::alarm::Priority;

use super::overview::Candidate;
pub use outcome::{Done, Helped, Measured, Outcome, Side, compare};

/// Top loops of the list whose repair is simulated.
pub const SIMULATED: usize = 30;
/// Share that a repair is assumed to remove if it is unknown.
const ASSUMED_SHARE: f64 = 0.5;
/// Weights of a growing and of a shrinking band.
const RISING: f64 = 1.25;
const FALLING: f64 = 0.8;

/// Fraction of PV's standard deviation that a repair removes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Removed {
    /// Median, 0 to 1.
    pub share: f64,
    /// 90 % interval.
    pub interval: [f64; 2],
}

/// Benefit of a simulated repair, or why it is unknown.
pub type Benefit = Result<Removed, String>;

/// A loop in the list.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Work {
    /// Place in the list, from 1.
    pub rank: usize,
    /// The loop's name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// Part of the plant.
    pub area: Option<String>,
    /// The valve's name in the maintenance system.
    pub equipment: Option<String>,
    /// How much the loop matters, 1 to 5; null where the configuration has no entry for it.
    pub criticality: Option<u8>,
    /// Whether its alarm is active.
    pub alarm: bool,
    /// Probability that the valve sticks, by the configured prevalence, of the newest window with an answer.
    pub p_stiction: Option<f64>,
    /// The same in words.
    pub probability: Option<String>,
    /// Grade of the newest window, where it finds stiction.
    pub grade: Option<char>,
    /// Dead band plus stick band of the newest window that finds stiction, OP units.
    pub s: Option<f64>,
    /// The same with its interval, in the display unit.
    pub size: Option<String>,
    /// Unit of `s`.
    pub op_unit: Option<String>,
    /// Trend of s: `rising`, `falling`, `steady`.
    pub s_trend: Option<&'static str>,
    /// What a repair removes; null if unknown, for the reason in `why`.
    pub removed: Option<Removed>,
    /// Whether that is still being computed; if so, ask again.
    pub pending: bool,
    /// End of the newest window, ms since 1970.
    pub window_end_ms: Option<f64>,
    /// The value that determines the rank: share removed (one half if unknown) x probability x weight of the grade x trend x
    /// criticality / 3.
    pub cost: f64,
    /// Benefit of a repair, in a few words.
    pub benefit: String,
    /// The next step, in a few words.
    pub next_step: &'static str,
    /// What to do.
    pub what_to_do: String,
    /// Reason for the work.
    pub why: String,
    /// How certain that is.
    pub sure: String,
}

impl From<&Repair> for Removed {
    fn from(repair: &Repair) -> Self {
        let ratio = repair.repaired.pv_sd_ratio;
        let removed = |ratio: f64| (1.0 - ratio).clamp(0.0, 1.0);
        let [low, high] = ratio.interval;
        Self { share: removed(ratio.value), interval: [removed(high), removed(low)] }
    }
}

/// The data of a candidate that the rank needs.
struct Known<'a> {
    candidate: &'a Candidate,
    /// The newest window, if it has an answer.
    answered: Option<&'a Assessment>,
    p: Option<f64>,
}

impl<'a> Known<'a> {
    fn of(candidate: &'a Candidate) -> Self {
        let answered = candidate.estimate.as_deref().map(|e| &e.assessment).filter(|a| a.stiction.is_some());
        let of_alarm = || candidate.alarm.as_deref().and_then(|alarm| alarm.figures.p);
        Self { candidate, answered, p: answered.and_then(|a| a.p_stiction).or_else(of_alarm) }
    }

    fn grade(&self) -> Option<char> {
        self.answered.and_then(answer::grade)
    }

    /// Cost of leaving the valve alone; it has no unit.
    fn cost(&self, benefit: Option<&Benefit>) -> f64 {
        let share = benefit.and_then(|b| b.as_ref().ok()).map_or(ASSUMED_SHARE, |removed| removed.share);
        let evidence = match self.grade() {
            Some('A') => 1.0,
            Some('B') => 0.9,
            Some('C') => 0.7,
            _ => 0.5,
        };
        let trend = match self.candidate.s_trend {
            Some("rising") => RISING,
            Some("falling") => FALLING,
            _ => 1.0,
        };
        let criticality = self.candidate.place.criticality.unwrap_or(Priority::CRITICALITY);
        let weight = f64::from(criticality) / f64::from(Priority::CRITICALITY);
        share * self.p.unwrap_or(0.5) * evidence * trend * weight
    }

    fn what_to_do(&self) -> String {
        let alarm = self.candidate.alarm.as_deref().filter(|alarm| alarm.active);
        let estimate = self.candidate.estimate.as_deref().map(|e| &e.assessment);
        let unit = self.candidate.place.op_unit.as_deref().unwrap_or("OP units");
        let of_estimate = || estimate.map(|a| Action::of(a).map_or_else(|| what_to_do(a), |action| action.alone(unit)));
        alarm.and_then(|alarm| alarm.what_to_do.clone()).or_else(of_estimate).unwrap_or_default()
    }

    /// The test that would confirm the band, or what to wait for.
    fn next_step(&self) -> &'static str {
        let alarm = self.candidate.alarm.as_deref().filter(|alarm| alarm.active).and_then(|alarm| alarm.action);
        match alarm.or_else(|| self.answered.and_then(Action::of)).map(|action| action.confirm) {
            Some(Confirm::Bump(_)) => "bump test, then inspect",
            Some(Confirm::Otherwise(_)) => "valve signature or position trend, then inspect",
            None => "wait for more windows",
        }
    }

    fn benefit(&self, benefit: Option<&Benefit>, pending: bool) -> String {
        match benefit {
            Some(Ok(Removed { interval: [low, high], .. })) => {
                format!("{:.0} to {:.0} % less PV variation", 100.0 * low, 100.0 * high)
            }
            None if pending => "being computed".to_owned(),
            Some(Err(_)) | None => "not known".to_owned(),
        }
    }

    fn why(&self, benefit: Option<&Benefit>, pending: bool) -> String {
        let criticality = match self.candidate.place.criticality {
            Some(criticality) => format!("Criticality {criticality} of 5"),
            None => format!("No criticality is configured, so {} of 5 counts", Priority::CRITICALITY),
        };
        let trend = match self.candidate.s_trend {
            Some("rising") => "; s is rising",
            Some("falling") => "; s is falling",
            _ => "",
        };
        format!("{criticality}{trend}; {}.", self.gain(benefit, pending))
    }

    /// Benefit of a repair, or why it is unknown.
    fn gain(&self, benefit: Option<&Benefit>, pending: bool) -> String {
        let unknown =
            |why: &str| format!("the rank assumes that a repair removes half of PV's variation, because {why}");
        match benefit {
            Some(Ok(Removed { interval: [low, high], .. })) => {
                let [from, to] = [low, high].map(|share| format!("{:.0}", 100.0 * share));
                match (from.as_str(), to.as_str()) {
                    (_, "0") => "a simulated repair does not reduce PV's variation".to_owned(),
                    ("0", to) => format!("a repair removes at most {to} % of PV's variation, perhaps nothing"),
                    (from, to) if from == to => format!("a repair removes about {to} % of PV's variation"),
                    (from, to) => format!("a repair removes {from} to {to} % of PV's variation"),
                }
            }
            Some(Err(why)) => unknown(&format!("the benefit cannot be estimated: {why}")),
            None if pending => unknown("the benefit is still being computed"),
            None if self.simulable().is_none() => {
                unknown("the newest window finds no stiction that could be simulated")
            }
            None => unknown(&format!("the benefit is computed for the first {SIMULATED} loops only")),
        }
    }

    /// End of the newest window if its repair can be simulated, ns since 1970.
    fn simulable(&self) -> Option<i64> {
        self.answered.filter(|a| a.stiction == Some(true)).map(|a| a.window.end_ns)
    }

    fn sure(&self) -> String {
        let newest = self.candidate.estimate.as_deref().map(|e| &e.assessment);
        let mut text =
            newest.map_or_else(|| "No window was judged since the daemon started.".to_owned(), words::sureness);
        let alarm = self.candidate.alarm.as_deref().filter(|alarm| alarm.active);
        match (self.answered, alarm.and_then(|alarm| alarm.figures.p)) {
            (None, Some(p)) => text += &format!(" The last answer was p {}.", probability(p)),
            (Some(a), _) if a.stiction == Some(false) => text += " The alarm is still active: wait for more windows.",
            _ => {}
        }
        if let Some(driven) = &self.candidate.driven {
            let first = if driven.starts_with("driven by") { ": repair the source first" } else { "" };
            text += &format!(" {}{first}.", capital(driven));
        }
        if self.candidate.silent {
            text += " No new data.";
        }
        text
    }

    fn work(&self, rank: usize, benefit: Option<&Benefit>) -> Work {
        let candidate = self.candidate;
        let pending = benefit.is_none() && rank <= SIMULATED && self.simulable().is_some();
        let of_alarm = || candidate.alarm.as_deref().and_then(|alarm| alarm.figures.s);
        Work {
            rank,
            loop_name: candidate.name.clone(),
            area: candidate.place.area.clone(),
            equipment: candidate.place.equipment.clone(),
            criticality: candidate.place.criticality,
            alarm: candidate.alarm.as_deref().is_some_and(|alarm| alarm.active),
            p_stiction: self.p,
            probability: self.answered.map(words::seen).or_else(|| self.p.map(|p| format!("p {}", probability(p)))),
            grade: self.grade(),
            size: self.answered.and_then(answer::size),
            s: self.answered.filter(|a| a.stiction == Some(true)).map_or_else(of_alarm, |a| a.s),
            op_unit: candidate.place.op_unit.clone(),
            s_trend: candidate.s_trend,
            removed: benefit.and_then(|b| b.as_ref().ok()).copied(),
            pending,
            window_end_ms: candidate.estimate.as_deref().map(|e| ms_from_ns(e.assessment.window.end_ns)),
            cost: self.cost(benefit),
            benefit: self.benefit(benefit, pending),
            next_step: self.next_step(),
            what_to_do: self.what_to_do(),
            why: self.why(benefit, pending),
            sure: self.sure(),
        }
    }
}

/// Candidates by the cost of leaving them alone, highest first, ties by name. `benefits` has the known benefits by loop.
#[must_use]
pub fn rank(candidates: &[Candidate], benefits: &BTreeMap<String, Benefit>) -> Vec<Work> {
    let known = candidates.iter().map(Known::of);
    let mut all: Vec<(f64, Known<'_>)> = known.map(|k| (k.cost(benefits.get(&k.candidate.name)), k)).collect();
    all.sort_by(|(a, x), (b, y)| b.total_cmp(a).then_with(|| x.candidate.name.cmp(&y.candidate.name)));
    let place = |(at, (_, known)): (usize, &(f64, Known<'_>))| known.work(at + 1, benefits.get(&known.candidate.name));
    all.iter().enumerate().map(place).collect()
}

/// End of the window whose repair can be simulated, ns since 1970; `None` if the newest window finds no stiction.
#[must_use]
pub fn simulable(candidate: &Candidate) -> Option<i64> {
    Known::of(candidate).simulable()
}
