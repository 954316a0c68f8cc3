//! What else stands in a recording: inputs that came from outside the samples, and the states that a file starts with.

use serde::{Deserialize, Serialize};

use super::neighbours::RecordedNeighbour;
use super::{Checkpoint, GroupStanding, SkipReason};
use crate::alarm::Command;
use stiction::core::gap::pool;

/// Schema name of a recorded input.
pub const INPUT_SCHEMA: &str = "stictiond.input.v1";
/// Schema name of a recorded state.
pub const STATE_SCHEMA: &str = "stictiond.state.v1";

/// What outside time or people brought into a run; replay obeys it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum RecordedInput {
    /// A due window that got no fit.
    Skip {
        /// The window's name.
        window_end_ns: i64,
        /// Its place among the loop's windows.
        seq: u64,
        /// Why.
        reason: SkipReason,
    },
    /// A person's command, taken here.
    Command(Command),
    /// A person's wish for a gap diagnosis, taken here.
    GapRun {
        /// Its place among the loop's diagnoses.
        number: u64,
        /// Who asked.
        by: Option<String>,
    },
    /// Other loops that a gap diagnosis is given.
    GapNeighbours {
        /// Its place among the loop's diagnoses.
        number: u64,
        /// The loops.
        neighbours: Vec<RecordedNeighbour>,
    },
    /// Earlier windows of the loop from which a gap diagnosis is decided, too.
    GapEarlier {
        /// Its place among the loop's diagnoses.
        number: u64,
        /// The windows, oldest first.
        windows: Vec<pool::Window>,
    },
    /// A gap diagnosis that was not made.
    GapSkip {
        /// Its place among the loop's diagnoses.
        number: u64,
        /// Why.
        reason: SkipReason,
    },
    /// A gap diagnosis whose search was ended before its budget: its document follows.
    GapCut {
        /// Its place among the loop's diagnoses.
        number: u64,
        /// Evaluations that it had done.
        evaluations: u64,
    },
    /// What a comparison of many loops says of this one; null where it is in no group any more.
    Group {
        /// The group's answer for the loop's next windows.
        standing: Option<Box<GroupStanding>>,
    },
    /// A comparison of the windows that all loops have now is due.
    Comparing {
        /// Names the windows.
        windows: String,
    },
    /// It is done; the documents of its groups follow.
    Compared {
        /// Names the windows.
        windows: String,
        /// Whether it broke off: then there are no groups.
        #[serde(default, skip_serializing_if = "core::ops::Not::not")]
        failed: bool,
    },
    /// The loop had sent nothing for long and left the memory: what comes next begins anew, but for an alarm that is not
    /// at rest.
    Forget,
    /// The configuration names the loop no longer: its alarm ends.
    Removed,
}

/// A loop's state at a place in a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StateDocument {
    /// [`STATE_SCHEMA`].
    pub schema: String,
    /// The loop's name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// The window after which it holds; null at the start of a file.
    pub window_end_ns: Option<i64>,
    /// The loop had left the plant: what is kept waits for its return.
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
