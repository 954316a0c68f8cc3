//! Writes loops of any source as a recording.

use std::collections::BTreeMap;
use std::path::Path;

use super::{LoadedLoop, METADATA_PREFIX, METADATA_UNITS, RecordingFile, WriteError};
use stiction::core::units::{is_loop_name, loop_name_from};
use stiction_engine::codec::topic;

/// Writes loops as a recording, first to `part`, which becomes `target` once complete. `about` gives origin and source.
/// Returns the number of samples.
///
/// # Errors
/// [`WriteError`] of the file.
pub fn write_loops(
    [part, target]: [&Path; 2],
    prefix: &str,
    [origin, source]: [&str; 2],
    loops: &[LoadedLoop],
) -> Result<usize, WriteError> {
    let metadata = metadata_of(prefix, [origin, source], loops);
    fill(RecordingFile::create_at(part.to_owned(), target.to_owned(), &metadata)?, prefix, loops)
}

/// The bytes of such a recording.
///
/// # Errors
/// [`WriteError`] of the recording.
pub fn loops_as_recording(
    prefix: &str,
    [origin, source]: [&str; 2],
    loops: &[LoadedLoop],
) -> Result<Vec<u8>, WriteError> {
    let (file, memory) = RecordingFile::create_in_memory(&metadata_of(prefix, [origin, source], loops))?;
    fill(file, prefix, loops)?;
    Ok(memory.take())
}

fn metadata_of(prefix: &str, [origin, source]: [&str; 2], loops: &[LoadedLoop]) -> BTreeMap<String, String> {
    let pairs =
        [("origin", origin), (METADATA_PREFIX, prefix), ("source", source), ("version", stiction::core::VERSION)];
    let mut metadata = BTreeMap::from(pairs.map(|(key, value)| (key.to_owned(), value.to_owned())));
    let units: BTreeMap<&str, &[Option<String>; 2]> =
        loops.iter().filter(|one| one.units != [None, None]).map(|one| (one.name.as_str(), &one.units)).collect();
    if let (false, Ok(json)) = (units.is_empty(), serde_json::to_string(&units)) {
        metadata.insert(METADATA_UNITS.to_owned(), json);
    }
    metadata
}

