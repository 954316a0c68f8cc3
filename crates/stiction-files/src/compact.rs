//! The toolbox's compact data store: `int_LoopNumber`, and `str_Compact` with a structure `loop1`..`loopN` for each
//! loop (`dbl_Compact_Data` N x 2: OP, PV; `dbl_SamplingTime`; `cell_char_TagList` 2 x 1; `cell_char_TimeStamp` N x 1;
//! `cell_Comment`, which the toolbox's manual also calls `char_Comment`).
//!
//! This program adds what it knows beyond that, in fields that the toolbox does not read: `cell_char_Units` 2 x 1, and the set
//! point, valve position and mode as `dbl_SP_Data`, `dbl_MV_Data`, `dbl_Mode_Data` N x 1: NaN where there is no sample, Inf
//! where one has no value; modes are 1 automatic, 2 manual, 3 cascade, 4 unknown.
//!
//! The sampling time decides: sample k is at the first timestamp plus k sampling times, whatever the other timestamps say.

use super::LoadedLoop;
use super::export::utc;
use super::mat::{self, Mat, MatError};
use std::io::Write;
use std::path::Path;
use stiction::core::record::{Mode, Sample, Signal, Value};
use stiction::core::units::{NS_PER_S, format_rfc3339, s_from_ns};
use thiserror::Error;

/// Variable with the number of loops.
const COUNT: &str = "int_LoopNumber";
/// Variable with the loops.
const STORE: &str = "str_Compact";
const DATA: &str = "dbl_Compact_Data";
const SAMPLING: &str = "dbl_SamplingTime";
const TAGS: &str = "cell_char_TagList";
const STAMPS: &str = "cell_char_TimeStamp";
const UNITS: &str = "cell_char_Units";
/// Signals beside OP and PV.
const OTHERS: [(Signal, &str); 3] =
    [(Signal::Sp, "dbl_SP_Data"), (Signal::Mv, "dbl_MV_Data"), (Signal::Mode, "dbl_Mode_Data")];
/// Modes by their number, from 1.
const MODES: [Mode; 4] = [Mode::Auto, Mode::Manual, Mode::Cascade, Mode::Unknown];
const COMMENTS: [&str; 2] = ["cell_Comment", "char_Comment"];
/// Shortest and longest valid sampling time, s: a microsecond, a hundred days.
const SAMPLING_TIMES_S: [f64; 2] = [1e-6, 8.64e6];

/// A store that cannot be used.
#[derive(Debug, Error)]
pub enum CompactError {
    /// The file cannot be read.
    #[error(transparent)]
    Mat(#[from] MatError),
    /// A MATLAB file without a compact store.
    #[error(
        "a MATLAB file without a compact store: {0}; create one with gen_cmpct_Data_stiction or stictiond compact new"
    )]
    Foreign(String),
    /// No loop of the store can be used.
    #[error("no usable loop: {0}")]
    NoLoop(String),
}

/// One loop of a store.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CompactLoop {
    /// `loop1`, `loop2` and so on.
    pub name: String,
    /// Tags of OP and PV.
    pub tags: [String; 2],
    /// Sampling time, s.
    pub ts_s: f64,
    /// Timestamp of the first sample, ns since 1970; `None` if no timestamp can be read.
    pub start_ns: Option<i64>,
    /// Comment.
    pub comment: String,
    /// Controller output and process variable; NaN if missing.
    pub rows: Vec<[f64; 2]>,
    /// Set point, valve position and mode: a value per row, NaN if there is no sample, infinite if it has no value.
    pub others: Vec<(Signal, Vec<f64>)>,
    /// Units of OP and PV.
    pub units: [Option<String>; 2],
}

/// A store and the warnings on it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Store {
    /// Loops in order.
    pub loops: Vec<CompactLoop>,
    /// Warnings, one line each.
    pub warnings: Vec<String>,
    /// Whether loops had to be skipped.
    pub incomplete: bool,
}

impl CompactLoop {
    /// Timestamp of row `k`, counted from 0; starts at 1970 if no timestamp could be read.
    #[must_use]
    pub fn stamp_ns(&self, k: usize) -> i64 {
        let steps = (self.ts_s * k as f64 * NS_PER_S as f64).round();
        self.start_ns.unwrap_or(0).saturating_add(steps as i64)
    }

