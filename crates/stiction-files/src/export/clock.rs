//! The meaning of a whole time column: its form, recognised from all cells, and the instants.

use jiff::tz::Offset;

use super::ExportError;
use super::columns::TimeColumn;
use super::stamp::{HOUR_NS, Number, Order, Stamp, local_ns};
use super::zone::{Letters, Reading, Zone, in_words};
use crate::conventions::{BY_SIZE, DATENUM_1970, EXCEL_1904_1970, EXCEL_1970, NET_1970, NUMBERS, unit_of_time};
use stiction::core::units::{NS_PER_S, format_rfc3339, s_from_ns};

/// Earliest year accepted without an option.
const FIRST_YEAR: i64 = 1990;
/// Seconds from 1970 to 1990.
const FIRST_S: i64 = 631_152_000;
/// How old a time may be if its unit is not given, s before the end of next year. Older ones are asked about: seconds since
/// 1980 or 2001, read as seconds since 1970, come out 10 or 31 years too early.
const LATE_S: i64 = 11 * 31_557_600;
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
    fn of_number(&self, number: Number) -> Option<Clock> {
        let (ns, local) = match self {
            Self::Epoch(unit) => (number.in_ns(*unit)?, false),
            Self::Days(of_1970) => {
                let days = number.value - *of_1970 as f64;
                let grains = (days * (DAY_S * NS_PER_S / DAYS_GRAIN_NS) as f64).round();
                ((grains.abs() < 9e12).then(|| grains as i64 * DAYS_GRAIN_NS)?, true)
            }
            Self::Ticks(of_1970) => (number.whole.checked_sub(*of_1970)?.checked_mul(100)?, *of_1970 == NET_1970),
            Self::Dated(_) | Self::Pattern(_) => return None,
        };
        Some(Clock { ns, local, letters: None })
    }
}

