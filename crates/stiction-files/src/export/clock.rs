//! The meaning of a whole time column: its form, recognised from all cells, and the instants.

use jiff::civil::DateTime;
use jiff::tz::Offset;

use super::ExportError;
use super::stamp::{Civil, HOUR_NS, Number, Order, Stamp};
use super::zone::{Letters, Reading, Zone, in_words};
use crate::conventions::{BY_SIZE, DATENUM_1970, EXCEL_1904_1970, EXCEL_1970, NET_1970, NUMBERS, unit_of_time};
use stiction::core::units::{NS_PER_S, format_rfc3339, s_from_ns};

/// Earliest year accepted without an option.
const FIRST_YEAR: i64 = 1990;
/// Seconds from 1970 to 1990.
const FIRST_S: i64 = 631_152_000;
/// Seconds in a day.
const DAY_S: i64 = 86_400;
/// Resolution of day numbers, which are fractions of a day; finer steps are rounding errors.
const DAYS_GRAIN_NS: i64 = 1_000_000;
/// Shortest sampling time accepted without an option, s.
const LEAST_SAMPLING_S: f64 = 1e-3;
/// Steps of day numbers longer than this, in days, are not the sampling of a loop.
const LONGEST_DAYS: f64 = 0.5;

/// Time format of a column, given or recognised.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TimeFormat {
    /// Numbers in units of this many ns since 1970 UTC.
    Epoch(i64),
    /// Days since this many days before 1970, local time.
    Days(i64),
    /// Hundreds of ns since this many of them before 1970: local time in .NET, UTC in Windows.
    Ticks(i64),
    /// Dates with this order of day, month and year.
    Dated(Order),
    /// A strftime pattern.
    Pattern(String),
}

impl TimeFormat {
    /// Parses the value of --time-format.
    ///
    /// # Errors
    /// A sentence that lists the valid values.
    pub fn parse(text: &str) -> Result<Self, String> {
        if let Some((_, form)) = NUMBERS.iter().find(|(word, _)| *word == text) {
            return Ok(form.clone());
        }
        if let Some(order) = Order::ALL.into_iter().find(|o| o.word() == text) {
            return Ok(Self::Dated(order));
        }
        if text == "iso" {
            return Ok(Self::Dated(Order::Ymd));
        }
        if text.contains('%') {
            return Ok(Self::Pattern(text.to_owned()));
        }
        let known = "s, ms, us, ns, min, h, d, excel, excel1904, datenum, ticks, filetime, ymd, dmy, mdy, or a pattern such as %d/%m/%Y %H:%M:%S";
        Err(format!("{text:?} is not a time format; write {known}"))
    }

    /// Parses the value of --time-unit.
    ///
    /// # Errors
    /// A sentence that lists the valid values.
    pub fn unit(text: &str) -> Result<Self, String> {
        let unit = unit_of_time(text).map(Self::Epoch);
        unit.ok_or_else(|| format!("{text:?} is not a unit of time; write s, ms, us, ns, min, h or d"))
    }

    /// Its word in --time-format.
    fn word(&self) -> &'static str {
        NUMBERS.iter().find(|(_, form)| form == self).map_or("", |(word, _)| word)
    }

    /// In a few words.
    fn words(&self) -> String {
        match self {
            Self::Epoch(_) => format!("{} since 1970", self.word()),
            Self::Ticks(NET_1970) => ".NET ticks".to_owned(),
            Self::Ticks(_) => "Windows file times".to_owned(),
            Self::Days(DATENUM_1970) => "MATLAB day numbers".to_owned(),
            Self::Days(EXCEL_1904_1970) => "Excel day numbers since 1904".to_owned(),
            Self::Days(_) => "Excel day numbers".to_owned(),
            Self::Dated(Order::Ymd) => "year-month-day".to_owned(),
            Self::Dated(Order::Dmy) => "day first".to_owned(),
            Self::Dated(Order::Mdy) => "month first".to_owned(),
            Self::Pattern(pattern) => format!("by {pattern}"),
        }
    }

    /// A number in this format: local time or instant.
    fn of_number(&self, number: Number) -> Option<Stamp> {
        match self {
            Self::Epoch(unit) => {
                // Binary fractions of a second since 1970 are good to a quarter of a microsecond.
                number.in_ns(*unit).map(Stamp::Instant)
            }
            Self::Days(of_1970) => {
                let days = number.value - *of_1970 as f64;
                let grains = (days * (DAY_S * NS_PER_S / DAYS_GRAIN_NS) as f64).round();
                (grains.abs() < 9e12).then(|| Stamp::Local(grains as i64 * DAYS_GRAIN_NS))
            }
            Self::Ticks(of_1970) => {
                let ns = number.whole.checked_sub(*of_1970)?.checked_mul(100)?;
                Some(if *of_1970 == NET_1970 { Stamp::Local(ns) } else { Stamp::Instant(ns) })
            }
            Self::Dated(_) | Self::Pattern(_) => None,
        }
    }
}

