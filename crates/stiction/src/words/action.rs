//! Recommended action for an estimate: one source for report, page, alarm, terminal and console.

use serde::{Deserialize, Serialize};

use crate::core::verdict::answer::{Scale, Standing};
use crate::core::verdict::bump_test::{self, BumpTest, Refusal};
use crate::core::verdict::{Assessment, NO_VALVE, SCREENED, ValvePosition, Verdict, texts};

/// How to confirm the band.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Confirm {
    /// By a bump test.
    Bump(BumpTest),
    /// By another method, because no bump test is proposed.
    Otherwise(Refusal),
}

/// Action for a valve that sticks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Action {
    /// Whether the valve has a dead band rather than slips.
    pub deadband: bool,
    /// Whether slip and play cannot be distinguished.
    pub open: bool,
    /// How to confirm it.
    pub confirm: Confirm,
    /// What the recorded valve position shows, which needs no test.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position: Option<ValvePosition>,
}

impl Action {
    /// Action for an estimate that finds stiction; `None` for any other.
    #[must_use]
    pub fn of(a: &Assessment) -> Option<Self> {
        (a.stiction == Some(true)).then(|| Self {
            deadband: a.verdict == Verdict::Deadband,
            open: a.j_identifiable == Some(false),
            confirm: bump_test::bump_test(a).map_or_else(Confirm::Otherwise, Confirm::Bump),
            position: a.valve_position.filter(|position| position.hysteresis.is_some()),
        })
    }

    /// What to inspect after the band is confirmed.
    fn inspect(&self) -> &'static str {
        let all = match (self.open, self.deadband) {
            (true, _) => texts::OPEN_ACTION,
            (false, true) => texts::of(Verdict::Deadband).action,
            (false, false) => texts::of(Verdict::Stiction).action,
        };
        all.split_once("then ").map_or(all, |(_, inspect)| inspect)
    }

    /// The action in sentences, for a report that also prints the steps of the test.
    #[must_use]
    pub fn words(&self) -> String {
        if let Some(position) = &self.position {
            return format!(
                "The valve position is recorded: {}. Where that agrees with the estimate, {}.",
                position.words(),
                self.inspect()
            );
        }
        match &self.confirm {
            Confirm::Bump(_) => {
                format!("Confirm the band by the bump test. If the test confirms it, {}.", self.inspect())
            }
            Confirm::Otherwise(why) => {
                format!("{} If that confirms the band, {}.", why.instead(), self.inspect())
            }
        }
    }

    /// The action in sentences by itself, for an alarm.
    #[must_use]
    pub fn alone(&self, op_unit: &str) -> String {
        match &self.confirm {
            Confirm::Bump(test) if self.position.is_none() => format!(
                "{} If the test confirms the band, {}. `stictiond analyze --report` writes the test out.",
                test.brief(op_unit),
                self.inspect()
            ),
            _ => self.words(),
        }
    }

    /// The bump test, one step per item; empty if the band is confirmed another way.
    #[must_use]
    pub fn steps(&self, op_unit: &str) -> Vec<String> {
        match &self.confirm {
            Confirm::Bump(test) if self.position.is_none() => test.steps(op_unit),
            _ => Vec::new(),
        }
    }
}

/// The recommended action in sentences.
#[must_use]
pub fn what_to_do(a: &Assessment) -> String {
    if let Some(action) = Action::of(a) {
        return action.words();
    }
    if a.stiction.is_none() {
        return texts::capital(better_data(a.reason.unwrap_or_default())) + ".";
    }
    match (Standing::of(a), a.verdict) {
        (Standing::Open, Verdict::NotOscillating) => texts::capital(texts::UNDECIDED_ACTION) + ".",
        (Standing::Open, cause) => {
            format!("{}. {}.", texts::capital(texts::of(cause).action), texts::capital(texts::UNDECIDED_ACTION))
        }
        (_, cause) => format!("{}. {}", texts::capital(texts::of(cause).action), limit(a)),
    }
}

/// The reservation about a negative result.
fn limit(a: &Assessment) -> String {
    match a.s_detectable {
        Some(least) => {
            format!("Bands below {} could easily be missed in this record.", Scale::of(a).told(least))
        }
        None if a.reason == Some(SCREENED) => {
            "The loop is calm and was only screened: this record rules out no band.".to_owned()
        }
        None => "The detection limit is not determinable, so this record rules out no band.".to_owned(),
    }
}

/// Data that would allow an answer, by the reason why there is no answer.
#[must_use]
pub fn better_data(reason: &str) -> &'static str {
    match reason {
        "manual" => "choose a section in which the controller is in automatic, or record one",
        "bad_quality" => "find out why values are missing or bad, and record again",
        "frozen_pv" | "stuck_signal" | "no_response" => {
            "check the transmitter, the block valves and the valve itself first"
        }
        "frozen_op" => "record a time in which the controller moves OP",
        "op_scale" => "give OP's range as OP is recorded: --op-range 0,1, or op_range = [0, 1] in the configuration",
        "swapped" => "exchange the keys or columns of OP and PV",
        "saturated" => "choose a section in which OP is not at a limit",
        "too_few_samples" | "too_few_periods" => "record longer: at least five periods of the oscillation",
        "too_few_reversals" => {
            "record longer, or a time in which the set point or the load moves: the stem must change its direction more often"
        }
        "rate_too_low" | "too_coarse" => "record faster: at least 50 samples a period",
        "op_held" => "record OP faster, or with less compression in the historian",
        "daily_cycle" => "look at sections of a few hours, sampled faster, in which the daily cycle plays no part",
        "trend" => "choose a section without the trend, or one in which the loop oscillates",
        "masked" => "find and repair the source of the shared oscillation, then judge this loop again",
        NO_VALVE => "nothing: drives, dampers and masters of cascades are not judged (final_element in [[loop]])",
        "skipped" => "give the machine more processor time, or analyze this window from the recording",
        _ => {
            "check that OP and PV belong to this loop and are not swapped; record longer, in automatic, while it oscillates"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reason_has_its_own_remedy_and_no_text_proposes_a_test_and_none() {
        let other = better_data("anything else");
        for reason in [
            "manual",
            "rate_too_low",
            "no_response",
            "op_scale",
            "op_held",
            "daily_cycle",
            "trend",
            "stuck_signal",
            "swapped",
            "too_few_reversals",
            "masked",
        ] {
            assert_ne!(better_data(reason), other, "{reason}");
        }
        let refused = Confirm::Otherwise(Refusal::Integrating);
        for open in [false, true] {
            let text = Action { deadband: true, open, confirm: refused, position: None }.alone("%");
            assert!(text.contains("No bump test is proposed") && !text.contains("by the bump test"), "{text}");
            assert!(text.contains("linkage") && text.contains("packing") == open, "{text}");
            let position = Some(ValvePosition { hysteresis: Some(1.25), halves: None });
            let text = Action { deadband: true, open, confirm: refused, position }.alone("%");
            assert!(text.contains("hysteresis 1.25 OP units") && !text.contains("trend the position"), "{text}");
        }
    }
}
