//! A neighbour's signals on the grid of the record that it may act on.

use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::sim::process::Pole;

/// Share of the record's points that a neighbour's samples must cover; ends are held.
const COVERED: f64 = 0.95;
/// Fewest samples of a neighbour.
const FEWEST: usize = 60;

/// Another loop on the record's grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Neighbour {
    /// Its name.
    pub name: String,
    /// Its PV at each point, its own units.
    pub pv: Vec<f64>,
    /// Its OP at each point, its own units.
    pub op: Vec<f64>,
}

/// Why a neighbour cannot be offered.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NeighbourError {
    /// Values that are no numbers.
    #[error(
        "neighbour {name}: {count} values of {signal} are not numbers; cut the section so that it leaves them out, or leave this \
         neighbour out"
    )]
    Values {
        /// Its name.
        name: String,
        /// Name of the signal.
        signal: &'static str,
        /// How many.
        count: usize,
    },
    /// Neither signal moves.
    #[error("neighbour {name}: its PV and OP are constant, so it drives nothing; leave it out")]
    Still {
        /// Its name.
        name: String,
    },
    /// Too few samples.
    #[error(
        "neighbour {name}: {samples} samples in the section are too few, {FEWEST} are needed; give a longer recording of it or \
         leave it out"
    )]
    TooShort {
        /// Its name.
        name: String,
        /// Its samples within the section.
        samples: usize,
    },
    /// It was recorded at another time.
    #[error(
        "neighbour {name}: its record covers {covered_pct:.0} % of the section, 95 % are needed; choose a section that both \
         cover, or leave it out"
    )]
    Apart {
        /// Its name.
        name: String,
        /// Points of the section that its samples cover, %.
        covered_pct: f64,
    },
    /// Signals of other lengths than the record.
    #[error("neighbour {name}: {points} points, but the record has {needed}; resample it to the record's grid")]
    Length {
        /// Its name.
        name: String,
        /// Points of the shorter signal.
        points: usize,
        /// Points of the record.
        needed: usize,
    },
}

impl Neighbour {
    /// A loop recorded as `other`, on the grid of `record`: means of its samples around each point, the last one before it
    /// where there are none. Clocks count as given.
    ///
    /// # Errors
    /// Values that are no numbers, signals that do not move, too few samples or another time.
    pub fn of(name: &str, other: &Record, record: &Record) -> Result<Self, NeighbourError> {
        let covered = covered(other, record);
        if covered < COVERED {
            return Err(NeighbourError::Apart { name: name.to_owned(), covered_pct: 100.0 * covered });
        }
        let samples = within(other, record);
        if samples < FEWEST {
            return Err(NeighbourError::TooShort { name: name.to_owned(), samples });
        }
        let made = Self {
            name: name.to_owned(),
            pv: on_grid(other, &other.pv, record),
            op: on_grid(other, &other.op(), record),
        };
        made.check(record.len())?;
        Ok(made)
    }

    /// Checks it against a record of `points` points.
    ///
    /// # Errors
    /// Other lengths, values that are no numbers, or signals that do not move.
    pub fn check(&self, points: usize) -> Result<(), NeighbourError> {
        let name = || self.name.clone();
        let shorter = self.pv.len().min(self.op.len());
        if self.pv.len() != points || self.op.len() != points {
            return Err(NeighbourError::Length { name: name(), points: shorter, needed: points });
        }
        for (signal, values) in [("PV", &self.pv), ("OP", &self.op)] {
            let count = values.iter().filter(|v| !v.is_finite()).count();
            if count > 0 {
                return Err(NeighbourError::Values { name: name(), signal, count });
            }
        }
        if !moves(&self.pv) && !moves(&self.op) {
            return Err(NeighbourError::Still { name: name() });
        }
        Ok(())
    }

    /// Its signals that move, PV first.
    pub(super) fn signals(&self) -> impl Iterator<Item = (bool, &[f64])> {
        [(false, &self.pv[..]), (true, &self.op[..])].into_iter().filter(|(_, values)| moves(values))
    }
}

/// Whether a signal has a spread that numbers can hold.
fn moves(values: &[f64]) -> bool {
    let (deviation, mean) = (stats::std_dev(values), stats::mean(values));
    deviation.is_normal() && deviation > 1e-12 * mean.abs()
}

/// Middle of a record's point, ns from the start of 1970, as a number of seconds from `origin_ns`.
fn middle_s(record: &Record, point: usize, origin_ns: i64) -> f64 {
    let start = (record.start_ns - origin_ns) as f64 * 1e-9;
    let within = 0.5 * (record.box_samples as f64 - 1.0) * record.ts_s;
    start + point as f64 * record.point_s() + within
}

/// Share of the record's points within the other's samples.
fn covered(other: &Record, record: &Record) -> f64 {
    let origin = record.start_ns;
    let last = other.len().saturating_sub(1);
    let from = middle_s(other, 0, origin) - other.point_s();
    let to = middle_s(other, last, origin) + other.point_s();
    let inside = (0..record.len()).filter(|k| (from..=to).contains(&middle_s(record, *k, origin))).count();
    if other.is_empty() || record.is_empty() { 0.0 } else { inside as f64 / record.len() as f64 }
}

/// Raw samples of the other within the record's time.
fn within(other: &Record, record: &Record) -> usize {
    let origin = record.start_ns;
    let end = middle_s(record, record.len().saturating_sub(1), origin);
    let inside = (0..other.len()).filter(|k| (0.0..=end).contains(&middle_s(other, *k, origin))).count();
    inside * other.box_samples
}

