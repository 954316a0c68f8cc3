//! The current status of a loop: its NE 107 sign, one sentence, and the answer of its newest window. Tiles, headline, page,
//! lists and tables all use it.

mod plant;

use serde::{Deserialize, Serialize};

use crate::alarm::{AlarmDocument, State, no_alarm};
use stiction::core::verdict::answer::Standing;
use stiction::core::verdict::{Assessment, Gate, NO_VALVE, Verdict, texts};
use stiction::words;
use stiction::words::answer::{Answer, settled};

pub use plant::{Headline, InPlant, Mood};

/// NAMUR NE 107 for a loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, schemars::JsonSchema)]
pub enum Sign {
    /// Maintenance required: the stiction alarm is active.
    #[serde(rename = "M")]
    Maintenance,
    /// Failure of a signal.
    #[serde(rename = "F")]
    Failure,
    /// Out of specification: the loop oscillates, or its valve sticks without an alarm.
    #[serde(rename = "S")]
    OutOfSpecification,
    /// Function check: out of service, or in manual.
    #[serde(rename = "C")]
    FunctionCheck,
    /// None of them: nothing was found. This does not say that the valve is in order.
    #[serde(rename = "none")]
    NothingFound,
}

impl Sign {
    /// Every sign, the most pressing first.
    pub const ALL: [Self; 5] =
        [Self::Maintenance, Self::Failure, Self::OutOfSpecification, Self::FunctionCheck, Self::NothingFound];

    /// Its letter in documents.
    #[must_use]
    pub const fn id(self) -> &'static str {
        match self {
            Self::Maintenance => "M",
            Self::Failure => "F",
            Self::OutOfSpecification => "S",
            Self::FunctionCheck => "C",
            Self::NothingFound => "none",
        }
    }

    /// Its name, and its meaning for a loop.
    #[must_use]
    pub const fn words(self) -> [&'static str; 2] {
        match self {
            Self::Maintenance => ["maintenance required", "stiction alarm active"],
            Self::Failure => ["failure of the signal", "signal frozen, bad or missing"],
            Self::OutOfSpecification => ["out of specification", "oscillates, or sticks without an alarm"],
            Self::FunctionCheck => ["function check", "in manual or out of service"],
            Self::NothingFound => ["nothing found", "no oscillation and no sign of stiction found"],
        }
    }

    /// The sign of an alarm alone: a loop out of service needs no maintenance for its alarm.
    #[must_use]
    pub const fn of_alarm(active: bool, out_of_service: bool) -> Option<Self> {
        match (out_of_service, active) {
            (true, _) => Some(Self::FunctionCheck),
            (false, true) => Some(Self::Maintenance),
            (false, false) => None,
        }
    }
}

/// The data on a loop.
#[derive(Debug, Clone, Default)]
pub struct Known<'a> {
    /// Its newest estimate.
    pub estimate: Option<&'a Assessment>,
    /// Verdicts of its windows, newest first, including that of `estimate`.
    pub verdicts: Vec<Verdict>,
    /// Its alarm.
    pub alarm: Option<&'a AlarmDocument>,
    /// Whether newer samples are missing.
    pub silent: bool,
    /// Whether the newest estimate is from an earlier run.
    pub restored: bool,
}

/// Status of a loop.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct LoopStatus {
    /// NE 107; null while there is no answer.
    pub sign: Option<Sign>,
    /// The reason, in one sentence without capital and full stop.
    pub sentence: String,
    /// The displayed verdict: that of its newest window, or the cause named by most of its last windows.
    pub verdict: Option<Verdict>,
    /// The answer of the newest window, under that verdict.
    pub answer: Option<Answer>,
    /// Whether the answer is older than it should be: it is from an earlier run, or newer samples are missing.
    pub stale: bool,
    /// Whether a signal has failed, whatever the sign says.
    pub failed: bool,
    /// Whether its stiction alarm is active.
    pub active: bool,
    /// Whether that alarm waits for acknowledgement.
    pub unacknowledged: bool,
    /// Whether its alarm is shelved or suppressed.
    pub put_aside: bool,
}

impl LoopStatus {
    /// The status from the data.
    #[must_use]
    pub fn of(known: &Known<'_>) -> Self {
        let state = known.alarm.map_or(State::Normal, |alarm| alarm.state);
        let active = known.alarm.is_some_and(|alarm| alarm.active);
        let shown = known.estimate.map(|a| shown(a, &known.verdicts));
        let failure = failure(known);
        let newest = known.estimate.zip(shown.as_ref()).map(|(a, shown)| newest(a, shown));
        let of_alarm = Sign::of_alarm(active, state == State::OutOfService);
        let (sign, sentence) = match (of_alarm, &failure, newest) {
            (Some(Sign::FunctionCheck), ..) => (of_alarm, out_of_service(active)),
            (Some(sign), failure, newest) => (Some(sign), under_alarm(known, failure.as_deref(), newest)),
            (None, Some(failure), newest) => (Some(Sign::Failure), after_failure(failure, known.silent, newest)),
            (None, None, None) => (None, "waiting for a window".to_owned()),
            (None, None, Some((sign, sentence))) => (sign, without_alarm(known, sentence)),
        };
        let answer = known
            .estimate
            .zip(shown.as_ref())
            .map(|(a, shown)| Answer { sentence: shown.sentence.clone(), ..Answer::of(a) });
        Self {
            sign,
            sentence,
            verdict: shown.map(|shown| shown.verdict),
            answer,
            stale: known.estimate.is_some() && (known.silent || known.restored),
            failed: failure.is_some(),
            active,
            unacknowledged: matches!(state, State::Unack | State::RtnUnack),
            put_aside: matches!(state, State::Shelved | State::Suppressed),
        }
    }

