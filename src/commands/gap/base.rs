//! `--base`: the model that the gap is measured from.

use std::path::Path;

use crate::cli::reading::model_file;
use stiction_engine::analysis::gap::BaseChoice;

/// Reads the word or the file.
pub(super) fn read(text: &str) -> anyhow::Result<BaseChoice> {
    if text == "linear" {
        return Ok(BaseChoice::Linear);
    }
    Ok(BaseChoice::File(Box::new(model_file(Path::new(text))?)))
}