/// The timestamps of a column and what else is known about them.
#[derive(Debug, Default)]
pub(super) struct Axis {
    /// The column's name, for messages.
    pub name: String,
    /// The unit that the column's name gives: numbers count from any start.
    pub unit: Option<TimeFormat>,
    /// Whether the column is called `t`: numbers may count seconds from any start.
    pub is_t: bool,
    /// The zone that the column's name gives.
    pub named_zone: Option<Zone>,
    /// Letters such as CET in the column's name.
    pub letters: Option<Letters>,
    /// One per row.
    pub stamps: Vec<Stamp>,
    /// Line numbers of the rows.
    pub lines: Vec<u64>,
}

/// Options on times.
#[derive(Debug, Clone, Copy)]
pub(super) struct TimeOptions<'o> {
    /// Time format.
    pub form: Option<&'o TimeFormat>,
    /// Zone of local times.
    pub zone: Option<&'o Zone>,
    /// First second that is not accepted: the end of next year.
    pub end_s: i64,
}

/// Instants of a time axis, and how they were recognised.
#[derive(Debug)]
pub(super) struct Times {
    /// ns since 1970 UTC, one per row.
    pub t_ns: Vec<i64>,
    /// What was recognised.
    pub words: String,
    /// Number of steps forward from one row to the next.
    pub forward: u64,
    /// Number of steps back.
    pub backward: u64,
}

/// The first second after next year.
pub(super) fn end_of_next_year(now_s: i64) -> i64 {
    let now = jiff::Timestamp::from_second(now_s).unwrap_or(jiff::Timestamp::UNIX_EPOCH);
    let year = i64::from(Offset::UTC.to_datetime(now).year()) + 2;
    jiff::civil::Date::new(i16::try_from(year).unwrap_or(i16::MAX), 1, 1)
        .ok()
        .and_then(|d| Offset::UTC.to_timestamp(d.to_datetime(jiff::civil::Time::midnight())).ok())
        .map_or(i64::MAX / NS_PER_S, jiff::Timestamp::as_second)
}

impl Axis {
    /// Adds a row and returns its index.
    pub(super) fn push(&mut self, stamp: Stamp, line: u64) -> u32 {
        self.stamps.push(stamp);
        self.lines.push(line);
        u32::try_from(self.stamps.len() - 1).unwrap_or(u32::MAX)
    }

    /// Finds the meaning of the column. Each of `groups` is a set of rows with a common clock (all rows, or those of a tag).
    pub(super) fn times(&self, groups: &[Vec<u32>], asked: TimeOptions<'_>) -> Result<Times, ExportError> {
        let (form, why) = self.form(asked)?;
        let named = self.unit.is_some() || self.is_t;
        let own = self.is_t && self.unit.is_some();
        let from_anywhere = named && (own || self.stamps.first().is_some_and(|s| !s.is_dated()));
        let first_s = if from_anywhere { i64::MIN } else { FIRST_S };
        let clocks = self.clocks(form.as_ref())?;
        // Some with a zone and some without would be read by two clocks.
        let local = clocks.iter().position(|(stamp, _)| matches!(stamp, Stamp::Local(_)));
        let instant = clocks.iter().position(|(stamp, _)| matches!(stamp, Stamp::Instant(_)));
        if let (Some(local), Some(instant)) = (local, instant) {
            return Err(self.mixed(local.max(instant), local.min(instant)));
        }
        let mut t_ns = vec![0; clocks.len()];
        let (mut forward, mut backward, mut twice, mut zoned) = (0, 0, 0, false);
        for rows in groups {
            let read = self.group(rows, &clocks, asked)?;
            rows.iter().zip(&read.t_ns).for_each(|(row, ns)| t_ns[*row as usize] = *ns);
            forward += read.forward;
            backward += read.backward;
            twice += read.twice;
            zoned |= read.zoned;
            if asked.form.is_none() {
                self.check(rows, &t_ns, first_s..asked.end_s)?;
                self.check_sampling(rows, &t_ns)?;
            }
            self.check_days(rows, &t_ns)?;
        }
        let mut words = form.map_or_else(|| "typed".to_owned(), |f| f.words()) + &why;
        if let (true, Some(zone)) = (zoned, asked.zone.or(self.named_zone.as_ref())) {
            words += &format!(", {}", zone.name());
            if twice > 0 {
                words += &format!(
                    " (includes the repeated hour{})",
                    if twice > groups.len() { " several times" } else { "" }
                );
            }
        }
        Ok(Times { t_ns, words, forward, backward })
    }

