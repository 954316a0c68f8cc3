//! What the reader of a file is told about it, and the words that say so: flags of commands, the page's query.

use encoding_rs::Encoding;

use super::{Codes, Decimal, Map, TimeFormat, Zone};

/// What the reader of a file was told about it.
#[derive(Debug, Clone, Default)]
pub struct ReadOptions {
    /// Which tags or columns are what.
    pub map: Option<Map>,
    /// How times are written.
    pub time_format: Option<TimeFormat>,
    /// Whose clock times without a zone are.
    pub zone: Option<Zone>,
    /// Decimal point or comma.
    pub decimal: Option<Decimal>,
    /// What parts cells.
    pub delimiter: Option<u8>,
    /// The text's encoding.
    pub encoding: Option<&'static Encoding>,
    /// The sheet of a workbook.
    pub sheet: Option<String>,
    /// What quality codes mean.
    pub codes: Option<Codes>,
}

impl ReadOptions {
    /// Takes one option by its flag's name without dashes, `-` or `_` inside, such as `time_format`.
    ///
    /// # Errors
    /// A sentence: no such option, or a value that is not understood.
    pub fn set(&mut self, name: &str, value: &str) -> Result<(), String> {
        match name.replace('-', "_").as_str() {
            "map" => self.map = Some(Map::parse(value)?),
            "time_format" => self.time_format = Some(TimeFormat::parse(value)?),
            "tz" => self.zone = Some(Zone::parse(value)?),
            "decimal" => self.decimal = Some(one_of(value)?),
            "delimiter" => self.delimiter = Some(delimiter(value)?),
            "encoding" => self.encoding = Some(encoding(value)?),
            "sheet" => self.sheet = Some(value.to_owned()),
            "quality" => self.codes = Some(one_of(value)?),
            _ => return Err(format!("{name:?} is no option for reading files")),
        }
        Ok(())
    }

    /// Whether a table `t,op,pv` is read otherwise than it says of itself.
    pub(super) fn overrules(&self) -> bool {
        self.map.is_some() || self.time_format.is_some() || self.decimal.is_some() || self.delimiter.is_some()
    }
}

fn one_of<T: clap::ValueEnum>(value: &str) -> Result<T, String> {
    let names = || T::value_variants().iter().filter_map(|v| v.to_possible_value().map(|v| v.get_name().to_owned()));
    T::from_str(value, false)
        .map_err(|_| format!("{value:?} is not known; write one of {}", names().collect::<Vec<_>>().join(", ")))
}

/// What parts cells: one character, or `tab`.
///
/// # Errors
/// A sentence that says what would be understood.
pub fn delimiter(text: &str) -> Result<u8, String> {
    match text.as_bytes() {
        b"tab" | b"\\t" => Ok(b'\t'),
        [one] if one.is_ascii() && *one != b'"' && *one != b'\n' => Ok(*one),
        _ => Err(format!("{text:?} is no delimiter: write one character such as ; or |, or tab")),
    }
}

/// An encoding by its name.
///
/// # Errors
/// A sentence that says what would be understood.
pub fn encoding(text: &str) -> Result<&'static Encoding, String> {
    Encoding::for_label(text.as_bytes())
        .ok_or_else(|| format!("{text:?} is no encoding: write a name such as utf-16le, windows-1251 or shift_jis"))
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
        assert!(refused("speed", "1").contains("no option"));
    }
}
