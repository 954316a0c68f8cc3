//! What the daemon should report at the end of known data: parsed from text, and compared with the engine's documents.
//!
//! ```toml
//! [[case]]
//! name = "FIC101 sticks"
//! input = "sticking.mcap"                # beside this file
//! loop = "FIC101"                        # where the input has several
//! until = "2026-01-05T08:30:00Z"         # uses no later samples; default: all
//! verdict = "stiction"
//! s = [7.5, 8.5]                         # lowest and highest
//! alarm = true
//! ```

use serde_json::Value;
use toml::de::DeTable;

use crate::codec::topic::Kind;
use crate::config::Fault;
use crate::config::reader::{Lines, TableReader, subtables, syntax_fault};
use stiction::core::units::{parse_time, significant};
use stiction::core::verdict::{Verdict, reasons};

/// Keys of numbers that an expectation can bound, and their paths in an estimate.
const NUMBERS: [(&str, &str); 6] = [
    ("s", "/s"),
    ("j", "/j"),
    ("p_stiction", "/p_stiction"),
    ("p_calibrated", "/p_calibrated"),
    ("stiction_index", "/stiction_index"),
    ("period_s", "/oscillation/period_s"),
];

/// Significant digits of a number in a message: enough to see on which side of a bound it is.
const DIGITS: usize = 6;

/// Data of one loop, and what the daemon should report at its end.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Unique in its file.
    pub name: String,
    /// Line of its header, from 1.
    pub line: usize,
    /// File with the data, relative to the file of the case.
    pub input: String,
    /// Roles of an export's columns, as in `analyze --map`; `None` if the names of the columns show them.
    pub map: Option<String>,
    /// Time zone of an export whose times have none, as in `analyze --tz`.
    pub tz: Option<String>,
    /// The loop; `None` if the input has only one.
    pub loop_name: Option<String>,
    /// Time after which samples are not used, ns since 1970.
    pub until_ns: Option<i64>,
    /// At least one expectation.
    pub expected: Vec<Expectation>,
}

/// One expected property.
#[derive(Debug, Clone, PartialEq)]
pub struct Expectation {
    /// Key in the text.
    pub key: &'static str,
    /// Line of its value, from 1.
    pub line: usize,
    /// The value.
    pub wanted: Wanted,
}

/// An expected value.
#[derive(Debug, Clone, PartialEq)]
pub enum Wanted {
    /// A word of the estimate.
    Word(&'static str),
    /// A number of the estimate, lowest and highest.
    Range([f64; 2]),
    /// Whether the alarm is active.
    Alarm(bool),
}

/// The engine's last reports on a loop.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Found {
    /// The newest estimate; `None` before the first window.
    pub estimate: Option<Value>,
    /// Whether the alarm is active.
    pub alarm: bool,
}

/// An expectation that does not hold.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Key in the text.
    pub key: &'static str,
    /// Line of the expected value, from 1.
    pub line: usize,
    /// What was expected, in words.
    pub expected: String,
    /// What was found, in words.
    pub found: String,
}

/// Reads the cases of a text.
///
/// # Errors
/// All faults of syntax, type and meaning, sorted by line.
pub fn parse(text: &str) -> Result<Vec<Case>, Vec<Fault>> {
    let (root, syntax) = DeTable::parse_recoverable(text);
    let lines = &Lines::new(text);
    let mut faults: Vec<Fault> = syntax.iter().map(|error| syntax_fault(lines, error)).collect();
    let root = root.get_ref();
    let mut cases: Vec<Case> = Vec::new();
    for (index, (table, line)) in subtables(lines, root, "case", &mut faults).into_iter().enumerate() {
        let mut reader = TableReader::new(lines, &format!("case[{index}]"), line, Some(table), &mut faults);
        let case = read_case(&mut reader);
        if !case.name.is_empty() && cases.iter().any(|other| other.name == case.name) {
            reader.refuse(line, "name", format!("{:?} occurs twice", case.name), "give each case its own name");
        }
        reader.close();
        cases.push(case);
    }
    let unknown = |key: &str, line, message: &str| Fault {
        line,
        key: key.to_owned(),
        message: message.to_owned(),
        remedy: "write [[case]] for each case".to_owned(),
    };
    let others = root.iter().filter(|(key, _)| key.get_ref() != "case");
    faults.extend(others.map(|(key, _)| unknown(key.get_ref(), lines.of(key.span().start), "unknown table or key")));
    if cases.is_empty() && faults.is_empty() {
        faults.push(unknown("case", 1, "there is no case"));
    }
    faults.sort_by_key(|fault| fault.line);
    if faults.is_empty() { Ok(cases) } else { Err(faults) }
}

