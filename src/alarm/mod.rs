//! The stiction alarm of one loop, after ISA-18.2: raised by m of n windows, held where a window says nothing, cleared
//! with a dead band, acknowledged by a person, raised again when it gets worse.
//!
//! It is a maintenance alert. Everything here depends on the order of the windows and on event time, never on a clock.

mod command;
mod priority;

use serde::{Deserialize, Serialize};

pub use command::{Command, CommandError, MAX_SHELVE_S, SHELVE_S, check_name};
pub use priority::Priority;

use crate::config::AlarmParams;
use crate::units::format_rfc3339;
use crate::verdict::{Assessment, Gate};

/// Schema name of an alarm.
pub const ALARM_SCHEMA: &str = "stictiond.alarm.v1";
/// Share of the limit below which s counts for clearing.
const CLEAR_SHARE: f64 = 0.8;
/// Windows in a row with a worse class before the alarm is raised again.
const WORSE_WINDOWS: u8 = 2;

/// Alarm states of ISA-18.2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, Default)]
#[cfg_attr(feature = "daemon", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Not active, nothing to acknowledge.
    #[default]
    Normal,
    /// Active, not acknowledged.
    Unack,
    /// Active, acknowledged.
    Acked,
    /// No longer active, not acknowledged.
    RtnUnack,
    /// Put aside by a person for a time.
    Shelved,
    /// Put aside by design.
    Suppressed,
    /// Taken out of service.
    OutOfService,
}

impl State {
    /// The state's word in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::Unack => "unack",
            Self::Acked => "acked",
            Self::RtnUnack => "rtn_unack",
            Self::Shelved => "shelved",
            Self::Suppressed => "suppressed",
            Self::OutOfService => "out_of_service",
        }
    }
}

/// What one window says to the alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Evidence {
    /// Stiction of at least the limit.
    For,
    /// No stiction, or clearly below the limit.
    Against,
    /// Stiction a little below the limit: neither raises nor clears.
    Between,
    /// No information: the alarm stays as it is.
    None,
}

impl Evidence {
    /// Reads an assessment.
    #[must_use]
    pub fn of(assessment: &Assessment, params: &AlarmParams) -> Self {
        match (assessment.stiction, assessment.s) {
            (None, _) => Self::None,
            (Some(true), _) if assessment.gates.contains(&Gate::TooCoarse) => Self::None,
            // Called, but not surely enough to raise anything; or without a size that could be held against the limit.
            (Some(true), _) if assessment.explanation.is_some_and(|e| !e.alarms()) => Self::None,
            (Some(true), None) => Self::None,
            (Some(true), Some(s)) if s >= params.s_limit_op => Self::For,
            (Some(true), Some(s)) if s >= CLEAR_SHARE * params.s_limit_op => Self::Between,
            _ => Self::Against,
        }
    }
}

/// A change that is published, recorded and logged.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "daemon", derive(schemars::JsonSchema))]
pub struct AlarmDocument {
    /// [`ALARM_SCHEMA`].
    pub schema: &'static str,
    /// The loop's name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// Which alarm: `stiction`.
    pub alarm: &'static str,
    /// State after the change.
    pub state: State,
    /// Whether the condition holds.
    pub active: bool,
    /// Class of the stiction while active.
    pub severity: Option<String>,
    /// ISA-18.2 priority while active, of the class and the loop's criticality (see [`Priority::of`]); absent for loops
    /// that the configuration says nothing of, as nobody has weighed them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub priority: Option<Priority>,
    /// NE 107 signal: `M` (maintenance required) while active, else `ok`.
    pub ne107: &'static str,
    /// When the condition was raised, event time, ns.
    pub raised_ns: Option<i64>,
    /// When the state changed, event time, ns.
    pub changed_ns: i64,
    /// Who changed it; null for the daemon itself.
    pub by: Option<String>,
    /// Why.
    pub why: String,
    /// End of the window that changed it, or of the last one.
    pub window_end_ns: Option<i64>,
}

