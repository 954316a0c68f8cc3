//! Local times to instants: named zones, and the two nights a year when clocks change.

use jiff::civil::DateTime;
use jiff::tz::{AmbiguousOffset, Offset, TimeZone};

use super::ExportError;
use super::stamp::HOUR_NS;
use crate::conventions::{LETTERS, WINDOWS};
use stiction::core::units::format_rfc3339;

/// Half an hour: rows closer than this belong together; steps at a clock change are longer.
const NEAR_NS: i64 = HOUR_NS / 2;

/// Letters behind a time, filled up with zeros.
pub(super) type Letters = [u8; 5];

/// Whether a word may be the letters of a zone.
pub(super) fn is_letters(word: &str) -> bool {
    (2..=5).contains(&word.len()) && word.bytes().all(|b| b.is_ascii_uppercase()) && word != "UTC" && word != "GMT"
}

/// The letters of a word that is known as such.
pub(super) fn letters_of(word: &str) -> Option<Letters> {
    let known = is_letters(word) && LETTERS.iter().any(|(known, _)| *known == word);
    known.then(|| std::array::from_fn(|at| word.as_bytes().get(at).copied().unwrap_or(0)))
}

/// The zone that a heading names, in brackets or as `UTC` with or without hours behind it; or letters such as CET.
pub(super) fn of_heading(name: &str, bracketed: &str) -> (Option<Zone>, Option<Letters>) {
    if let Some(letters) = letters_of(bracketed) {
        return (None, Some(letters));
    }
    let named = Zone::parse(bracketed).ok().filter(|_| !bracketed.is_empty() && !is_letters(bracketed));
    let words = name.split([' ', '(', ')', '[', ']', '_', '/']).filter(|word| !word.is_empty());
    let of_word = |word: &str| {
        let start = word.get(..3).filter(|start| ["utc", "gmt"].contains(&start.to_lowercase().as_str()))?;
        Zone::parse(if word.len() == start.len() { "UTC" } else { &word[3..] }).ok()
    };
    (named.or_else(|| words.filter_map(of_word).next_back()), None)
}

/// A time zone as requested.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Zone {
    name: String,
    zone: TimeZone,
}

/// One local time, in time order.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reading {
    /// ns as if it were UTC.
    pub local_ns: i64,
    /// Letters such as CEST after it.
    pub letters: Option<Letters>,
    /// Line in the file.
    pub line: u64,
}

/// Possible meanings of a local time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Meaning {
    Once(i64),
    /// In the repeated hour: first pass, second pass.
    Twice(i64, i64),
}

impl Zone {
    /// Parses `Europe/Berlin`, `UTC`, `+01:00`, a Windows name, or a POSIX rule such as `CET-1CEST,M3.5.0,M10.5.0/3`.
    ///
    /// # Errors
    /// A sentence that says what is valid.
    pub fn parse(text: &str) -> Result<Self, String> {
        let of = |zone| Ok(Self { name: text.to_owned(), zone });
        if text.eq_ignore_ascii_case("utc") || text.eq_ignore_ascii_case("gmt") || text == "Z" {
            return Ok(Self::utc());
        }
        if let Some(offset) = fixed(text) {
            return of(TimeZone::fixed(offset));
        }
        let windows = WINDOWS.iter().find(|(name, _)| name.eq_ignore_ascii_case(text)).map(|(_, name)| *name);
        if let Ok(zone) = TimeZone::get(windows.unwrap_or(text)) {
            return of(zone);
        }
        if text.contains(',')
            && let Ok(zone) = TimeZone::posix(text)
        {
            return of(zone);
        }
        Err(format!(
            "{text:?} is not a time zone; write a name such as Europe/Berlin, UTC, or an offset such as +01:00"
        ))
    }

    /// UTC.
    pub(super) fn utc() -> Self {
        Self { name: "UTC".to_owned(), zone: TimeZone::UTC }
    }

    /// Whether two zones have the same clocks, by their offsets in each month of a year.
    pub(super) fn agrees(&self, other: &Self) -> bool {
        (1..=12).all(|month| {
            let noon = jiff::civil::date(2025, month, 15).at(12, 0, 0, 0);
            let at = Offset::UTC.to_timestamp(noon).unwrap_or(jiff::Timestamp::UNIX_EPOCH);
            self.zone.to_offset(at) == other.zone.to_offset(at)
        })
    }

    /// Whether letters behind a time can be those of this zone at an instant.
    fn check_letters(&self, reading: Reading, t_ns: i64) -> Result<(), ExportError> {
        let Some(letters) = reading.letters.map(in_words) else { return Ok(()) };
        let at = jiff::Timestamp::from_nanosecond(i128::from(t_ns)).unwrap_or(jiff::Timestamp::UNIX_EPOCH);
        let info = self.zone.to_offset_info(at);
        let own = info.abbreviation();
        let fits = LETTERS.iter().any(|(word, hours)| *word == letters && info.offset().seconds() == 3600 * hours);
        if own == letters || fits {
            return Ok(());
        }
        let what = format!("the time says {letters}, but the zone {} is {own} then", self.name);
        Err(ExportError::at(reading.line, what, "give the zone of these times with --tz"))
    }

