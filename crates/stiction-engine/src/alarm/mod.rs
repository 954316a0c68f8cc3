//! The stiction alarm of one loop, after ISA-18.2: raised by m of n windows, unchanged by uninformative windows, cleared with
//! a dead band, acknowledged by a person, raised again when it gets worse.
//!
//! It is a maintenance alert. It depends only on the order of the windows and on event time, never on a clock.

mod command;
mod document;
mod params;
mod priority;
mod why;

use serde::{Deserialize, Serialize};
use stiction::core::ident::region::Size;

pub use command::{AlarmAction, Command, CommandError, MAX_SHELVE_S, SHELVE_S, check_name};
pub use document::{ALARM_SCHEMA, AlarmDocument, AlarmWindow, Event, Figures, LoopContext, Mark, Marks};
pub use params::AlarmParams;
pub use priority::Priority;
pub use why::why_not_active;

use crate::status::Sign;
use document::{Occurrence, event_id, occurrence_id};
use stiction::core::units::{format_rfc3339, probability};
use stiction::core::verdict::answer::Scale;
use stiction::core::verdict::{Assessment, NO_VALVE};
use stiction::words;
use stiction::words::action::Action;

/// s counts towards clearing below this fraction of the limit.
const CLEAR_SHARE: f64 = 0.8;
/// Band that even a new valve with its positioner may have, % of travel (0.25 to 1 % by type), or OP units if OP's range is
/// unknown.
const NEW_VALVE: f64 = 0.5;
/// Consecutive windows with a worse class before the alarm is raised again.
const WORSE_WINDOWS: u8 = 2;

/// Alarm states of ISA-18.2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, Default, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Not active, nothing to acknowledge.
    #[default]
    Normal,
    /// Active, not acknowledged.
    Unack,
    /// Active, acknowledged.
    Acked,
    /// No longer active, not acknowledged.
    RtnUnack,
    /// Shelved by a person for a time.
    Shelved,
    /// Suppressed by design.
    Suppressed,
    /// Taken out of service.
    OutOfService,
}

impl State {
    /// The state's word in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::Unack => "unack",
            Self::Acked => "acked",
            Self::RtnUnack => "rtn_unack",
            Self::Shelved => "shelved",
            Self::Suppressed => "suppressed",
            Self::OutOfService => "out_of_service",
        }
    }
}

/// What a window means for the alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Evidence {
    /// Stiction of at least the limit.
    For,
    /// No stiction, or clearly below the limit.
    Against,
    /// Stiction a little below the limit: neither raises nor clears.
    Between,
    /// No information, or not enough of it: the alarm does not change.
    None,
}

impl Evidence {
    /// From an assessment. Only windows that count, by [`Assessment::counted_by`], raise or clear.
    #[must_use]
    pub fn of(assessment: &Assessment, params: &AlarmParams) -> Self {
        let limit = s_limit(assessment, params).unwrap_or(0.0);
        match (assessment.stiction, assessment.s) {
            // An alarm from before the declaration clears.
            (None, _) if assessment.reason == Some(NO_VALVE) => Self::Against,
            (None, _) => Self::None,
            _ if assessment.counted_by.is_none() || no_alarm(assessment).is_some() => Self::None,
            (Some(true), Some(s)) if s >= limit => Self::For,
            (Some(true), Some(s)) if s >= CLEAR_SHARE * limit => Self::Between,
            _ => Self::Against,
        }
    }
}

/// Why a window that finds stiction raises no alarm whatever the limits are; `None` if it may raise one.
#[must_use]
pub fn no_alarm(a: &Assessment) -> Option<&'static str> {
    match (a.stiction?, a.s) {
        (true, _) if !is_sure(a) => Some("its calibrated p is below the alarm threshold"),
        (true, None) => Some("the size is not known"),
        _ => None,
    }
}

/// Whether p, which a group may have lowered, is high enough to count towards an alarm.
fn is_sure(a: &Assessment) -> bool {
    a.explanation.is_none_or(|opinion| a.p_calibrated.unwrap_or_else(|| opinion.p()) >= opinion.cuts.alarm)
}

/// The s above which a window counts, OP units: the smaller of the limits that are set, if any. If OP's span is small, a
/// fraction of it is no fault of the valve, so the limit by span is at least [`NEW_VALVE`]. If OP's range is unknown and OP
/// moves by no more than one unit, OP may run from 0 to 1, so that minimum cannot be applied.
fn s_limit(a: &Assessment, params: &AlarmParams) -> Option<f64> {
    let scale = Scale::of(a);
    let span = a.s.zip(a.s_over_span).map(|(s, share)| s / share).filter(|span| span.is_finite() && *span > 0.0);
    let by_span = span.filter(|_| params.s_limit_span > 0.0).map(|span| params.s_limit_span * span);
    let is_known = a.op_range.is_some() || span.is_some_and(|span| span > 1.0);
    let by_span = by_span.map(|limit| if is_known { limit.max(scale.op_units(NEW_VALVE)) } else { limit });
    let by_op = (params.s_limit_op > 0.0).then(|| scale.op_units(params.s_limit_op));
    [by_op, by_span].into_iter().flatten().reduce(f64::min)
}