impl AlarmDocument {
    /// The same on a loop of this criticality.
    #[must_use]
    pub fn with_criticality(self, criticality: Option<u8>) -> Self {
        let weighed = criticality.filter(|_| self.active);
        Self { priority: weighed.map(|c| Priority::of(self.severity.as_deref(), c)), ..self }
    }

    /// One line that an operator understands.
    #[must_use]
    pub fn line(&self) -> String {
        let by = self.by.as_ref().map(|b| format!(" by {b}")).unwrap_or_default();
        let when = format_rfc3339(self.changed_ns);
        format!("{}: stiction alarm {}{by} at {when}: {}", self.loop_name, self.state.name(), self.why)
    }
}

/// Where an alarm was put by people; it goes on as ever behind it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Aside {
    /// Put aside by a person until then, event time, ns.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shelved_until_ns: Option<i64>,
    /// Put aside by design, as while a unit stands still.
    pub suppressed: bool,
    /// Taken out of service, as while the valve is repaired.
    pub out_of_service: bool,
}

impl Aside {
    fn is_nowhere(&self) -> bool {
        *self == Self::default()
    }
}

/// One loop's alarm, with the memory that m of n needs. Written into every recording, so that a restart keeps it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Alarm {
    /// Its state but for where it was put: `normal`, `unack`, `acked` or `rtn_unack`. See [`Alarm::shown`].
    pub state: State,
    /// Where it was put.
    #[serde(default, skip_serializing_if = "Aside::is_nowhere")]
    pub aside: Aside,
    /// Whether the condition holds.
    pub active: bool,
    /// The last informative windows, newest in bit 0: evidence for.
    history_for: u32,
    /// The same: evidence against.
    history_against: u32,
    /// Worst class since the alarm was raised.
    class: Option<String>,
    worse_windows: u8,
    raised_ns: Option<i64>,
    window_end_ns: Option<i64>,
}

/// Why a document stands that the shelf's time brought.
const SHELF_OVER: &str = "the time on the shelf is over";

/// What a command did, where nobody says why.
fn done_by(cmd: &str) -> &'static str {
    match cmd {
        "shelve" => "shelved",
        "unshelve" => "taken off the shelf",
        "suppress" => "suppressed",
        "unsuppress" => "no longer suppressed",
        "out_of_service" => "taken out of service",
        "in_service" => "back in service",
        _ => "acknowledged",
    }
}

/// Rank of a class, 0 for none.
fn rank(class: Option<&str>) -> u8 {
    match class {
        Some("weak") => 1,
        Some("moderate") => 2,
        Some("strong") => 3,
        _ => 0,
    }
}

impl Alarm {
    /// The state as people see it: out of service before suppressed before shelved before the rest.
    #[must_use]
    pub const fn shown(&self) -> State {
        match self.aside {
            Aside { out_of_service: true, .. } => State::OutOfService,
            Aside { suppressed: true, .. } => State::Suppressed,
            Aside { shelved_until_ns: Some(_), .. } => State::Shelved,
            _ => self.state,
        }
    }

    /// Takes the next window of the loop; gives out a document if the state changes.
    pub fn window(&mut self, loop_name: &str, a: &Assessment, params: &AlarmParams) -> Option<AlarmDocument> {
        let end_ns = a.window.end_ns;
        self.window_end_ns = Some(end_ns);
        let over = self.aside.shelved_until_ns.is_some_and(|until_ns| end_ns >= until_ns);
        if over {
            self.aside.shelved_until_ns = None;
        }
        let changed = self.weigh(loop_name, a, params);
        match changed {
            Some(document) if over => {
                Some(AlarmDocument { why: format!("{}; {SHELF_OVER}", document.why), ..document })
            }
            None if over => Some(self.document(loop_name, end_ns, None, SHELF_OVER.to_owned())),
            changed => changed,
        }
    }

