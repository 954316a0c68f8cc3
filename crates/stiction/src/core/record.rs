//! Data types: one [`Sample`] as received, and the [`Record`] behind one estimate.
//!
//! A [`Record`] keeps output, process variable, sampling time and data quality together. A missing value is absent, never
//! 0.0.

use serde::{Deserialize, Serialize};

use super::signal::held::held_over;

/// The signal of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Signal {
    /// Controller output, the signal sent to the valve.
    Op,
    /// Set point.
    Sp,
    /// Controller mode.
    Mode,
    /// Valve position (stem).
    Mv,
    /// Process variable.
    Pv,
}

impl Signal {
    /// All signals, in the order in which samples with equal timestamps are processed (PV last: it completes a scan).
    pub const ALL: [Self; 5] = [Self::Op, Self::Sp, Self::Mode, Self::Mv, Self::Pv];

    /// Last part of the signal's key, and its CSV column.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Op => "op",
            Self::Sp => "sp",
            Self::Mode => "mode",
            Self::Mv => "mv",
            Self::Pv => "pv",
        }
    }

    /// The signal for a key part or CSV column.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|s| s.name() == name)
    }
}

/// Controller mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The controller moves OP.
    Auto,
    /// A person moves OP.
    Manual,
    /// The controller moves OP, and another controller moves its set point.
    Cascade,
    /// An unmapped mode.
    Unknown,
}

impl Mode {
    /// The mode's word in payloads and documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Manual => "manual",
            Self::Cascade => "cascade",
            Self::Unknown => "unknown",
        }
    }

    /// Parses the words of control systems; any other word is [`Mode::Unknown`].
    #[must_use]
    pub fn from_word(word: &str) -> Self {
        match word.trim().to_ascii_lowercase().as_str() {
            "auto" | "aut" | "automatic" | "a" => Self::Auto,
            "manual" | "man" | "hand" | "m" => Self::Manual,
            "cascade" | "cas" | "casc" | "rcas" | "remote" | "c" => Self::Cascade,
            _ => Self::Unknown,
        }
    }
}

/// A value as the plant sent it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Value {
    /// A finite number.
    Number(f64),
    /// A mode sent as a word.
    Mode(Mode),
    /// Null or not finite.
    Missing,
}

impl Value {
    /// A number, or [`Value::Missing`] if it is not finite.
    #[must_use]
    pub fn number(value: f64) -> Self {
        if value.is_finite() { Self::Number(value) } else { Self::Missing }
    }

    /// The finite number, if any.
    #[must_use]
    pub const fn as_number(self) -> Option<f64> {
        if let Self::Number(v) = self { Some(v) } else { None }
    }
}

/// One value of one signal as received, before any check.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// Its signal.
    pub signal: Signal,
    /// Source time, ns since 1970.
    pub t_ns: i64,
    /// The value.
    pub value: Value,
    /// Quality code as received, if any; its convention is in the configuration.
    pub quality: Option<u32>,
}

/// Data quality of a record, as counts of raw samples.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Facts {
    /// Samples taken while the controller was in manual.
    pub manual: u32,
    /// Samples filled in for lost ones.
    pub filled: u32,
    /// Values that were missing or of bad quality.
    pub bad: u32,
    /// PV samples equal to the one before.
    pub pv_repeats: u32,
    /// OP samples equal to the one before.
    pub op_repeats: u32,
}

/// A uniform stretch of one loop without a data gap: the basis of one estimate.
///
/// The `n` points are `ts_s * box_samples` seconds apart. If the raw samples fit, a point is a sample (`box_samples` = 1)
/// and `op_path` has one value per point. Otherwise a point is an averaging bin of `box_samples` samples: `pv`, `sp` and
/// `mv` are means, and `op_path` has four values per point (first OP, the extremes in a plausible order, last OP), because
/// the valve model must run on OP as recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Timestamp of the first sample, ns.
    pub start_ns: i64,
    /// Timestamp of the last sample, ns.
    pub end_ns: i64,
    /// Mean time between raw samples, s.
    pub ts_s: f64,
    /// Mean time between recorded samples, s: equals `ts_s`, unless bins have a fractional number of samples.
    pub recorded_ts_s: f64,
    /// Raw samples over which each PV value is held; 1 if none is held, or if a point is a bin.
    pub held: usize,
    /// Raw samples in the record.
    pub raw_samples: usize,
    /// Raw samples per point (a power of two in the daemon).
    pub box_samples: usize,
    /// Path of OP through each point, `n * path_per_point` values.
    pub op_path: Vec<f64>,
    /// PV at each point, PV units.
    pub pv: Vec<f64>,
    /// Set point at each point, PV units.
    pub sp: Option<Vec<f64>>,
    /// Valve position at each point.
    pub mv: Option<Vec<f64>>,
    /// Variation of the time between points: robust standard deviation over mean.
    pub irregularity: f64,
    /// Counts for the validity checks.
    pub facts: Facts,
}

