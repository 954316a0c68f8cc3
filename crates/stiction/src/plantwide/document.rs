//! The document of a group, `stictiond.group.v1`.

use serde::Serialize;

use crate::units::Moment;
use crate::verdict::{Assessment, Verdict};

/// Schema of a group's document.
pub const GROUP_SCHEMA: &str = "stictiond.group.v1";

/// Loops whose oscillations are one, and which of them makes it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GroupDocument {
    /// [`GROUP_SCHEMA`].
    pub schema: &'static str,
    /// Names of the loops, the likeliest source first.
    pub members: Vec<String>,
    /// What makes the oscillation.
    pub source: Source,
    /// The other members, in the order of `members`.
    pub followers: Vec<Follower>,
    /// Every member as the group judges it, in the order of `members`.
    pub judgements: Vec<MemberJudgement>,
    /// Period of the common oscillation, s.
    pub period_s: f64,
    /// The time that all members' windows share.
    pub window: Span,
    /// Probability that chance links the weakest member, with all pairs compared.
    pub p_value: f64,
    /// How many pairs of loops were compared.
    pub pairs_compared: usize,
    /// Version of the library.
    pub version: &'static str,
}

/// A stretch of time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Span {
    /// Its start, ns since 1970.
    pub start_ns: i64,
    /// Its end, ns since 1970.
    pub end_ns: i64,
    /// The start, RFC 3339.
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub start: Moment,
    /// The end, RFC 3339.
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub end: Moment,
}

/// What kind of source a group has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum SourceKind {
    /// One member.
    Loop,
    /// None of the members.
    Outside,
    /// More than one member.
    Several,
    /// The windows do not decide it.
    CannotTell,
}

/// What makes a group's oscillation.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Source {
    /// What kind it is.
    pub kind: SourceKind,
    /// The loop; the likeliest one where it cannot be told; absent where it is outside.
    #[serde(rename = "loop")]
    pub loop_name: Option<String>,
    /// Probability of `kind`, with that loop where it is one.
    pub probability: f64,
    /// What says so, a sentence each.
    pub reasons: Vec<String>,
    /// What would settle it, where it cannot be told.
    pub next_test: Option<String>,
}

/// A member that does not make the oscillation.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Follower {
    /// Its name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// Its lag behind the likeliest source at the common period, s; as the sign of the gain between them is not known, it is
    /// given within half a period.
    pub lag_s: f64,
    /// Share of its signal's power in the common oscillation and its harmonics.
    pub share: f64,
}

/// A member as the group judges it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MemberJudgement {
    /// Its name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// Probability that the loop makes the oscillation.
    pub p_source: f64,
    /// Probability that its valve sticks, from the loop's own window alone.
    pub p_alone: Option<f64>,
    /// The same from the whole group.
    pub p_stiction: Option<f64>,
    /// What drives it, such as `driven by FIC101, p 0.94`; absent for the source.
    pub cause: Option<String>,
    /// The source's oscillation hides whether this valve sticks: judge it again once the source is repaired.
    pub masked: bool,
}

/// Reason of an estimate without a verdict: the loop follows an oscillation of its group, which hides the state of its valve.
pub const MASKED: &str = "masked";

impl MemberJudgement {
    /// Puts the group's answer into the estimate of the member's window.
    pub fn apply(&self, a: &mut Assessment) {
        let Some(p) = self.p_stiction.filter(|_| a.stiction.is_some()) else { return };
        let called = p >= called_at(a);
        a.p_stiction = Some(p);
        match a.stiction {
            Some(true) if !called => {
                (a.verdict, a.stiction, a.reason) = (Verdict::Inconclusive, None, Some(MASKED));
                a.grade = Some('D');
            }
            Some(false) if called => (a.verdict, a.stiction) = (Verdict::Stiction, Some(true)),
            _ => {}
        }
        a.confidence = a.stiction.map(|_| p.max(1.0 - p));
    }
}

/// Probability above which an estimate calls a valve sticking.
pub(super) fn called_at(a: &Assessment) -> f64 {
    a.explanation.map_or(0.5, |opinion| opinion.cuts.called)
}
