//! Signals that do not belong to their loop or have the wrong sign.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError};

use super::Overview;
use super::obstacles::ObstacleKind;
use stiction::core::ident::controller::CERTAIN_R2;
use stiction::core::verdict::Assessment;
use stiction_engine::config::Action;
use stiction_engine::engine::Misplaced;

/// The faults of a loop's signals, each with the start of the first window that shows it, ns since 1970.
#[derive(Debug, Clone, Default)]
pub(super) struct SignalFaults {
    /// From the newest comparison of loops.
    misplaced: Option<(Misplaced, i64)>,
    /// The configured action, if the controller contradicts it.
    against: Option<(Action, i64)>,
}

impl SignalFaults {
    /// Compares the configured action with the controller found in a window. A window that shows no controller changes nothing.
    pub fn window(&mut self, action: Option<Action>, a: &Assessment) {
        let controller = a.controller.as_ref().filter(|controller| controller.r2 >= CERTAIN_R2);
        match (action, controller) {
            (None, _) => self.against = None,
            (Some(action), Some(controller)) if action.contradicts(controller.kc) => {
                self.against.get_or_insert((action, a.window.start_ns));
            }
            (Some(_), Some(_)) => self.against = None,
            (Some(_), None) => {}
        }
    }

    fn compared(&mut self, found: Option<Misplaced>, start_ns: i64) {
        let before = self.misplaced.take();
        self.misplaced = found.map(|found| match before {
            Some((same, since_ns)) if same == found => (found, since_ns),
            _ => (found, start_ns),
        });
    }

    /// The obstacle: kind, words, remedy and beginning.
    pub fn found(&self) -> Option<(ObstacleKind, String, String, i64)> {
        let check = |other: &str| format!("check the keys of OP and PV of this loop and of {other}");
        if let Some((misplaced, since_ns)) = &self.misplaced {
            let (kind, words, remedy) = match misplaced {
                Misplaced::SamePv(of) => (
                    ObstacleKind::Misplaced,
                    format!("PV is that of {of}: the controller of {of} answers it, this loop's does not"),
                    check(of),
                ),
                Misplaced::SameOp(of) => (
                    ObstacleKind::Misplaced,
                    format!("OP is that of {of}: it answers the PV of {of}, not this loop's"),
                    check(of),
                ),
                Misplaced::AnswersPv(of) => (
                    ObstacleKind::Misplaced,
                    format!("OP answers the PV of {of}, not this loop's: one of the two belongs to another loop"),
                    check(of),
                ),
                Misplaced::OppositePosition => (
                    ObstacleKind::WrongSign,
                    "the valve position falls when OP rises".to_owned(),
                    "turn the sign of OP or of the valve position: both in % open".to_owned(),
                ),
            };
            return Some((kind, words, remedy, *since_ns));
        }
        let (action, since_ns) = self.against?;
        let moves = if action == Action::Reverse { "rises with PV" } else { "falls when PV rises" };
        let words = format!("OP {moves}, and action = \"{}\" says the opposite", action.name());
        let remedy = "turn the sign of OP or PV at its source, or correct action in the configuration".to_owned();
        Some((ObstacleKind::WrongSign, words, remedy, since_ns))
    }
}

impl Overview {
    /// Sets the loops with a signal under the wrong name or of the wrong sign, from the newest comparison of loops.
    pub fn show_misplaced(&self, found: Vec<(Arc<str>, Misplaced)>) {
        let mut found: BTreeMap<Arc<str>, Misplaced> = found.into_iter().collect();
        let mut loops = self.0.write().unwrap_or_else(PoisonError::into_inner);
        for (name, entry) in &mut loops.by_name {
            let start_ns = entry.estimate.as_ref().map_or(0, |estimate| estimate.assessment.window.start_ns);
            entry.signals.compared(found.remove(name), start_ns);
        }
    }
}
