//! Local times to instants: named zones, and the two nights a year when clocks change.

use jiff::tz::{AmbiguousOffset, Offset, TimeZone};

use super::ExportError;
use super::stamp::HOUR_NS;
use crate::conventions::{LETTERS, NO_ZONES, REGIONS, WINDOWS, is_one_of, unit_of_time};
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

/// The time zone that a heading, a title or a comment names.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Said {
    /// The heading or line, as error messages name it.
    pub place: String,
    pub zone: Option<Zone>,
    /// Letters such as CET, which name a zone for half of the year only.
    pub letters: Option<Letters>,
    /// Words in the place of a zone that name none we know: the user is asked.
    pub unknown: Option<String>,
}

impl Said {
    /// What a heading says: in brackets, as `UTC` with or without hours behind it, or as letters.
    pub(super) fn by_heading(name: &str) -> Self {
        let mut said = Self { place: format!("the heading {name:?}"), ..Self::in_text(name) };
        if let Some(inside) = super::names::unit(name).filter(|_| said.says_nothing()) {
            said.zone = Zone::parse(inside).or_else(|_| of_city(inside)).ok();
            let is_name = inside.len() > 3 && inside.chars().all(|c| c.is_alphabetic() || c == ' ');
            let is_unit = unit_of_time(inside).is_some() || is_one_of(&inside.to_lowercase(), NO_ZONES);
            said.unknown = (said.zone.is_none() && is_name && !is_unit).then(|| inside.to_owned());
        }
        said
    }

    /// What a line above the names says, if it speaks of times and holds none.
    pub(super) fn by_line(line: u64, text: &str) -> Self {
        let lower = text.to_lowercase();
        let has_clock =
            text.as_bytes().windows(3).any(|w| w[0].is_ascii_digit() && w[1] == b':' && w[2].is_ascii_digit());
        let is_offset =
            lower.contains("utc+") || lower.contains("utc-") || lower.contains("gmt+") || lower.contains("gmt-");
        let is_tz = lower.split(|c: char| !c.is_alphabetic()).any(|word| word == "tz");
        if !(is_tz || lower.contains("time") || lower.contains("zeit")) || (has_clock && !is_offset) {
            return Self::default();
        }
        let place = format!("line {line}");
        let mut said = Self { place, ..Self::in_text(text) };
        let value =
            text.split_once([':', '=', ',', ';', '\t']).map(|(_, value)| value.trim_matches([' ', ',', ';', '"']));
        if let Some(value) = value.filter(|value| said.says_nothing() && !value.is_empty()) {
            let is_zone = is_tz || ["time zone", "timezone", "zeitzone"].iter().any(|word| lower.contains(word));
            let city = || of_city(value).ok().filter(|_| is_zone);
            said.zone = Zone::parse(value).ok().or_else(city);
            let is_open = said.zone.is_none() && !is_one_of(&value.to_lowercase(), NO_ZONES);
            said.unknown = (is_zone && is_open).then(|| value.to_owned());
        }
        said
    }

    /// Names of zones and offsets from UTC between other words.
    fn in_text(text: &str) -> Self {
        let text = text.replace('\u{2212}', "-");
        let lower = text.to_lowercase();
        let by_name = |list: &[(&str, &str)], summer| {
            let is_there = |words: &str| {
                let at = lower.find(&words.to_lowercase())?;
                // Not behind another word, as in `AUS Eastern Standard Time`.
                (!lower[..at].trim_end().ends_with(char::is_alphanumeric)).then_some(())
            };
            let (words, place) = list.iter().find(|(words, _)| is_there(words).is_some())?;
            Some(Zone { name: (*words).to_owned(), either: summer, ..Zone::parse(place).ok()? })
        };
        if let Some(zone) = by_name(&WINDOWS, false).or_else(|| by_name(&REGIONS, true)) {
            return Self { zone: Some(zone), ..Self::default() };
        }
        let words = || text.split([' ', '(', ')', '[', ']', '_', ',', ';', '"', '\t']).filter(|word| !word.is_empty());
        let known = |word: &&str| !["UTC", "GMT"].contains(word) && LETTERS.iter().any(|(known, _)| known == word);
        if let Some(letters) = words().find(known) {
            return Self { letters: Some(letters_of(letters)), ..Self::default() };
        }
        let of_word = |word: &str| {
            if word.contains('/') {
                return Zone::parse(word).ok();
            }
            let from = word.get(..3).filter(|start| ["utc", "gmt"].contains(&start.to_lowercase().as_str()))?;
            let zone = Zone::parse(if word.len() == from.len() { "UTC" } else { &word[3..] }).ok()?;
            // Windows shows the offset in winter, and places whose clocks are moved.
            let behind = text.split_once(word).is_some_and(|(_, behind)| behind.contains(char::is_alphabetic));
            Some(Zone { either: zone.name != "UTC" && behind, ..zone })
        };
        Self { zone: words().filter_map(of_word).next_back(), ..Self::default() }
    }

