//! Commands on an alarm and their validation.

use serde::{Deserialize, Serialize};

/// Why a command was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    /// Nothing to acknowledge.
    #[error("nothing to acknowledge: the alarm of {loop_name} is {state}")]
    NothingToAcknowledge {
        /// The loop.
        loop_name: String,
        /// State of its alarm.
        state: &'static str,
    },
    /// An unknown command.
    #[error("unknown command {0:?}; use cmd=ack;by=NAME;why=TEXT, or one of {COMMANDS}")]
    Unknown(String),
    /// An unknown loop.
    #[error("there is no monitored loop {0:?}; check the name")]
    UnknownLoop(String),
    /// The command does not fit the state.
    #[error("the alarm of {loop_name} is {state}: {why}")]
    Unfit {
        /// The loop.
        loop_name: String,
        /// State of its alarm.
        state: &'static str,
        /// What is possible.
        why: &'static str,
    },
    /// Shelving time out of range.
    #[error("for_s = {0} is out of range; write 1 to {MAX_SHELVE_S} s")]
    ShelveTime(u64),
    /// Missing name of the person.
    #[error("the command does not name the person; add by=NAME, as in cmd=ack;by=NAME;why=TEXT")]
    Nameless,
    /// A text that is too long.
    #[error("{what} has {bytes} bytes, the limit is {limit}; shorten it")]
    TooLong {
        /// Name of the text.
        what: &'static str,
        /// Its size, bytes.
        bytes: usize,
        /// The limit, bytes.
        limit: usize,
    },
    /// Control characters.
    #[error("{0} has control characters; write plain text")]
    Control(&'static str),
}

/// Longest name, bytes.
const NAME_BYTES: usize = 64;
/// Longest reason, bytes.
const WHY_BYTES: usize = 500;

/// Validates the name of the person: plain text of bounded length.
///
/// # Errors
/// [`CommandError`] with what is missing or too long.
pub fn check_name(by: Option<&str>) -> Result<(), CommandError> {
    let name = by.map(str::trim).filter(|name| !name.is_empty()).ok_or(CommandError::Nameless)?;
    check_text("by", name, NAME_BYTES)
}

fn check_text(what: &'static str, text: &str, limit: usize) -> Result<(), CommandError> {
    if text.len() > limit {
        return Err(CommandError::TooLong { what, bytes: text.len(), limit });
    }
    if text.chars().any(char::is_control) { Err(CommandError::Control(what)) } else { Ok(()) }
}

impl Command {
    /// Validates a command before it is accepted. Commands in a recording were accepted and are not validated again.
    ///
    /// # Errors
    /// [`CommandError`] with what is missing or too long.
    pub fn check(&self) -> Result<(), CommandError> {
        check_text("cmd", &self.cmd, NAME_BYTES)?;
        check_name(self.by.as_deref())?;
        self.why.as_deref().map_or(Ok(()), |why| check_text("why", why, WHY_BYTES))
    }
}

/// A command on an alarm.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Command {
    /// `ack`, `shelve`, `unshelve`, `suppress`, `unsuppress`, `out_of_service` or `in_service`.
    pub cmd: String,
    /// Who sends it.
    pub by: Option<String>,
    /// Why.
    pub why: Option<String>,
    /// Shelving time, s of the loop's own time; only for `shelve`. Default [`SHELVE_S`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub for_s: Option<u64>,
}

/// Commands other than `ack`, as listed in errors.
const COMMANDS: &str = "shelve;for_s=SECONDS, unshelve, suppress, unsuppress, out_of_service, in_service";
/// Default shelving time: a shift, s.
pub const SHELVE_S: u64 = 8 * 3600;
/// Longest shelving time: a month, s.
pub const MAX_SHELVE_S: u64 = 31 * 86_400;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_needs_a_name_and_plain_words_of_some_length() {
        let command = |by: Option<&str>, why: &str| Command {
            cmd: "ack".into(),
            by: by.map(str::to_owned),
            why: Some(why.to_owned()),
            for_s: None,
        };
        assert_eq!(command(Some("ann"), "seen").check(), Ok(()));
        for by in [None, Some(""), Some("  ")] {
            assert_eq!(command(by, "seen").check(), Err(CommandError::Nameless));
        }
        assert_eq!(command(Some("a\u{1b}[2J"), "seen").check(), Err(CommandError::Control("by")));
        assert_eq!(command(Some("ann"), "\u{9b}2J").check(), Err(CommandError::Control("why")));
        assert!(matches!(command(Some(&"n".repeat(65)), "").check(), Err(CommandError::TooLong { limit: 64, .. })));
        assert!(matches!(command(Some("ann"), &"w".repeat(60_000)).check(), Err(CommandError::TooLong { .. })));
        let unknown = Command { cmd: "z".repeat(100_000), by: Some("ann".into()), why: None, for_s: None };
        assert!(unknown.check().unwrap_err().to_string().len() < 200);
    }
}