    /// The rows as samples.
    #[must_use]
    pub fn samples(&self) -> Vec<Sample> {
        let row = |(k, row): (usize, &[f64; 2])| {
            let t_ns = self.stamp_ns(k);
            let of = move |signal, value| Sample { signal, t_ns, value, quality: None };
            let others = self.others.iter().filter_map(move |(signal, values)| {
                let v = values.get(k).copied().filter(|v| !v.is_nan())?;
                let mode = || MODES.get((v as usize).wrapping_sub(1)).copied().unwrap_or(Mode::Unknown);
                let is_mode = *signal == Signal::Mode && v.is_finite();
                Some(of(*signal, if is_mode { Value::Mode(mode()) } else { Value::number(v) }))
            });
            let pair = [(Signal::Op, row[0]), (Signal::Pv, row[1])];
            pair.map(|(signal, v)| of(signal, Value::number(v))).into_iter().chain(others)
        };
        self.rows.iter().enumerate().flat_map(row).collect()
    }

    /// A loop of any source at a constant rate: its own, or one that is given, s.
    ///
    /// # Errors
    /// As [`CompactLoop::from_samples`].
    pub fn of(one: &LoadedLoop, ts_s: Option<f64>) -> Result<Self, String> {
        let about = one.about.as_ref();
        let mut kept = Self::from_samples(&one.name, &one.samples, ts_s.or(about.map(|about| about.ts_s)))?;
        if let Some(about) = about {
            (kept.tags, kept.comment) = (about.tags.clone(), about.comment.clone());
        }
        kept.units.clone_from(&one.units);
        Ok(kept)
    }

    /// A loop from samples at a constant rate: OP and PV side by side, NaN if missing; other signals in the nearest row.
    ///
    /// # Errors
    /// A sentence: the samples have no constant rate, or there are too few.
    pub fn from_samples(name: &str, samples: &[Sample], ts_s: Option<f64>) -> Result<Self, String> {
        let mut stamps: Vec<i64> =
            samples.iter().filter(|s| matches!(s.signal, Signal::Op | Signal::Pv)).map(|s| s.t_ns).collect();
        stamps.sort_unstable();
        stamps.dedup();
        let (Some(&start_ns), Some(&end_ns)) = (stamps.first(), stamps.last()) else {
            return Err("has neither OP nor PV".to_owned());
        };
        let ts_s =
            ts_s.or_else(|| median_step_s(&stamps)).ok_or("a single timestamp gives no sampling time; use --ts")?;
        let ts_ns = ts_s * NS_PER_S as f64;
        let count = (end_ns.saturating_sub(start_ns) as f64 / ts_ns).round() as usize + 1;
        if count > 4 * stamps.len() + 16 {
            return Err(format!(
                "{} timestamps over {} s have no constant rate; at {ts_s} s there would be {count}",
                stamps.len(),
                s_from_ns(end_ns.saturating_sub(start_ns))
            ));
        }
        let mut rows = vec![[f64::NAN; 2]; count];
        let mut others: Vec<(Signal, Vec<f64>)> = Vec::new();
        let mut off = 0;
        for sample in samples {
            let place = sample.t_ns.saturating_sub(start_ns) as f64 / ts_ns;
            let at = place.round() as usize;
            let column = match sample.signal {
                Signal::Op => 0,
                Signal::Pv => 1,
                signal => {
                    let known = others.iter().position(|(other, _)| *other == signal);
                    let known = known.unwrap_or_else(|| {
                        others.push((signal, vec![f64::NAN; count]));
                        others.len() - 1
                    });
                    let last = count - 1;
                    others[known].1[at.min(last)] = match sample.value {
                        Value::Number(number) => number,
                        Value::Mode(mode) => {
                            MODES.iter().position(|m| *m == mode).map_or(f64::INFINITY, |k| k as f64 + 1.0)
                        }
                        Value::Missing => f64::INFINITY,
                    };
                    continue;
                }
            };
            off += usize::from((place - place.round()).abs() > 0.1);
            if let (Some(slot), Some(value)) = (rows.get_mut(at), sample.value.as_number()) {
                slot[column] = value;
            }
        }
        if off * 20 > samples.len() {
            return Err(format!("{off} of {} samples are off the constant rate of one every {ts_s} s", samples.len()));
        }
        let tags = default_tags(name);
        Ok(Self { name: name.to_owned(), tags, ts_s, start_ns: Some(start_ns), rows, others, ..Self::default() })
    }
}