    fn fault(&self, row: usize, what: String, remedy: &str) -> ExportError {
        ExportError::at(self.lines.get(row).copied().unwrap_or(0), what, remedy)
    }

    /// The format of all cells, with the reason if it is not obvious.
    fn form(&self, asked: TimeOptions<'_>) -> Result<(Option<TimeFormat>, String), ExportError> {
        if let Some(form) = asked.form {
            return Ok((Some(form.clone()), String::new()));
        }
        let Some((at, first)) =
            self.stamps.iter().enumerate().find(|(_, s)| matches!(s, Stamp::Number(_) | Stamp::Civil(_)))
        else {
            return Ok((None, String::new()));
        };
        match first {
            Stamp::Number(_) => self.form_of_numbers(asked.end_s, at).map(|f| (Some(f), String::new())),
            _ => self.form_of_dates(asked.end_s),
        }
    }

    /// The unit in the column's name, else the one for which every number is between 1990 and the end of next year.
    fn form_of_numbers(&self, end_s: i64, first: usize) -> Result<TimeFormat, ExportError> {
        let numbers = self.stamps.iter().enumerate().map(|(row, stamp)| match stamp {
            Stamp::Number(number) => Ok((row, *number)),
            _ => Err(self.mixed(row, first)),
        });
        let numbers: Vec<(usize, Number)> = numbers.collect::<Result<_, _>>()?;
        let seconds = |form: &TimeFormat, n: Number| match form.of_number(n) {
            Some(Stamp::Instant(ns) | Stamp::Local(ns)) => Some(ns.div_euclid(NS_PER_S)),
            _ => None,
        };
        let plausible = |form: &TimeFormat, n: Number| seconds(form, n).is_some_and(|s| (FIRST_S..end_s).contains(&s));
        if let Some(unit) = &self.unit {
            self.doubt_days(unit, &numbers, plausible)?;
            let others =
                NUMBERS[..BY_SIZE].iter().map(|(_, form)| form).filter(|form| !matches!(form, TimeFormat::Days(_)));
            let other =
                others.into_iter().find(|form| *form != unit && numbers.iter().all(|(_, n)| plausible(form, *n)));
            if let Some(other) = other.filter(|_| numbers.iter().all(|(_, n)| !plausible(unit, *n))) {
                let (row, number) = numbers[0];
                let (named, other) = (unit.word(), other.word());
                let text =
                    format!("{:?} contains {}, a time of today in {other}, not in {named}", self.name, number.value);
                return Err(self.fault(row, text, &format!("use --time-format {other} or --time-format {named}")));
            }
            let late = numbers.iter().find(|(_, n)| seconds(unit, *n).is_none_or(|s| s >= end_s));
            return late.map_or(Ok(unit.clone()), |(row, number)| {
                let text =
                    format!("{:?} contains {}, in {} later than next year", self.name, number.value, unit.word());
                Err(self.fault(*row, text, "give the format: --time-format s, ms, us, ns or ticks"))
            });
        }
        let mut left: Vec<&TimeFormat> = NUMBERS[..BY_SIZE].iter().map(|(_, form)| form).collect();
        for (row, number) in &numbers {
            left.retain(|form| plausible(form, *number));
            if left.is_empty() {
                if self.is_t {
                    return Ok(TimeFormat::Epoch(NS_PER_S));
                }
                let text = format!(
                    "{:?} contains {}, which is not a time between {FIRST_YEAR} and next year in s, ms, us, ns, ticks, Excel or MATLAB days",
                    self.name, number.value
                );
                let remedy =
                    "give the format: --time-format s (from any start), ms, min, h, excel, datenum, or a pattern";
                return Err(self.fault(*row, text, remedy));
            }
        }
        if let [one, other, ..] = left[..] {
            let text = format!(
                "{:?} contains {}, which may be {} or {}",
                self.name,
                numbers[0].1.whole,
                one.words(),
                other.words()
            );
            let remedy = format!("choose one: --time-format {} or --time-format {}", other.word(), one.word());
            return Err(self.fault(numbers[0].0, text, &remedy));
        }
        if self.is_t {
            let seconds = TimeFormat::Epoch(NS_PER_S);
            self.doubt_days(&seconds, &numbers, plausible)?;
            if matches!(left[0], TimeFormat::Days(_)) {
                return Ok(seconds);
            }
        }
        Ok(left[0].clone())
    }

