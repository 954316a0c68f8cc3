//! Options for reading files, shared by every command that takes foreign files; a one-line note on what was recognised;
//! the configuration of a recording; configuration, scenario and model files.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};

use crate::cli::{note, on_all_cores};
use crate::daemon::ConfigFile;
use stiction::core::gap::model_file::ModelFile;
use stiction::simulated::scenario::Scenario;
use stiction_engine::config::Config;
use stiction_files::export::{Codes, Decimal, Map, TimeFormat, Zone, delimiter, encoding};
use stiction_files::inputs::{Unit, units};
use stiction_files::run;
use stiction_files::{FileError, Loaded, ReadOptions};

/// Options for exports. What the file itself shows needs no option.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ReadArgs {
    /// Role of each tag or column: op=TAG,pv=TAG[,sp=TAG][,position=TAG][,mode=TAG][,t=COLUMN]. Columns by name or by number
    /// from 1; overrides roles recognised from names. Long tables also take tag=, value=, quality=.
    #[arg(long, value_name = "MAP", value_parser = Map::parse, help_heading = "Reading files")]
    pub map: Option<Map>,
    /// Time format: s, ms, us, ns, min, h, d (since 1970), excel, excel1904, datenum (days), ticks (.NET), filetime (Windows),
    /// ymd, dmy, mdy, or a pattern such as "%d/%m/%Y %H:%M:%S" [default: recognised from the file].
    #[arg(long, value_name = "FORM", value_parser = TimeFormat::parse, help_heading = "Reading files")]
    pub time_format: Option<TimeFormat>,
    /// Unit of times that are numbers: s, ms, us, ns, min, h or d.
    #[arg(long, value_name = "UNIT", value_parser = TimeFormat::unit, conflicts_with = "time_format", help_heading = "Reading files")]
    pub time_unit: Option<TimeFormat>,
    /// Time zone of timestamps without one: Europe/Berlin, UTC, +01:00. Needed only if the file does not show it.
    #[arg(long, value_name = "ZONE", value_parser = Zone::parse, allow_hyphen_values = true, help_heading = "Reading files")]
    pub tz: Option<Zone>,
    /// Decimal separator [default: recognised from the file].
    #[arg(long, value_enum, help_heading = "Reading files")]
    pub decimal: Option<Decimal>,
    /// Cell separator: one character, or tab [default: recognised from the file].
    #[arg(long, value_name = "CHAR", value_parser = delimiter, help_heading = "Reading files")]
    pub delimiter: Option<u8>,
    /// Text encoding, such as windows-1251 or shift_jis [default: recognised from the file].
    #[arg(long, value_name = "NAME", value_parser = encoding, help_heading = "Reading files")]
    pub encoding: Option<&'static encoding_rs::Encoding>,
    /// Sheet of a workbook [default: every sheet with a table].
    #[arg(long, value_name = "NAME", help_heading = "Reading files")]
    pub sheet: Option<String>,
    /// Meaning of the quality codes [default: recognised from the file].
    #[arg(long, value_enum, value_name = "CODES", help_heading = "Reading files")]
    pub quality: Option<Codes>,
    /// Words and numbers that stand for a missing value, separated by commas; none: every number is a value.
    #[arg(
        long,
        value_name = "WORDS",
        value_delimiter = ',',
        allow_hyphen_values = true,
        help_heading = "Reading files"
    )]
    pub missing: Vec<String>,
}

impl ReadArgs {
    /// The same as library options.
    #[must_use]
    pub fn options(&self) -> ReadOptions {
        ReadOptions {
            map: self.map.clone(),
            time_format: self.time_format.clone().or_else(|| self.time_unit.clone()),
            zone: self.tz.clone(),
            decimal: self.decimal,
            delimiter: self.delimiter,
            encoding: self.encoding,
            sheet: self.sheet.clone(),
            codes: self.quality,
            missing: self.missing.clone(),
        }
    }

    /// The input units that the paths and patterns of a command line name.
    ///
    /// # Errors
    /// A path or pattern matches no file.
    pub fn units(&self, words: &[PathBuf]) -> Result<Vec<Unit>, FileError> {
        units(words, &self.options())
    }

    /// Reads one unit and notes on stderr what was recognised.
    ///
    /// # Errors
    /// As [`Unit::load`].
    pub fn load(&self, unit: &Unit) -> Result<Loaded, FileError> {
        let loaded = unit.load(&self.options())?;
        tell(&unit.name(), &loaded);
        Ok(loaded)
    }

    /// Reads one file and notes on stderr what was recognised.
    ///
    /// # Errors
    /// As [`Unit::load`].
    pub fn load_file(&self, path: &Path) -> Result<Loaded, FileError> {
        self.load(&Unit { paths: vec![path.to_owned()] })
    }

    /// Reads all paths as one input. Among several files, one that cannot be read gives a warning.
    ///
    /// # Errors
    /// No file can be read.
    pub fn load_all(&self, words: &[PathBuf]) -> anyhow::Result<Loaded> {
        let units = self.units(words)?;
        if let [one] = &units[..] {
            return Ok(self.load(one)?);
        }
        let read = on_all_cores(&units, Unit::name, |unit| self.load(unit));
        let (all, faults) = Loaded::join(units.iter().map(Unit::name).zip(read));
        faults.iter().for_each(crate::cli::warn);
        let first = faults.into_iter().next();
        all.ok_or_else(|| first.map_or_else(|| anyhow!("no file was given"), anyhow::Error::from))
    }
}

/// The configuration that a file was recorded with; defaults for foreign files and for several files.
pub fn config_of(paths: &[PathBuf]) -> anyhow::Result<Config> {
    match paths {
        [path] => run::config_of(path),
        _ => Ok(Config::with_prefix("plant")),
    }
}

/// Reads a configuration file; returns its text too.
pub fn config_file(path: &Path) -> anyhow::Result<(String, Config)> {
    let (config, text) = ConfigFile { path: path.to_owned(), id: None, shard: None }.read()?;
    Ok((text, config))
}

/// Reads a scenario file; returns its text too.
pub fn scenario_file(path: &Path) -> anyhow::Result<(String, Scenario)> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let scenario = Scenario::parse(&text).map_err(|e| anyhow!("{}: {e}", path.display()))?;
    Ok((text, scenario))
}

/// Reads a model file.
pub fn model_file(path: &Path) -> anyhow::Result<ModelFile> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    ModelFile::parse(&text).with_context(|| path.display().to_string())
}

/// A short name for the input.
#[must_use]
pub fn named(words: &[PathBuf]) -> String {
    match words {
        [] => String::new(),
        [one] => one.display().to_string(),
        [first, rest @ ..] => format!("{} and {} more", first.display(), rest.len()),
    }
}

/// Notes in one line what was recognised in an export.
fn tell(name: &str, loaded: &Loaded) {
    if let Some(found) = &loaded.recognised {
        let loops = match &loaded.loops[..] {
            [one] => format!("loop {}", one.name),
            all => format!("{} loops", all.len()),
        };
        note(format_args!("{name}: read as {found}; {loops}"));
    }
}
