//! `--base`: the model that the gap is measured from.

use std::path::Path;

use crate::cli::reading::model_file;
use stiction::gap::Base;
use stiction::gap::model_file::ModelFile;
use stiction::record::Record;

/// `--base`, read.
pub(super) enum BaseArg {
    /// Without friction.
    Linear,
    /// A model from a file.
    File(ModelFile),
}

impl BaseArg {
    /// Reads the word or the file.
    pub fn read(text: &str) -> anyhow::Result<Self> {
        if text == "linear" {
            return Ok(Self::Linear);
        }
        Ok(Self::File(model_file(Path::new(text))?))
    }

    /// The base for a record.
    pub fn on(&self, record: &Record) -> Base {
        match self {
            Self::Linear => Base::Linear,
            Self::File(file) => Base::Given(Box::new(file.on(record))),
        }
    }
}