    /// `t` above 46000 in fine steps may be seconds of a long record, or days of a spreadsheet.
    fn doubt_days(
        &self,
        unit: &TimeFormat,
        numbers: &[(usize, Number)],
        plausible: impl Fn(&TimeFormat, Number) -> bool,
    ) -> Result<(), ExportError> {
        let Some((row, first)) = numbers.first().filter(|_| *unit == TimeFormat::Epoch(NS_PER_S)) else {
            return Ok(());
        };
        let mut steps: Vec<f64> =
            numbers.windows(2).map(|w| (w[1].1.value - w[0].1.value).abs()).filter(|s| *s > 0.0).collect();
        if steps.is_empty() || *median(&mut steps) >= LONGEST_DAYS {
            return Ok(());
        }
        let days = [TimeFormat::Days(EXCEL_1970), TimeFormat::Days(DATENUM_1970)];
        let days = days.iter().find(|days| numbers.iter().all(|(_, n)| plausible(days, *n)));
        days.map_or(Ok(()), |days| {
            let text = format!("{:?} contains {}, which may be seconds or {}", self.name, first.value, days.words());
            Err(self.fault(*row, text, &format!("use --time-format s or --time-format {}", days.word())))
        })
    }

    /// The order of day, month and year that fits all rows.
    fn form_of_dates(&self, end_s: i64) -> Result<(Option<TimeFormat>, String), ExportError> {
        let mut left: Vec<Order> = Order::ALL.to_vec();
        let (mut why, mut first) = (String::new(), None);
        for (row, stamp) in self.stamps.iter().enumerate() {
            let civil = match stamp {
                Stamp::Civil(civil) => *civil,
                Stamp::Number(_) => return Err(self.mixed(row, first.unwrap_or(0))),
                _ => continue,
            };
            let before = left.clone();
            left.retain(|order| civil.date(*order).is_some());
            let started = first.get_or_insert(row);
            if left.is_empty() {
                let text = if before.len() == 3 {
                    "this date does not exist".to_owned()
                } else {
                    let words: Vec<&str> = before.iter().map(|o| o.word()).collect();
                    format!("this date cannot be {} like those from line {}", words.join(" or "), self.lines[*started])
                };
                return Err(self.fault(row, text, "correct it, or give the format with --time-format"));
            }
            if before.len() > 1 && left.len() == 1 && row > *started {
                why = format!(" (line {} shows it)", self.lines[row]);
            }
        }
        // The year tells where only one order lies in the years believed.
        let believed = |order: &Order| {
            self.stamps
                .iter()
                .filter_map(|s| civil_of(s)?.local_ns(*order))
                .all(|ns| (FIRST_S..end_s).contains(&ns.div_euclid(NS_PER_S)))
        };
        if left.len() > 1 && left.iter().any(believed) {
            left.retain(believed);
        }
        if left.len() > 1 {
            let (order, reason) = self.settle(&left, first.unwrap_or(0))?;
            return Ok((Some(TimeFormat::Dated(order)), reason));
        }
        let named = self.stamps.iter().filter_map(civil_of).any(Civil::has_named_month);
        let why = if named { " with the month's name".to_owned() } else { why };
        Ok((Some(TimeFormat::Dated(left[0])), why))
    }