/// `NAME.OP`, `NAME.PV`.
#[must_use]
pub fn default_tags(name: &str) -> [String; 2] {
    ["OP", "PV"].map(|signal| format!("{name}.{signal}"))
}

/// The common part of the tags of OP and PV: `FIC101` of `FIC101.OP` and `FIC101.PV`.
#[must_use]
pub fn stem_of(tags: &[String; 2]) -> Option<&str> {
    let common = tags[0].bytes().zip(tags[1].bytes()).take_while(|(a, b)| a == b).count();
    let stem = tags[0].get(..common)?.trim_end_matches(['.', '_', '-', '/', ' ', ':']);
    (!stem.is_empty()).then_some(stem)
}

/// Checks the range of a sampling time.
///
/// # Errors
/// A sentence with the valid range.
pub fn check_sampling_time(ts_s: f64) -> Result<f64, String> {
    let [least, most] = SAMPLING_TIMES_S;
    if (least..=most).contains(&ts_s) {
        Ok(ts_s)
    } else {
        Err(format!("a sampling time of {ts_s} s is out of range; write seconds from {least} to {most}"))
    }
}

fn median_step_s(stamps: &[i64]) -> Option<f64> {
    let mut steps: Vec<i64> = stamps.windows(2).map(|w| w[1].saturating_sub(w[0])).collect();
    let middle = steps.len().checked_sub(1)? / 2;
    Some(s_from_ns(*steps.select_nth_unstable(middle).1))
}

/// Reads a store.
///
/// # Errors
/// [`CompactError`] names the place and the remedy.
pub fn read(path: &Path) -> Result<Store, CompactError> {
    of_variables(&mat::read(path, &|name| name == COUNT || name == STORE)?)
}

/// A store from a MATLAB file's variables.
///
/// # Errors
/// [`CompactError`] if they are not a store, or none of its loops can be used.
pub fn of_variables(variables: &[(String, Mat)]) -> Result<Store, CompactError> {
    let variable = |name: &str| variables.iter().find(|(n, _)| n == name).map(|(_, value)| value);
    let store = variable(STORE).ok_or_else(|| CompactError::Foreign(format!("there is no variable {STORE}")))?;
    let Mat::Struct(fields) = store else {
        return Err(CompactError::Foreign(format!("{STORE} is {}, not a structure", store.describe())));
    };
    let mut out = Store::default();
    let mut faults = Vec::new();
    for (name, value) in fields {
        let number = name.strip_prefix("loop").and_then(|n| n.parse::<usize>().ok());
        if number.is_none() {
            out.warnings.push(format!("skipped {STORE}.{name}, which is not named loop1, loop2 and so on"));
            continue;
        }
        match one_loop(name, value, &mut out.warnings) {
            Ok(one) => out.loops.push(one),
            Err(fault) => faults.push(format!("{STORE}.{name}{fault}")),
        }
    }
    out.loops.sort_by_key(|one| one.name["loop".len()..].parse::<usize>().unwrap_or(usize::MAX));
    if out.loops.is_empty() {
        let none = || format!("{STORE} has no field loop1");
        return Err(CompactError::NoLoop(faults.first().cloned().unwrap_or_else(none)));
    }
    out.incomplete = !faults.is_empty();
    out.warnings.extend(faults.iter().map(|fault| format!("skipped: {fault}")));
    let counted = variable(COUNT).and_then(scalar);
    let there = out.loops.len() + faults.len();
    if counted != Some(there as f64) {
        let said = counted.map_or("is missing".to_owned(), |n| format!("says {n}"));
        out.warnings.push(format!("{COUNT} {said}, but {STORE} has {there} loops; all of them are used"));
    }
    Ok(out)
}

