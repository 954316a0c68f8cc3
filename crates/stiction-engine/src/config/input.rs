//! `[input]`: which data to accept, and how much.

use serde::Serialize;
use toml::de::DeTable;

use super::reader::{Fault, Lines, TableReader};
use crate::codec::{self, ConfiguredCodec};
use stiction::core::record::Mode;
use stiction::samples::align::Quality;

/// Default of `[input] queue_bytes`.
const QUEUE_BYTES: usize = 64 << 20;
/// Default of `[input] max_rate_hz`: a thousand times what a plant sends.
const MAX_RATE_HZ: f64 = 1000.0;
/// Default of `[input] max_ahead_s`: a day.
const MAX_AHEAD_S: f64 = 86_400.0;
/// Default of `[input] new_loops_per_hour`.
const NEW_LOOPS_PER_HOUR: u32 = 20_000;

/// Default of `[input] forget_after_s`: a week.
const FORGET_AFTER_S: f64 = 604_800.0;

// Keys that came later are left out of the hash at their defaults: older recordings still read as recorded.
#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
const fn is_queue_bytes_default(bytes: &usize) -> bool {
    *bytes == QUEUE_BYTES
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_rate_default(rate_hz: &f64) -> bool {
    rate_hz.to_bits() == MAX_RATE_HZ.to_bits()
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_ahead_default(ahead_s: &f64) -> bool {
    ahead_s.to_bits() == MAX_AHEAD_S.to_bits()
}

#[allow(clippy::trivially_copy_pass_by_ref)]
const fn is_new_loops_default(n: &u32) -> bool {
    *n == NEW_LOOPS_PER_HOUR
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_forget_default(after_s: &f64) -> bool {
    after_s.to_bits() == FORGET_AFTER_S.to_bits()
}

/// `[input]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Input {
    /// Monitor every loop that appears below the prefix.
    pub discover: bool,
    /// Most loops; further ones are counted and ignored. Loops named in the configuration are always included.
    pub max_loops: usize,
    /// Most loops discovered per hour, or at once after an hour without discoveries.
    #[serde(skip_serializing_if = "is_new_loops_default")]
    pub new_loops_per_hour: u32,
    /// Time without a sample after which a loop is removed from memory, s; 0: never.
    #[serde(skip_serializing_if = "is_forget_default")]
    pub forget_after_s: f64,
    /// Most samples per second on one key in the long run; 0: no limit.
    #[serde(skip_serializing_if = "is_rate_default")]
    pub max_rate_hz: f64,
    /// Most that a timestamp may be ahead of both the system clock and the other loops, s; 0: no limit.
    #[serde(skip_serializing_if = "is_ahead_default")]
    pub max_ahead_s: f64,
    /// Most messages waiting for the engine.
    pub queue: usize,
    /// Most bytes of messages waiting for the engine.
    #[serde(skip_serializing_if = "is_queue_bytes_default")]
    pub queue_bytes: usize,
    /// Payload codec.
    #[serde(serialize_with = "codec::serialize_choice")]
    pub codec: ConfiguredCodec,
    /// Convention of quality codes.
    pub quality: Quality,
    /// Numeric codes of controller modes.
    pub modes: Vec<(i64, Mode)>,
}

pub(super) fn read_input(r: &mut TableReader<'_, '_>) -> Input {
    let mut modes = Vec::new();
    for (number, word, line) in r.text_map("modes") {
        match (number.parse::<i64>(), Mode::from_word(&word)) {
            (Ok(n), mode) if mode != Mode::Unknown || word == "unknown" => modes.push((n, mode)),
            (Ok(_), _) => {
                r.refuse(line, "modes", format!("{word:?} is not a mode"), "write auto, manual, cascade or unknown");
            }
            (Err(_), _) => {
                r.refuse(line, "modes", format!("{number:?} is not a whole number"), "write 0 = \"manual\"");
            }
        }
    }
    Input {
        discover: r.boolean("discover", true),
        max_loops: r.integer("max_loops", 100_000, 1, 1_000_000) as usize,
        new_loops_per_hour: r.integer("new_loops_per_hour", NEW_LOOPS_PER_HOUR.into(), 1, 1_000_000) as u32,
        forget_after_s: r.number("forget_after_s", FORGET_AFTER_S, 0.0, 1e9),
        max_rate_hz: r.number("max_rate_hz", MAX_RATE_HZ, 0.0, 1e9),
        max_ahead_s: r.number("max_ahead_s", MAX_AHEAD_S, 0.0, 1e10),
        queue: r.integer("queue", 65_536, 16, 16_777_216) as usize,
        queue_bytes: r.integer("queue_bytes", QUEUE_BYTES as u64, 4_194_304, 1 << 40) as usize,
        codec: r.choice("codec", &codec::choices()),
        quality: r.choice("quality", &[("ua", Quality::Ua), ("classic", Quality::Classic)]),
        modes,
    }
}

/// A fault if `max_loops` is less than the number of configured loops.
pub(super) fn too_few_places(lines: &Lines, root: &DeTable<'_>, max_loops: usize, named: usize) -> Option<Fault> {
    let head = root.iter().find(|(key, _)| key.get_ref() == "input").map_or(0, |(key, _)| key.span().start);
    (named > max_loops).then(|| Fault {
        line: lines.of(head),
        key: "input.max_loops".to_owned(),
        message: format!("{max_loops} is less than the {named} loops in [[loop]]"),
        remedy: format!("write at least {named}"),
    })
}