    /// The requested name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    fn meaning(&self, reading: Reading) -> Result<Meaning, ExportError> {
        let fault = |what: String, remedy: &str| ExportError::at(reading.line, what, remedy);
        let civil =
            civil_of(reading.local_ns).ok_or_else(|| fault("time out of range".into(), "correct the timestamp"))?;
        let ambiguous = self.zone.to_ambiguous_timestamp(civil);
        let instant = |offset: Offset| {
            let ns = offset.to_timestamp(civil).ok().and_then(|t| i64::try_from(t.as_nanosecond()).ok());
            ns.ok_or_else(|| fault(format!("{civil} is out of range"), "correct the timestamp"))
        };
        match ambiguous.offset() {
            AmbiguousOffset::Unambiguous { offset } => Ok(Meaning::Once(instant(offset)?)),
            AmbiguousOffset::Fold { before, after } => {
                let wanted = |offset: &&Offset| {
                    let letters = reading.letters.map(in_words);
                    let there = offset.to_timestamp(civil).ok();
                    letters.is_some_and(|l| there.is_some_and(|t| self.zone.to_offset_info(t).abbreviation() == l))
                };
                match [before, after].iter().find(wanted) {
                    Some(offset) => Ok(Meaning::Once(instant(*offset)?)),
                    None => Ok(Meaning::Twice(instant(before)?, instant(after)?)),
                }
            }
            AmbiguousOffset::Gap { .. } => Err(fault(
                format!("{civil} does not exist in {}: clocks went forward then", self.name),
                "give the zone of these timestamps, such as --tz UTC or a fixed offset, --tz +01:00",
            )),
        }
    }

    /// Local times in time order to ns since 1970 UTC; also the number of repeated hours.
    pub(super) fn instants(&self, readings: &[Reading]) -> Result<(Vec<i64>, usize), ExportError> {
        let meanings: Vec<Meaning> = readings.iter().map(|r| self.meaning(*r)).collect::<Result<_, _>>()?;
        let mut out = Vec::with_capacity(readings.len());
        let (mut at, mut twice) = (0, 0);
        while at < meanings.len() {
            if let Meaning::Once(ns) = meanings[at] {
                out.push(ns);
                at += 1;
                continue;
            }
            let run = meanings[at..].iter().take_while(|m| matches!(m, Meaning::Twice(..))).count();
            let first_pass = self.first_pass(readings, at, at + run)?;
            out.extend(meanings[at..at + run].iter().enumerate().map(|(k, m)| match *m {
                Meaning::Twice(first, _) if k < first_pass => first,
                Meaning::Twice(_, second) => second,
                Meaning::Once(ns) => ns,
            }));
            twice += 1;
            at += run;
        }
        readings.iter().zip(&out).try_for_each(|(reading, t_ns)| self.check_letters(*reading, *t_ns))?;
        Ok((out, twice))
    }

    /// How many rows of a run in the repeated hour belong to its first pass.
    fn first_pass(&self, readings: &[Reading], from: usize, to: usize) -> Result<usize, ExportError> {
        let run = &readings[from..to];
        let back: Vec<usize> = (1..run.len()).filter(|k| run[*k].local_ns < run[*k - 1].local_ns).collect();
        let before = from.checked_sub(1).map(|k| run[0].local_ns - readings[k].local_ns);
        let after = readings.get(to).map(|next| next.local_ns - run[run.len() - 1].local_ns);
        let near = |step: i64| (0..NEAR_NS).contains(&step);
        match (&back[..], before, after) {
            (&[at], _, _) => Ok(at),
            // It stands once: on the side that it joins.
            ([], Some(before), Some(after)) if near(before) && after >= NEAR_NS => Ok(run.len()),
            ([], Some(before), Some(after)) if near(after) && before >= NEAR_NS => Ok(0),
            ([], Some(before), None) if near(before) => Ok(run.len()),
            ([], None, Some(after)) if near(after) => Ok(0),
            _ => Err(ExportError::at(
                run[0].line,
                format!(
                    "{} occurs twice in {}, and the rows do not show which one is meant",
                    format_rfc3339(run[0].local_ns).replace('Z', ""),
                    self.name
                ),
                "if these timestamps have no daylight saving time, give their offset, such as --tz +01:00; else export in UTC",
            )),
        }
    }
}

fn fixed(text: &str) -> Option<Offset> {
    let figures = text.strip_prefix("UTC").unwrap_or(text);
    let sign = match figures.chars().next()? {
        '+' => 1,
        '-' => -1,
        _ => return None,
    };
    let (hours, minutes) = figures[1..].split_once(':').unwrap_or((&figures[1..], "0"));
    let seconds = hours.parse::<i32>().ok()? * 3600 + minutes.parse::<i32>().ok().filter(|m| (0..60).contains(m))? * 60;
    (seconds <= 15 * 3600).then(|| Offset::from_seconds(sign * seconds).ok()).flatten()
}

fn civil_of(local_ns: i64) -> Option<DateTime> {
    let stamp = jiff::Timestamp::from_nanosecond(i128::from(local_ns)).ok()?;
    Some(Offset::UTC.to_datetime(stamp))
}

