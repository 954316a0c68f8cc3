//! Further contents of a recording: inputs other than samples, and the states at the head of a file.

use serde::{Deserialize, Serialize};

use super::neighbours::RecordedNeighbour;
use super::{Checkpoint, GroupStanding, SkipReason};
use crate::alarm::Command;
use stiction::core::gap::pool;

/// Schema name of a recorded input.
pub const INPUT_SCHEMA: &str = "stictiond.input.v1";
/// Schema name of a recorded state.
pub const STATE_SCHEMA: &str = "stictiond.state.v1";

/// An input from people or from timing; replay follows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum RecordedInput {
    /// A due window that was not fitted.
    Skip {
        /// End of the window, ns.
        window_end_ns: i64,
        /// Its number among the loop's windows.
        seq: u64,
        /// The reason.
        reason: SkipReason,
    },
    /// A person's command, applied at this point.
    Command(Command),
    /// A person's request for a gap diagnosis, accepted at this point.
    GapRun {
        /// Its number among the loop's diagnoses.
        number: u64,
        /// Who requested it.
        by: Option<String>,
    },
    /// Other loops passed to a gap diagnosis.
    GapNeighbours {
        /// Its number among the loop's diagnoses.
        number: u64,
        /// The loops.
        neighbours: Vec<RecordedNeighbour>,
    },
    /// Earlier windows of the loop that help to decide the cause in a gap diagnosis.
    GapEarlier {
        /// Its number among the loop's diagnoses.
        number: u64,
        /// The windows, oldest first.
        windows: Vec<pool::Window>,
    },
    /// A skipped gap diagnosis.
    GapSkip {
        /// Its number among the loop's diagnoses.
        number: u64,
        /// The reason.
        reason: SkipReason,
    },
    /// A gap diagnosis whose search was ended before its budget; its document follows.
    GapCut {
        /// Its number among the loop's diagnoses.
        number: u64,
        /// Evaluations done by then.
        evaluations: u64,
    },
    /// Result of a comparison of many loops for this one; null once the loop is in no group.
    Group {
        /// The group's answer for the loop's next windows.
        standing: Option<Box<GroupStanding>>,
    },
    /// A comparison of the current windows of all loops came due.
    Comparing {
        /// Identifies the windows.
        windows: String,
    },
    /// The comparison has finished; the documents of its groups follow.
    Compared {
        /// Identifies the windows.
        windows: String,
        /// Whether it failed; then there are no groups.
        #[serde(default, skip_serializing_if = "core::ops::Not::not")]
        failed: bool,
    },
    /// The loop was silent for long and was forgotten: its next samples start from nothing, except for an active alarm.
    Forget,
    /// The loop is no longer configured: its alarm ends.
    Removed,
}

/// A loop's state at a point in a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StateDocument {
    /// [`STATE_SCHEMA`].
    pub schema: String,
    /// The loop's name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// The last window that it includes; null at the start of a file.
    pub window_end_ns: Option<i64>,
    /// Whether the loop had left the plant; the state then waits for its return.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    pub left: bool,
    /// The state.
    #[serde(flatten)]
    pub checkpoint: Checkpoint,
}

impl StateDocument {
    /// A state, named.
    #[must_use]
    pub fn new(loop_name: &str, window_end_ns: Option<i64>, checkpoint: Checkpoint) -> Self {
        let (schema, loop_name) = (STATE_SCHEMA.to_owned(), loop_name.to_owned());
        Self { schema, loop_name, window_end_ns, left: false, checkpoint }
    }
}