fn read_case(r: &mut TableReader<'_, '_>) -> Case {
    let line = r.line();
    let case = Case {
        name: required(r, "name", "write name = \"FIC101 sticks\""),
        line,
        input: required(r, "input", "write input = \"FILE\", a recording, a table or a scenario"),
        map: r.text("map").map(|(text, _)| text),
        tz: r.text("tz").map(|(text, _)| text),
        loop_name: r.text("loop").map(|(name, _)| name),
        until_ns: read_until(r),
        expected: read_expected(r),
    };
    if case.expected.is_empty() {
        r.refuse(line, "verdict", "and every other expectation is missing", "write verdict, alarm, s or another one");
    }
    case
}

fn required(r: &mut TableReader<'_, '_>, key: &'static str, remedy: &str) -> String {
    let line = r.line();
    let text = r.text(key);
    match &text {
        None => r.refuse(line, key, "is missing", remedy),
        Some((text, line)) if text.trim().is_empty() => r.refuse(*line, key, "is empty", remedy),
        Some(_) => {}
    }
    text.map(|(text, _)| text).unwrap_or_default()
}

fn read_until(r: &mut TableReader<'_, '_>) -> Option<i64> {
    let (text, line) = r.text("until")?;
    let time = parse_time(&text);
    if let Err(error) = &time {
        r.refuse(line, "until", error.to_string(), "write a time such as \"2026-01-05T08:30:00Z\"");
    }
    time.ok()
}

fn read_expected(r: &mut TableReader<'_, '_>) -> Vec<Expectation> {
    let mut expected = Vec::new();
    let verdicts = Verdict::ALL.map(Verdict::name);
    let reasons: Vec<&str> = reasons().collect();
    for (key, words) in [("verdict", &verdicts[..]), ("reason", &reasons)] {
        let choices: Vec<_> = words.iter().map(|word| (*word, *word)).collect();
        let word = r.choice(key, &choices);
        expected.extend(r.line_of(key).map(|line| Expectation { key, line, wanted: Wanted::Word(word) }));
    }
    for (key, _) in NUMBERS {
        let Some((range, line)) = r.pair(key, "the lowest and the highest value, such as [7.5, 8.5]") else { continue };
        if range[0] > range[1] {
            r.refuse(line, key, format!("[{}, {}] is empty", range[0], range[1]), "write [LOW, HIGH]");
        }
        expected.push(Expectation { key, line, wanted: Wanted::Range(range) });
    }
    let alarm = r.boolean("alarm", false);
    expected.extend(r.line_of("alarm").map(|line| Expectation { key: "alarm", line, wanted: Wanted::Alarm(alarm) }));
    expected
}

impl Found {
    /// Takes one of the engine's documents for the loop; only estimates and alarms have an effect.
    ///
    /// # Errors
    /// It is not JSON.
    pub fn take(&mut self, kind: Kind, json: &[u8]) -> serde_json::Result<()> {
        match kind {
            Kind::Estimate => self.estimate = Some(serde_json::from_slice(json)?),
            Kind::Alarm => self.alarm = serde_json::from_slice::<Value>(json)?["active"] == true,
            _ => {}
        }
        Ok(())
    }

    fn number(&self, key: &str) -> Option<f64> {
        let (_, pointer) = NUMBERS.iter().find(|(known, _)| *known == key)?;
        self.estimate.as_ref()?.pointer(pointer)?.as_f64()
    }
}

impl Case {
    /// The expectations that do not hold; all of them if no window was judged.
    #[must_use]
    pub fn differences(&self, found: &Found) -> Vec<Difference> {
        self.expected.iter().filter_map(|expectation| expectation.difference(found)).collect()
    }
}

impl Expectation {
    fn difference(&self, found: &Found) -> Option<Difference> {
        let seen = match (&self.wanted, &found.estimate) {
            (_, None) => Err("no estimate".to_owned()),
            (Wanted::Word(word), Some(estimate)) => {
                let seen = estimate[self.key].as_str();
                if seen == Some(word) { Ok(()) } else { Err(seen.unwrap_or("none").to_owned()) }
            }
            (Wanted::Range([low, high]), Some(_)) => match found.number(self.key) {
                Some(value) if (*low..=*high).contains(&value) => Ok(()),
                value => Err(value.map_or_else(|| "none".to_owned(), |value| significant(value, DIGITS))),
            },
            (Wanted::Alarm(alarm), Some(_)) if *alarm == found.alarm => Ok(()),
            (Wanted::Alarm(_), Some(_)) => Err(alarm_word(found.alarm).to_owned()),
        };
        let found = seen.err()?;
        Some(Difference { key: self.key, line: self.line, expected: self.wanted.to_string(), found })
    }
}

