//! Requests of people and the system to the engine, and its answers.

use std::sync::Arc;

use stiction_engine::alarm::Command;
use stiction_engine::config::{Config, ConfigChanges};
use stiction_engine::engine::{LoopSettings, Snapshot};

/// How a command is answered: the new document, or what is wrong with the command.
pub type Answer = Box<dyn FnOnce(Result<Vec<u8>, String>) + Send>;

/// A loop's history at one moment, from which a window can be cut.
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
        /// Where the answer goes.
        answer: Answer,
    },
    /// A person's request for a gap diagnosis.
    GapRun {
        /// The loop's name.
        loop_name: String,
        /// Who asks.
        by: Option<String>,
        /// Whether the cause is decided from the windows of earlier diagnoses, too.
        pool: bool,
        /// Where the answer goes, once there is one.
        answer: Answer,
    },
    /// Somebody looks at a loop's window; nothing changes.
    GetWindow {
        /// The loop's name.
        loop_name: String,
        /// Where the window ends, ns since 1970; with the newest sample if absent.
        end_ns: Option<i64>,
        /// Where the answer goes.
        answer: Box<dyn FnOnce(Option<WindowSnapshot>) + Send>,
    },
    /// A reload: another configuration takes the place of the one in force.
    Edit {
        /// The other configuration.
        edit: Box<Edit>,
        /// Called once it is in force.
        answer: Box<dyn FnOnce() + Send>,
    },
}

/// A configuration that a running daemon takes over.
pub struct Edit {
    /// The configuration.
    pub config: Arc<Config>,
    /// Its text, which recordings hold.
    pub text: String,
    /// What differs in it from the one in force.
    pub changes: ConfigChanges,
}