    /// The conclusion of its newest window on stiction.
    #[must_use]
    pub fn standing(&self) -> Standing {
        self.answer.as_ref().map_or(Standing::NoAnswer, |answer| answer.standing)
    }
}

/// The displayed verdict of a loop, and its sentence.
struct Shown {
    verdict: Verdict,
    sentence: String,
}

/// A window that finds stiction, or gives no answer, is displayed as it is, since the alarm counts those. The cause of an
/// oscillation is the one that most of the last windows name.
fn shown(a: &Assessment, verdicts: &[Verdict]) -> Shown {
    let settled = settled(verdicts.iter().copied()).filter(|_| a.stiction == Some(false));
    match settled {
        Some((cause, count, of)) if cause != a.verdict => Shown {
            verdict: cause,
            sentence: format!("{} ({count} of the last {of} windows)", words::beside_cause(a, cause)),
        },
        _ => Shown { verdict: a.verdict, sentence: words::claim(a) },
    }
}

/// The fault of a signal, if any.
fn failure(known: &Known<'_>) -> Option<String> {
    if known.silent {
        return Some("no new data".to_owned());
    }
    let a = known.estimate?;
    let failed = |gate: &&Gate| {
        matches!(gate, Gate::FrozenPv | Gate::FrozenOp | Gate::NoResponse | Gate::Swapped | Gate::BadQuality)
    };
    let of_gate = a.gates.iter().find(failed).map(|gate| words::gate(*gate).to_owned());
    of_gate.or_else(|| a.reason.filter(|reason| *reason == "stuck_signal").map(words::reason))
}

fn out_of_service(active: bool) -> String {
    format!("out of service{}", if active { ", while its stiction alarm is active" } else { "" })
}

/// Sign and sentence from the newest window, whatever the alarm.
fn newest(a: &Assessment, shown: &Shown) -> (Option<Sign>, String) {
    if a.gates.contains(&Gate::Manual) {
        return (Some(Sign::FunctionCheck), "the controller is in manual".to_owned());
    }
    let sign = match (shown.verdict, Standing::of(a)) {
        (Verdict::Inconclusive, _) if a.reason == Some(NO_VALVE) && a.oscillation.oscillating => {
            Some(Sign::OutOfSpecification)
        }
        (Verdict::Inconclusive, _) | (Verdict::NotOscillating, Standing::Open) => None,
        (Verdict::NotOscillating, _) => Some(Sign::NothingFound),
        _ => Some(Sign::OutOfSpecification),
    };
    (sign, shown.sentence.clone())
}

/// The sentence while the alarm is active: the finding of the newest window, or that the window does not confirm the alarm.
fn under_alarm(known: &Known<'_>, failure: Option<&str>, newest: Option<(Option<Sign>, String)>) -> String {
    let found = known.estimate.is_some_and(|a| Standing::of(a).is_found());
    let said = match (newest, failure) {
        (Some((_, sentence)), None) if found && !known.restored => return sentence,
        (Some((_, sentence)), None) if known.restored => format!("no window since the start; the last one: {sentence}"),
        (_, Some(failure)) => failure.to_owned(),
        (Some((_, sentence)), None) => format!("the newest window does not confirm it: {sentence}"),
        (None, None) => "no window since the start".to_owned(),
    };
    format!("stiction alarm active; {said}")
}

fn after_failure(failure: &str, silent: bool, newest: Option<(Option<Sign>, String)>) -> String {
    match newest {
        Some((_, sentence)) if silent => format!("{failure}; the last window: {sentence}"),
        _ => failure.to_owned(),
    }
}

/// The sentence without an alarm: a sticking valve has none yet, or cannot have one.
fn without_alarm(known: &Known<'_>, sentence: String) -> String {
    let found = known.estimate.is_some_and(|a| Standing::of(a).is_found());
    let no_alarm = known.estimate.filter(|_| found).map_or_else(String::new, |a| {
        no_alarm(a).map_or_else(|| "; no alarm yet".to_owned(), |why| format!("; no alarm: {why}"))
    });
    let since = if known.restored { "no window since the start; the last one: " } else { "" };
    format!("{since}{sentence}{no_alarm}")
}

/// A sentence with a capital and a full stop.
#[must_use]
pub fn sentence(text: &str) -> String {
    texts::capital(text) + "."
}

#[cfg(test)]
mod tests;