/// One loop, or the fault with its field.
fn one_loop(name: &str, value: &Mat, warnings: &mut Vec<String>) -> Result<CompactLoop, String> {
    if !matches!(value, Mat::Struct(_)) {
        return Err(format!(" is {}, not a structure", value.describe()));
    }
    let rows = data(value.field(DATA).ok_or_else(|| format!(" has no field {DATA}"))?)?;
    let ts_s = value.field(SAMPLING).ok_or_else(|| format!(" has no field {SAMPLING}"))?;
    let ts_s = scalar(ts_s).ok_or_else(|| format!(".{SAMPLING} is {}, not one number", ts_s.describe()))?;
    let ts_s = check_sampling_time(ts_s).map_err(|fault| format!(".{SAMPLING}: {fault}"))?;
    let mut warn = |what: String| warnings.push(format!("{STORE}.{name}{what}"));
    let mut tags = default_tags(name);
    let listed = value.field(TAGS).map(lines).unwrap_or_default();
    if listed.len() != 2 {
        warn(format!(".{TAGS} has {} tags instead of 2; missing ones are named after the loop", listed.len()));
    }
    for (tag, listed) in tags.iter_mut().zip(listed) {
        if !listed.trim().is_empty() {
            listed.trim().clone_into(tag);
        }
    }
    let stamps = value.field(STAMPS).map(lines).unwrap_or_default();
    let start_ns = stamps.first().and_then(|text| utc(text));
    if start_ns.is_none() {
        let said =
            stamps.first().map_or("is missing".to_owned(), |text| format!("begins with {text:?}, which is not a time"));
        warn(format!(".{STAMPS} {said}: times are counted from 1970 by the sampling time"));
    } else if stamps.len() != rows.len() {
        let counts = (stamps.len(), rows.len());
        warn(format!(".{STAMPS} has {} rows, the data {}; the sampling time is used", counts.0, counts.1));
    } else if let (Some(start), Some(last)) = (start_ns, stamps.last().and_then(|text| utc(text))) {
        let (said, ruled) = (s_from_ns(last.saturating_sub(start)), ts_s * (rows.len() - 1) as f64);
        // Stamps may be rounded to whole seconds.
        if (said - ruled).abs() > ts_s.max(1.0) {
            warn(format!(
                ".{STAMPS} spans {said} s, but {} samples every {ts_s} s span {ruled} s; the sampling time is used",
                rows.len()
            ));
        }
    }
    let comment = COMMENTS.iter().find_map(|field| value.field(field)).map(lines).unwrap_or_default().join("\n");
    let other = |(signal, field): (Signal, &str)| match value.field(field) {
        Some(Mat::Numbers { values, .. }) if values.len() == rows.len() => Some((signal, values.clone())),
        _ => None,
    };
    let others = OTHERS.into_iter().filter_map(other).collect();
    let mut units = value.field(UNITS).map(lines).unwrap_or_default().into_iter().map(|unit| unit.trim().to_owned());
    let units = [(); 2].map(|()| units.next().filter(|unit| !unit.is_empty()));
    Ok(CompactLoop { name: name.to_owned(), tags, ts_s, start_ns, comment, rows, others, units })
}

/// OP and PV side by side.
fn data(value: &Mat) -> Result<Vec<[f64; 2]>, String> {
    let Mat::Numbers { dims, values } = value else {
        return Err(format!(".{DATA} is {}, not N x 2 numbers", value.describe()));
    };
    let [rows, 2] = dims[..] else {
        return Err(format!(".{DATA} is {}, not N x 2: OP and PV", value.describe()));
    };
    if rows == 0 {
        return Err(format!(".{DATA} is empty"));
    }
    let (op, pv) = values.split_at(rows);
    Ok(op.iter().zip(pv).map(|(op, pv)| [*op, *pv]).collect())
}

fn scalar(value: &Mat) -> Option<f64> {
    match value {
        Mat::Numbers { values, .. } => values.first().copied().filter(|_| values.len() == 1),
        Mat::Text(rows) => rows.first()?.trim().parse().ok(),
        _ => None,
    }
}

/// Lines of text, from cells or character rows.
fn lines(value: &Mat) -> Vec<String> {
    match value {
        Mat::Text(rows) => rows.clone(),
        Mat::Cell { items, .. } => items.iter().map(|item| lines(item).join(" ")).collect(),
        Mat::Numbers { values, .. } => values.iter().map(ToString::to_string).collect(),
        _ => Vec::new(),
    }
}

/// Writes a store; compressed as by `save -v7` if `deflated`, else as by `save -v6`.
///
/// # Errors
/// Error of the system.
pub fn write(out: &mut impl Write, loops: &[CompactLoop], deflated: bool) -> std::io::Result<()> {
    let fields = loops.iter().enumerate().map(|(k, one)| (format!("loop{}", k + 1), of_loop(one))).collect();
    let count = Mat::number(loops.len() as f64);
    mat::write(out, &[(COUNT, &count), (STORE, &Mat::Struct(fields))], deflated)
}

