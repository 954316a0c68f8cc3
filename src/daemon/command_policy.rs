//! Who may send commands and ask for diagnoses, and how often.

use std::time::Duration;

use crate::runtime::queue::{Rate, logged_rate};
use stiction_engine::alarm::{Command, check_name};
use stiction_engine::config::Commands;

/// Fraction of a minute's commands that may come in one burst.
const COMMANDS_AT_ONCE: f64 = 0.5;
/// Most diagnoses that may be requested in one burst.
const RUNS_AT_ONCE: f64 = 8.0;

/// The rules for commands and requests.
#[derive(Debug)]
pub struct CommandPolicy {
    settings: Commands,
    commands: Rate,
    runs: Rate,
    logged: Rate,
}

impl CommandPolicy {
    /// Rules from the configuration.
    #[must_use]
    pub fn new(settings: &Commands) -> Self {
        let (per_minute, per_hour) = (f64::from(settings.per_minute), f64::from(settings.runs_per_hour));
        Self {
            settings: settings.clone(),
            commands: Rate::new(per_minute / 60.0, (COMMANDS_AT_ONCE * per_minute).max(1.0)),
            runs: Rate::new(per_hour / 3600.0, per_hour.min(RUNS_AT_ONCE)),
            logged: logged_rate(),
        }
    }

    fn open(&self) -> Result<(), String> {
        if self.settings.enabled { Ok(()) } else { Err("commands are switched off: [commands] enabled = false".into()) }
    }

    /// Whether a command on an alarm is allowed at all, whatever the rate.
    pub fn check(&self, command: &Command) -> Result<(), String> {
        self.open()?;
        command.check().map_err(|e| e.to_string())
    }

    /// Whether the rate allows one more command now.
    pub fn command(&mut self, now: Duration) -> Result<(), String> {
        if self.commands.allow(now.as_secs_f64()) {
            return Ok(());
        }
        Err(format!("more than {} commands a minute: try again later", self.settings.per_minute))
    }

    /// Whether a person of this name may send requests.
    pub fn name(&self, by: Option<&str>) -> Result<(), String> {
        self.open()?;
        check_name(by).map_err(|e| e.to_string())
    }

    /// Whether the rate allows a diagnosis now.
    pub fn run(&mut self, now: Duration) -> Result<(), String> {
        if self.runs.allow(now.as_secs_f64()) {
            return Ok(());
        }
        Err(format!("more than {} diagnoses an hour: try again later", self.settings.runs_per_hour))
    }

    /// Logs a refusal, at a limited rate. Text from outside is escaped.
    pub fn log_refusal(&mut self, now: Duration, what: &str, loop_name: &str, by: Option<&str>, why: &str) {
        if self.logged.allow(now.as_secs_f64()) {
            let short = |text: &str| text.chars().take(64).collect::<String>();
            let (what, name, by) = (short(what), short(loop_name), by.map(short));
            tracing::warn!(?what, ?name, ?by, ?why, "refused");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction_engine::alarm::AlarmAction;

    #[test]
    fn names_rates_and_the_switch_are_held() {
        let ack = |by: &str| Command { action: AlarmAction::Ack, by: Some(by.into()), why: None, for_s: None };
        let mut policy = CommandPolicy::new(&Commands { per_minute: 60, runs_per_hour: 5, ..Commands::default() });
        let taken = |policy: &mut CommandPolicy, at_s: u64| policy.command(Duration::from_secs(at_s)).is_ok();
        assert_eq!((0..100).filter(|_| taken(&mut policy, 0)).count(), 30);
        assert!(taken(&mut policy, 1) && !taken(&mut policy, 1));
        assert!(policy.check(&ack("")).is_err() && policy.check(&ack("ann")).is_ok());
        assert_eq!((0..100).filter(|_| policy.run(Duration::ZERO).is_ok()).count(), 5);
        assert!(policy.run(Duration::from_secs(720)).is_ok());
        let shut = CommandPolicy::new(&Commands { enabled: false, ..Commands::default() });
        assert!(shut.check(&ack("ann")).is_err() && shut.name(Some("ann")).is_err());
    }
}