/// A signal of the other on the record's grid: means, held where the other is slower.
fn on_grid(other: &Record, values: &[f64], record: &Record) -> Vec<f64> {
    let origin = record.start_ns;
    let half = 0.5 * record.point_s();
    let last = values.len().saturating_sub(1);
    let mut next = 0;
    let mut held = values.first().copied().unwrap_or(0.0);
    (0..record.len())
        .map(|k| {
            let end = middle_s(record, k, origin) + half;
            let first = next;
            while next <= last && middle_s(other, next, origin) < end {
                next += 1;
            }
            // What came before the record began is old, not a part of its first point.
            let begin = if k == 0 { next.saturating_sub(1).max(first) } else { first };
            if let Some(some) = values.get(begin..next).filter(|some| !some.is_empty()) {
                held = stats::mean(some);
            }
            held
        })
        .collect()
}

/// A neighbour's signal as a load: zero mean, unit deviation.
#[derive(Debug, Clone, PartialEq)]
pub struct Load {
    /// The neighbour's name.
    pub name: String,
    /// Whether it is OP, not PV.
    pub from_op: bool,
    /// The signal at each point of the record.
    pub values: Vec<f64>,
    /// Its deviation, the neighbour's units.
    pub deviation: f64,
    /// Share of shifted neighbours of which the best explains as much.
    pub p_value: f64,
}

impl Load {
    pub(in crate::core::gap) fn new(name: &str, from_op: bool, signal: &[f64], p_value: f64) -> Self {
        let (mean, deviation) = (stats::mean(signal), stats::std_dev(signal));
        let values = signal.iter().map(|v| (v - mean) / deviation).collect();
        Self { name: name.to_owned(), from_op, values, deviation, p_value }
    }

    /// The signal behind a first-order lag and a delay, points, over `n` points; beyond its end the last value holds.
    #[must_use]
    pub(crate) fn behind(&self, lag: f64, delay: f64, n: usize) -> Vec<f64> {
        let mut out = Vec::new();
        let first = self.values.first().copied().unwrap_or(0.0);
        let whole = delay.max(0.0).floor();
        Pole::lag(lag, delay.max(0.0) - whole).run(whole as usize, &self.values, first, &mut out);
        let last = out.last().copied().unwrap_or(0.0);
        out.resize(n, last);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::units::ns_from_s;
    use proptest::prelude::*;

    fn ramp(n: usize, ts_s: f64, start_s: f64) -> Record {
        let values: Vec<f64> = (0..n).map(|k| start_s + k as f64 * ts_s).collect();
        let mut record = Record::uniform(ts_s, values.clone(), values);
        (record.start_ns, record.end_ns) = (record.start_ns + ns_from_s(start_s), record.end_ns + ns_from_s(start_s));
        record
    }

    #[test]
    fn a_quicker_neighbour_is_averaged_and_a_slower_one_is_held() {
        let record = ramp(100, 2.0, 0.0);
        let quick = Neighbour::of("quick", &ramp(1000, 0.25, -10.0), &record).unwrap();
        // Eight samples around each point, from a second before it to 0.75 s behind it.
        assert!((quick.pv[10] - 19.875).abs() < 1e-9, "{}", quick.pv[10]);
        let record = ramp(200, 2.0, 0.0);
        let slow = Neighbour::of("slow", &ramp(100, 5.0, -10.0), &record).unwrap();
        assert_eq!(slow.pv[9..14], [15.0, 20.0, 20.0, 20.0, 25.0]);
        assert_eq!(slow.pv.len(), 200);
    }

    #[test]
    fn hostile_neighbours_are_refused_by_name_with_a_remedy() {
        let record = ramp(200, 1.0, 0.0);
        let said = |other: &Record| Neighbour::of("FIC7", other, &record).unwrap_err().to_string();
        let mut wild = ramp(200, 1.0, 0.0);
        wild.pv[7] = f64::NAN;
        for (other, why) in [
            (Record::uniform(1.0, vec![5.0; 200], vec![1e9; 200]), "constant"),
            (ramp(40, 5.0, 0.0), "40 samples"),
            (ramp(200, 1.0, 150.0), "covers 2"),
            (ramp(200, 1.0, 5000.0), "covers 0 %"),
            (Record::uniform(1.0, Vec::new(), Vec::new()), "covers 0 %"),
            (wild, "1 values of PV are not numbers"),
        ] {
            let said = said(&other);
            assert!(said.starts_with("neighbour FIC7:") && said.contains(why), "{said}");
            assert!(said.contains("leave it out") || said.contains("leave this neighbour out"), "{said}");
        }
    }

    proptest! {
        #[test]
        fn any_neighbour_is_refused_or_of_the_records_length_and_finite(
            n in 0_usize..400, ts_s in 0.1..30.0_f64, start_s in -500.0..500.0_f64, wild in 0_usize..500, still: bool,
        ) {
            let record = ramp(150, 2.0, 0.0);
            let mut other = ramp(n, ts_s, start_s);
            if still {
                other.pv.fill(3.0);
                other.op_path.fill(3.0);
            }
            if let Some(v) = other.pv.get_mut(wild) {
                *v = f64::INFINITY;
            }
            if let Ok(made) = Neighbour::of("N", &other, &record) {
                prop_assert!(!still && made.pv.len() == 150 && made.op.len() == 150);
                prop_assert!(made.pv.iter().chain(&made.op).all(|v| v.is_finite()));
                let load = Load::new("N", false, &made.pv, 1.0).behind(2.0, 1.5, 170);
                prop_assert!(load.len() == 170 && load.iter().all(|v| v.is_finite()));
            }
        }
    }
}
