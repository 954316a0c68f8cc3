//! `--base`: the model that the gap is measured from.

use std::path::Path;

use anyhow::Context;

use stiction::gap::model_file::ModelFile;
use stiction_monitor::analysis::gap::BaseChoice;

/// Reads the word or the file.
pub(super) fn read(text: &str) -> anyhow::Result<BaseChoice> {
    if text == "linear" {
        return Ok(BaseChoice::Linear);
    }
    Ok(BaseChoice::File(Box::new(model_file(Path::new(text))?)))
}

/// Reads a model's file.
pub(in crate::cli) fn model_file(path: &Path) -> anyhow::Result<ModelFile> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    ModelFile::parse(&text).with_context(|| path.display().to_string())
}