    /// Two orders fit every row: the change at midnight may decide.
    fn settle(&self, left: &[Order], first: usize) -> Result<(Order, String), ExportError> {
        let civils: Vec<(usize, Civil)> =
            self.stamps.iter().enumerate().filter_map(|(row, s)| civil_of(s).map(|c| (row, c))).collect();
        let same = civils.iter().all(|(_, c)| left.iter().all(|o| c.local_ns(*o) == c.local_ns(left[0])));
        if same {
            return Ok((left[0], String::new()));
        }
        let mut told: Option<(Order, usize)> = None;
        for pair in civils.windows(2).filter(|w| !w[0].1.same_date(w[1].1)) {
            let step = |o: &Order| Some((pair[1].1.local_ns(*o)? - pair[0].1.local_ns(*o)?).abs());
            let mut near = left.iter().filter(|o| step(o).is_some_and(|s| s <= HOUR_NS));
            if let (Some(order), None) = (near.next(), near.next()) {
                if told.is_some_and(|(other, _)| other != *order) {
                    told = None;
                    break;
                }
                told.get_or_insert((*order, pair[1].0));
            }
        }
        if let Some((order, row)) = told {
            return Ok((order, format!(" (midnight at line {} shows it)", self.lines[row])));
        }
        let readings: Vec<String> = left
            .iter()
            .filter_map(|o| civils[0].1.date(*o).map(|d| format!("{d} (--time-format {})", o.word())))
            .collect();
        let text = format!("this date may be {}, and no row of the file decides", readings.join(" or "));
        Err(self.fault(first, text, "choose with --time-format"))
    }

    fn mixed(&self, row: usize, first: usize) -> ExportError {
        let text = format!("time written differently from line {}", self.lines.get(first).copied().unwrap_or(0));
        self.fault(row, text, "write all times alike")
    }

    /// Every timestamp as a local time or an instant.
    fn clocks(&self, form: Option<&TimeFormat>) -> Result<Vec<Clock>, ExportError> {
        let read = |row: usize, stamp: &Stamp| {
            let read = match (stamp, form) {
                (Stamp::Number(n), Some(form)) => form.of_number(*n).map(|s| (s, None)),
                (Stamp::Civil(c), Some(TimeFormat::Dated(order))) => c.local_ns(*order).map(|ns| match c.offset_s {
                    Some(offset) => (Stamp::Instant(ns.saturating_sub(i64::from(offset) * NS_PER_S)), None),
                    None => (Stamp::Local(ns), c.zone),
                }),
                (typed @ (Stamp::Local(_) | Stamp::Instant(_)), _) => Some((*typed, None)),
                _ => None,
            };
            read.ok_or_else(|| {
                let form = form.map_or_else(String::new, TimeFormat::words);
                self.fault(row, format!("this time cannot be read as {form}"), "give another --time-format, or omit it")
            })
        };
        self.stamps.iter().enumerate().map(|(row, stamp)| read(row, stamp)).collect()
    }

    /// The zone of local times: as asked, which must be that of the column's name.
    fn zone<'a>(&'a self, row: usize, clocks: &[Clock], asked: TimeOptions<'a>) -> Result<&'a Zone, ExportError> {
        match (asked.zone, &self.named_zone) {
            (Some(zone), Some(named)) if !zone.agrees(named) => {
                let text = format!("the heading {:?} names {}, --tz gives {}", self.name, named.name(), zone.name());
                Err(self.fault(row, text, &format!("leave --tz out, or give --tz {}", named.name())))
            }
            (zone, named) => zone.or(named.as_ref()).ok_or_else(|| self.without_zone(row, clocks)),
        }
    }

    /// Instants of the rows of one clock.
    fn group(&self, rows: &[u32], clocks: &[Clock], asked: TimeOptions<'_>) -> Result<Group, ExportError> {
        let raw = |row: u32| match clocks[row as usize].0 {
            Stamp::Instant(ns) | Stamp::Local(ns) => ns,
            Stamp::Number(_) | Stamp::Civil(_) => 0,
        };
        let steps = |back: bool| {
            rows.windows(2).filter(|w| if back { raw(w[1]) < raw(w[0]) } else { raw(w[1]) > raw(w[0]) }).count() as u64
        };
        let (forward, backward) = (steps(false), steps(true));
        let Some(first) = rows.iter().find(|row| matches!(clocks[**row as usize].0, Stamp::Local(_))) else {
            return Ok(Group {
                t_ns: rows.iter().map(|row| raw(*row)).collect(),
                forward,
                backward,
                twice: 0,
                zoned: false,
            });
        };
        let zone = self.zone(*first as usize, clocks, asked)?;
        let mut ordered: Vec<u32> = rows.to_vec();
        if backward > forward {
            ordered.reverse();
        }
        let reading = |row: &u32| Reading {
            local_ns: raw(*row),
            letters: clocks[*row as usize].1.or(self.letters),
            line: self.lines[*row as usize],
        };
        let (mut t_ns, twice) = zone.instants(&ordered.iter().map(reading).collect::<Vec<_>>())?;
        if backward > forward {
            t_ns.reverse();
        }
        Ok(Group { t_ns, forward, backward, twice, zoned: true })
    }