fn fill(mut file: RecordingFile, prefix: &str, loops: &[LoadedLoop]) -> Result<usize, WriteError> {
    let mut samples = 0;
    for one in loops {
        let name = if is_loop_name(&one.name) { one.name.clone() } else { loop_name_from(&one.name) };
        for sample in &one.samples {
            file.sample(&topic::raw(prefix, &name, sample.signal), sample.t_ns, sample)?;
        }
        samples += one.samples.len();
    }
    file.finish()?;
    Ok(samples)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compact::{self, CompactLoop};
    use crate::{csv, load_samples};
    use proptest::prelude::*;
    use stiction::core::record::{Mode, Record, Sample, Signal, Value};
    use stiction::samples::align::Quality;
    use stiction_engine::analysis::Points;

    #[test]
    fn a_recording_in_memory_is_the_one_that_a_file_would_be() {
        let sample = |k: i64| Sample { signal: Signal::Pv, t_ns: k, value: Value::Number(k as f64), quality: None };
        let loops = [LoadedLoop::new("FIC101", (1..2000).map(sample).collect())];
        let dir = tempfile::tempdir().unwrap();
        let [part, target] = ["a.part", "a.mcap"].map(|name| dir.path().join(name));
        assert_eq!(write_loops([&part, &target], "p", ["page", "x"], &loops).unwrap(), 1999);
        assert_eq!(loops_as_recording("p", ["page", "x"], &loops).unwrap(), std::fs::read(&target).unwrap());
    }

    /// Row by row OP, PV, SP and mode, each a value, missing, or of bad quality.
    fn loops() -> impl Strategy<Value = LoadedLoop> {
        let cell = || (0..4_u8, -1000..1000_i32);
        let rows = proptest::collection::vec((cell(), cell(), proptest::option::of(cell()), 0..3_u8), 2..60);
        let units = (proptest::option::of("[a-z%]{1,4}"), proptest::option::of("[a-z/]{1,4}"));
        (rows, units).prop_map(|(rows, (op_unit, pv_unit))| {
            let mut samples = Vec::new();
            for (k, (op, pv, sp, mode)) in rows.into_iter().enumerate() {
                let t_ns = 1_781_510_400_000_000_000 + k as i64 * 1_000_000_000;
                let number = |signal, (how, v): (u8, i32)| {
                    let value = if how == 1 { Value::Missing } else { Value::Number(f64::from(v) / 8.0) };
                    Sample { signal, t_ns, value, quality: (how == 2).then_some(0x8000_0000) }
                };
                samples.extend([number(Signal::Op, op), number(Signal::Pv, pv)]);
                samples.extend(sp.map(|sp| number(Signal::Sp, sp)));
                let mode = [None, Some(Value::Mode(Mode::Auto)), Some(Value::Missing)][usize::from(mode)];
                samples.extend(mode.map(|value| Sample { signal: Signal::Mode, t_ns, value, quality: None }));
            }
            LoadedLoop { units: [op_unit, pv_unit], ..LoadedLoop::new("FIC101", samples) }
        })
    }

    /// What a judgement sees: values that are not bad, by time and signal.
    fn seen(one: &LoadedLoop) -> Vec<(i64, Signal, Value)> {
        let mut seen: Vec<_> = one.judged(Quality::Ua).samples.iter().map(|s| (s.t_ns, s.signal, s.value)).collect();
        seen.sort_by_key(|(t_ns, signal, _)| (*t_ns, *signal));
        seen
    }

    /// What is judged: the records behind the documents.
    fn judged(one: &LoadedLoop) -> Option<Vec<Record>> {
        let config = stiction_engine::config::Config::with_prefix("p");
        let (found, _) = Points::of("FIC101", &one.judged(Quality::Ua).samples, &config).judgeable().ok()?;
        Some([vec![found.record], found.windows].concat())
    }

    #[derive(Debug, Clone, Copy)]
    enum Format {
        Table,
        Recording,
        Store,
        #[cfg(feature = "parquet")]
        Parquet,
    }

    impl Format {
        #[cfg(feature = "parquet")]
        const ALL: [Self; 4] = [Self::Table, Self::Recording, Self::Store, Self::Parquet];
        #[cfg(not(feature = "parquet"))]
        const ALL: [Self; 3] = [Self::Table, Self::Recording, Self::Store];

        /// The loop as a file of this format gives it back; values of bad quality go as `convert` writes them.
        fn carry(self, one: &LoadedLoop) -> LoadedLoop {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("FIC101");
            let one = &one.judged(Quality::Ua);
            match self {
                Self::Table => csv::write(one, &mut std::fs::File::create(&path).unwrap()).map(drop).unwrap(),
                Self::Recording => {
                    let bytes = loops_as_recording("p", ["t", "x"], std::slice::from_ref(one)).unwrap();
                    std::fs::write(&path, bytes).unwrap();
                }
                Self::Store => {
                    let store = [CompactLoop::of(one, None).unwrap()];
                    compact::write(&mut std::fs::File::create(&path).unwrap(), &store, true).unwrap();
                }
                #[cfg(feature = "parquet")]
                Self::Parquet => {
                    crate::partition::write(one, dir.path(), false).unwrap();
                    let units = crate::inputs::units(&[dir.path().to_owned()], &crate::ReadOptions::default()).unwrap();
                    return units[0]
                        .load(&crate::ReadOptions::default())
                        .unwrap_or_else(|e| panic!("{e}"))
                        .loops
                        .remove(0);
                }
            }
            load_samples(&path).unwrap_or_else(|e| panic!("{e}")).loops.remove(0)
        }
    }

    #[test]
    #[cfg(feature = "parquet")]
    fn a_signal_that_is_missing_throughout_stays_one() {
        let missing = |t_ns| Sample { signal: Signal::Op, t_ns, value: Value::Missing, quality: None };
        let number = |t_ns| Sample { signal: Signal::Pv, t_ns, value: Value::Number(1.5), quality: None };
        let at = |k: i64| 1_781_510_400_000_000_000 + k * 1_000_000_000;
        let one = LoadedLoop::new("FIC101", (0..5).flat_map(|k| [missing(at(k)), number(at(k))]).collect());
        for format in Format::ALL {
            assert_eq!(seen(&format.carry(&one)), seen(&one), "{format:?}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn every_pair_of_formats_carries_the_same_there_and_back(one in loops()) {
            let formats = Format::ALL;
            for (first, second) in formats.iter().flat_map(|a| formats.iter().map(move |b| (a, b))) {
                let there = first.carry(&one);
                let back = second.carry(&there);
                for (found, by) in [(&there, format!("{first:?}")), (&back, format!("{first:?} and {second:?}"))] {
                    prop_assert_eq!(seen(found), seen(&one), "{}", by);
                    prop_assert_eq!(&found.units, &one.units, "{}", by);
                    prop_assert_eq!(judged(found), judged(&one), "{}", by);
                }
            }
        }
    }
}
