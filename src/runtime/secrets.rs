//! Secrets and certificates, read from the files that options and settings name.

use anyhow::Context;

/// The text in a secret's file, without the newline at the end; `None` if no file is named.
///
/// # Errors
/// The file cannot be read.
pub fn secret(path: &str) -> anyhow::Result<Option<String>> {
    if path.is_empty() {
        return Ok(None);
    }
    let text = std::fs::read_to_string(path).with_context(|| format!("secret_file {path}"))?;
    Ok(Some(text.trim_end_matches(['\r', '\n']).to_owned()))
}

/// The bytes of a PEM file; `None` if no file is named.
///
/// # Errors
/// The file cannot be read; `key` names it.
pub fn pem(key: &str, path: &str) -> anyhow::Result<Option<Vec<u8>>> {
    if path.is_empty() {
        return Ok(None);
    }
    std::fs::read(path).map(Some).with_context(|| format!("{key} {path}"))
}
