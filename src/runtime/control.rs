//! Requests to the engine from people and the system, and its answers.

use std::sync::Arc;

use stiction_engine::alarm::Command;
use stiction_engine::config::{Config, ConfigChanges};
use stiction_engine::engine::{LoopSettings, Snapshot};

/// Receives the answer to a command: the new document, or the reason for refusal.
pub type Answer = Box<dyn FnOnce(Result<Vec<u8>, String>) + Send>;

/// A loop's history at one moment, from which windows can be cut.
#[derive(Debug, Clone)]
pub struct WindowSnapshot {
    /// `None` before the loop's first sample.
    pub snapshot: Option<Snapshot>,
    /// The loop's settings.
    pub settings: Arc<LoopSettings>,
}

/// A request to the engine. Requests have a separate queue, which samples cannot fill.
pub enum Control {
    /// A person's command.
    Command {
        /// The loop's name.
        loop_name: String,
        /// The command.
        command: Command,
        /// Receives the answer.
        answer: Answer,
    },
    /// A person's request for a gap diagnosis.
    GapRun {
        /// The loop's name.
        loop_name: String,
        /// Who requests it.
        by: Option<String>,
        /// Whether the windows of earlier diagnoses help to decide the cause.
        pool: bool,
        /// Receives the answer when there is one.
        answer: Answer,
    },
    /// A request for a loop's window; changes nothing.
    GetWindow {
        /// The loop's name.
        loop_name: String,
        /// End of the window, ns since 1970; the newest sample if absent.
        end_ns: Option<i64>,
        /// Receives the answer.
        answer: Box<dyn FnOnce(Option<WindowSnapshot>) + Send>,
    },
    /// A reload: replaces the configuration in force.
    Edit {
        /// The new configuration.
        edit: Box<Edit>,
        /// Called once it is in force.
        answer: Box<dyn FnOnce() + Send>,
    },
}

/// A configuration that a running daemon adopts.
pub struct Edit {
    /// The configuration.
    pub config: Arc<Config>,
    /// Its text, for the recordings.
    pub text: String,
    /// The differences from the configuration in force.
    pub changes: ConfigChanges,
}
