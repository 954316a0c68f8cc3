//! Reads a TOML table key by key and collects every fault with its line, instead of stopping at the first.

use std::fmt;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A fault in a configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// Line in the text, from 1.
    pub line: usize,
    /// Dotted key; empty for syntax errors.
    pub key: String,
    /// What is wrong.
    pub message: String,
    /// What to write instead.
    pub remedy: String,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: ", self.line)?;
        if !self.key.is_empty() {
            write!(f, "{}: ", self.key)?;
        }
        write!(f, "{}", self.message)?;
        if self.remedy.is_empty() { Ok(()) } else { write!(f, "; {}", self.remedy) }
    }
}

/// Line starts of a text: a configuration may have a hundred thousand tables, each of which looks up its line.
pub(crate) struct Lines(Vec<usize>);

impl Lines {
    /// The line starts of a text.
    pub fn new(text: &str) -> Self {
        Self(text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at).collect())
    }

    /// Line (from 1) at a byte offset.
    pub fn of(&self, offset: usize) -> usize {
        self.0.partition_point(|end| *end < offset) + 1
    }
}

/// The fault for a text that is not TOML.
pub(crate) fn syntax_fault(lines: &Lines, error: &toml::de::Error) -> Fault {
    let line = error.span().map_or(1, |s| lines.of(s.start));
    Fault { line, key: String::new(), message: error.message().trim().replace('\n', ", "), remedy: String::new() }
}

/// Keys that were renamed before the first release.
const RENAMED: [(&str, &str); 1] = [("mv", "position")];

/// Finds the lines of keys in a text that was parsed before.
pub struct Places<'t> {
    lines: Lines,
    root: Option<Spanned<DeTable<'t>>>,
}

impl<'t> Places<'t> {
    /// The keys of a TOML text; none if it is not TOML.
    #[must_use]
    pub fn of(text: &'t str) -> Self {
        Self { lines: Lines::new(text), root: DeTable::parse(text).ok() }
    }

    /// The line of a key in its table, else of the table, else line 1.
    #[must_use]
    pub fn line_of(&self, section: &str, key: &str) -> usize {
        let Some(table) = self.root.as_ref().and_then(|root| root.get_ref().get(section)) else { return 1 };
        let value = table.get_ref().as_table().and_then(|table| table.get(key));
        self.lines.of(value.unwrap_or(table).span().start)
    }

    /// The line of the name of an entry of `[[section]]`, else line 1.
    #[must_use]
    pub fn line_of_entry(&self, section: &str, name: &str) -> usize {
        let entries = self.root.as_ref().and_then(|root| root.get_ref().get(section)?.get_ref().as_array());
        let names = entries.into_iter().flat_map(|a| a.iter()).filter_map(|e| e.get_ref().as_table()?.get("name"));
        let mut named = names.filter(|value| value.get_ref().as_str() == Some(name));
        named.next().map_or(1, |value| self.lines.of(value.span().start))
    }
}

/// A table being read: each requested key is known; any other is a fault when the table is closed.
pub(crate) struct TableReader<'a, 'i> {
    lines: &'a Lines,
    section: String,
    line: usize,
    table: Option<&'a DeTable<'i>>,
    known: Vec<&'static str>,
    faults: &'a mut Vec<Fault>,
}

impl<'a, 'i> TableReader<'a, 'i> {
    /// Opens a table; `None` gives all defaults.
    pub fn new(
        lines: &'a Lines,
        section: &str,
        line: usize,
        table: Option<&'a DeTable<'i>>,
        faults: &'a mut Vec<Fault>,
    ) -> Self {
        Self { lines, section: section.to_owned(), line, table, known: Vec::new(), faults }
    }

    fn dotted(&self, key: &str) -> String {
        if self.section.is_empty() { key.to_owned() } else { format!("{}.{key}", self.section) }
    }

    fn fault(&mut self, line: usize, key: &str, message: String, remedy: String) {
        let key = self.dotted(key);
        self.faults.push(Fault { line, key, message, remedy });
    }

    fn get(&mut self, key: &'static str) -> Option<(&'a DeValue<'i>, usize)> {
        self.known.push(key);
        let table = self.table?;
        let (_, value) = table.iter().find(|(k, _)| k.get_ref() == key)?;
        Some((value.get_ref(), self.lines.of(value.span().start)))
    }

    fn wrong_type(&mut self, line: usize, key: &str, found: &DeValue<'_>, wanted: &str) {
        let message = match not_finite(found) {
            Some(word) => format!("{word} is not allowed: a setting must be a finite number"),
            None => format!("is {} {}", article(found.type_str()), found.type_str()),
        };
        self.fault(line, key, message, format!("write {wanted}"));
    }

