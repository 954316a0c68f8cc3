//! The plant's headline in sentences: what is wrong, where to begin, and how certain it is. Active alarms come first.

use serde::Serialize;

use super::{LoopStatus, Sign, sentence};
use crate::alarm::Priority;
use stiction::core::ident::region::Size;
use stiction::core::verdict::answer::Standing;

/// A loop of the plant.
#[derive(Debug, Clone, Copy)]
pub struct InPlant<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its status.
    pub status: &'a LoopStatus,
    /// Priority of its alarm.
    pub priority: Option<Priority>,
    /// Class of its alarm.
    pub class: Option<Size>,
    /// Probability that its valve sticks, from its newest window.
    pub p: Option<f64>,
}

impl InPlant<'_> {
    /// Its urgency; larger values come first.
    #[must_use]
    pub fn urgency(&self) -> f64 {
        let found = self.status.standing().is_found();
        let sign = match self.status.sign {
            Some(Sign::Maintenance) => 6.0,
            Some(Sign::OutOfSpecification) if found => 5.0,
            Some(Sign::Failure) => 4.0,
            Some(Sign::OutOfSpecification) => 3.0,
            Some(Sign::FunctionCheck) => 2.0,
            None => 1.0,
            Some(Sign::NothingFound) => 0.0,
        };
        let priority = match self.priority {
            None => 0.0,
            Some(Priority::Low) => 1.0,
            Some(Priority::Medium) => 2.0,
            Some(Priority::High) => 3.0,
            Some(Priority::Urgent) => 4.0,
        };
        let class = match self.class {
            None | Some(Size::None) => 0.0,
            Some(Size::Weak) => 1.0,
            Some(Size::Moderate) => 2.0,
            Some(Size::Strong) => 3.0,
        };
        let waits = f64::from(u8::from(self.status.unacknowledged));
        1e4 * sign + 1e3 * priority + 500.0 * waits + 100.0 * class + 99.0 * self.p.unwrap_or(0.0)
    }
}

/// The plant's overall state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mood {
    /// An alarm is active.
    Act,
    /// A valve shows stiction without an alarm, or a signal has failed.
    Watch,
    /// Neither.
    Calm,
    /// No loop has an answer.
    Wait,
}

/// The plant in sentences.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Headline {
    /// The overall state.
    pub mood: Mood,
    /// The first sentence.
    pub words: String,
    /// The loop to begin with: the one with the most urgent active alarm.
    pub first: Option<String>,
    /// Further sentences.
    pub more: Vec<String>,
}

#[derive(Debug, Default)]
struct Counts {
    all: usize,
    maintain: usize,
    aside: usize,
    unacknowledged: usize,
    out_of_service: usize,
    sticking: usize,
    oscillating: usize,
    open: usize,
    failed: usize,
    unanswered: usize,
    missing: usize,
}

impl Counts {
    fn add(&mut self, status: &LoopStatus) {
        let found = status.standing().is_found();
        self.all += 1;
        self.maintain += usize::from(status.sign == Some(Sign::Maintenance));
        self.aside += usize::from(status.sign == Some(Sign::Maintenance) && status.put_aside);
        self.unacknowledged += usize::from(status.unacknowledged);
        self.out_of_service += usize::from(status.active && status.sign != Some(Sign::Maintenance));
        self.sticking += usize::from(status.sign == Some(Sign::OutOfSpecification) && found);
        self.oscillating += usize::from(status.sign == Some(Sign::OutOfSpecification) && !found);
        self.open += usize::from(status.sign.is_none() && status.standing() == Standing::Open);
        self.failed += usize::from(status.failed);
        self.unanswered += usize::from(status.sign.is_none() && status.answer.is_none());
    }
}

fn count(n: usize, one: &str, many: &str) -> String {
    format!("{n} {}", if n == 1 { one } else { many })
}

impl Headline {
    /// For all loops; `missing` further ones are configured but have sent nothing. `prefix` is where data are expected.
    #[must_use]
    pub fn of<'a>(loops: impl IntoIterator<Item = InPlant<'a>>, missing: usize, prefix: &str) -> Self {
        let mut counts = Counts { all: missing, missing, ..Counts::default() };
        let mut first: Option<InPlant<'a>> = None;
        let mut only = None;
        for one in loops {
            counts.add(one.status);
            only = Some(one.name);
            let presses = |known: &InPlant<'_>| one.urgency().total_cmp(&known.urgency()).is_gt();
            if one.status.sign == Some(Sign::Maintenance) && first.as_ref().is_none_or(presses) {
                first = Some(one);
            }
        }
        let Some(only) = only else {
            let words = format!("No loop yet: waiting for data under {prefix}.");
            return Self { mood: Mood::Wait, words, first: None, more: Vec::new() };
        };
        let mut more: Vec<String> = first.iter().map(|one| sentence(&evidence(one))).collect();
        more.extend(counts.more());
        Self {
            mood: counts.mood(),
            words: counts.words(first.as_ref().map(|one| one.name), only),
            first: first.map(|one| one.name.to_owned()),
            more,
        }
    }
}

impl Counts {
    const fn mood(&self) -> Mood {
        if self.maintain > 0 {
            Mood::Act
        } else if self.unanswered + self.missing == self.all {
            Mood::Wait
        } else if self.sticking > 0 || self.failed > 0 || self.unacknowledged > 0 {
            Mood::Watch
        } else {
            Mood::Calm
        }
    }

    fn words(&self, first: Option<&str>, only: &str) -> String {
        let valves = count(self.all, "valve", "valves");
        match (self.maintain, first) {
            (1, Some(name)) => format!("1 of {valves} needs maintenance: {name}."),
            (n, Some(name)) => format!("{n} of {valves} need maintenance; {name} first."),
            _ if self.unanswered + self.missing == self.all => {
                format!(
                    "No answer yet: {} still collecting a first window.",
                    count(self.unanswered, "loop is", "loops are")
                )
            }
            _ if self.all == 1 => format!("No stiction alarm for {only}."),
            _ => format!("No stiction alarm in {valves}."),
        }
    }

    /// The further sentences.
    fn more(&self) -> Vec<String> {
        let told = self.unanswered + self.missing == self.all && self.maintain == 0;
        let waiting = if told { 0 } else { self.unanswered };
        let said = [
            (self.unacknowledged, "alarm waits", "alarms wait", "for an acknowledgement"),
            (self.aside, "active alarm is", "active alarms are", "shelved or suppressed"),
            (self.out_of_service, "active alarm is", "active alarms are", "out of service"),
            (self.sticking, "valve shows", "valves show", "stiction without an alarm"),
            (self.oscillating, "loop oscillates", "loops oscillate", "for another or an unknown reason"),
            (self.open, "loop leaves", "loops leave", "open whether the valve sticks"),
            (self.failed, "loop has", "loops have", "a failed or missing signal"),
            (waiting, "loop is", "loops are", "still collecting a first window"),
            (self.missing, "configured loop has", "configured loops have", "sent nothing yet"),
        ];
        let said = said.into_iter().filter(|(n, ..)| *n > 0);
        said.map(|(n, one, many, rest)| format!("{} {rest}.", count(n, one, many))).collect()
    }
}

/// A loop's status with its figures, in one line.
fn evidence(one: &InPlant<'_>) -> String {
    let mut text = format!("{}: {}", one.name, one.status.sentence);
    if let Some(answer) = &one.status.answer {
        let size = answer.size.iter().map(|size| format!("s {size}"));
        for part in size.chain([answer.probability.clone()]) {
            text = format!("{text}, {part}");
        }
    }
    text
}
