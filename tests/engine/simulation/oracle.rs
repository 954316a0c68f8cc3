//! Expected results, kept independently of the daemon: alarms by the model, messages by counting.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;
use stiction::core::units::ms_from_ns;
use stiction_engine::alarm::Alarm;
use stiction_engine::codec::topic::Kind;
use stictiond::daemon::sim_daemon::SimDaemon;
use stictiond::daemon::sink::zenoh::Publication;

use crate::isa::Model;

pub const RAISE: [usize; 2] = [2, 3];
const CLASSES: [&str; 3] = ["weak", "moderate", "strong"];

/// An unanswered command.
#[derive(Debug, Clone)]
pub struct Asked {
    pub loop_name: String,
    pub cmd: &'static str,
    pub for_s: Option<u64>,
}

/// One loop: every state since the last one known to be on disk, oldest first.
#[derive(Debug, Default)]
struct Known {
    states: Vec<Model>,
    /// Whether the last window requires an alarm document, which must come next.
    owed: bool,
}

impl Known {
    fn now(&self) -> Model {
        self.states.last().cloned().unwrap_or_default()
    }
}

#[derive(Default)]
pub struct Oracle {
    loops: BTreeMap<String, Known>,
    /// Unanswered commands, in the order in which they were sent.
    pub asked: Vec<Asked>,
    /// Digest of all publications: equal for equal seeds.
    pub digest: u64,
    pub raised: u64,
    pub skipped: u64,
    /// Loop and identity of the alarms published since they were last taken.
    pub alarms: Vec<(String, String)>,
    /// End of each loop's newest window in this run, ns, and of all windows of earlier runs.
    newest: BTreeMap<String, i64>,
    earlier: BTreeMap<String, BTreeSet<i64>>,
}

/// The vote of a window, from its published document and the configured rule.
fn vote_of(document: &Value) -> (Option<char>, usize) {
    let rank =
        |class: &Value| class.as_str().map(|name| CLASSES.iter().position(|c| *c == name).map_or(0, |at| at + 1));
    // Without OP's range, a fraction of OP's span does not justify the highest class.
    let class = rank(&document["severity_by_range"]).or_else(|| rank(&document["strength_by_span"]).map(|c| c.min(2)));
    let class = class.unwrap_or(0);
    let counts = document["counted_by"].is_string();
    let vote = match (document["stiction"].as_bool(), document["s"].as_f64()) {
        (None, _) => None,
        _ if !counts => None,
        (Some(true), Some(s)) if s >= 1.0 => Some('f'),
        (Some(true), Some(s)) if s >= 0.8 => Some('-'),
        _ => Some('a'),
    };
    (vote, class)
}

/// Whether a stored alarm matches the model, including its memory of windows.
fn agrees(model: &Model, alarm: &Alarm) -> bool {
    let json = serde_json::to_value(alarm).unwrap();
    let bits = |kind: char| {
        let votes = model.informative.iter().rev().take(RAISE[1]).enumerate();
        votes.filter(|(_, vote)| **vote == kind).fold(0_u64, |bits, (place, _)| bits | 1 << place)
    };
    let aside = |place: &str| json["aside"][place].as_bool().unwrap_or(false);
    // The state behind any inhibition.
    let behind = Model { shelf_ends_ns: None, suppressed: false, out_of_service: false, ..model.clone() };
    let class = if model.active { model.class.checked_sub(1).map(|at| CLASSES[at]) } else { None };
    model.shown() == alarm.shown().name()
        && json["state"] == behind.shown()
        && model.active == alarm.active
        && json["class"].as_str() == class
        && json["aside"]["shelved_until_ns"].as_i64() == model.shelf_ends_ns
        && aside("suppressed") == model.suppressed
        && aside("out_of_service") == model.out_of_service
        && json["history_for"].as_u64() == Some(bits('f'))
        && json["history_against"].as_u64() == Some(bits('a'))
        && json["worse_windows"].as_u64() == Some(model.worse as u64)
}

