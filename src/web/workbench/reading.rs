//! Options for reading an export, as on the command line, and the parameters of an upload.

use serde::Serialize;

use super::fault::Fault;
use super::names;
use stiction_files::ReadOptions;

/// Names of the reading options in URLs; on the command line `_` becomes `-`.
pub const OPTIONS: [&str; 8] = ["map", "time_format", "tz", "decimal", "delimiter", "encoding", "sheet", "quality"];

/// Longest value of an option, bytes.
const LONGEST: usize = 2_000;

/// Reading options as typed: `("tz", "UTC")`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ReadingWords(Vec<(&'static str, String)>);

impl ReadingWords {
    /// Sets one option. An empty value counts as absent.
    ///
    /// # Errors
    /// The option does not exist, occurs twice, or is too long.
    pub fn set(&mut self, name: &str, value: &str) -> Result<(), Fault> {
        let known = OPTIONS.into_iter().find(|known| *known == name);
        let known = known.ok_or_else(|| {
            Fault::wrong(format!("{:?} is not an option; use name, {}", names::shown(name), OPTIONS.join(", ")))
        })?;
        if value.len() > LONGEST {
            return Err(Fault::wrong(format!("{name} is longer than {LONGEST} bytes")));
        }
        if self.0.iter().any(|(there, _)| *there == known) {
            return Err(Fault::wrong(format!("{name} is given twice")));
        }
        if !value.trim().is_empty() {
            self.0.push((known, value.to_owned()));
        }
        Ok(())
    }

    /// The options as command-line arguments.
    #[must_use]
    pub fn arguments(&self) -> Vec<String> {
        // With `=`, since a value may begin with a dash.
        self.0.iter().map(|(name, value)| format!("--{}={value}", name.replace('_', "-"))).collect()
    }

    /// The options in the form that readers take.
    ///
    /// # Errors
    /// Names the invalid value, and what is valid.
    pub fn options(&self) -> Result<ReadOptions, Fault> {
        let mut options = ReadOptions::default();
        for (name, value) in &self.0 {
            options.set(name, value).map_err(|why| Fault::wrong(format!("{name}: {why}")))?;
        }
        Ok(options)
    }
}

impl Serialize for ReadingWords {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(name, value)| (name, value)))
    }
}

/// Query parameters of an upload.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Upload {
    /// Name of the file.
    pub name: String,
    /// How to read it.
    pub reading: ReadingWords,
}

impl Upload {
    /// Reads `name=FILE[&tz=…&map=…]`, percent-encoded. Bytes that are not UTF-8 become U+FFFD.
    ///
    /// # Errors
    /// A part is not understood.
    pub fn read(query: &str) -> Result<Self, Fault> {
        let (mut name, mut reading) = (None, ReadingWords::default());
        for (key, value) in form_urlencoded::parse(query.as_bytes()) {
            if key != "name" {
                reading.set(&key, &value)?;
            } else if name.replace(names::shown(&value)).is_some() {
                return Err(Fault::wrong("name is given twice"));
            }
        }
        let name = name.ok_or_else(|| Fault::wrong("give the file name: ?name=FIC101.csv"))?;
        Ok(Self { name, reading })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn encoded(text: &str) -> String {
        text.bytes().map(|byte| format!("%{byte:02X}")).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        #[test]
        fn what_is_sent_is_what_is_read(name in "\\PC{0,80}", values in prop::collection::vec(".{0,60}", OPTIONS.len()), mask in 0_u32..256) {
            let given: Vec<(&str, &String)> =
                OPTIONS.into_iter().zip(&values).enumerate().filter(|(k, _)| mask >> k & 1 == 1).map(|(_, pair)| pair).collect();
            let query: String = given.iter().map(|(key, value)| format!("&{key}={}", encoded(value))).collect();
            let read = Upload::read(&format!("name={}{query}", encoded(&name))).unwrap();
            prop_assert_eq!(&read.name, &names::shown(&name));
            let wanted: Vec<String> = given.iter().filter(|(_, value)| !value.trim().is_empty())
                .map(|(key, value)| format!("--{}={value}", key.replace('_', "-"))).collect();
            prop_assert_eq!(read.reading.arguments(), wanted);
        }

        #[test]
        fn nothing_in_an_address_does_harm(query in "\\PC{0,200}", bytes in prop::collection::vec(any::<u8>(), 0..60)) {
            let hostile: String = bytes.iter().map(|byte| format!("%{byte:02x}")).collect();
            for text in [query.clone(), format!("name={hostile}"), format!("name=a&{hostile}={query}"), format!("name=%{query}")] {
                if let Ok(read) = Upload::read(&text) {
                    prop_assert!(!read.name.contains(['/', '\\', '\0']) && !read.name.starts_with(['.', '-']));
                    drop(read.reading.options());
                }
            }
        }
    }

    #[test]
    fn options_are_read_or_refused_with_a_reason() {
        let read = Upload::read("name=a%20b.csv&tz=Europe%2FBerlin&decimal=").unwrap();
        assert_eq!((read.name.as_str(), read.reading.arguments()), ("a b.csv", vec!["--tz=Europe/Berlin".to_owned()]));
        assert!(read.reading.options().is_ok());
        for (query, part) in [("", "?name="), ("name=a&name=b", "twice"), ("name=a&speed=1", "is not an option")] {
            let refused = Upload::read(query).unwrap_err();
            assert!(refused.text().contains(part), "{query}: {refused}");
        }
        let wrong = Upload::read("name=a&decimal=dot").unwrap().reading.options().unwrap_err();
        assert!(wrong.text().starts_with("decimal: "), "{wrong}");
    }
}
