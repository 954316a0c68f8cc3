//! Other loops for a diagnosis: from separate files, or from the input.

use std::path::PathBuf;

use anyhow::anyhow;

use crate::cli::reading::{ReadArgs, config_of};
use crate::cli::selection::points;
use stiction::core::gap::Neighbour;
use stiction::core::record::Record;
use stiction_engine::analysis::gap::neighbour;
use stiction_engine::config::Config;
use stiction_files::LoadedLoop;

/// Which loops are offered.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct NeighbourArgs {
    /// Files or folders of other loops, each of which may drive this one: their PV and OP are offered as loads. Their
    /// clocks must agree; sampling times may differ.
    #[arg(long, value_name = "FILES", num_args = 1.., help_heading = "Other loops")]
    neighbours: Vec<PathBuf>,
    /// Offer the other loops of the input, too.
    #[arg(long, help_heading = "Other loops")]
    other_loops: bool,
}

/// The loops offered as neighbours.
pub(super) struct Neighbours {
    loops: Vec<LoadedLoop>,
    config: Config,
    /// Whether the loops come from files that the user named.
    named: bool,
}

impl NeighbourArgs {
    /// Reads them; `input` are the input's loops.
    ///
    /// # Errors
    /// A file cannot be read or has no loop.
    pub(super) fn read(&self, reading: &ReadArgs, input: &[LoadedLoop]) -> anyhow::Result<Neighbours> {
        let mut loops = Vec::new();
        let mut config = Config::with_prefix("plant");
        if !self.neighbours.is_empty() {
            let loaded = reading.load_all(&self.neighbours)?;
            for warning in &loaded.warnings {
                tracing::warn!("{warning}");
            }
            if loaded.loops.is_empty() {
                return Err(anyhow!("--neighbours: no loop found; a loop needs an OP and a PV"));
            }
            config = config_of(&self.neighbours)?;
            loops.extend(loaded.loops);
        }
        let named = !self.other_loops && self.neighbours.iter().all(|path| path.is_file());
        if self.other_loops {
            loops.extend(input.iter().cloned());
        }
        Ok(Neighbours { loops, config, named })
    }
}

impl Neighbours {
    /// All loops except `name`, on the grid of its record.
    ///
    /// # Errors
    /// A loop from a file that the user named cannot be offered; others are left out with a warning.
    pub(super) fn beside(&self, name: &str, record: &Record) -> anyhow::Result<Vec<Neighbour>> {
        let mut out: Vec<Neighbour> = Vec::new();
        for other in self.loops.iter().filter(|other| other.name != name) {
            if out.iter().any(|known| known.name == other.name) {
                continue;
            }
            match neighbour(&points(other, &self.config), record) {
                Ok(made) => out.push(made),
                Err(error) if self.named => return Err(anyhow!("{error}")),
                Err(error) => tracing::warn!("{error}"),
            }
        }
        Ok(out)
    }
}