/// The timestamps of a column.
#[derive(Debug, Default)]
pub(super) struct Axis {
    /// The column, and what its name says.
    pub column: TimeColumn,
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
    let start = jiff::civil::Date::new(i16::try_from(year).unwrap_or(i16::MAX), 1, 1).ok();
    start.and_then(|day| local_ns(day.at(0, 0, 0, 0))).unwrap_or(i64::MAX) / NS_PER_S
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
        let column = &self.column;
        let numbers = self.stamps.first().is_some_and(|s| !s.is_dated());
        let from_anywhere = (column.is_t && (numbers || column.unit.is_some())) || (column.unit.is_some() && numbers);
        let clocks = self.clocks(form.as_ref())?;
        let mut all = Times { t_ns: vec![0; clocks.len()], words: String::new(), forward: 0, backward: 0 };
        let (mut twice, mut zone) = (0, None);
        for rows in groups {
            let t_ns = match rows.iter().find(|row| clocks[**row as usize].local) {
                None => rows.iter().map(|row| clocks[*row as usize].ns).collect(),
                Some(first) => {
                    let own = self.zone(*first as usize, clocks[*first as usize], asked)?;
                    zone = Some(own);
                    let (t_ns, hours) = self.instants(rows, &clocks, own)?;
                    twice += hours;
                    t_ns
                }
            };
            let (forward, backward) = steps(&t_ns);
            (all.forward, all.backward) = (all.forward + forward, all.backward + backward);
            if asked.form.is_none() {
                self.check(rows, &t_ns, if from_anywhere { i64::MIN } else { FIRST_S }..asked.end_s)?;
            }
            self.check_days(rows, &t_ns)?;
            rows.iter().zip(t_ns).for_each(|(row, ns)| all.t_ns[*row as usize] = ns);
        }
        all.words = form.map_or_else(|| "typed".to_owned(), |f| f.words()) + why;
        if let Some(zone) = zone {
            let more = if twice > groups.len() { " several times" } else { "" };
            let repeated = if twice > 0 { format!(" (includes the repeated hour{more})") } else { String::new() };
            all.words += &format!(", {}{repeated}", zone.name());
        }
        Ok(all)
    }

    fn fault(&self, row: usize, what: String, remedy: &str) -> ExportError {
        ExportError::at(self.lines.get(row).copied().unwrap_or(0), what, remedy)
    }

    /// The format of all cells, with the reason if it is not obvious.
    fn form(&self, asked: TimeOptions<'_>) -> Result<(Option<TimeFormat>, &'static str), ExportError> {
        let written = |s: &Stamp| matches!(s, Stamp::Number(_) | Stamp::Civil(_));
        match (asked.form, self.stamps.iter().find(|stamp| written(stamp))) {
            (Some(form), _) => Ok((Some(form.clone()), "")),
            (None, None) => Ok((None, "")),
            (None, Some(Stamp::Number(_))) => self.form_of_numbers(asked.end_s).map(|f| (Some(f), "")),
            (None, Some(_)) => {
                self.form_of_dates(asked.end_s).map(|(order, why)| (Some(TimeFormat::Dated(order)), why))
            }
        }
    }

    /// The unit in the column's name, else the one for which every number is a time of the last years.
    fn form_of_numbers(&self, end_s: i64) -> Result<TimeFormat, ExportError> {
        if let Some(row) = self.stamps.iter().position(|stamp| !matches!(stamp, Stamp::Number(_))) {
            return Err(self.mixed(row));
        }
        let numbers =
            || self.stamps.iter().filter_map(|s| if let Stamp::Number(number) = s { Some(*number) } else { None });
        let seconds = |form: &TimeFormat, n: Number| form.of_number(n).map(|clock| clock.ns.div_euclid(NS_PER_S));
        let outside = |form: &TimeFormat, from_s: i64| {
            numbers().position(|n| seconds(form, n).is_none_or(|s| !(from_s..end_s).contains(&s)))
        };
        let value = |row: usize| numbers().nth(row).map_or(0.0, |number| number.value);
        let mut steps: Vec<f64> = numbers().zip(numbers().skip(1)).map(|(a, b)| (b.value - a.value).abs()).collect();
        steps.retain(|step| *step > 0.0);
        // Whole days are not the sampling of a loop, but seconds of a long record.
        let is_days = steps.is_empty() || *median(&mut steps) < LONGEST_DAYS;
        let days = TimeFormat::Days(EXCEL_1904_1970);
        let is_1900 = |form: &TimeFormat| *form == TimeFormat::Days(EXCEL_1970);
        let own = |form| if self.column.since_1904 && is_1900(form) { &days } else { form };
        let all = NUMBERS[..BY_SIZE].iter().map(|(_, form)| own(form));
        let fits: Vec<&TimeFormat> = all
            .clone()
            .filter(|form| (is_days || !matches!(form, TimeFormat::Days(_))) && outside(form, FIRST_S).is_none())
            .collect();
        let (name, first) = (&self.column.name, value(0));
        let two = |what: String, one: &TimeFormat, other: &TimeFormat| {
            let remedy = format!("use --time-format {} or --time-format {}", one.word(), other.word());
            Err(self.fault(0, format!("{name:?} contains {first}, {what}"), &remedy))
        };
        let count = TimeFormat::Epoch(NS_PER_S);
        let by_name = self.column.unit.as_ref().or_else(|| {
            let counted = fits.iter().all(|form| matches!(form, TimeFormat::Days(_)));
            (self.column.is_t && counted).then_some(&count)
        });
        let mut late = fits.iter().copied().filter(|form| outside(form, end_s - LATE_S).is_none());
        let sole = late.next().filter(|_| late.next().is_none());
        match (by_name, &fits[..]) {
            (Some(unit), [first, ..]) if !fits.contains(&unit) => {
                let other = sole.unwrap_or(first);
                two(format!("a time of today in {}, not in {}", other.words(), unit.word()), other, unit)
            }
            (Some(unit), _) => outside(unit, i64::MIN).map_or(Ok(unit.clone()), |row| {
                let what = format!("{name:?} contains {}, in {} later than next year", value(row), unit.word());
                Err(self.fault(row, what, "give the format: --time-format s, ms, us, ns or ticks"))
            }),
            (None, [one]) if sole.is_some() || self.column.is_t => Ok((*one).clone()),
            (None, [one]) => {
                let row = outside(one, end_s - LATE_S).unwrap_or(0);
                let year = numbers().nth(row).and_then(|n| seconds(one, n)).map_or(0, |s| 1970 + s / 31_556_952);
                let what = format!("{name:?} contains {}, in {} a time of {year}", value(row), one.words());
                Err(self.fault(row, what, &format!("use --time-format {} if that is right", one.word())))
            }
            (None, [one, other, ..]) => two(format!("which may be {} or {}", one.words(), other.words()), other, one),
            (None, []) => {
                let row = all.filter_map(|form| outside(form, FIRST_S)).max().unwrap_or(0);
                let what = format!(
                    "{name:?} contains {}, which is not a time between {FIRST_YEAR} and next year in s, ms, us, ns, ticks, Excel or MATLAB days",
                    value(row)
                );
                let remedy =
                    "give the format: --time-format s (from any start), ms, min, h, excel, datenum, or a pattern";
                Err(self.fault(row, what, remedy))
            }
        }
    }

    /// The order of day, month and year that fits all rows.
    fn form_of_dates(&self, end_s: i64) -> Result<(Order, &'static str), ExportError> {
        let mut left: Vec<Order> = Order::ALL.to_vec();
        for (row, stamp) in self.stamps.iter().enumerate() {
            let civil = match stamp {
                Stamp::Civil(civil) => civil,
                Stamp::Number(_) => return Err(self.mixed(row)),
                // Typed dates have one reading.
                Stamp::Local(_) | Stamp::Instant(_) => continue,
            };
            if left.iter().all(|order| civil.local_ns(*order).is_none()) {
                let words: Vec<&str> = left.iter().map(|order| order.word()).collect();
                let text = format!("this date cannot be {} like those from line {}", words.join(" or "), self.lines[0]);
                return Err(self.fault(row, text, "correct it, or give the format with --time-format"));
            }
            left.retain(|order| civil.local_ns(*order).is_some());
        }
        let civils =
            || self.stamps.iter().filter_map(|s| if let Stamp::Civil(civil) = s { Some(*civil) } else { None });
        let ns = |order: Order| civils().filter_map(move |civil| civil.local_ns(order));
        let believed = |order: &Order| ns(*order).all(|ns| (FIRST_S..end_s).contains(&ns.div_euclid(NS_PER_S)));
        // Day and month in the wrong order leap by a month at midnight.
        let runs_on = |order: &Order| ns(*order).zip(ns(*order).skip(1)).all(|(a, b)| (b - a).abs() <= HOUR_NS);
        let same = |left: &[Order]| left.iter().all(|order| ns(*order).eq(ns(left[0])));
        let told = |left: &[Order]| left.len() == 1 || same(left);
        let by_hand = told(&left);
        if !by_hand && left.iter().any(believed) {
            left.retain(believed);
        }
        let by_year = told(&left);
        if !by_year && left.iter().any(runs_on) {
            left.retain(runs_on);
        }
        if !told(&left) {
            let reading = |order: &Order| {
                let day = ns(*order).next().map(format_rfc3339).unwrap_or_default();
                format!("{} (--time-format {})", day.get(..10).unwrap_or_default(), order.word())
            };
            let readings: Vec<String> = left.iter().map(reading).collect();
            let text = format!("this date may be {}, and no row of the file decides", readings.join(" or "));
            return Err(self.fault(0, text, "choose with --time-format"));
        }
        let named = civils().any(|civil| civil.named);
        Ok((
            left[0],
            if named {
                " with the month's name"
            } else if by_year {
                ""
            } else {
                " (midnight shows it)"
            },
        ))
    }

    fn mixed(&self, row: usize) -> ExportError {
        let text = format!("time written differently from line {}", self.lines.first().copied().unwrap_or(0));
        self.fault(row, text, "write all times alike")
    }

    /// Every timestamp as a local time or an instant: of one kind, since others would be read by two clocks.
    fn clocks(&self, form: Option<&TimeFormat>) -> Result<Vec<Clock>, ExportError> {
        let mut clocks: Vec<Clock> = Vec::with_capacity(self.stamps.len());
        for (row, stamp) in self.stamps.iter().enumerate() {
            let read = match (stamp, form) {
                (Stamp::Number(n), Some(form)) => form.of_number(*n),
                (Stamp::Civil(c), Some(TimeFormat::Dated(order))) => c.local_ns(*order).map(|ns| {
                    let offset_ns = c.offset_s.map(|offset| i64::from(offset) * NS_PER_S);
                    let ns = ns.saturating_sub(offset_ns.unwrap_or(0));
                    Clock { ns, local: offset_ns.is_none(), letters: c.letters }
                }),
                (Stamp::Local(ns) | Stamp::Instant(ns), _) => {
                    Some(Clock { ns: *ns, local: matches!(stamp, Stamp::Local(_)), letters: None })
                }
                _ => None,
            };
            let clock = read.ok_or_else(|| {
                let form = form.map_or_else(String::new, TimeFormat::words);
                self.fault(row, format!("this time cannot be read as {form}"), "give another --time-format, or omit it")
            })?;
            if clocks.first().is_some_and(|first| first.local != clock.local) {
                return Err(self.mixed(row));
            }
            clocks.push(clock);
        }
        Ok(clocks)
    }

    /// The zone of local times: as asked, which must be the one that the file names.
    fn zone<'a>(&'a self, row: usize, first: Clock, asked: TimeOptions<'a>) -> Result<&'a Zone, ExportError> {
        let (name, said) = (&self.column.name, &self.column.said);
        match (asked.zone, &said.zone) {
            (Some(zone), Some(named)) if !zone.agrees(named) => {
                let text = format!("{} names {}, --tz gives {}", said.place, named.name(), zone.name());
                Err(self.fault(row, text, &format!("give --tz {}, or correct what the file says", named.option())))
            }
            (Some(zone), _) if said.unknown.is_none() || self.column.chosen => Ok(zone),
            (None, Some(zone)) if !zone.is_either() => Ok(zone),
            (Some(zone), _) => {
                let named = said.unknown.as_deref().unwrap_or_default();
                let text = format!("{} names {named:?}, which is no time zone that is known", said.place);
                let remedy =
                    format!("use --map t={},op=…,pv=… too if --tz {} is right", self.column.at + 1, zone.option());
                Err(self.fault(row, text, &remedy))
            }
            (None, named) => {
                let shown = format_rfc3339(first.ns).replace('Z', "").replace('T', " ");
                let half = |letters| format!("{} names a zone for half of the year only", in_words(letters));
                let open = |zone: &Zone| format!("{} leaves summer time open", zone.name());
                let unknown = |name: &String| format!("{name:?} is no time zone that is known");
                let letters = first.letters.or(said.letters).map(half);
                let what = letters.or(named.as_ref().map(open)).or(said.unknown.as_ref().map(unknown));
                let what = what.map_or_else(|| " without a time zone".to_owned(), |what| format!(", and {what}"));
                let zone = named.as_ref().map_or_else(|| "Europe/Berlin".to_owned(), Zone::option);
                let remedy = format!("give the time zone: --tz {zone}, or --tz UTC");
                Err(self.fault(row, format!("{name:?} contains {shown}{what}"), &remedy))
            }
        }
    }

    /// Instants of local times, and the number of repeated hours.
    fn instants(&self, rows: &[u32], clocks: &[Clock], zone: &Zone) -> Result<(Vec<i64>, usize), ExportError> {
        let reading = |row: &u32| Reading {
            local_ns: clocks[*row as usize].ns,
            letters: clocks[*row as usize].letters.or(self.column.said.letters),
            line: self.lines[*row as usize],
        };
        let mut readings: Vec<Reading> = rows.iter().map(reading).collect();
        let (forward, backward) = steps(&readings.iter().map(|r| r.local_ns).collect::<Vec<_>>());
        if backward > forward {
            readings.reverse();
        }
        let (mut t_ns, twice) = zone.instants(&readings)?;
        if backward > forward {
            t_ns.reverse();
        }
        Ok((t_ns, twice))
    }

    /// Times are of the years believed, and not faster than loops are sampled.
    fn check(&self, rows: &[u32], t_ns: &[i64], believed_s: std::ops::Range<i64>) -> Result<(), ExportError> {
        let name = &self.column.name;
        if let Some(at) = t_ns.iter().position(|ns| !believed_s.contains(&ns.div_euclid(NS_PER_S))) {
            let when = format_rfc3339(t_ns[at]);
            let text = format!("{name:?} gives {when}, which is not between {FIRST_YEAR} and next year");
            let remedy = "if that is right, give the format: --time-format s, ymd, dmy, mdy or a pattern";
            return Err(self.fault(rows[at] as usize, text, remedy));
        }
        let mut ordered = t_ns.to_vec();
        ordered.sort_unstable();
        let mut steps: Vec<f64> = ordered.windows(2).map(|w| s_from_ns(w[1].saturating_sub(w[0]))).collect();
        steps.retain(|step_s| *step_s > 0.0);
        if steps.is_empty() || *median(&mut steps) >= LEAST_SAMPLING_S {
            return Ok(());
        }
        let text = format!("{name:?} steps by {:.3e} s, faster than loops are sampled", median(&mut steps));
        Err(self.fault(rows[0] as usize, text, "give the format: --time-format s, ms, us, ns, ticks, excel or datenum"))
    }

    /// Several rows of one date without a time of day lack it.
    fn check_days(&self, rows: &[u32], t_ns: &[i64]) -> Result<(), ExportError> {
        let no_clock = |row: &u32| matches!(self.stamps[*row as usize], Stamp::Civil(civil) if civil.clock_ns == 0);
        let same = t_ns.windows(2).position(|w| w[0] == w[1]);
        same.filter(|_| rows.iter().all(no_clock)).map_or(Ok(()), |at| {
            let name = &self.column.name;
            let text = format!("{name:?} gives the same date as the row before, without a time of day");
            let remedy = "name a column with date and time: --map t=COLUMN,op=…,pv=…";
            Err(self.fault(rows[at + 1] as usize, text, remedy))
        })
    }
}

/// A local time as if it were UTC, or an instant, and letters such as CEST after it.
#[derive(Debug, Clone, Copy)]
struct Clock {
    ns: i64,
    local: bool,
    letters: Option<Letters>,
}

/// How many steps go forward, and how many back.
fn steps(t_ns: &[i64]) -> (u64, u64) {
    let count = |is: fn(i64, i64) -> bool| t_ns.windows(2).filter(|w| is(w[0], w[1])).count() as u64;
    (count(|a, b| b > a), count(|a, b| b < a))
}

fn median(values: &mut [f64]) -> &f64 {
    let middle = values.len() / 2;
    values.select_nth_unstable_by(middle, f64::total_cmp).1
}