    /// The first of two names of one key, unless the table has only the second.
    pub fn either(&self, key: &'static str, older: &'static str) -> &'static str {
        let has = |key: &str| self.table.is_some_and(|table| table.iter().any(|(k, _)| k.get_ref() == key));
        if has(older) && !has(key) { older } else { key }
    }

    /// A finite number in `min..=max`.
    pub fn number(&mut self, key: &'static str, default: f64, min: f64, max: f64) -> f64 {
        let Some((value, line)) = self.get(key) else { return default };
        let Some(number) = number_of(value) else {
            self.wrong_type(line, key, value, &format!("a number from {min} to {max}"));
            return default;
        };
        if !(min..=max).contains(&number) {
            self.fault(line, key, format!("{number} is out of range"), format!("write a number from {min} to {max}"));
            return default;
        }
        number
    }

    /// An integer in `min..=max`.
    pub fn integer(&mut self, key: &'static str, default: u64, min: u64, max: u64) -> u64 {
        let Some((value, line)) = self.get(key) else { return default };
        let parsed = value.as_integer().and_then(|i| i64::from_str_radix(&i.as_str().replace('_', ""), i.radix()).ok());
        match parsed {
            Some(n) if u64::try_from(n).is_ok_and(|n| (min..=max).contains(&n)) => n as u64,
            Some(n) => {
                self.fault(
                    line,
                    key,
                    format!("{n} is out of range"),
                    format!("write a whole number from {min} to {max}"),
                );
                default
            }
            None => {
                self.wrong_type(line, key, value, "a whole number");
                default
            }
        }
    }

    /// True or false.
    pub fn boolean(&mut self, key: &'static str, default: bool) -> bool {
        let Some((value, line)) = self.get(key) else { return default };
        value.as_bool().unwrap_or_else(|| {
            self.wrong_type(line, key, value, "true or false");
            default
        })
    }

    /// Text; `None` if the key is absent.
    pub fn text(&mut self, key: &'static str) -> Option<(String, usize)> {
        self.text_or(key, "text in quotes")
    }

    /// Text; if the key has another type, `wanted` says what to write.
    pub fn text_or(&mut self, key: &'static str, wanted: &str) -> Option<(String, usize)> {
        let (value, line) = self.get(key)?;
        let Some(text) = value.as_str() else {
            self.wrong_type(line, key, value, wanted);
            return None;
        };
        self.printable(key, text, line).then(|| (text.to_owned(), line))
    }

    /// Whether a text has no control characters, which escapes in double quotes can produce.
    fn printable(&mut self, key: &'static str, text: &str, line: usize) -> bool {
        let Some(found) = text.chars().find(|c| c.is_control()) else { return true };
        let message = format!("{text:?} contains the control character {found:?}");
        self.fault(line, key, message, "write the text in single quotes, or each backslash twice".to_owned());
        false
    }

    /// One of several words; the default without the key.
    pub fn choice<T: Copy + Default>(&mut self, key: &'static str, choices: &[(&'static str, T)]) -> T {
        let Some((word, line)) = self.text(key) else { return T::default() };
        if let Some((_, chosen)) = choices.iter().find(|(one, _)| *one == word) {
            return *chosen;
        }
        let words: Vec<&str> = choices.iter().map(|(one, _)| *one).collect();
        let remedy = format!("write one of {}", words.join(", "));
        self.fault(line, key, format!("{word:?} is not a valid value"), remedy);
        T::default()
    }

    /// A list of texts, each with its line.
    pub fn texts(&mut self, key: &'static str) -> Vec<(String, usize)> {
        let Some((value, line)) = self.get(key) else { return Vec::new() };
        let lines = self.lines;
        let entry = |v: &Spanned<DeValue<'i>>| Some((v.get_ref().as_str()?.to_owned(), lines.of(v.span().start)));
        let list: Option<Vec<(String, usize)>> = value.as_array().and_then(|a| a.iter().map(entry).collect());
        let Some(mut list) = list else {
            self.wrong_type(line, key, value, "a list of texts, such as [\"tcp/127.0.0.1:7447\"]");
            return Vec::new();
        };
        list.retain(|(text, line)| self.printable(key, text, *line));
        list
    }

    /// Two numbers.
    pub fn pair(&mut self, key: &'static str, wanted: &str) -> Option<([f64; 2], usize)> {
        let (value, line) = self.get(key)?;
        let numbers: Option<Vec<f64>> =
            value.as_array().and_then(|a| a.iter().map(|v| number_of(v.get_ref())).collect());
        if let Some([a, b]) = numbers.as_deref() {
            return Some(([*a, *b], line));
        }
        self.wrong_type(line, key, value, wanted);
        None
    }

    /// A table from text to text.
    pub fn text_map(&mut self, key: &'static str) -> Vec<(String, String, usize)> {
        let Some((value, line)) = self.get(key) else { return Vec::new() };
        let Some(table) = value.as_table() else {
            self.wrong_type(line, key, value, "a table");
            return Vec::new();
        };
        let mut pairs = Vec::new();
        for (name, entry) in table.iter() {
            let line = self.lines.of(entry.span().start);
            if let Some(text) = entry.get_ref().as_str() {
                pairs.push((name.get_ref().to_string(), text.to_owned(), line));
            } else {
                self.wrong_type(line, key, entry.get_ref(), "text in quotes for each entry");
            }
        }
        pairs
    }

    /// Adds a fault at the line of a value.
    pub fn refuse(&mut self, line: usize, key: &str, message: impl Into<String>, remedy: impl Into<String>) {
        self.fault(line, key, message.into(), remedy.into());
    }

    /// Line of a key's value; `None` if the key is absent.
    pub fn line_of(&self, key: &str) -> Option<usize> {
        let (_, value) = self.table?.iter().find(|(k, _)| k.get_ref() == key)?;
        Some(self.lines.of(value.span().start))
    }

    /// Line of the table's header.
    pub fn line(&self) -> usize {
        self.line
    }

    /// Closes the table: every key that was not requested is a fault.
    pub fn close(mut self) {
        let Some(table) = self.table else { return };
        let unknown: Vec<(String, usize)> = table
            .iter()
            .filter(|(k, _)| !self.known.iter().any(|known| known == k.get_ref()))
            .map(|(k, _)| (k.get_ref().to_string(), self.lines.of(k.span().start)))
            .collect();
        for (key, line) in unknown {
            if let Some((_, new)) = RENAMED.iter().find(|(old, new)| *old == key && self.known.contains(new)) {
                self.fault(line, &key, format!("is called {new} now"), format!("write {new} = …"));
                continue;
            }
            let nearest = nearest(&key, &self.known);
            let remedy = nearest.map_or_else(
                || format!("valid keys: {}", self.known.join(", ")),
                |near| format!("did you mean {near}? valid keys: {}", self.known.join(", ")),
            );
            self.fault(line, &key, "unknown key".into(), remedy);
        }
    }
}

