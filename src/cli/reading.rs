//! How files are read: the same options for every command that takes a file of others, one line on what was found, the
//! configuration of a recording, a model's file.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};

use super::{note, on_all_cores};
use stiction::gap::model_file::ModelFile;
use stiction_monitor::config::Config;
use stictiond::daemon::replay;
use stictiond::files::export::{Codes, Decimal, Map, TimeFormat, Zone, delimiter, encoding};
use stictiond::files::inputs::{Unit, units};
use stictiond::files::{FileError, Loaded, ReadOptions};

/// Options for exports; everything that the files show needs none.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ReadArgs {
    /// Which tag or column is what: op=TAG,pv=TAG[,sp=TAG][,mv=TAG][,mode=TAG][,t=COLUMN]; columns by name, or counted
    /// from 1. Overrules what names show. In long tables also tag=, value=, quality=.
    #[arg(long, value_name = "MAP", value_parser = Map::parse, help_heading = "How files are read")]
    pub map: Option<Map>,
    /// How times are written: s, ms, us, ns (since 1970), excel, excel1904, datenum (days), ymd, dmy, mdy, or a
    /// pattern such as "%d/%m/%Y %H:%M:%S".
    #[arg(long, value_name = "FORM", value_parser = TimeFormat::parse, help_heading = "How files are read")]
    pub time_format: Option<TimeFormat>,
    /// Whose clock times without a zone are: Europe/Berlin, UTC, +01:00.
    #[arg(long, value_name = "ZONE", value_parser = Zone::parse, allow_hyphen_values = true, help_heading = "How files are read")]
    pub tz: Option<Zone>,
    /// What parts a number's whole from its fraction.
    #[arg(long, value_enum, help_heading = "How files are read")]
    pub decimal: Option<Decimal>,
    /// What parts cells: one character, or tab.
    #[arg(long, value_name = "CHAR", value_parser = delimiter, help_heading = "How files are read")]
    pub delimiter: Option<u8>,
    /// The text's encoding, such as windows-1251 or shift_jis.
    #[arg(long, value_name = "NAME", value_parser = encoding, help_heading = "How files are read")]
    pub encoding: Option<&'static encoding_rs::Encoding>,
    /// The sheet of a workbook; otherwise every sheet that holds a table.
    #[arg(long, value_name = "NAME", help_heading = "How files are read")]
    pub sheet: Option<String>,
    /// What quality codes mean.
    #[arg(long, value_enum, value_name = "CODES", help_heading = "How files are read")]
    pub quality: Option<Codes>,
}

impl ReadArgs {
    /// As files are read by.
    #[must_use]
    pub fn options(&self) -> ReadOptions {
        ReadOptions {
            map: self.map.clone(),
            time_format: self.time_format.clone(),
            zone: self.tz.clone(),
            decimal: self.decimal,
            delimiter: self.delimiter,
            encoding: self.encoding,
            sheet: self.sheet.clone(),
            codes: self.quality,
        }
    }

    /// What the words of a command line stand for.
    ///
    /// # Errors
    /// A word stands for no file.
    pub fn units(&self, words: &[PathBuf]) -> Result<Vec<Unit>, FileError> {
        units(words, &self.options())
    }

    /// Reads one unit and says what was recognised.
    ///
    /// # Errors
    /// As [`Unit::load`].
    pub fn load(&self, unit: &Unit) -> Result<Loaded, FileError> {
        let loaded = unit.load(&self.options())?;
        tell(&unit.name(), &loaded);
        Ok(loaded)
    }

    /// Reads one file and says what was recognised.
    ///
    /// # Errors
    /// As [`Unit::load`].
    pub fn load_file(&self, path: &Path) -> Result<Loaded, FileError> {
        self.load(&Unit { paths: vec![path.to_owned()] })
    }

    /// Reads everything that the words stand for as one: what cannot be read among several files is a warning.
    ///
    /// # Errors
    /// Nothing can be read.
    pub fn load_all(&self, words: &[PathBuf]) -> anyhow::Result<Loaded> {
        let units = self.units(words)?;
        if let [one] = &units[..] {
            return Ok(self.load(one)?);
        }
        let read = on_all_cores(&units, Unit::name, |unit| self.load(unit));
        let mut all: Option<Loaded> = None;
        let mut first = None;
        for (unit, loaded) in units.iter().zip(read) {
            match (loaded, &mut all) {
                (Ok(loaded), None) => all = Some(loaded),
                (Ok(mut loaded), Some(all)) => {
                    let place = |w: &String| format!("{}: {w}", unit.name());
                    all.loops.append(&mut loaded.loops);
                    all.warnings.extend(loaded.warnings.iter().map(place));
                    all.data_loss |= loaded.data_loss;
                }
                (Err(error), _) => {
                    super::warn(&error);
                    first.get_or_insert(error);
                }
            }
        }
        all.ok_or_else(|| first.map_or_else(|| anyhow!("no file was given"), anyhow::Error::from))
    }
}

/// The configuration that a file was recorded under; the defaults for files of others and for several files.
pub(super) fn config_of(paths: &[PathBuf]) -> anyhow::Result<Config> {
    match paths {
        [path] => replay::config_of(path),
        _ => Ok(Config::with_prefix("plant")),
    }
}

/// Reads a model's file.
pub(super) fn model_file(path: &Path) -> anyhow::Result<ModelFile> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    ModelFile::parse(&text).with_context(|| path.display().to_string())
}

/// What was given, in a few words.
#[must_use]
pub fn named(words: &[PathBuf]) -> String {
    match words {
        [] => String::new(),
        [one] => one.display().to_string(),
        [first, rest @ ..] => format!("{} and {} more", first.display(), rest.len()),
    }
}

/// Says in one line what was recognised in an export.
fn tell(name: &str, loaded: &Loaded) {
    if let Some(found) = &loaded.recognised {
        let loops = match &loaded.loops[..] {
            [one] => format!("loop {}", one.name),
            all => format!("{} loops", all.len()),
        };
        note(format_args!("{name}: read as {found}; {loops}"));
    }
}
