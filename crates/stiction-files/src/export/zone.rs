//! Local times to instants: named zones, and the two nights a year when clocks change.

use jiff::tz::{AmbiguousOffset, Offset, TimeZone};

use super::ExportError;
use super::stamp::HOUR_NS;
use crate::conventions::{LETTERS, WINDOWS};
use stiction::core::units::format_rfc3339;

/// Half an hour: rows closer than this belong together; steps at a clock change are longer.
const NEAR_NS: i64 = HOUR_NS / 2;

/// Letters behind a time, filled up with zeros.
pub(super) type Letters = [u8; 5];

/// Letters in the form of [`Letters`].
pub(super) fn letters_of(word: &str) -> Letters {
    std::array::from_fn(|at| word.as_bytes().get(at).copied().unwrap_or(0))
}

/// Whether a text is an offset, or letters that are known.
pub(super) fn is_known(text: &str) -> bool {
    offset_of(text).is_some() || LETTERS.iter().any(|(known, _)| known.eq_ignore_ascii_case(text))
}

/// The zone that a heading names, in brackets or as `UTC` with or without hours behind it; or letters such as CET.
pub(super) fn of_heading(name: &str) -> (Option<Zone>, Option<Letters>) {
    let name = &name.replace('\u{2212}', "-");
    let words = || name.split([' ', '(', ')', '[', ']', '_']).filter(|word| !word.is_empty());
    let known = |word: &&str| !["UTC", "GMT"].contains(word) && LETTERS.iter().any(|(known, _)| known == word);
    if let Some(letters) = words().find(known) {
        return (None, Some(letters_of(letters)));
    }
    let of_word = |word: &str| {
        let from = word.get(..3).filter(|start| ["utc", "gmt"].contains(&start.to_lowercase().as_str()))?;
        Zone::parse(if word.len() == from.len() { "UTC" } else { &word[3..] }).ok()
    };
    let named = super::names::unit(name).and_then(|inside| Zone::parse(inside).ok());
    (named.or_else(|| words().filter_map(of_word).next_back()), None)
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

impl Zone {
    /// Parses `Europe/Berlin`, `UTC`, `+01:00`, a Windows name, or a POSIX rule such as `CET-1CEST,M3.5.0,M10.5.0/3`.
    ///
    /// # Errors
    /// A sentence that says what is valid.
    pub fn parse(text: &str) -> Result<Self, String> {
        let windows = WINDOWS.iter().find(|(name, _)| name.eq_ignore_ascii_case(text)).map(|(_, name)| *name);
        let zone = match offset_of(text) {
            Some(Offset::UTC) => return Ok(Self { name: "UTC".to_owned(), zone: TimeZone::UTC }),
            Some(offset) => Ok(TimeZone::fixed(offset)),
            None if text.contains(',') => TimeZone::posix(text),
            None => TimeZone::get(windows.unwrap_or(text)),
        };
        if let Ok(zone) = zone {
            return Ok(Self { name: text.to_owned(), zone });
        }
        Err(format!(
            "{text:?} is not a time zone; write a name such as Europe/Berlin, UTC, or an offset such as +01:00"
        ))
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

    /// The instant of a local time, and the second one in the hour that is repeated.
    fn meaning(&self, reading: Reading) -> Result<(i64, Option<i64>), ExportError> {
        let fault = |what: String, remedy: &str| ExportError::at(reading.line, what, remedy);
        let civil = jiff::Timestamp::from_nanosecond(i128::from(reading.local_ns)).map(|t| Offset::UTC.to_datetime(t));
        let civil = civil.map_err(|_| fault("time out of range".into(), "correct the timestamp"))?;
        let instant = |offset: Offset| {
            let ns = offset.to_timestamp(civil).ok().and_then(|t| i64::try_from(t.as_nanosecond()).ok());
            ns.ok_or_else(|| fault(format!("{civil} is out of range"), "correct the timestamp"))
        };
        match self.zone.to_ambiguous_timestamp(civil).offset() {
            AmbiguousOffset::Unambiguous { offset } => Ok((instant(offset)?, None)),
            AmbiguousOffset::Fold { before, after } => {
                let own = |offset: &&Offset| {
                    let there = offset.to_timestamp(civil).ok().map(|t| self.zone.to_offset_info(t));
                    there.is_some_and(|info| reading.letters == Some(letters_of(info.abbreviation())))
                };
                match [before, after].iter().find(own) {
                    Some(offset) => Ok((instant(*offset)?, None)),
                    None => Ok((instant(before)?, Some(instant(after)?))),
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
        let meanings: Vec<(i64, Option<i64>)> = readings.iter().map(|r| self.meaning(*r)).collect::<Result<_, _>>()?;
        let mut out: Vec<i64> = meanings.iter().map(|(first, _)| *first).collect();
        let (mut at, mut twice) = (0, 0);
        for run in meanings.chunk_by(|a, b| a.1.is_some() == b.1.is_some()) {
            let to = at + run.len();
            if run[0].1.is_some() {
                let second = at + self.first_pass(readings, at, to)?;
                (second..to).for_each(|k| out[k] = meanings[k].1.unwrap_or(out[k]));
                twice += 1;
            }
            at = to;
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

/// `Z`, `UTC`, `GMT+1`, `+01:00`, `-0530`, `+2`.
pub(super) fn offset_of(text: &str) -> Option<Offset> {
    let upper = text.to_ascii_uppercase();
    let signed = ["UTC", "GMT"].iter().find_map(|start| upper.strip_prefix(start)).unwrap_or(&upper).trim_start();
    if (signed.is_empty() && !text.is_empty()) || signed == "Z" {
        return Some(Offset::UTC);
    }
    let figures = signed.strip_prefix(['+', '-'])?.replace(':', "");
    let (hours, minutes) = figures.split_at_checked(2).unwrap_or((&figures, ""));
    let number = |text: &str, below: i32| text.parse::<i32>().ok().filter(|n| (0..below).contains(n));
    let seconds = number(hours, 16)? * 3600 + if minutes.is_empty() { 0 } else { number(minutes, 60)? * 60 };
    Offset::from_seconds(if signed.starts_with('-') { -seconds } else { seconds }).ok()
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
            let (text, letters) = text.split_once(' ').map_or((text, None), |(t, z)| (t, Some(letters_of(z))));
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
        let of = |name: &str| of_heading(name).0.map(|zone| zone.name().to_owned());
        for (name, zone) in [
            ("Time (UTC)", Some("UTC")),
            ("timestamp_utc", Some("UTC")),
            ("Timestamp GMT+1", Some("+1")),
            ("Time (UTC+02:00)", Some("UTC+02:00")),
            ("Time (Europe/Berlin)", Some("Europe/Berlin")),
            ("Time (W. Europe Standard Time)", Some("W. Europe Standard Time")),
            ("Time", None),
            ("Time (local)", None),
        ] {
            assert_eq!(of(name).as_deref(), zone, "{name}");
        }
        assert_eq!(
            ["Zeit [MESZ]", "Time CET", "t [s]"].map(|name| of_heading(name).1),
            [Some(*b"MESZ\0"), Some(*b"CET\0\0"), None]
        );
    }

    #[test]
    fn zones_have_several_names() {
        for name in ["UTC", "Europe/Berlin", "+01:00", "-3", "W. Europe Standard Time", "CET-1CEST,M3.5.0,M10.5.0/3"] {
            assert!(Zone::parse(name).is_ok(), "{name}");
        }
        assert!(Zone::parse("Middle Earth").unwrap_err().contains("Europe/Berlin"));
    }
}