/// Inhibition of an alarm by people; the alarm itself continues behind it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Inhibit {
    /// Shelved until this event time, ns.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shelved_until_ns: Option<i64>,
    /// Suppressed by design, for example while a unit is down.
    pub suppressed: bool,
    /// Out of service, for example while the valve is repaired.
    pub out_of_service: bool,
}

impl Inhibit {
    fn is_nowhere(&self) -> bool {
        *self == Self::default()
    }
}

/// The alarm of one loop with its m-of-n history. Written into every recording, so that a restart keeps it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Alarm {
    /// Its state without inhibition: `normal`, `unack`, `acked` or `rtn_unack`. See [`Alarm::shown`].
    pub state: State,
    /// Its inhibition.
    #[serde(default, skip_serializing_if = "Inhibit::is_nowhere")]
    pub aside: Inhibit,
    /// Whether the condition is active.
    pub active: bool,
    /// The last informative windows, newest in bit 0: 1 for stiction.
    history_for: u32,
    /// The same: 1 for no stiction.
    history_against: u32,
    /// Worst class since the alarm was raised.
    class: Option<Size>,
    worse_windows: u8,
    window_end_ns: Option<i64>,
    /// Data of the raised alarm, until it returns to normal.
    #[serde(default)]
    occurrence: Option<Occurrence>,
    /// When it was raised, in states written by builds that kept only this.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    raised_ns: Option<i64>,
    /// Size from the newest informative window.
    #[serde(default)]
    figures: Figures,
    /// What to do, by the newest window that found stiction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    action: Option<Action>,
    /// Data of the last command.
    #[serde(default)]
    marks: Marks,
    /// Number of changes so far, and the identity of the last one.
    #[serde(default)]
    changes: u64,
    #[serde(default)]
    event_id: String,
}

/// Reason in the document when shelving ends by itself.
const SHELF_OVER: &str = "the shelving time has ended";
/// Reason in the document when the loop is removed.
const REMOVED: &str = "the loop was removed from the configuration";

/// Default reason of a command.
const fn done_by(event: Event) -> &'static str {
    match event {
        Event::Shelved => "shelved",
        Event::Unshelved => "unshelved",
        Event::Suppressed => "suppressed",
        Event::Unsuppressed => "no longer suppressed",
        Event::OutOfService => "taken out of service",
        Event::InService => "back in service",
        _ => "acknowledged",
    }
}

impl Alarm {
    /// The displayed state: out of service takes precedence over suppressed, then shelved, then the rest.
    #[must_use]
    pub const fn shown(&self) -> State {
        match self.aside {
            Inhibit { out_of_service: true, .. } => State::OutOfService,
            Inhibit { suppressed: true, .. } => State::Suppressed,
            Inhibit { shelved_until_ns: Some(_), .. } => State::Shelved,
            _ => self.state,
        }
    }

    /// Whether it is not inhibited, and is active or has a newest informative window that counts towards raising it.
    #[must_use]
    pub fn is_active_or_near(&self) -> bool {
        (self.active || self.history_for & 1 == 1) && self.aside.is_nowhere()
    }

    /// Takes the next window of the loop; returns a document if the state changes.
    pub fn window(&mut self, loop_name: &str, a: &Assessment, params: &AlarmParams) -> Option<AlarmDocument> {
        let end_ns = a.window.end_ns;
        self.window_end_ns = Some(end_ns);
        let over = self.aside.shelved_until_ns.is_some_and(|until_ns| end_ns >= until_ns);
        if over {
            self.aside.shelved_until_ns = None;
            self.marks.shelved = None;
        }
        let (event, detail) = match (self.weigh(a, params), over) {
            (Some((event, detail)), true) => (event, format!("{detail}; {SHELF_OVER}")),
            (None, true) => (Event::ShelfEnded, SHELF_OVER.to_owned()),
            (Some(changed), false) => changed,
            (None, false) => return None,
        };
        Some(self.changed(loop_name, end_ns, event, None, detail))
    }

