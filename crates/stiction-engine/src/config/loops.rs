//! `[[loop]]`: loops with mapped keys or their own settings.

use std::collections::{HashMap, HashSet};

use serde::Serialize;
use toml::de::DeTable;

use super::alarm::read_alarm;
use super::bundle::NAME_MARK;
use super::reader::{Fault, Lines, TableReader, subtables};
use super::{LoopConfig, read_window};
use crate::alarm::AlarmParams;
use crate::engine::WindowParams;
use stiction::core::record::Signal;
use stiction::core::units::{FinalElement, LoopKind, is_loop_name};

/// Action of a controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// OP falls when PV rises.
    Reverse,
    /// OP rises with PV.
    Direct,
}

impl Action {
    /// Word in configurations.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Reverse => "reverse",
            Self::Direct => "direct",
        }
    }

    /// Whether a controller with this gain, OP units per PV unit of SP - PV, has the opposite action.
    #[must_use]
    pub fn contradicts(self, kc: f64) -> bool {
        if self == Self::Reverse { kc < 0.0 } else { kc > 0.0 }
    }
}

pub(super) fn read_loops(
    lines: &Lines,
    root: &DeTable<'_>,
    window: WindowParams,
    alarm: AlarmParams,
    faults: &mut Vec<Fault>,
) -> Vec<LoopConfig> {
    let mut loops: Vec<LoopConfig> = Vec::new();
    // A site may list a hundred thousand loops, so use hash sets.
    let (mut names, mut owners) = (HashSet::new(), HashMap::new());
    for (index, (table, line)) in subtables(lines, root, "loop", faults).into_iter().enumerate() {
        let mut r = TableReader::new(lines, &format!("loop[{index}]"), line, Some(table), faults);
        let entry = read_loop(&mut r, window, alarm);
        if !names.insert(entry.name.clone()) {
            r.refuse(line, "name", format!("{:?} occurs twice", entry.name), "give each loop its own name");
        }
        for (signal, key) in &entry.keys {
            let (place, name) = key.split_once(NAME_MARK).unwrap_or((key, "all"));
            let chunks = place.split('/').all(|chunk| !chunk.is_empty());
            if !chunks || place.contains(['*', '$', '?']) || name.is_empty() {
                let remedy = "write a full key, such as gateway/opc/FIC101.PV, or KEY#NAME for one value of a payload";
                r.refuse(
                    line,
                    setting_of(*signal),
                    format!("{key:?} is not a key: it has an empty part, an empty name or a wildcard"),
                    remedy,
                );
            }
            match owners.insert(key.clone(), index) {
                None => {}
                Some(owner) if owner == index => {
                    r.refuse(
                        line,
                        setting_of(*signal),
                        format!("{key:?} occurs twice in this loop"),
                        "map each key once",
                    );
                }
                Some(owner) => {
                    let message = format!("{key:?} is already mapped for loop {:?}", loops[owner].name);
                    r.refuse(line, setting_of(*signal), message, "map each key once");
                }
            }
        }
        r.close();
        loops.push(entry);
    }
    loops
}

/// The key of `[[loop]]` that maps a signal. In the trade MV often means the controller output, so the valve position has a
/// different word here.
#[must_use]
pub const fn setting_of(signal: Signal) -> &'static str {
    match signal {
        Signal::Mv => "position",
        other => other.name(),
    }
}

fn read_loop(r: &mut TableReader<'_, '_>, window: WindowParams, alarm: AlarmParams) -> LoopConfig {
    let line = r.line();
    let name = r.text("name");
    match &name {
        Some((name, line)) if !is_loop_name(name) => {
            r.refuse(*line, "name", format!("{name:?} is not a valid name"), "do not use * $ ? # @ or empty parts");
        }
        None => r.refuse(line, "name", "is missing", "write name = \"FIC101\""),
        Some(_) => {}
    }
    let keys = Signal::ALL.into_iter().filter_map(|s| r.text(setting_of(s)).map(|(key, _)| (s, key))).collect();
    let op_range = r.pair("op_range", "two numbers, such as [0.0, 100.0]").and_then(|(range, line)| {
        if range[1] > range[0] {
            return Some(range);
        }
        r.refuse(line, "op_range", format!("[{}, {}] is empty", range[0], range[1]), "write [LOW, HIGH]");
        None
    });
    let kind = r.choice("kind", &LoopKind::ALL.map(|kind| (kind.name(), Some(kind))));
    let final_element = r.choice("final_element", &FinalElement::ALL.map(|one| (one.name(), one)));
    let action = r.choice("action", &[Action::Reverse, Action::Direct].map(|action| (action.name(), Some(action))));
    let upstream = read_upstream(r, name.as_ref().map(|(name, _)| name.as_str()));
    LoopConfig {
        name: name.map(|(n, _)| n).unwrap_or_default(),
        keys,
        op_range,
        kind,
        final_element,
        action,
        criticality: r.integer("criticality", 3, 1, 5) as u8,
        area: read_label(r, "area"),
        equipment: read_label(r, "equipment"),
        op_unit: read_label(r, "op_unit"),
        upstream,
        window: read_window(r, window),
        alarm: read_alarm(r, alarm),
    }
}

/// Names of other loops. They need not be configured: most loops appear by themselves.
fn read_upstream(r: &mut TableReader<'_, '_>, own: Option<&str>) -> Vec<String> {
    let names = r.texts("upstream");
    for (name, line) in &names {
        if !is_loop_name(name) || Some(name.as_str()) == own {
            r.refuse(*line, "upstream", format!("{name:?} is not another loop"), "write names of other loops");
        }
    }
    names.into_iter().map(|(name, _)| name).collect()
}

/// Longest label, bytes.
const LABEL_BYTES: usize = 128;

/// A short plain text for documents.
fn read_label(r: &mut TableReader<'_, '_>, key: &'static str) -> String {
    let Some((label, line)) = r.text(key) else { return String::new() };
    if label.len() > LABEL_BYTES || label.chars().any(char::is_control) {
        r.refuse(
            line,
            key,
            "is too long or has control characters",
            format!("write at most {LABEL_BYTES} bytes of text"),
        );
    }
    label.trim().to_owned()
}
