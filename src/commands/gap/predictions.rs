//! `--predictions`: measured and simulated PV, row by row.

use std::path::Path;

use stiction::core::units::format_seconds;
use stiction_engine::analysis::predictions::Row;

/// Writes the rows to a temporary file first, so that the output is complete or absent.
pub(super) fn write(path: &Path, rows: &[Row]) -> anyhow::Result<()> {
    let mut part = path.to_owned().into_os_string();
    part.push(".part");
    let mut file = csv::Writer::from_path(&part)?;
    file.write_record(["t", "pv", "pv_base", "pv_after", "held_out"])?;
    for row in rows {
        let [base, after] = match row.simulated {
            Some(both) => both.map(|v| v.to_string()),
            None => [String::new(), String::new()],
        };
        let held_out = u8::from(row.held_out).to_string();
        file.write_record([format_seconds(row.t_ns), row.pv.to_string(), base, after, held_out])?;
    }
    file.flush()?;
    drop(file);
    std::fs::rename(&part, path)?;
    Ok(())
}
