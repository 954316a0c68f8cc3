//! The alarm's document: every change as structured fields, so that no program has to parse text.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use stiction::core::ident::region::Size;

use super::{Priority, State};
use crate::hash::short_hash;
use stiction::core::units::format_rfc3339;
use stiction::core::verdict::Assessment;
use stiction::core::verdict::answer::{self, Scale};
use stiction::words;
use stiction::words::action::Action;

/// Schema name of an alarm.
pub const ALARM_SCHEMA: &str = "stictiond.alarm.v2";
/// Unit of sizes if none is configured: the unit of OP, whatever that is.
const OP_UNIT: &str = "OP";

/// Reason for an alarm document.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Event {
    /// The condition appeared.
    Raised,
    /// The condition holds and has become more severe.
    Worse,
    /// The condition ended.
    Cleared,
    /// A person has acknowledged it.
    Acknowledged,
    /// A person shelved the alarm for a time.
    Shelved,
    /// A person unshelved the alarm.
    Unshelved,
    /// The shelving expired.
    ShelfEnded,
    /// Suppressed by design.
    Suppressed,
    /// No longer suppressed by design.
    Unsuppressed,
    /// Taken out of service.
    OutOfService,
    /// Back in service.
    InService,
    /// The loop was removed from the configuration.
    Removed,
    /// Nothing changed: repeated after a restart under the identity of its last change.
    Restored,
}

impl Event {
    /// The event's word in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Raised => "raised",
            Self::Worse => "worse",
            Self::Cleared => "cleared",
            Self::Acknowledged => "acknowledged",
            Self::Shelved => "shelved",
            Self::Unshelved => "unshelved",
            Self::ShelfEnded => "shelf_ended",
            Self::Suppressed => "suppressed",
            Self::Unsuppressed => "unsuppressed",
            Self::OutOfService => "out_of_service",
            Self::InService => "in_service",
            Self::Removed => "removed",
            Self::Restored => "restored",
        }
    }
}

/// A loop's context from the configuration: site, importance, place and neighbours.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LoopContext {
    /// The site's prefix, since the same tag at another site is a different loop.
    pub site: Arc<str>,
    /// Importance of the loop, 1 to 5; `None` without a configuration entry.
    pub criticality: Option<u8>,
    /// Part of the plant.
    pub area: Option<String>,
    /// The valve's name in the maintenance system.
    pub equipment: Option<String>,
    /// Unit of OP.
    pub op_unit: Option<String>,
    /// Names of the loops upstream.
    pub upstream: Vec<String>,
}

/// A person's action on an alarm.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Mark {
    /// Who.
    pub by: String,
    /// Why, in that person's words.
    pub why: Option<String>,
    /// When, event time, ns since 1970.
    pub at_ns: i64,
    /// The same, RFC 3339.
    pub at: String,
    /// End, event time, ns since 1970; null if none was set.
    pub until_ns: Option<i64>,
    /// The same, RFC 3339.
    pub until: Option<String>,
}

impl Mark {
    pub(super) fn new(by: &str, why: Option<&String>, at_ns: i64, until_ns: Option<i64>) -> Self {
        let until = until_ns.map(format_rfc3339);
        Self { by: by.to_owned(), why: why.cloned(), at_ns, at: format_rfc3339(at_ns), until_ns, until }
    }
}

/// What people did to an alarm and what still holds of it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default)]
pub struct Marks {
    /// The acknowledgement of this occurrence; null while it waits for one.
    pub acknowledged: Option<Mark>,
    /// Put aside for a time.
    pub shelved: Option<Mark>,
    /// Suppressed by design.
    pub suppressed: Option<Mark>,
    /// Taken out of service.
    pub out_of_service: Option<Mark>,
}

/// The stretch of time that figures are from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct AlarmWindow {
    /// Stamp of its first sample, ns since 1970.
    pub start_ns: i64,
    /// Its end, which identifies the window, ns since 1970.
    pub end_ns: i64,
    /// The start, RFC 3339.
    pub start: String,
    /// The end, RFC 3339.
    pub end: String,
}

/// Figures of the newest window that could answer; null before there was one.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default)]
pub struct Figures {
    /// Verdict of that window.
    pub verdict: Option<String>,
    /// fs + fd, dead band plus stick band.
    pub s: Option<f64>,
    /// 90 % interval of s.
    pub s_interval: Option<[f64; 2]>,
    /// The s from which on that window counts for the alarm.
    pub s_limit: Option<f64>,
    /// Probability that the valve sticks, for the configured prevalence, 0 to 1.
    pub p: Option<f64>,
    /// The same where half of the valves stick, and the share that `p` assumes.
    pub p_calibrated: Option<f64>,
    /// See `p_calibrated`.
    pub prevalence: Option<f64>,
    /// s with its interval, its limit and p in words, in % of travel where OP's range is known; s where stiction was found.
    pub size: Option<String>,
    /// See `size`.
    pub limit: Option<String>,
    /// See `size`.
    pub probability: Option<String>,
    /// How much of the error the valve law explains, 0 to 1.
    pub stiction_index: Option<f64>,
    /// The window.
    pub window: Option<AlarmWindow>,
}