    /// Whether it says nothing of a zone.
    pub(super) fn says_nothing(&self) -> bool {
        self.zone.is_none() && self.letters.is_none() && self.unknown.is_none()
    }
}

/// The zone of a city that gives one its name. `North` or `Central` may be a part of the plant: the old zone names
/// `Australia/North` and `US/Central` are no cities.
fn of_city(city: &str) -> Result<Zone, String> {
    const CONTINENTS: [&str; 6] = ["Africa", "America", "Asia", "Australia", "Europe", "Pacific"];
    const NO_CITIES: [&str; 4] = ["North", "South", "West", "Victoria"];
    let wanted = city.replace(' ', "_");
    let named = |zone: &jiff::tz::TimeZoneName<'_>| {
        let parts = zone.as_str().split_once('/');
        parts.is_some_and(|(area, place)| CONTINENTS.contains(&area) && place == wanted && !NO_CITIES.contains(&place))
    };
    let found = jiff::tz::db().available().find(named).ok_or_else(|| format!("{city:?} is no city of a time zone"))?;
    Zone::parse(found.as_str())
}

/// A time zone as requested.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Zone {
    name: String,
    zone: TimeZone,
    /// Whether the name leaves open if its clocks are moved in summer.
    either: bool,
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
            Some(Offset::UTC) => return Ok(Self { name: "UTC".to_owned(), zone: TimeZone::UTC, either: false }),
            Some(offset) => Ok(TimeZone::fixed(offset)),
            None if text.contains(',') => TimeZone::posix(text),
            None => TimeZone::get(windows.unwrap_or(text)),
        };
        if let Ok(zone) = zone {
            return Ok(Self { name: text.to_owned(), zone, either: false });
        }
        Err(format!(
            "{text:?} is not a time zone; write a name such as Europe/Berlin, UTC, or an offset such as +01:00"
        ))
    }

    /// Whether it has the clocks of a zone that a file names, by the offsets in each month of a year; in some month, if the
    /// name leaves summer time open.
    pub(super) fn agrees(&self, named: &Self) -> bool {
        let same = |month: i8| {
            let noon = jiff::civil::date(2025, month, 15).at(12, 0, 0, 0);
            let at = Offset::UTC.to_timestamp(noon).unwrap_or(jiff::Timestamp::UNIX_EPOCH);
            self.zone.to_offset(at) == named.zone.to_offset(at)
        };
        if named.either { (1..=12).any(same) } else { (1..=12).all(same) }
    }

    /// Whether its name leaves open if its clocks are moved in summer.
    pub(super) const fn is_either(&self) -> bool {
        self.either
    }

    /// The name as --tz takes it.
    pub(super) fn option(&self) -> String {
        let name = self.zone.iana_name().filter(|name| *name != "UTC").unwrap_or(&self.name);
        if name.contains(' ') { format!("{name:?}") } else { name.to_owned() }
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
    fn a_city_in_a_heading_is_a_zone_and_a_part_of_the_plant_is_not() {
        let zone = |name: &str| Said::by_heading(name).zone.map(|zone| zone.option());
        assert_eq!(zone("Time (Berlin)").as_deref(), Some("Europe/Berlin"));
        assert_eq!(zone("Time (New York)").as_deref(), Some("America/New_York"));
        for part in ["North", "West", "Central", "East", "Center"] {
            assert_eq!(zone(&format!("Time ({part})")), None, "{part}");
        }
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
        let of = |name: &str| Said::by_heading(name);
        for (name, zone) in [
            ("Time (UTC)", Some("UTC")),
            ("timestamp_utc", Some("UTC")),
            ("Timestamp GMT+1", Some("+1")),
            ("Time (UTC+02:00)", Some("+02:00")),
            ("Time (Europe/Berlin)", Some("Europe/Berlin")),
            ("Time (Berlin)", Some("Europe/Berlin")),
            ("Time (New York)", Some("America/New_York")),
            ("Time (W. Europe Standard Time)", Some("W. Europe Standard Time")),
            ("Time (Central European Time)", Some("Central European Time")),
            ("Time", None),
            ("Time (local)", None),
        ] {
            assert_eq!(of(name).zone.map(|zone| zone.name().to_owned()).as_deref(), zone, "{name}");
        }
        assert_eq!(
            ["Zeit [MESZ]", "Time CET", "t [s]"].map(|name| of(name).letters),
            [Some(*b"MESZ\0"), Some(*b"CET\0\0"), None]
        );
        let unknown = ["Time (Munich)", "Time (Atlantis Standard Time)", "Time (local)", "t [s]", "Time (min)"];
        let unknown = unknown.map(|name| of(name).unknown.is_some());
        assert_eq!(unknown, [true, true, false, false, false]);
        // Summer time is open where a region is named, not where a zone is.
        let agrees = |tz: &str, name: &str| Zone::parse(tz).unwrap().agrees(&of(name).zone.unwrap());
        for (tz, agreed) in [("UTC", false), ("Europe/London", false), ("Europe/Paris", true), ("+01:00", true)] {
            assert_eq!(agrees(tz, "Time (Central European Time)"), agreed, "{tz}");
        }
        assert!(!agrees("+01:00", "Time (Berlin)"));
    }

    #[test]
    fn lines_above_the_names_say_the_zone_if_they_speak_of_times() {
        let of = |text: &str| {
            let said = Said::by_line(2, text);
            said.zone.map(|z| z.name().to_owned()).or(said.letters.map(in_words)).or(said.unknown)
        };
        for (text, zone) in [
            ("# Time zone: Europe/Berlin", Some("Europe/Berlin")),
            ("# Timezone=Berlin", Some("Europe/Berlin")),
            ("# all times in UTC", Some("UTC")),
            ("Zeitzone, MEZ", Some("MEZ")),
            ("Time zone, AUS Eastern Standard Time", Some("AUS Eastern Standard Time")),
            ("Time zone: W. Europe Standard Time", Some("W. Europe Standard Time")),
            ("Time zone: Atlantis", Some("Atlantis")),
            ("# exported on 2026-06-15 at 08:00 UTC, time of the server", None),
            ("# Plant 41, June", None),
            ("# Time series, Berlin", None),
            ("# Start time: local", None),
        ] {
            assert_eq!(of(text).as_deref(), zone, "{text}");
        }
        let shown = Said::by_line(1, "Time zone: (UTC+01:00) Amsterdam, Berlin, Rome").zone.unwrap();
        assert!(shown.is_either() && Zone::parse("Europe/Berlin").unwrap().agrees(&shown));
    }

    #[test]
    fn zones_have_several_names() {
        for name in ["UTC", "Europe/Berlin", "+01:00", "-3", "W. Europe Standard Time", "CET-1CEST,M3.5.0,M10.5.0/3"] {
            assert!(Zone::parse(name).is_ok(), "{name}");
        }
        assert!(Zone::parse("Middle Earth").unwrap_err().contains("Europe/Berlin"));
    }
}