    fn weigh(&mut self, loop_name: &str, a: &Assessment, params: &AlarmParams) -> Option<AlarmDocument> {
        let end_ns = a.window.end_ns;
        let evidence = Evidence::of(a, params);
        if evidence == Evidence::None {
            return None;
        }
        let [m, n] = params.raise.map(u32::from);
        let mask = u32::MAX >> (32 - n.clamp(1, 32));
        self.history_for = (self.history_for << 1 | u32::from(evidence == Evidence::For)) & mask;
        self.history_against = (self.history_against << 1 | u32::from(evidence == Evidence::Against)) & mask;
        let class = a.severity.or(a.strength);
        if !self.active && evidence == Evidence::For && self.history_for.count_ones() >= m {
            self.active = true;
            self.history_against = 0;
            self.state = State::Unack;
            self.class = class.map(str::to_owned);
            self.raised_ns = Some(end_ns);
            self.worse_windows = 0;
            let why = format!("{} of the last {n} windows show stiction; {}", self.history_for.count_ones(), size(a));
            return Some(self.document(loop_name, end_ns, None, why));
        }
        if self.active && self.history_against.count_ones() >= m {
            self.active = false;
            self.history_for = 0;
            self.state = if self.state == State::Unack { State::RtnUnack } else { State::Normal };
            let why = format!("{} of the last {n} windows show no stiction", self.history_against.count_ones());
            let document = self.document(loop_name, end_ns, None, why);
            self.class = None;
            self.raised_ns = None;
            return Some(document);
        }
        self.worsened(loop_name, a, class, evidence)
    }

    /// Raises an active alarm again when its class gets worse and stays so.
    fn worsened(
        &mut self,
        loop_name: &str,
        a: &Assessment,
        class: Option<&'static str>,
        evidence: Evidence,
    ) -> Option<AlarmDocument> {
        let worse = self.active && evidence == Evidence::For && rank(class) > rank(self.class.as_deref());
        self.worse_windows = if worse { self.worse_windows + 1 } else { 0 };
        if self.worse_windows < WORSE_WINDOWS {
            return None;
        }
        self.worse_windows = 0;
        let before = self.class.replace(class.unwrap_or_default().to_owned()).unwrap_or_else(|| "none".to_owned());
        self.state = State::Unack;
        let why = format!("worse than before: {before} has become {}; {}", class.unwrap_or("none"), size(a));
        Some(self.document(loop_name, a.window.end_ns, None, why))
    }

    /// Carries out a person's command at the loop's event time.
    ///
    /// # Errors
    /// [`CommandError`] where the command is unknown or does not fit the state; nothing changes then.
    pub fn command(&mut self, loop_name: &str, c: &Command, at_ns: i64) -> Result<AlarmDocument, CommandError> {
        let why = c.why.clone().unwrap_or_else(|| done_by(&c.cmd).to_owned());
        match c.cmd.as_str() {
            "ack" => self.acknowledge(loop_name)?,
            "shelve" => self.shelve(loop_name, c.for_s.unwrap_or(SHELVE_S), at_ns)?,
            "unshelve" => {
                let shelved = self.aside.shelved_until_ns.take().is_some();
                self.expect(loop_name, shelved, "it is not shelved")?;
            }
            "suppress" => self.put(loop_name, |aside| &mut aside.suppressed, true)?,
            "unsuppress" => self.put(loop_name, |aside| &mut aside.suppressed, false)?,
            "out_of_service" => self.put(loop_name, |aside| &mut aside.out_of_service, true)?,
            "in_service" => self.put(loop_name, |aside| &mut aside.out_of_service, false)?,
            other => return Err(CommandError::Unknown(other.to_owned())),
        }
        Ok(self.document(loop_name, at_ns, c.by.clone(), why))
    }

    fn acknowledge(&mut self, loop_name: &str) -> Result<(), CommandError> {
        self.state = match self.state {
            State::Unack => State::Acked,
            State::RtnUnack => State::Normal,
            _ => {
                let (loop_name, state) = (loop_name.to_owned(), self.shown().name());
                return Err(CommandError::NothingToAcknowledge { loop_name, state });
            }
        };
        Ok(())
    }