    fn without_zone(&self, row: usize, clocks: &[Clock]) -> ExportError {
        let (Stamp::Local(ns) | Stamp::Instant(ns), zone) = clocks[row] else {
            return self.fault(row, "unreadable time".into(), "give the format with --time-format");
        };
        let shown = format_rfc3339(ns).replace('Z', "").replace('T', " ");
        let text = match zone {
            Some(found) => format!(
                "{:?} contains {shown} {}, whose letters name a zone for half of the year only",
                self.name,
                in_words(found)
            ),
            None => format!("{:?} contains {shown} without a time zone", self.name),
        };
        self.fault(row, text, "give the time zone: --tz Europe/Berlin, or --tz UTC")
    }

    fn check(&self, rows: &[u32], t_ns: &[i64], believed_s: std::ops::Range<i64>) -> Result<(), ExportError> {
        let odd = rows.iter().find(|row| !believed_s.contains(&t_ns[**row as usize].div_euclid(NS_PER_S)));
        odd.map_or(Ok(()), |row| {
            let when = format_rfc3339(t_ns[*row as usize]);
            let text = format!("{:?} gives {when}, which is not between {FIRST_YEAR} and next year", self.name);
            Err(self.fault(
                *row as usize,
                text,
                "if that is right, give the format: --time-format s, ymd, dmy, mdy or a pattern",
            ))
        })
    }

    /// Several rows of one date without a time of day lack it.
    fn check_days(&self, rows: &[u32], t_ns: &[i64]) -> Result<(), ExportError> {
        let no_clock = |row: &u32| civil_of(&self.stamps[*row as usize]).is_some_and(|civil| civil.clock_ns == 0);
        let same = rows.windows(2).find(|w| t_ns[w[0] as usize] == t_ns[w[1] as usize]);
        match same {
            Some(pair) if rows.iter().all(no_clock) => {
                let text = format!("{:?} gives the same date as the row before, without a time of day", self.name);
                Err(self.fault(pair[1] as usize, text, "name a column with date and time: --map t=COLUMN,op=…,pv=…"))
            }
            _ => Ok(()),
        }
    }

    fn check_sampling(&self, rows: &[u32], t_ns: &[i64]) -> Result<(), ExportError> {
        let mut ordered: Vec<i64> = rows.iter().map(|row| t_ns[*row as usize]).collect();
        ordered.sort_unstable();
        check_sampling(&ordered).map_err(|step_s| {
            let text = format!("{:?} steps by {step_s:.3e} s, faster than loops are sampled", self.name);
            self.fault(0, text, "give the format: --time-format s, ms, us, ns, ticks, excel or datenum")
        })
    }
}

/// A local time or an instant, and letters such as CEST after it.
type Clock = (Stamp, Option<Letters>);

struct Group {
    t_ns: Vec<i64>,
    forward: u64,
    backward: u64,
    twice: usize,
    zoned: bool,
}

fn civil_of(stamp: &Stamp) -> Option<Civil> {
    if let Stamp::Civil(civil) = stamp { Some(*civil) } else { None }
}

fn median(values: &mut [f64]) -> &f64 {
    let middle = values.len() / 2;
    values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Whether the typical step of sorted timestamps is at least a millisecond; else that step in s.
pub(super) fn check_sampling(ordered_ns: &[i64]) -> Result<(), f64> {
    let mut steps: Vec<f64> =
        ordered_ns.windows(2).map(|w| s_from_ns(w[1].saturating_sub(w[0]))).filter(|s| *s > 0.0).collect();
    if steps.is_empty() {
        return Ok(());
    }
    let step_s = *median(&mut steps);
    if step_s < LEAST_SAMPLING_S { Err(step_s) } else { Ok(()) }
}

/// A time by a strftime pattern.
pub(super) fn by_pattern(pattern: &str, text: &str) -> Option<Stamp> {
    let parsed = jiff::fmt::strtime::parse(pattern, text).ok()?;
    if parsed.offset().is_some() {
        let ns = parsed.to_timestamp().ok()?.as_nanosecond();
        return i64::try_from(ns).ok().map(Stamp::Instant);
    }
    let civil: DateTime = parsed
        .to_datetime()
        .or_else(|_| parsed.to_date().map(|d| d.to_datetime(jiff::civil::Time::midnight())))
        .ok()?;
    let ns = Offset::UTC.to_timestamp(civil).ok()?.as_nanosecond();
    i64::try_from(ns).ok().map(Stamp::Local)
}