const fn alarm_word(active: bool) -> &'static str {
    if active { "active" } else { "not active" }
}

impl std::fmt::Display for Wanted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Word(word) => f.write_str(word),
            Self::Range([low, high]) => write!(f, "{low} to {high}"),
            Self::Alarm(active) => f.write_str(alarm_word(*active)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const GOOD: &str = r#"
[[case]]
name = "sticks"
input = "a.mcap"
loop = "FIC101"
until = "1970-01-01T00:00:10Z"
verdict = "stiction"
s = [7.5, 8.5]
period_s = [90, 110]
alarm = true

[[case]]
name = "is coarse"
input = "b.csv"
reason = "too_coarse"
"#;

    #[test]
    fn cases_are_read_with_the_lines_of_their_expectations() {
        let cases = parse(GOOD).unwrap();
        assert_eq!((cases.len(), cases[0].line, cases[1].line), (2, 2, 12));
        assert_eq!((cases[0].loop_name.as_deref(), cases[0].until_ns), (Some("FIC101"), Some(10_000_000_000)));
        let lines: Vec<(&str, usize)> = cases[0].expected.iter().map(|e| (e.key, e.line)).collect();
        assert_eq!(lines, [("verdict", 7), ("s", 8), ("period_s", 9), ("alarm", 10)]);
        assert_eq!(cases[1].expected[0].wanted, Wanted::Word("too_coarse"));
    }

    #[test]
    fn every_fault_names_its_line_and_a_remedy() {
        for (from, to, line, key, part) in [
            ("s = [7.5", "s = [9.5", 8, "case[0].s", "is empty"),
            ("[7.5, 8.5]", "8.0", 8, "case[0].s", "lowest"),
            ("verdict = \"stiction\"", "verdict = \"sticking\"", 7, "case[0].verdict", "not_oscillating"),
            ("too_coarse", "coarse", 15, "case[1].reason", "too_coarse"),
            ("alarm = true", "alarm = \"yes\"", 10, "case[0].alarm", "true or false"),
            ("alarm = true", "alarms = true", 10, "case[0].alarms", "did you mean alarm?"),
            ("reason = \"too_coarse\"", "", 12, "case[1].verdict", "missing"),
            ("input = \"b.csv\"", "", 12, "case[1].input", "recording"),
            ("is coarse", "sticks", 12, "case[1].name", "twice"),
            ("until = \"1970-01-01T00:00:10Z\"", "until = \"soon\"", 6, "case[0].until", "2026"),
            ("\n[[case]]\nname = \"sticks\"", "[cases]\nname = \"sticks\"", 1, "cases", "[[case]]"),
        ] {
            let faults = parse(&GOOD.replacen(from, to, 1)).unwrap_err();
            let fault = faults.iter().find(|f| f.key == key).unwrap_or_else(|| panic!("{key}: {faults:?}"));
            assert_eq!(fault.line, line, "{fault}");
            assert!(fault.to_string().contains(part) && !fault.remedy.is_empty(), "{fault}");
        }
        assert!(parse("").unwrap_err()[0].remedy.contains("[[case]]"));
        assert_eq!(parse("[[case]\n").unwrap_err()[0].line, 1);
    }

    #[test]
    fn what_does_not_hold_is_named_and_nothing_else() {
        let case = &parse(GOOD).unwrap()[0];
        let mut found = Found::default();
        assert!(case.differences(&found).iter().all(|d| d.found == "no estimate"));
        assert_eq!(case.differences(&found).len(), 4);
        let estimate = json!({"verdict": "stiction", "s": 8.0, "oscillation": {"period_s": 99.0}});
        found.take(Kind::Estimate, estimate.to_string().as_bytes()).unwrap();
        found.take(Kind::Alarm, br#"{"active": true}"#).unwrap();
        assert_eq!(case.differences(&found), []);
        let estimate = json!({"verdict": "stiction", "s": 6.123_456, "oscillation": {"period_s": null}});
        found.take(Kind::Estimate, estimate.to_string().as_bytes()).unwrap();
        found.take(Kind::Alarm, br#"{"active": false}"#).unwrap();
        let differences = case.differences(&found);
        let words: Vec<[&str; 3]> = differences.iter().map(|d| [d.key, &d.expected, &d.found]).collect();
        let wanted =
            [["s", "7.5 to 8.5", "6.12346"], ["period_s", "90 to 110", "none"], ["alarm", "active", "not active"]];
        assert_eq!(words, wanted);
    }
}