/// The table under a key, with the line of its value; a fault if the value is not a table.
pub(super) fn subtable<'a, 'i>(
    lines: &Lines,
    root: &'a DeTable<'i>,
    key: &str,
    faults: &mut Vec<Fault>,
) -> (Option<&'a DeTable<'i>>, usize) {
    let Some((_, value)) = root.iter().find(|(k, _)| k.get_ref() == key) else { return (None, 0) };
    let line = lines.of(value.span().start);
    let table = value.get_ref().as_table();
    if table.is_none() {
        faults.push(Fault {
            line,
            key: key.to_owned(),
            message: format!("is not a table but {}", value.get_ref().type_str()),
            remedy: format!("write [{key}] on a line of its own"),
        });
    }
    (table, line)
}

/// The tables of an array `[[key]]` with their lines.
pub(crate) fn subtables<'a, 'i>(
    lines: &Lines,
    root: &'a DeTable<'i>,
    key: &str,
    faults: &mut Vec<Fault>,
) -> Vec<(&'a DeTable<'i>, usize)> {
    let Some((_, value)) = root.iter().find(|(k, _)| k.get_ref() == key) else { return Vec::new() };
    let mut tables = Vec::new();
    let entries: &[Spanned<DeValue<'i>>] = value.get_ref().as_array().map_or(&[], |a| a.as_ref());
    for entry in entries {
        if let Some(table) = entry.get_ref().as_table() {
            tables.push((table, lines.of(entry.span().start)));
        }
    }
    if tables.len() != entries.len() || tables.is_empty() {
        let line = lines.of(value.span().start);
        let (message, remedy) = ("is not a list of tables".to_owned(), format!("write [[{key}]] for each"));
        faults.push(Fault { line, key: key.to_owned(), message, remedy });
    }
    tables
}

fn number_of(value: &DeValue<'_>) -> Option<f64> {
    if let Some(i) = value.as_integer() {
        return i64::from_str_radix(&i.as_str().replace('_', ""), i.radix()).ok().map(|n| n as f64);
    }
    value.as_float().and_then(|f| f.as_str().replace('_', "").parse().ok()).filter(|f: &f64| f.is_finite())
}

/// How a float that is NaN or infinite is written in the file.
fn not_finite<'v>(value: &'v DeValue<'_>) -> Option<&'v str> {
    let text = value.as_float()?.as_str();
    text.parse::<f64>().is_ok_and(|number| !number.is_finite()).then_some(text)
}

fn article(noun: &str) -> &'static str {
    if noun.starts_with(['a', 'i', 'o']) { "an" } else { "a" }
}

/// The most similar known key, if it is similar enough to be a typing error.
fn nearest(key: &str, known: &[&'static str]) -> Option<&'static str> {
    known.iter().map(|k| (edit_distance(key, k), *k)).filter(|(d, _)| *d <= 2).min().map(|(_, k)| k)
}

fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().take(64).enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let above = row[j + 1];
            row[j + 1] = (above + 1).min(row[j] + 1).min(diagonal + usize::from(ca != *cb));
            diagonal = above;
        }
    }
    row[b.len()]
}