impl Figures {
    pub(super) fn of(a: &Assessment, s_limit: Option<f64>) -> Self {
        let (start_ns, end_ns) = (a.window.start_ns, a.window.end_ns);
        let window = AlarmWindow { start_ns, end_ns, start: format_rfc3339(start_ns), end: format_rfc3339(end_ns) };
        Self {
            verdict: Some(a.verdict.name().to_owned()),
            s: a.s,
            s_interval: a.s_interval,
            s_limit,
            p: a.p_stiction,
            p_calibrated: a.p_calibrated,
            prevalence: Some(a.prevalence),
            size: answer::size(a),
            limit: s_limit.map(|limit| Scale::of(a).told(limit)),
            probability: a.stiction.map(|_| words::seen(a)),
            stiction_index: a.stiction_index,
            window: Some(window),
        }
    }
}

/// One occurrence of the condition: from when it was raised until it has cleared and was acknowledged.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Occurrence {
    /// When it was raised, event time, ns.
    pub since_ns: i64,
    /// The reason, in words.
    pub why: String,
}

/// `stictiond.alarm.v2`: a change that is published, recorded and logged.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct AlarmDocument {
    /// [`ALARM_SCHEMA`].
    pub schema: &'static str,
    /// The loop's name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// Kind of alarm: `stiction`.
    pub alarm: &'static str,
    /// Identity of this change: a consumer that has it already can drop the document.
    pub event_id: String,
    /// Identity that all changes have in common from raising until the alarm is at rest again; null at rest.
    pub occurrence_id: Option<String>,
    /// Reason for this document.
    pub event: Event,
    /// State after it, of ISA-18.2.
    pub state: State,
    /// Whether the condition holds, even if the alarm is shelved, suppressed or out of service.
    pub active: bool,
    /// What to look at first, while active: follows from class and criticality (3 where that is null).
    pub priority: Option<Priority>,
    /// Importance of the loop, 1 to 5; null if the configuration gives none.
    pub criticality: Option<u8>,
    /// Part of the plant, from the configuration.
    pub area: Option<String>,
    /// The valve's name in the maintenance system, from the configuration.
    pub equipment: Option<String>,
    /// NE 107 category: `M` maintenance required while active, `C` function check while out of service, else `none`.
    pub ne107: &'static str,
    /// Worst class since it was raised, while active: `weak`, `moderate` or `strong`, by % of travel where OP's range is
    /// known, else by OP's span, and then at most `moderate`.
    pub class: Option<Size>,
    /// Unit of s, its interval and its limit.
    pub unit: String,
    /// Figures of the newest window that could answer.
    #[serde(flatten)]
    pub figures: Figures,
    /// What to do by the newest window that found stiction; written out in `what_to_do`.
    #[serde(skip)]
    pub action: Option<Action>,
    /// What raised the condition, in words; stays until the alarm is at rest again, whatever people do.
    pub why: Option<String>,
    /// What to do about it, while active.
    pub what_to_do: Option<String>,
    /// When the condition was raised, event time, ns since 1970.
    pub since_ns: Option<i64>,
    /// The same, RFC 3339.
    pub since: Option<String>,
    /// When this change happened, event time, ns since 1970.
    pub changed_ns: i64,
    /// The same, RFC 3339.
    pub changed: String,
    /// Who brought this change; null for the daemon itself.
    pub by: Option<String>,
    /// This change in words: a person's own where they gave any.
    pub detail: String,
    /// What people did to it.
    #[serde(flatten)]
    pub marks: Marks,
    /// Id of the daemon that published it; absent if there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub daemon: Option<String>,
}

impl AlarmDocument {
    /// The document with the loop's context: criticality and thus priority, area, equipment and unit; the identities are made
    /// unique for the site. A context without a site leaves the identities alone.
    #[must_use]
    pub fn at(self, place: &LoopContext) -> Self {
        let of_site = |id: String| {
            if place.site.is_empty() { id } else { short_hash(format!("{}\n{id}", place.site).as_bytes()) }
        };
        let priority =
            self.active.then(|| Priority::of(self.class, place.criticality.unwrap_or(Priority::CRITICALITY)));
        let unit = place.op_unit.as_deref().unwrap_or(OP_UNIT).to_owned();
        let what_to_do =
            self.active.then(|| self.action.map(|action| action.alone(&unit)).or(self.what_to_do)).flatten();
        Self {
            event_id: of_site(self.event_id),
            occurrence_id: self.occurrence_id.map(of_site),
            priority,
            criticality: place.criticality,
            area: place.area.clone(),
            equipment: place.equipment.clone(),
            unit,
            what_to_do,
            ..self
        }
    }

    /// One line that an operator can understand.
    #[must_use]
    pub fn line(&self) -> String {
        let by = self.by.as_ref().map(|b| format!(" by {b}")).unwrap_or_default();
        format!("{}: stiction alarm {}{by} at {}: {}", self.loop_name, self.state.name(), self.changed, self.detail)
    }
}

/// Identity of a change of a loop's alarm within its site: equal in a live run and its replay, different for every other
/// change.
pub(super) fn event_id(loop_name: &str, changes: u64, changed_ns: i64, event: Event) -> String {
    short_hash(format!("{loop_name}\n{changes}\n{changed_ns}\n{}", event.name()).as_bytes())
}

/// Identity of an occurrence within its site.
pub(super) fn occurrence_id(loop_name: &str, since_ns: i64) -> String {
    short_hash(format!("{loop_name}\n{since_ns}").as_bytes())
}