    fn shelve(&mut self, loop_name: &str, for_s: u64, at_ns: i64) -> Result<(), CommandError> {
        if !(1..=MAX_SHELVE_S).contains(&for_s) {
            return Err(CommandError::ShelveTime(for_s));
        }
        self.expect(loop_name, self.aside.shelved_until_ns.is_none(), "unshelve it first")?;
        let for_ns = i64::try_from(for_s).unwrap_or(i64::MAX).saturating_mul(1_000_000_000);
        self.aside.shelved_until_ns = Some(at_ns.saturating_add(for_ns));
        Ok(())
    }

    fn put(&mut self, loop_name: &str, place: fn(&mut Aside) -> &mut bool, to: bool) -> Result<(), CommandError> {
        let changes = std::mem::replace(place(&mut self.aside), to) != to;
        self.expect(loop_name, changes, if to { "it is so already" } else { "it is not" })
    }

    fn expect(&self, loop_name: &str, fits: bool, why: &'static str) -> Result<(), CommandError> {
        if fits {
            return Ok(());
        }
        Err(CommandError::Unfit { loop_name: loop_name.to_owned(), state: self.shown().name(), why })
    }

    /// End of the last window that was taken.
    #[must_use]
    pub const fn window_end_ns(&self) -> Option<i64> {
        self.window_end_ns
    }

    /// The alarm as it stands, after a restart.
    #[must_use]
    pub fn restored(&self, loop_name: &str) -> AlarmDocument {
        let at_ns = self.window_end_ns.unwrap_or(0);
        self.document(loop_name, at_ns, None, "carried over from the run before".to_owned())
    }

    fn document(&self, loop_name: &str, changed_ns: i64, by: Option<String>, why: String) -> AlarmDocument {
        AlarmDocument {
            schema: ALARM_SCHEMA,
            loop_name: loop_name.to_owned(),
            alarm: "stiction",
            state: self.shown(),
            active: self.active,
            severity: self.class.clone(),
            priority: None,
            ne107: if self.active { "M" } else { "ok" },
            raised_ns: self.raised_ns,
            changed_ns,
            by,
            why,
            window_end_ns: self.window_end_ns,
        }
    }
}