impl Record {
    /// A record of raw samples at a constant rate that starts at time 0; as long as the shorter signal.
    #[must_use]
    pub fn uniform(ts_s: f64, mut op: Vec<f64>, mut pv: Vec<f64>) -> Self {
        let n = op.len().min(pv.len());
        op.truncate(n);
        pv.truncate(n);
        let repeats = |x: &[f64]| x.windows(2).filter(|w| w[0] == w[1]).count() as u32;
        Self {
            start_ns: 0,
            end_ns: crate::core::units::ns_from_s(ts_s * n.saturating_sub(1) as f64),
            ts_s,
            recorded_ts_s: ts_s,
            held: held_over(&pv),
            raw_samples: n,
            box_samples: 1,
            facts: Facts { pv_repeats: repeats(&pv), op_repeats: repeats(&op), ..Facts::default() },
            op_path: op,
            pv,
            sp: None,
            mv: None,
            irregularity: 0.0,
        }
    }

    /// Bytes of the record's values.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let optional = [&self.sp, &self.mv].into_iter().flatten().map(Vec::len).sum::<usize>();
        (self.op_path.len() + self.pv.len() + optional) * size_of::<f64>()
    }

    /// The points `from` to `to`, excluding `to`. The counts of [`Facts`] are scaled in proportion, because their positions are
    /// not kept.
    #[must_use]
    pub fn part(&self, from: usize, to: usize) -> Self {
        let (to, m) = (to.min(self.len()), self.path_per_point());
        let from = from.min(to);
        let cut = |x: &Vec<f64>| x.get(from..to).map(<[f64]>::to_vec);
        let share = (to - from) as f64 / self.len().max(1) as f64;
        let count = |n: u32| (f64::from(n) * share).round() as u32;
        let stamp = |point: usize| self.start_ns + crate::core::units::ns_from_s(point as f64 * self.point_s());
        let f = self.facts;
        let facts = Facts {
            manual: count(f.manual),
            filled: count(f.filled),
            bad: count(f.bad),
            pv_repeats: count(f.pv_repeats),
            op_repeats: count(f.op_repeats),
        };
        Self {
            start_ns: stamp(from),
            end_ns: stamp(to.saturating_sub(1)),
            raw_samples: (to - from) * self.box_samples,
            op_path: self.op_path[from * m..to * m].to_vec(),
            pv: self.pv[from..to].to_vec(),
            sp: self.sp.as_ref().and_then(cut),
            mv: self.mv.as_ref().and_then(cut),
            facts,
            ..*self
        }
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.pv.len()
    }

    /// Whether there are no points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pv.is_empty()
    }

    /// OP values per point: 1 for raw samples, 4 for the daemon's bins, all raw values for bins from
    /// [`crate::core::signal::resample`].
    #[must_use]
    pub fn path_per_point(&self) -> usize {
        (self.op_path.len() / self.pv.len().max(1)).max(1)
    }

    /// Time between points, s.
    #[must_use]
    pub fn point_s(&self) -> f64 {
        self.ts_s * self.box_samples as f64
    }

    /// OP at each point: the sample, or the mean of the bin's extremes.
    #[must_use]
    pub fn op(&self) -> Vec<f64> {
        match self.path_per_point() {
            1 => self.op_path.clone(),
            m => self.op_path.chunks_exact(m).map(middle).collect(),
        }
    }
}

/// The mean of the extremes.
fn middle(path: &[f64]) -> f64 {
    let (low, high) = path.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    0.5 * (low + high)
}