fn of_loop(one: &CompactLoop) -> Mat {
    let column = |c: usize| one.rows.iter().map(move |row| row[c]);
    let values = column(0).chain(column(1)).collect();
    let stamps = (0..one.rows.len()).map(|k| Mat::text(format_rfc3339(one.stamp_ns(k)))).collect();
    let comment = one.comment.lines().map(Mat::text).collect::<Vec<_>>();
    let comment = if comment.is_empty() { vec![Mat::text("")] } else { comment };
    let mut fields = vec![
        (DATA, Mat::Numbers { dims: vec![one.rows.len(), 2], values }),
        (SAMPLING, Mat::number(one.ts_s)),
        (TAGS, Mat::column(one.tags.iter().map(Mat::text).collect())),
        (STAMPS, Mat::column(stamps)),
        (COMMENTS[0], Mat::column(comment)),
    ];
    for (signal, values) in &one.others {
        let field = OTHERS.iter().find(|(of, _)| of == signal).map(|(_, field)| *field);
        fields.extend(field.map(|f| (f, Mat::Numbers { dims: vec![values.len(), 1], values: values.clone() })));
    }
    if one.units != [None, None] {
        let unit = |unit: &Option<String>| Mat::text(unit.clone().unwrap_or_default());
        fields.push((UNITS, Mat::column(one.units.iter().map(unit).collect())));
    }
    Mat::Struct(fields.into_iter().map(|(name, value)| (name.to_owned(), value)).collect())
}

