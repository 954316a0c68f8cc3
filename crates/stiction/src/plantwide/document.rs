//! The document of a group, `stictiond.group.v1`.

use serde::Serialize;

use crate::core::units::Moment;
use crate::core::verdict::MemberJudgement;

/// Schema of a group's document.
pub const GROUP_SCHEMA: &str = "stictiond.group.v1";

/// Loops that share an oscillation, and the loop that causes it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GroupDocument {
    /// [`GROUP_SCHEMA`].
    pub schema: &'static str,
    /// Names of the loops, the likeliest source first; but a loop that is configured upstream of another member comes before it.
    pub members: Vec<String>,
    /// What causes the oscillation.
    pub source: Source,
    /// Members that have one and the same record under several names, such as a file that was sent twice: no source is named
    /// then. Absent where there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub same_record: Vec<String>,
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
    /// Area of the plant that all members are configured to be in, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub area: Option<String>,
    /// Version of the library.
    pub version: &'static str,
    /// Id of the daemon that made it, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub daemon: Option<String>,
}

impl GroupDocument {
    /// The name that all documents of a group share while its members stay the same: the alphabetically first member.
    #[must_use]
    pub fn key(&self) -> &str {
        self.members.iter().min().map_or("", String::as_str)
    }
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

/// Kind of source of a group.
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

/// Cause of a group's oscillation.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Source {
    /// Kind of cause.
    pub kind: SourceKind,
    /// The loop; the likeliest one where it cannot be told; absent where it is outside.
    #[serde(rename = "loop")]
    pub loop_name: Option<String>,
    /// Probability of `kind`, with that loop where it is one.
    pub probability: f64,
    /// The evidence, one sentence each.
    pub reasons: Vec<String>,
    /// The test that would decide, if the windows do not.
    pub next_test: Option<String>,
}

impl Source {
    /// The source if no loop can be named.
    pub(super) const fn unnamed() -> Self {
        let kind = SourceKind::CannotTell;
        Self { kind, loop_name: None, probability: 0.0, reasons: Vec::new(), next_test: None }
    }
}

/// A member that does not cause the oscillation.
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