/// The size of the stiction in words.
fn size(a: &Assessment) -> String {
    let number = |x: Option<f64>| x.map_or_else(|| "?".to_owned(), |v| format!("{v:.2}"));
    let class = a.severity.or(a.strength).unwrap_or("unclassed");
    format!("s = {} in OP units ({class}), stiction index {}", number(a.s), number(a.stiction_index))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verdict::{Oscillation, Verdict, Window};
    use proptest::prelude::*;

    fn assessment(k: i64, verdict: Verdict, s: f64, strength: &'static str) -> Assessment {
        let window = Window { start_ns: k * 10, end_ns: (k + 1) * 10, samples: 100, ts_s: 1.0, box_samples: 1 };
        let oscillation = Oscillation {
            oscillating: true,
            period_s: None,
            periods: None,
            samples_per_period: None,
            regularity: None,
        };
        let mut a = Assessment::empty(window, oscillation);
        a.verdict = verdict;
        a.stiction = verdict.stiction();
        a.s = Some(s);
        a.strength = Some(strength);
        a
    }

    fn run(alarm: &mut Alarm, verdicts: &[(Verdict, f64)]) -> Vec<State> {
        let params = AlarmParams { raise: [3, 4], s_limit_op: 1.0 };
        let each = verdicts.iter().enumerate();
        each.filter_map(|(k, (v, s))| alarm.window("L", &assessment(k as i64, *v, *s, "weak"), &params))
            .map(|d| d.state)
            .collect()
    }

    const YES: (Verdict, f64) = (Verdict::Stiction, 2.0);
    const NO: (Verdict, f64) = (Verdict::Disturbance, 0.0);
    const SILENT: (Verdict, f64) = (Verdict::Inconclusive, 0.0);

    #[test]
    fn it_takes_m_of_n_windows_and_silence_holds() {
        let mut alarm = Alarm::default();
        assert!(run(&mut alarm, &[YES, YES, SILENT, NO]).is_empty());
        assert_eq!(run(&mut alarm, &[SILENT, SILENT, YES]), [State::Unack]);
        assert!(run(&mut alarm, &[SILENT; 50]).is_empty());
        assert!(alarm.active);
        assert_eq!(run(&mut alarm, &[NO, NO, NO]), [State::RtnUnack]);
    }

    #[test]
    fn it_is_acknowledged_once_and_clears_with_a_dead_band() {
        let mut alarm = Alarm::default();
        run(&mut alarm, &[YES; 3]);
        let ack = Command { cmd: "ack".into(), by: Some("ann".into()), why: None, for_s: None };
        assert_eq!(alarm.command("L", &ack, 5).unwrap().state, State::Acked);
        assert!(matches!(alarm.command("L", &ack, 5), Err(CommandError::NothingToAcknowledge { .. })));
        let unknown = Command { cmd: "explode".into(), by: None, why: None, for_s: None };
        assert!(matches!(alarm.command("L", &unknown, 5), Err(CommandError::Unknown(_))));
        assert!(run(&mut alarm, &[(Verdict::Stiction, 0.9); 10]).is_empty());
        assert_eq!(run(&mut alarm, &[(Verdict::Stiction, 0.7); 4]), [State::Normal]);
    }

    #[test]
    fn one_of_three_does_not_flap() {
        let params = AlarmParams { raise: [1, 3], s_limit_op: 1.0 };
        let mut alarm = Alarm::default();
        let mut changes = Vec::new();
        for (k, verdict) in
            [Verdict::Stiction, Verdict::Tuning, Verdict::Tuning, Verdict::Tuning].into_iter().enumerate()
        {
            changes.extend(alarm.window("L", &assessment(k as i64, verdict, 2.0, "weak"), &params).map(|d| d.state));
        }
        assert_eq!(changes, [State::Unack, State::RtnUnack]);
    }

    #[test]
    fn it_is_raised_again_when_it_gets_worse() {
        let params = AlarmParams { raise: [1, 1], s_limit_op: 1.0 };
        let mut alarm = Alarm::default();
        alarm.window("L", &assessment(0, Verdict::Stiction, 2.0, "weak"), &params).unwrap();
        let ack = Command { cmd: "ack".into(), by: None, why: None, for_s: None };
        alarm.command("L", &ack, 5).unwrap();
        assert!(alarm.window("L", &assessment(1, Verdict::Stiction, 9.0, "strong"), &params).is_none());
        let again = alarm.window("L", &assessment(2, Verdict::Stiction, 9.0, "strong"), &params).unwrap();
        assert_eq!((again.state, again.severity.as_deref()), (State::Unack, Some("strong")));
        let priority = |criticality| again.clone().with_criticality(criticality).priority;
        assert_eq!([None, Some(3), Some(5)].map(priority), [None, Some(Priority::High), Some(Priority::Urgent)]);
        let over = alarm.window("L", &assessment(3, Verdict::Tuning, 0.0, "weak"), &params).unwrap();
        assert_eq!(over.with_criticality(Some(5)).priority, None);
    }

    proptest! {
        #[test]
        fn states_and_activity_agree_in_any_order(steps in proptest::collection::vec(0_u8..6, 0..64)) {
            let params = AlarmParams { raise: [2, 3], s_limit_op: 1.0 };
            let mut alarm = Alarm::default();
            for (k, step) in steps.into_iter().enumerate() {
                let verdict = [Verdict::Stiction, Verdict::Disturbance, Verdict::Inconclusive][usize::from(step % 3)];
                if step == 5 {
                    let _ = alarm.command("L", &Command { cmd: "ack".into(), by: None, why: None, for_s: None }, k as i64);
                } else {
                    alarm.window("L", &assessment(k as i64, verdict, f64::from(step), "weak"), &params);
                }
                prop_assert_eq!(alarm.active, matches!(alarm.state, State::Unack | State::Acked));
                let text = serde_json::to_string(&alarm).unwrap();
                prop_assert_eq!(serde_json::from_str::<Alarm>(&text).unwrap(), alarm.clone());
            }
        }
    }
}