/// Rows from two columns of equal length.
///
/// # Errors
/// A sentence with both lengths.
pub fn rows_of(op: &[f64], pv: &[f64]) -> Result<Vec<[f64; 2]>, String> {
    if op.len() != pv.len() {
        return Err(format!("OP has {} values and PV {}; give equally many", op.len(), pv.len()));
    }
    Ok(op.iter().zip(pv).map(|(op, pv)| [*op, *pv]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    fn example() -> Vec<CompactLoop> {
        let of = |name: &str, op: &[f64], pv: &[f64]| CompactLoop {
            name: name.to_owned(),
            tags: default_tags(name),
            ts_s: 3.0,
            start_ns: Some(1_000_000_000),
            comment: "first line\nzweite Zeile: Öl".to_owned(),
            rows: rows_of(op, pv).unwrap(),
            ..CompactLoop::default()
        };
        vec![of("loop1", &[1.0, 3.0, 5.0], &[2.0, 4.0, 6.0]), of("loop2", &[3.0, 7.0, f64::NAN], &[2.0, 6.0, 8.0])]
    }

    fn variables(bytes: &[u8]) -> Vec<(String, Mat)> {
        mat::read_from(Cursor::new(bytes), &|_| true).unwrap()
    }

    #[test]
    fn a_store_reads_back_as_it_was_written() {
        for deflated in [false, true] {
            let mut bytes = Vec::new();
            write(&mut bytes, &example(), deflated).unwrap();
            let variables = variables(&bytes);
            let loop1 = variables[1].1.field("loop1").unwrap();
            let columns = Mat::Numbers { dims: vec![3, 2], values: vec![1.0, 3.0, 5.0, 2.0, 4.0, 6.0] };
            assert_eq!(loop1.field(DATA), Some(&columns));
            let back = of_variables(&variables).unwrap();
            assert!(back.warnings.is_empty() && !back.incomplete, "{back:?}");
            assert_eq!(format!("{:?}", back.loops), format!("{:?}", example()));
            assert_eq!(back.loops[0].stamp_ns(2), 7_000_000_000);
        }
    }

    /// The example's variables with one field of the first loop replaced, or taken away.
    fn changed(field: &str, value: Option<Mat>) -> Vec<(String, Mat)> {
        let mut bytes = Vec::new();
        write(&mut bytes, &example(), false).unwrap();
        let mut variables = variables(&bytes);
        let Mat::Struct(loops) = &mut variables[1].1 else { panic!() };
        let Mat::Struct(fields) = &mut loops[0].1 else { panic!() };
        fields.retain(|(name, _)| name != field);
        fields.extend(value.map(|value| (field.to_owned(), value)));
        variables
    }

    #[test]
    fn a_fault_costs_its_loop_and_names_its_field() {
        let numbers =
            |dims: &[usize]| Some(Mat::Numbers { dims: dims.to_vec(), values: vec![1.0; dims.iter().product()] });
        for (field, value, part) in [
            (DATA, None, "has no field dbl_Compact_Data"),
            (DATA, numbers(&[3, 3]), "3 x 3 numbers, not N x 2"),
            (DATA, numbers(&[0, 2]), "empty"),
            (DATA, Some(Mat::text("x")), "rows of text"),
            (SAMPLING, None, "has no field dbl_SamplingTime"),
            (SAMPLING, Some(Mat::number(0.0)), "of 0 s is out of range"),
            (SAMPLING, Some(Mat::number(-3.0)), "of -3 s is out of range"),
            (SAMPLING, Some(Mat::number(f64::NAN)), "of NaN s is out of range"),
            (SAMPLING, Some(Mat::number(1e12)), "of 1000000000000 s is out of range"),
        ] {
            let store = of_variables(&changed(field, value)).unwrap();
            assert!(store.incomplete && store.loops.len() == 1 && store.loops[0].name == "loop2");
            let told = store.warnings.iter().find(|w| w.contains("str_Compact.loop1")).unwrap();
            assert!(told.contains(part), "{told}");
        }
        let error = of_variables(&[("x".to_owned(), Mat::number(1.0))]).unwrap_err().to_string();
        assert!(error.contains("no variable str_Compact"), "{error}");
        let error = of_variables(&[(STORE.to_owned(), Mat::Struct(Vec::new()))]).unwrap_err().to_string();
        assert!(error.contains("no field loop1"), "{error}");
    }

    #[test]
    fn stamps_are_told_where_they_contradict_the_sampling_time() {
        let column = |stamps: &[&str]| Some(Mat::column(stamps.iter().map(|s| Mat::text(*s)).collect()));
        for (stamps, start_ns, part) in [
            (column(&["1", "2", "3"]), None, "not a time"),
            (None, None, "missing"),
            (column(&["05-Jan-2026 08:00:00", "x"]), Some(1_767_600_000_000_000_000), "has 2 rows, the data 3"),
            (column(&["05-Jan 08:00:00", "x", "y"]), None, "not a time"),
            (column(&["2026-01-05 08:00:00", "", "2026-01-05 09:00:00"]), Some(1_767_600_000_000_000_000), "span 6 s"),
        ] {
            let store = of_variables(&changed(STAMPS, stamps)).unwrap();
            assert_eq!(store.loops[0].start_ns, start_ns);
            assert!(store.warnings.len() == 1 && store.warnings[0].contains(part), "{:?}", store.warnings);
        }
    }

    #[test]
    fn the_comment_has_two_names_and_tags_have_defaults() {
        let mut variables = changed(COMMENTS[0], None);
        let Mat::Struct(loops) = &mut variables[1].1 else { panic!() };
        let Mat::Struct(fields) = &mut loops[0].1 else { panic!() };
        fields.push((COMMENTS[1].to_owned(), Mat::text("by the other name")));
        assert_eq!(of_variables(&variables).unwrap().loops[0].comment, "by the other name");
        let store = of_variables(&changed(TAGS, Some(Mat::column(vec![Mat::text("FIC101.OP")])))).unwrap();
        assert_eq!(store.loops[0].tags, ["FIC101.OP", "loop1.PV"]);
        assert_eq!(stem_of(&["FIC101.OP".into(), "FIC101.PV".into()]), Some("FIC101"));
        assert_eq!(stem_of(&["a".into(), "b".into()]), None);
    }

    #[test]
    fn samples_become_rows_at_a_constant_rate_or_say_why_not() {
        let sample = |signal, t_s: f64, v| Sample { signal, t_ns: (t_s * 1e9) as i64, value: v, quality: None };
        let mut samples: Vec<Sample> = (0..40)
            .flat_map(|k| {
                let (t, v) = (2.0 * f64::from(k), Value::Number(f64::from(k)));
                [sample(Signal::Op, t, v), sample(Signal::Pv, t, v), sample(Signal::Sp, t, v)]
            })
            .collect();
        samples[4].value = Value::Missing;
        let one = CompactLoop::from_samples("A", &samples, None).unwrap();
        assert_eq!((one.ts_s, one.rows.len(), one.rows[39]), (2.0, 40, [39.0, 39.0]));
        assert!(one.rows[1][0] == 1.0 && one.rows[1][1].is_nan());
        let uneven: Vec<Sample> = (0..40).map(|k| sample(Signal::Pv, f64::from(k * k), Value::Number(1.0))).collect();
        assert!(CompactLoop::from_samples("A", &uneven, None).unwrap_err().contains("constant rate"));
        assert!(CompactLoop::from_samples("A", &[], None).unwrap_err().contains("neither"));
    }
}