/// The letters as text.
pub(super) fn in_words(letters: Letters) -> String {
    letters.iter().filter(|b| **b != 0).map(|b| char::from(*b)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::units::{NS_PER_S, parse_time};

    fn readings(texts: &[&str]) -> Vec<Reading> {
        let reading = |text: &str| {
            let (text, letters) = text.split_once(' ').map_or((text, None), |(t, z)| {
                let mut letters = [0; 5];
                letters[..z.len()].copy_from_slice(z.as_bytes());
                (t, Some(letters))
            });
            Reading { local_ns: parse_time(&format!("{text}Z")).unwrap(), letters, line: 2 }
        };
        texts.iter().map(|t| reading(t)).collect()
    }

    fn hours(texts: &[&str]) -> Result<Vec<i64>, String> {
        let zone = Zone::parse("Europe/Berlin").unwrap();
        let from = parse_time("2026-10-25T00:00:00Z").unwrap();
        let read = zone.instants(&readings(texts)).map_err(|e| e.to_string())?.0;
        Ok(read.iter().map(|ns| (ns - from) / (60 * NS_PER_S)).collect())
    }

    #[test]
    fn the_doubled_hour_is_told_by_the_order_of_rows() {
        let day = |times: &[&str]| times.iter().map(|t| format!("2026-10-25T{t}")).collect::<Vec<_>>();
        let of = |times: &[&str]| hours(&day(times).iter().map(String::as_str).collect::<Vec<_>>());
        let both = of(&["01:45:00", "02:15:00", "02:45:00", "02:15:00", "02:45:00", "03:15:00"]);
        assert_eq!(both.unwrap(), [-15, 15, 45, 75, 105, 135]);
        assert_eq!(of(&["02:40:00", "02:50:00", "03:00:00"]).unwrap(), [100, 110, 120]);
        assert_eq!(of(&["01:59:00", "02:10:00"]).unwrap(), [-1, 10]);
        assert_eq!(of(&["02:10:00 CET", "03:00:00"]).unwrap(), [70, 120]);
        // A clock that is never moved passes the hour once, without a break.
        assert!(of(&["01:50:00", "02:10:00", "02:50:00", "03:10:00"]).unwrap_err().contains("+01:00"));
        assert!(of(&["02:10:00", "02:20:00"]).unwrap_err().contains("twice"));
        let spring = hours(&["2026-03-29T02:30:00"]).unwrap_err();
        assert!(spring.contains("line 2") && spring.contains("does not exist"), "{spring}");
    }

    #[test]
    fn letters_must_be_those_of_the_zone() {
        let read = |zone: &str, time: &str| {
            Zone::parse(zone).unwrap().instants(&readings(&[time])).map(|_| ()).map_err(|e| e.to_string())
        };
        for (zone, time) in [
            ("Europe/Berlin", "2026-06-15T10:00:00 CEST"),
            ("Europe/Berlin", "2026-06-15T10:00:00 MESZ"),
            ("+02:00", "2026-06-15T10:00:00 CEST"),
            ("America/New_York", "2026-01-15T10:00:00 EST"),
        ] {
            assert_eq!(read(zone, time), Ok(()), "{zone} {time}");
        }
        for (zone, time) in [
            ("UTC", "2026-06-15T10:00:00 CEST"),
            ("Europe/Berlin", "2026-06-15T10:00:00 CET"),
            ("Europe/Berlin", "2026-06-15T10:00:00 EDT"),
            ("Europe/Berlin", "2026-06-15T10:00:00 NACH"),
        ] {
            let told = read(zone, time).unwrap_err();
            let letters = time.rsplit(' ').next().unwrap();
            assert!(told.contains(letters) && told.contains(zone) && told.contains("--tz"), "{told}");
        }
    }

    #[test]
    fn headings_name_zones() {
        let of = |name: &str, bracketed: &str| of_heading(name, bracketed).0.map(|zone| zone.name().to_owned());
        for (name, bracketed, zone) in [
            ("Time (UTC)", "UTC", Some("UTC")),
            ("timestamp_utc", "", Some("UTC")),
            ("Timestamp GMT+1", "", Some("+1")),
            ("Time (UTC+02:00)", "UTC+02:00", Some("UTC+02:00")),
            ("Time (Europe/Berlin)", "Europe/Berlin", Some("Europe/Berlin")),
            ("Time", "", None),
            ("Time (local)", "local", None),
        ] {
            assert_eq!(of(name, bracketed).as_deref(), zone, "{name}");
        }
        assert_eq!(of_heading("Zeit [MESZ]", "MESZ").1, Some(*b"MESZ\0"));
    }

    #[test]
    fn zones_have_several_names() {
        for name in ["UTC", "Europe/Berlin", "+01:00", "-3", "W. Europe Standard Time", "CET-1CEST,M3.5.0,M10.5.0/3"] {
            assert!(Zone::parse(name).is_ok(), "{name}");
        }
        assert!(Zone::parse("Middle Earth").unwrap_err().contains("Europe/Berlin"));
    }
}
