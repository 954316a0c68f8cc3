//! A loop's record for the trend: between two times, thinned to the resolution of a screen.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::fault::Fault;
use super::sampling::sampling_time_s;
use super::shelf::Shelf;
use crate::web::thin::thin;
use stiction::samples::align::Point;
use stiction_engine::analysis::{Points, Section};

/// Default and largest number of points.
const POINTS: [usize; 2] = [2_000, 20_000];

/// Which part of a record is requested.
#[derive(Debug, Clone, Deserialize)]
pub struct RecordQuery {
    /// The loop.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// Start, ms since 1970.
    pub from_ms: Option<f64>,
    /// End, ms since 1970.
    pub to_ms: Option<f64>,
    /// Number of points.
    pub points: Option<usize>,
}

/// Curves over a common axis. Missing values are null.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct RecordAnswer {
    /// Sampling time, s.
    pub ts_s: Option<f64>,
    /// Samples of the whole loop.
    pub samples: usize,
    /// Numbers of the first and last sample between the two times, from 1; null if there is none.
    pub range: Option<[usize; 2]>,
    /// Stamps, ms since 1970.
    pub t_ms: Vec<f64>,
    /// Controller output.
    pub op: Vec<Option<f64>>,
    /// Process variable.
    pub pv: Vec<Option<f64>>,
    /// Set point, if recorded.
    pub sp: Option<Vec<Option<f64>>>,
    /// Valve position, if recorded.
    pub mv: Option<Vec<Option<f64>>>,
    /// Number of each point's sample, from 1, as in `--samples`; null in a hole between two stretches.
    pub index: Vec<Option<usize>>,
}

/// The record between two times.
///
/// # Errors
/// There is no such file or loop.
pub fn record(shelf: &Shelf, id: &str, query: &RecordQuery) -> Result<RecordAnswer, Fault> {
    let points = shelf.points(id, &query.loop_name)?;
    answer(&points, query)
}

fn answer(points: &Points, query: &RecordQuery) -> Result<RecordAnswer, Fault> {
    let all = points.samples(Section::Whole).map_err(|error| Fault::wrong(error.to_string()))?;
    let ts_s = sampling_time_s(&all);
    let ms = |point: &Point| point.t_ns as f64 / 1e6;
    // Stretches are in order of time unless the clock was set back; then take everything between first and last.
    let from = query.from_ms.map_or(0, |from| all.iter().position(|p| ms(p) >= from).unwrap_or(all.len()));
    let to = query.to_ms.map_or(all.len(), |to| all.iter().rposition(|p| ms(p) <= to).map_or(0, |last| last + 1));
    let part = all.get(from..to).unwrap_or_default();
    let curve = |of: &dyn Fn(&Point) -> Option<f64>| -> Vec<f64> {
        part.iter().map(|point| of(point).unwrap_or(f64::NAN)).collect()
    };
    let (op, pv) = (curve(&|p| Some(p.op)), curve(&|p| Some(p.pv)));
    let recorded = |of: &dyn Fn(&Point) -> Option<f64>| Some(curve(of)).filter(|c| c.iter().any(|v| v.is_finite()));
    let (sp, mv) = (recorded(&|p| p.sp), recorded(&|p| p.mv));
    let [usual, most] = POINTS;
    let kept = thin(&[&op, &pv], query.points.unwrap_or(usual).clamp(10, most));
    let mut rows: Vec<Option<usize>> = Vec::with_capacity(kept.len() + 8);
    let mut t_ms: Vec<f64> = Vec::with_capacity(kept.len() + 8);
    let hole_ms = ts_s.map_or(f64::INFINITY, |ts| 1e3 * ts * HOLE);
    for pair in kept.windows(2).chain(kept.last().map(std::slice::from_ref)) {
        let at = pair[0];
        rows.push(Some(at));
        t_ms.push(ms(&part[at]));
        // Without a missing point, the chart would draw a line across the hole.
        if let Some(gap) = pair.get(1).and_then(|next| hole(&part[at..=*next], hole_ms)) {
            rows.push(None);
            t_ms.push(gap);
        }
    }
    let values = |curve: &[f64]| -> Vec<Option<f64>> {
        rows.iter().map(|row| row.map(|at| curve[at]).filter(|value| value.is_finite())).collect()
    };
    Ok(RecordAnswer {
        ts_s,
        samples: all.len(),
        range: (!part.is_empty()).then_some([from + 1, to]),
        op: values(&op),
        pv: values(&pv),
        sp: sp.as_deref().map(values),
        mv: mv.as_deref().map(values),
        index: rows.iter().map(|row| row.map(|at| from + at + 1)).collect(),
        t_ms,
    })
}

