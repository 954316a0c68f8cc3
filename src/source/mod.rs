//! Where samples come from: the bus, behind a bounded queue that the engine drains.

pub mod presence;
pub mod zenoh;

use crate::alarm::Command;
use crate::config::Config;
use crate::daemon::queue::Room;

/// One message as it arrived, before anything was read from it.
#[derive(Debug)]
pub struct Message {
    /// Its key.
    pub key: Box<str>,
    /// Its bytes.
    pub payload: Vec<u8>,
    /// The encoding that it says it has, if it says one.
    pub encoding: Option<Box<str>>,
    /// The bus's time stamp, ns since 1970.
    pub bus_ns: Option<i64>,
    /// When it arrived, ns since 1970.
    pub arrival_ns: i64,
    /// Its bytes of the queue's budget.
    pub room: Room,
}

/// How a command is answered: the new document, or what is wrong with the command.
pub type Answer = Box<dyn FnOnce(Result<Vec<u8>, String>) + Send>;

/// What waits for the engine.
pub enum Incoming {
    /// Data from the plant.
    Message(Message),
    /// A person's command.
    Command {
        /// The loop's name.
        loop_name: String,
        /// What is asked.
        command: Command,
        /// Where the answer goes.
        answer: Answer,
    },
    /// A person's wish for a gap diagnosis.
    GapRun {
        /// The loop's name.
        loop_name: String,
        /// Who asks.
        by: Option<String>,
        /// Where the answer goes, once there is one.
        answer: Answer,
    },
    /// Settings that hold from now on.
    Settings(Box<Config>),
}
