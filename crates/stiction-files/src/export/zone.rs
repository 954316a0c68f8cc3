//! Local times to instants: named zones, and the two nights a year when clocks change.

use jiff::civil::DateTime;
use jiff::tz::{AmbiguousOffset, Offset, TimeZone};

use super::ExportError;
use super::stamp::HOUR_NS;
use stiction::core::units::format_rfc3339;

/// Half an hour: rows closer than this belong together; steps at a clock change are longer.
const NEAR_NS: i64 = HOUR_NS / 2;

/// Windows names of time zones that occur in exports.
const WINDOWS: [(&str, &str); 14] = [
    ("W. Europe Standard Time", "Europe/Berlin"),
    ("Central Europe Standard Time", "Europe/Budapest"),
    ("Central European Standard Time", "Europe/Warsaw"),
    ("Romance Standard Time", "Europe/Paris"),
    ("GMT Standard Time", "Europe/London"),
    ("FLE Standard Time", "Europe/Helsinki"),
    ("Eastern Standard Time", "America/New_York"),
    ("Central Standard Time", "America/Chicago"),
    ("Mountain Standard Time", "America/Denver"),
    ("Pacific Standard Time", "America/Los_Angeles"),
    ("E. South America Standard Time", "America/Sao_Paulo"),
    ("China Standard Time", "Asia/Shanghai"),
    ("India Standard Time", "Asia/Kolkata"),
    ("AUS Eastern Standard Time", "Australia/Sydney"),
];

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
    pub letters: Option<[u8; 5]>,
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
            return Ok(Self { name: "UTC".to_owned(), zone: TimeZone::UTC });
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
                    let letters = reading.letters.map(letters_of);
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

fn letters_of(letters: [u8; 5]) -> String {
    letters.iter().filter(|b| **b != 0).map(|b| char::from(*b)).collect()
}

/// The letters as text, for messages.
pub(super) fn letters(letters: [u8; 5]) -> String {
    letters_of(letters)
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
    fn zones_have_several_names() {
        for name in ["UTC", "Europe/Berlin", "+01:00", "-3", "W. Europe Standard Time", "CET-1CEST,M3.5.0,M10.5.0/3"] {
            assert!(Zone::parse(name).is_ok(), "{name}");
        }
        assert!(Zone::parse("Middle Earth").unwrap_err().contains("Europe/Berlin"));
    }
}