impl Oracle {
    /// Follows publications.
    pub fn follow(&mut self, publications: impl Iterator<Item = Publication>) {
        for publication in publications {
            let mut document: Value = serde_json::from_slice(publication.document.as_deref().unwrap()).unwrap();
            // The hash depends on the folder's name.
            document.as_object_mut().unwrap().remove("config_hash");
            if matches!(publication.kind, Kind::Estimate | Kind::Alarm) {
                let text = format!("{}{document}", publication.key);
                self.digest =
                    text.bytes().fold(self.digest ^ 0x9e37, |h, b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3));
            }
            match publication.kind {
                Kind::Estimate => self.estimate(&document),
                Kind::Alarm => self.alarm(&document),
                _ => {}
            }
        }
        let owing = self.loops.iter().find(|(_, known)| known.owed);
        assert!(owing.is_none(), "an alarm changed and nothing said so: {owing:?}");
    }

    fn estimate(&mut self, document: &Value) {
        let name = document["loop"].as_str().unwrap();
        let known = self.loops.entry(name.to_owned()).or_default();
        assert!(!known.owed, "an alarm changed and nothing said so: {document}");
        let (vote, class) = vote_of(document);
        let mut model = known.now();
        let end_ns = document["window"]["end_ns"].as_i64().unwrap();
        self.newest.insert(name.to_owned(), end_ns);
        self.earlier.entry(name.to_owned()).or_default().insert(end_ns);
        known.owed = model.window(end_ns, vote, class, RAISE);
        known.states.push(model);
        self.skipped += u64::from(document["gates"].as_array().unwrap().iter().any(|gate| gate == "skipped"));
    }

    fn alarm(&mut self, document: &Value) {
        let name = document["loop"].as_str().unwrap();
        self.alarms.push((name.to_owned(), document["event_id"].as_str().unwrap().to_owned()));
        let known = self.loops.entry(name.to_owned()).or_default();
        let mut model = known.now();
        if document["by"].is_null() {
            assert!(known.owed, "an alarm spoke up unasked: {document}");
            known.owed = false;
            self.raised += u64::from(document["active"] == true && document["event"] == "raised");
        } else {
            assert!(!known.owed, "a command came between a window and its alarm: {document}");
            let place = self.asked.iter().position(|a| a.loop_name == name).expect("a command nobody sent");
            let asked = self.asked.remove(place);
            let taken = model.command(asked.cmd, asked.for_s, document["changed_ns"].as_i64().unwrap());
            assert!(taken, "{asked:?} was taken: {document}\n{model:?}");
            known.states.push(model.clone());
        }
        assert_eq!(document["state"], model.shown(), "{document}\n{model:?}");
        assert_eq!(document["active"], model.active, "{document}");
    }

    /// A command was refused: the model must refuse it too, unless the reason is not the alarm's state.
    pub fn refused(&mut self, asked: &Asked, why: &str) {
        if let Some(place) = self.asked.iter().position(|a| a.loop_name == asked.loop_name) {
            self.asked.remove(place);
        }
        let fits =
            self.loops.get(&asked.loop_name).map(Known::now).unwrap_or_default().command(asked.cmd, asked.for_s, 0);
        assert!(!fits || why.contains("no loop"), "{asked:?} was refused: {why}");
    }

    /// Everything is on disk, and no crash may undo it.
    pub fn stored(&mut self) {
        for known in self.loops.values_mut() {
            known.states.drain(..known.states.len().saturating_sub(1));
        }
    }

    /// Checks that each loop's alarm matches the model.
    pub fn compare(&self, stage: &SimDaemon) {
        for id in stage.engine().ids() {
            let name = stage.engine().name(id);
            let model = self.loops.get(&**name).map(Known::now).unwrap_or_default();
            let alarm = stage.engine().checkpoint(id).alarm;
            assert!(agrees(&model, &alarm), "{name}: {model:?}\n{alarm:?}");
        }
    }

    /// Checks that the page shows each loop as in the model, and no other.
    pub fn compare_page(&self, stage: &SimDaemon, now_ns: i64) {
        let rows = stage.overview().rows_after(0, None, usize::MAX, now_ns);
        assert_eq!(rows.len(), stage.engine().ids().len(), "one row a loop");
        for row in rows {
            assert!(stage.engine().find(&row.name).is_some(), "{} is on the page alone", row.name);
            let model = self.loops.get(&row.name).map(Known::now).unwrap_or_default();
            assert_eq!((row.alarm_state.name(), row.active), (model.shown(), model.active), "{}", row.name);
            match self.newest.get(&row.name) {
                Some(end_ns) => assert_eq!(row.window_end_ms, Some(ms_from_ns(*end_ns)), "{}", row.name),
                // From an earlier run's recording, if it can be read.
                None => {
                    let earlier = self.earlier.get(&row.name).into_iter().flatten();
                    let was_told = |end_ms| earlier.into_iter().any(|end_ns| ms_from_ns(*end_ns) == end_ms);
                    assert!(row.window_end_ms.is_none_or(was_told), "{}", row.name);
                }
            }
        }
    }

    /// After a restart, each loop must be in its last stored state or a later one, never an earlier one.
    pub fn restarted(&mut self, stage: &mut SimDaemon) {
        self.asked.clear();
        self.newest.clear();
        for (name, known) in &mut self.loops {
            known.owed = false;
            let alarm = stage.engine().find(name).map(|id| stage.engine().checkpoint(id).alarm).unwrap_or_default();
            let place = known.states.iter().rposition(|model| agrees(model, &alarm));
            let first = known.states.first().cloned().unwrap_or_default();
            let Some(place) = place else {
                // Nothing was stored yet, so it may start from nothing.
                let unborn = first.informative.len() <= 1 && agrees(&Model::default(), &alarm);
                assert!(unborn, "{name} is where it never was since it was stored: {:?}\n{alarm:?}", known.states);
                known.states.clear();
                continue;
            };
            known.states.truncate(place + 1);
        }
        // What is restored is in the store before the run begins.
        for publication in stage.published() {
            if publication.kind == Kind::Alarm {
                let document: Value = serde_json::from_slice(publication.document.as_deref().unwrap()).unwrap();
                let model = self.loops[document["loop"].as_str().unwrap()].now();
                assert_eq!(document["state"], model.shown(), "{document}");
            }
        }
    }
}