    /// The change due to a window, and its reason.
    fn weigh(&mut self, a: &Assessment, params: &AlarmParams) -> Option<(Event, String)> {
        let evidence = Evidence::of(a, params);
        if evidence == Evidence::None {
            return None;
        }
        self.figures = Figures::of(a, s_limit(a, params));
        self.action = Action::of(a).or(self.action);
        let [m, n] = params.raise.map(u32::from);
        let mask = u32::MAX >> (32 - n.clamp(1, 32));
        self.history_for = (self.history_for << 1 | u32::from(evidence == Evidence::For)) & mask;
        self.history_against = (self.history_against << 1 | u32::from(evidence == Evidence::Against)) & mask;
        let class = words::size_class(a);
        if !self.active && evidence == Evidence::For && self.history_for.count_ones() >= m {
            self.active = true;
            self.history_against = 0;
            self.state = State::Unack;
            self.class = class;
            self.worse_windows = 0;
            self.marks.acknowledged = None;
            let why = format!("{} of the last {n} windows show stiction; {}", self.history_for.count_ones(), size(a));
            self.occurrence = Some(Occurrence { since_ns: a.window.end_ns, why: why.clone() });
            return Some((Event::Raised, why));
        }
        if self.active && self.history_against.count_ones() >= m {
            self.active = false;
            self.history_for = 0;
            self.state = if self.state == State::Unack { State::RtnUnack } else { State::Normal };
            let shown = self.history_against.count_ones();
            return Some((Event::Cleared, format!("{shown} of the last {n} windows show no sign of stiction")));
        }
        self.worsened(a, class, evidence)
    }

    /// Raises an active alarm again when its class stays worse.
    fn worsened(&mut self, a: &Assessment, class: Option<Size>, evidence: Evidence) -> Option<(Event, String)> {
        let worse =
            self.active && evidence == Evidence::For && class.unwrap_or(Size::None) > self.class.unwrap_or(Size::None);
        self.worse_windows = if worse { self.worse_windows + 1 } else { 0 };
        if self.worse_windows < WORSE_WINDOWS {
            return None;
        }
        self.worse_windows = 0;
        let [before, now] = [self.class, class].map(|class| class.map_or("none", Size::name));
        self.class = class;
        self.state = State::Unack;
        self.marks.acknowledged = None;
        let why = format!("stiction has got worse, from {before} to {now}; {}", size(a));
        if let Some(occurrence) = &mut self.occurrence {
            occurrence.why.clone_from(&why);
        }
        Some((Event::Worse, why))
    }

    /// Carries out a person's command at the loop's event time.
    ///
    /// # Errors
    /// [`CommandError`] if the name is missing, or the command is unknown or does not fit the state; nothing changes then.
    pub fn command(&mut self, loop_name: &str, c: &Command, at_ns: i64) -> Result<AlarmDocument, CommandError> {
        let by = c.by.as_deref().filter(|by| !by.trim().is_empty()).ok_or(CommandError::Nameless)?;
        let mark = |until_ns| Some(Mark::new(by, c.why.as_ref(), at_ns, until_ns));
        let event = match c.action {
            AlarmAction::Ack => {
                self.acknowledge(loop_name)?;
                self.marks.acknowledged = mark(None);
                Event::Acknowledged
            }
            AlarmAction::Shelve => {
                self.shelve(loop_name, c.for_s.unwrap_or(SHELVE_S), at_ns)?;
                self.marks.shelved = mark(self.aside.shelved_until_ns);
                Event::Shelved
            }
            AlarmAction::Unshelve => {
                let shelved = self.aside.shelved_until_ns.take().is_some();
                self.expect(loop_name, shelved, "it is not shelved")?;
                self.marks.shelved = None;
                Event::Unshelved
            }
            AlarmAction::Suppress | AlarmAction::Unsuppress => {
                let on = c.action == AlarmAction::Suppress;
                self.put(loop_name, |aside| &mut aside.suppressed, on)?;
                self.marks.suppressed = mark(None).filter(|_| on);
                if on { Event::Suppressed } else { Event::Unsuppressed }
            }
            AlarmAction::OutOfService | AlarmAction::InService => {
                let out = c.action == AlarmAction::OutOfService;
                self.put(loop_name, |aside| &mut aside.out_of_service, out)?;
                self.marks.out_of_service = mark(None).filter(|_| out);
                if out { Event::OutOfService } else { Event::InService }
            }
        };
        let detail = c.why.clone().unwrap_or_else(|| done_by(event).to_owned());
        Ok(self.changed(loop_name, at_ns, event, Some(by.to_owned()), detail))
    }

    fn acknowledge(&mut self, loop_name: &str) -> Result<(), CommandError> {
        self.state = match self.state {
            State::Unack => State::Acked,
            State::RtnUnack => State::Normal,
            _ => {
                let (loop_name, state) = (loop_name.to_owned(), self.shown().name());
                return Err(CommandError::NothingToAcknowledge { loop_name, state });
            }
        };
        Ok(())
    }

