//! Commands on an alarm and their validation.

use std::str::FromStr;

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
        check_name(self.by.as_deref())?;
        self.why.as_deref().map_or(Ok(()), |why| check_text("why", why, WHY_BYTES))
    }
}

/// Action of a person on an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AlarmAction {
    /// Acknowledges it.
    Ack,
    /// Shelves it for a limited time.
    Shelve,
    /// Ends shelving early.
    Unshelve,
    /// Suppresses it until further notice.
    Suppress,
    /// Ends suppression.
    Unsuppress,
    /// Takes it out of service.
    OutOfService,
    /// Returns it to service.
    InService,
}

impl AlarmAction {
    /// All actions.
    pub const ALL: [Self; 7] = [
        Self::Ack,
        Self::Shelve,
        Self::Unshelve,
        Self::Suppress,
        Self::Unsuppress,
        Self::OutOfService,
        Self::InService,
    ];

    /// Its word in commands and recordings.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ack => "ack",
            Self::Shelve => "shelve",
            Self::Unshelve => "unshelve",
            Self::Suppress => "suppress",
            Self::Unsuppress => "unsuppress",
            Self::OutOfService => "out_of_service",
            Self::InService => "in_service",
        }
    }
}

impl FromStr for AlarmAction {
    type Err = CommandError;

    fn from_str(word: &str) -> Result<Self, CommandError> {
        check_text("cmd", word, NAME_BYTES)?;
        let found = Self::ALL.into_iter().find(|action| action.name() == word);
        found.ok_or_else(|| CommandError::Unknown(word.to_owned()))
    }
}

/// A command on an alarm.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Command {
    /// The action.
    #[serde(rename = "cmd")]
    pub action: AlarmAction,
    /// Who sends it.
    pub by: Option<String>,
    /// The reason.
    pub why: Option<String>,
    /// Shelving time, s of the loop's time; only for `shelve`. Default [`SHELVE_S`].
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
            action: AlarmAction::Ack,
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
        assert!("z".repeat(100_000).parse::<AlarmAction>().unwrap_err().to_string().len() < 200);
        assert!(matches!("explode".parse::<AlarmAction>(), Err(CommandError::Unknown(_))));
        for action in AlarmAction::ALL {
            assert_eq!(
                (action.name().parse(), serde_json::to_value(action).unwrap()),
                (Ok(action), action.name().into())
            );
        }
    }
}
