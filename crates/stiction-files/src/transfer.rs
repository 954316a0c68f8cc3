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
    use stiction::core::record::{Sample, Signal, Value};

    #[test]
    fn a_recording_in_memory_is_the_one_that_a_file_would_be() {
        let sample = |k: i64| Sample { signal: Signal::Pv, t_ns: k, value: Value::Number(k as f64), quality: None };
        let loops = [LoadedLoop::new("FIC101", (1..2000).map(sample).collect())];
        let dir = tempfile::tempdir().unwrap();
        let [part, target] = ["a.part", "a.mcap"].map(|name| dir.path().join(name));
        assert_eq!(write_loops([&part, &target], "p", ["page", "x"], &loops).unwrap(), 1999);
        assert_eq!(loops_as_recording("p", ["page", "x"], &loops).unwrap(), std::fs::read(&target).unwrap());
    }
}
