//! Options of the file reader and their words, as flags of commands and in the page's queries.

use encoding_rs::Encoding;

use super::{Codes, Decimal, Map, TimeFormat, Zone};

/// Options of the file reader.
#[derive(Debug, Clone, Default)]
pub struct ReadOptions {
    /// Roles of tags or columns.
    pub map: Option<Map>,
    /// Time format.
    pub time_format: Option<TimeFormat>,
    /// Zone of timestamps without one.
    pub zone: Option<Zone>,
    /// Decimal separator.
    pub decimal: Option<Decimal>,
    /// Cell separator.
    pub delimiter: Option<u8>,
    /// Text encoding.
    pub encoding: Option<&'static Encoding>,
    /// The sheet of a workbook.
    pub sheet: Option<String>,
    /// Meaning of quality codes.
    pub codes: Option<Codes>,
    /// Words and numbers that stand for a missing value; `none` says that all numbers count.
    pub missing: Vec<String>,
}

impl ReadOptions {
    /// Sets one option by its flag's name without dashes, with `-` or `_` inside, such as `time_format`.
    ///
    /// # Errors
    /// A sentence: no such option, or an invalid value.
    pub fn set(&mut self, name: &str, value: &str) -> Result<(), String> {
        match name.replace('-', "_").as_str() {
            "map" => self.map = Some(Map::parse(value)?),
            "time_format" => self.time_format = Some(TimeFormat::parse(value)?),
            "time_unit" => self.time_format = Some(TimeFormat::unit(value)?),
            "missing" => self.missing = value.split(',').map(|word| word.trim().to_owned()).collect(),
            "tz" => self.zone = Some(Zone::parse(value)?),
            "decimal" => self.decimal = Some(one_of(value)?),
            "delimiter" => self.delimiter = Some(delimiter(value)?),
            "encoding" => self.encoding = Some(encoding(value)?),
            "sheet" => self.sheet = Some(value.to_owned()),
            "quality" => self.codes = Some(one_of(value)?),
            _ => return Err(format!("{name:?} is not an option for reading files")),
        }
        Ok(())
    }

    /// Whether a table `t,op,pv` is read differently from its own header.
    pub(super) fn overrules(&self) -> bool {
        self.map.is_some() || self.time_format.is_some() || self.decimal.is_some() || self.delimiter.is_some()
    }
}

fn one_of<T: clap::ValueEnum>(value: &str) -> Result<T, String> {
    let names = || T::value_variants().iter().filter_map(|v| v.to_possible_value().map(|v| v.get_name().to_owned()));
    T::from_str(value, false)
        .map_err(|_| format!("{value:?} is not a valid value; write one of {}", names().collect::<Vec<_>>().join(", ")))
}

/// A cell separator: one character, or `tab`.
///
/// # Errors
/// A sentence that says what is valid.
pub fn delimiter(text: &str) -> Result<u8, String> {
    match text.as_bytes() {
        b"tab" | b"\\t" => Ok(b'\t'),
        [one] if one.is_ascii() && *one != b'"' && *one != b'\n' => Ok(*one),
        _ => Err(format!("{text:?} is not a cell separator; write one character such as ; or |, or tab")),
    }
}

/// An encoding by its name.
///
/// # Errors
/// A sentence that says what is valid.
pub fn encoding(text: &str) -> Result<&'static Encoding, String> {
    Encoding::for_label(text.as_bytes())
        .ok_or_else(|| format!("{text:?} is not an encoding; write a name such as utf-16le, windows-1251 or shift_jis"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_read_or_refused_with_a_reason() {
        let mut options = ReadOptions::default();
        for (name, value) in
            [("tz", "UTC"), ("time-format", "dmy"), ("delimiter", "tab"), ("decimal", "comma"), ("encoding", "latin1")]
        {
            options.set(name, value).unwrap();
        }
        assert_eq!((options.delimiter, options.decimal), (Some(b'\t'), Some(Decimal::Comma)));
        assert!(options.overrules() && options.zone.is_some() && options.encoding.is_some());
        let mut refused = |name: &str, value: &str| options.set(name, value).unwrap_err();
        assert!(refused("decimal", "dot").contains("point, comma"));
        assert!(refused("delimiter", "ab").contains("tab") && refused("delimiter", "\"").contains("tab"));
        assert!(refused("encoding", "klingon").contains("utf-16le"));
        assert!(refused("speed", "1").contains("not an option"));
    }
}