/// Two samples further apart than this have a hole between them, sampling times.
const HOLE: f64 = 5.5;

/// The middle of the first hole among samples, ms.
fn hole(samples: &[Point], longest_ms: f64) -> Option<f64> {
    let ms = |point: &Point| point.t_ns as f64 / 1e6;
    let found = samples.windows(2).find(|pair| ms(&pair[1]) - ms(&pair[0]) > longest_ms)?;
    Some(0.5 * (ms(&found[0]) + ms(&found[1])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::record::{Sample, Signal, Value};
    use stiction::core::units::ns_from_s;
    use stiction_engine::config::Config;

    fn points(stamps_s: &[f64]) -> Points {
        let of = |signal, t: f64, v| Sample { signal, t_ns: ns_from_s(t), value: Value::Number(v), quality: None };
        let samples: Vec<Sample> = stamps_s
            .iter()
            .flat_map(|t| [of(Signal::Op, *t, libm::sin(0.1 * t)), of(Signal::Pv, *t, libm::cos(0.1 * t))])
            .collect();
        Points::of("A", &samples, &Config::with_prefix("p"))
    }

    fn query(from_ms: Option<f64>, to_ms: Option<f64>, points: usize) -> RecordQuery {
        RecordQuery { loop_name: "A".into(), from_ms, to_ms, points: Some(points) }
    }

    #[test]
    fn samples_are_numbered_as_sections_count_them() {
        let stamps: Vec<f64> = (0..5_000).map(f64::from).collect();
        let points = points(&stamps);
        let some = answer(&points, &query(Some(1_000_000.0), Some(1_999_000.0), 4_000)).unwrap();
        assert_eq!((some.samples, some.range, some.t_ms.len()), (5_000, Some([1_001, 2_000]), 1_000));
        assert_eq!((some.index[0], some.t_ms[0], some.ts_s), (Some(1_001), 1_000_000.0, Some(1.0)));
        // The section with these numbers begins at that time.
        let (record, _) = points.record(Section::Samples(1_001, 2_000), 5_000).unwrap();
        assert_eq!((record.start_ns, record.end_ns), (ns_from_s(1_000.0), ns_from_s(1_999.0)));
        let few = answer(&points, &query(None, None, 100)).unwrap();
        assert!(few.t_ms.len() <= 104 && few.sp.is_none() && few.index.last() == Some(&Some(5_000)));
        let none = answer(&points, &query(Some(9e9), None, 100)).unwrap();
        assert_eq!((none.range, none.t_ms.len(), none.samples), (None, 0, 5_000));
        let turned = answer(&points, &query(Some(2e6), Some(1e6), 100)).unwrap();
        assert_eq!(turned.range, None);
    }

    #[test]
    fn a_hole_is_no_line() {
        let stamps: Vec<f64> = (0..500).map(f64::from).chain((900..1_400).map(f64::from)).collect();
        for most in [4_000, 60] {
            let all = answer(&points(&stamps), &query(None, None, most)).unwrap();
            let hole = all.index.iter().position(Option::is_none).unwrap();
            assert!((499_000.0..900_000.0).contains(&all.t_ms[hole]) && all.op[hole].is_none(), "{most}");
            assert!(all.t_ms.windows(2).all(|pair| pair[1] > pair[0]));
        }
    }
}