    fn shelve(&mut self, loop_name: &str, for_s: u64, at_ns: i64) -> Result<(), CommandError> {
        if !(1..=MAX_SHELVE_S).contains(&for_s) {
            return Err(CommandError::ShelveTime(for_s));
        }
        self.expect(loop_name, self.aside.shelved_until_ns.is_none(), "unshelve it first")?;
        let for_ns = i64::try_from(for_s).unwrap_or(i64::MAX).saturating_mul(1_000_000_000);
        self.aside.shelved_until_ns = Some(at_ns.saturating_add(for_ns));
        Ok(())
    }

    fn put(&mut self, loop_name: &str, place: fn(&mut Inhibit) -> &mut bool, to: bool) -> Result<(), CommandError> {
        let changes = std::mem::replace(place(&mut self.aside), to) != to;
        self.expect(loop_name, changes, if to { "already in this state" } else { "not in this state" })
    }

    fn expect(&self, loop_name: &str, fits: bool, why: &'static str) -> Result<(), CommandError> {
        if fits {
            return Ok(());
        }
        Err(CommandError::Unfit { loop_name: loop_name.to_owned(), state: self.shown().name(), why })
    }

    /// Ends the alarm of a loop that is no longer configured. `None` if it is normal.
    pub fn remove(&mut self, loop_name: &str, at_ns: i64) -> Option<AlarmDocument> {
        if self.shown() == State::Normal {
            return None;
        }
        (self.state, self.active) = (State::Normal, false);
        (self.aside, self.marks) = (Inhibit::default(), Marks::default());
        Some(self.changed(loop_name, at_ns, Event::Removed, None, REMOVED.to_owned()))
    }

    /// End of the last window taken.
    #[must_use]
    pub const fn window_end_ns(&self) -> Option<i64> {
        self.window_end_ns
    }

    /// Progress, by which of two states of the same alarm the newer one is greater.
    #[must_use]
    pub const fn progress(&self) -> (Option<i64>, u64) {
        (self.window_end_ns, self.changes)
    }

    /// The document of the current state, after a restart.
    #[must_use]
    pub fn restored(&self, loop_name: &str) -> AlarmDocument {
        let at_ns = self.window_end_ns.unwrap_or(0);
        self.document(loop_name, at_ns, Event::Restored, None, "restored from the previous run".to_owned())
    }

    /// Makes the document of a change and counts the change.
    fn changed(
        &mut self,
        loop_name: &str,
        changed_ns: i64,
        event: Event,
        by: Option<String>,
        detail: String,
    ) -> AlarmDocument {
        self.changes += 1;
        self.event_id = event_id(loop_name, self.changes, changed_ns, event);
        let document = self.document(loop_name, changed_ns, event, by, detail);
        if !self.active {
            self.class = None;
            if self.state == State::Normal {
                (self.occurrence, self.raised_ns) = (None, None);
                self.marks.acknowledged = None;
            }
        }
        document
    }

    fn document(
        &self,
        loop_name: &str,
        changed_ns: i64,
        event: Event,
        by: Option<String>,
        detail: String,
    ) -> AlarmDocument {
        let since_ns = self.occurrence.as_ref().map(|o| o.since_ns).or(self.raised_ns);
        let document = AlarmDocument {
            schema: ALARM_SCHEMA,
            loop_name: loop_name.to_owned(),
            alarm: "stiction",
            event_id: self.event_id.clone(),
            occurrence_id: since_ns.map(|since_ns| occurrence_id(loop_name, since_ns)),
            event,
            state: self.shown(),
            active: self.active,
            priority: None,
            criticality: None,
            area: None,
            equipment: None,
            ne107: self.ne107(),
            class: self.class.filter(|_| self.active),
            unit: String::new(),
            figures: self.figures.clone(),
            action: self.action,
            why: self.occurrence.as_ref().map(|o| o.why.clone()),
            what_to_do: None,
            since_ns,
            since: since_ns.map(format_rfc3339),
            changed_ns,
            changed: format_rfc3339(changed_ns),
            by,
            detail,
            marks: self.marks.clone(),
            daemon: None,
        };
        document.at(&LoopContext::default())
    }

    /// NE 107 category: out of service takes precedence.
    fn ne107(&self) -> &'static str {
        Sign::of_alarm(self.active, self.aside.out_of_service).unwrap_or(Sign::NothingFound).id()
    }
}

/// The finding and its size in words.
fn size(a: &Assessment) -> String {
    let size = words::size(a).unwrap_or_else(|| "unknown size".to_owned());
    let p = a.p_stiction.map_or_else(String::new, |p| format!("; p {}, {}", probability(p), words::assumed(a)));
    format!("{}: {size}{p}", words::claim(a))
}

#[cfg(test)]
mod tests;
