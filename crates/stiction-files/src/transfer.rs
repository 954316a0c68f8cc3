//! Writes loops of any source as a recording.

use std::collections::BTreeMap;
use std::path::Path;

use super::{LoadedLoop, METADATA_PREFIX, RecordingFile, WriteError};
use stiction_core::units::{is_loop_name, loop_name_from};
use stiction_monitor::codec::topic;

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
    let metadata = BTreeMap::from(
        [("origin", origin), (METADATA_PREFIX, prefix), ("source", source), ("version", stiction_core::VERSION)]
            .map(|(key, value)| (key.to_owned(), value.to_owned())),
    );
    let mut file = RecordingFile::create_at(part.to_owned(), target.to_owned(), &metadata)?;
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
