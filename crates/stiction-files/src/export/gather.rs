//! Rows to series: each tag's values in time order.

use std::collections::{BTreeMap, HashMap};

use super::cell::{Cell, Table};
use super::clock::{Axis, TimeOptions};
use super::columns::{Layout, Shape, TimeColumn, ValueColumn};
use super::map::Map;
use super::names::{Role, is_value, role, unit};
use super::quality::{Codes, Mark, convention, doubt};
use super::series::{Series, Taken, check_once};
use super::stamp::{Number, Stamp};
use super::{Contents, ExportError, ReadOptions};
use crate::number::{Decimal, Hint, hint, is_missing_word, is_unit, number, sentinel, with_unit};
use stiction::core::record::{Mode, Signal, Value};

/// Rows after which the search for the decimal separator stops, whether found or not.
const ENOUGH_ROWS: u64 = 20_000;
/// Most words for missing values listed.
const MOST_WORDS: usize = 6;

/// The role of a tag, from its name or from --map.
fn role_of(tag: &str, map: Option<&Map>) -> Option<Role> {
    let mapped = map.filter(|m| m.names_signals());
    match mapped {
        Some(map) => map.signal_of(tag).map(|signal| Role { loop_name: String::new(), signal, rank: 0 }),
        None => role(tag),
    }
}

/// The tag of a column: a single-signal file names it in the heading or in the file name.
fn tag_of(name: &str, alone: bool, stem: &str, map: Option<&Map>) -> String {
    if alone && map.is_some_and(|m| m.signal_of(stem).is_some()) {
        return stem.to_owned();
    }
    if alone
        && (is_value(name) || role(name).is_none_or(|r| r.loop_name.is_empty()))
        && role(stem).is_some_and(|r| !r.loop_name.is_empty())
    {
        stem.to_owned()
    } else {
        name.to_owned()
    }
}

/// The signal of a single-signal file.
pub(super) fn only_role(layout: &Layout, stem: &str, map: Option<&Map>) -> Option<Role> {
    match &layout.shape {
        Shape::Wide(columns) => match &columns[..] {
            [one] => role_of(&tag_of(&one.tag, true, stem, map), map),
            _ => None,
        },
        Shape::Long { .. } => None,
    }
}

struct Gatherer<'o> {
    options: &'o ReadOptions,
    decimal: Decimal,
    axes: Vec<Axis>,
    open: Vec<Series>,
    by_tag: HashMap<String, Option<usize>>,
    ignored: Vec<String>,
    words: BTreeMap<String, u64>,
    codes: BTreeMap<i64, u64>,
    first_code: u64,
    marked_bad: u64,
    /// The name of the columns' quality, for messages.
    quality: String,
}

/// Reads every row of a table.
///
/// # Errors
/// What cannot be read, with its line and the option that settles it.
pub(super) fn gather(
    table: &Table<'_>,
    layout: &Layout,
    stem: &str,
    options: &ReadOptions,
    end_s: i64,
) -> Result<Contents, ExportError> {
    let decimal = decimal_of(table, layout, stem, options)?;
    let axes = layout.times.iter().map(|column| Axis { column: column.clone(), ..Axis::default() });
    let mut all = Gatherer {
        options,
        decimal,
        axes: axes.collect(),
        open: Vec::new(),
        by_tag: HashMap::new(),
        ignored: Vec::new(),
        words: BTreeMap::new(),
        codes: BTreeMap::new(),
        first_code: 0,
        marked_bad: 0,
        quality: "quality".to_owned(),
    };
    match &layout.shape {
        Shape::Wide(_) => all.take_wide(table, layout, stem)?,
        Shape::Long { .. } => all.take_long(table, layout)?,
    }
    all.close(table, layout, end_s)
}

/// Columns of values that belong to signals.
fn wanted<'l>(columns: &'l [ValueColumn], stem: &str, map: Option<&Map>) -> Vec<(&'l ValueColumn, String)> {
    let tagged = columns.iter().map(|column| (column, tag_of(&column.tag, columns.len() == 1, stem, map)));
    tagged.filter(|(_, tag)| role_of(tag, map).is_some()).collect()
}

/// Decimal separator: the one given, else the one that the numbers of the signals show, else any other cell.
///
/// Where each number has three figures behind its only separator, these are decimals in a comma-separated file; else nothing
/// shows it.
fn decimal_of(table: &Table<'_>, layout: &Layout, stem: &str, options: &ReadOptions) -> Result<Decimal, ExportError> {
    if let Some(decimal) = options.decimal {
        return Ok(decimal);
    }
    let columns: Vec<usize> = match &layout.shape {
        Shape::Wide(columns) => wanted(columns, stem, options.map.as_ref()).iter().map(|(c, _)| c.at).collect(),
        Shape::Long { value, .. } => vec![*value],
    };
    // The first lines with each separator: for sure, for one of two reasons, and in other columns.
    let (mut sure, mut either, mut elsewhere) = ([0_u64; 2], [0_u64; 2], [0_u64; 2]);
    let mut rows = 0;
    table.rows.each(&mut |line, cells| {
        rows += 1;
        for (at, cell) in cells.iter().enumerate() {
            let Cell::Text(text) = cell else { continue };
            let own = columns.contains(&at);
            let (seen, kind) = match hint(with_unit(text).0) {
                Hint::Sure(kind) if own => (&mut sure, kind),
                Hint::Sure(kind) => (&mut elsewhere, kind),
                Hint::Either(kind) if own => (&mut either, kind),
                _ => continue,
            };
            let first = &mut seen[usize::from(kind == Decimal::Comma)];
            *first = if *first == 0 { line } else { *first };
        }
        Ok(rows < ENOUGH_ROWS || (sure == [0, 0] && either != [0, 0]))
    })?;
    let [point, comma] = sure;
    if point > 0 && comma > 0 {
        let text = format!("line {point} has a decimal point, line {comma} a decimal comma");
        let remedy = "choose one with --decimal point or --decimal comma, and correct the other numbers";
        return Err(ExportError::at(point.max(comma), text, remedy));
    }
    let only = |seen: [u64; 2], kind: usize| seen[kind] > 0 && seen[1 - kind] == 0;
    if comma > 0 || (point == 0 && only(either, 1) && only(elsewhere, 1)) {
        return Ok(Decimal::Comma);
    }
    let points = table.decimal.is_some() || only(elsewhere, 0);
    if point > 0 || either == [0, 0] || (either[1] == 0 && points) {
        return Ok(Decimal::Point);
    }
    let (line, mark) = if either[1] > 0 { (either[1], ',') } else { (either[0], '.') };
    let [word, other] = if either[1] > 0 { ["comma", "point"] } else { ["point", "comma"] };
    let what = format!("every number with a {word} has three figures behind it: decimals or thousands");
    let mut both = [(word, "1.234"), (other, "1234")];
    // Where commas do not separate the cells, they more often separate decimals.
    both.sort_by_key(|(word, _)| *word == "point" && table.decimal.is_none());
    let [first, second] = both.map(|(word, value)| format!("--decimal {word} (1{mark}234 is {value})"));
    let remedy = format!("use {first} or {second}");
    Err(ExportError::at(line, what, remedy))
}

/// A text that is neither a number nor a word for none.
fn unreadable(tag: &str, text: &str, decimal: Decimal, line: u64) -> ExportError {
    let shown: String = text.chars().take(40).collect();
    let other = if decimal == Decimal::Point { Decimal::Comma } else { Decimal::Point };
    let (figures, _) = with_unit(text);
    let what = format!("{tag:?} contains {shown:?}, which is not a number");
    let remedy = match number(figures, other) {
        Some(_) if other == Decimal::Comma => "use --decimal comma".to_owned(),
        Some(_) => "use --decimal point".to_owned(),
        None if text.contains(|c: char| c.is_ascii_digit()) => "export plain numbers".to_owned(),
        None => format!("if it stands for a missing value, use --missing {shown:?}"),
    };
    ExportError::at(line, what, remedy)
}

impl Gatherer<'_> {
    fn stamp(&self, line: u64, cells: &[Cell<'_>], time: &TimeColumn) -> Result<Option<Stamp>, ExportError> {
        let cell = |at: usize| cells.get(at).copied().unwrap_or(Cell::Empty);
        let unreadable = || {
            let seen = cell(time.at).shown();
            if seen.contains(":60") {
                let text =
                    format!("{:?} contains {seen:?}, a leap second, which times since 1970 do not have", time.name);
                return ExportError::at(line, text, "remove this line");
            }
            let text = format!("{:?} contains {seen:?}, which is not a time", time.name);
            if self.axes.iter().any(|axis| !axis.stamps.is_empty()) {
                return ExportError::at(line, text + " as those above are", "remove or correct this line");
            }
            let remedy = "give the form with --time-format, such as \"%d/%m/%Y %H:%M:%S\", or another column with --map t=COLUMN";
            ExportError::at(line, text, remedy)
        };
        let joined;
        let zone = time.zone_at.map_or(String::new(), |at| cell(at).shown());
        let text = match (cell(time.at), time.clock_at.map(cell)) {
            (Cell::Empty, _) => return Ok(None),
            (Cell::Text(date), Some(Cell::Text(clock))) => {
                // Spreadsheets write midnight behind a date.
                joined = format!("{} {clock} {zone}", date.trim_end_matches("00:00:00").trim_end_matches([' ', 'T']));
                joined.trim_end()
            }
            (Cell::Text(text), None) if !zone.is_empty() => {
                joined = format!("{text} {zone}");
                &joined
            }
            (Cell::Text(text), None) => text,
            (Cell::Local(ns), None) => return Ok(Some(Stamp::Local(ns))),
            (Cell::Instant(ns), None) => return Ok(Some(Stamp::Instant(ns))),
            (Cell::Integer(v), None) => return Ok(Some(Stamp::Number(Number::of_i64(v)))),
            (Cell::Number(v), None) => return Number::of_f64(v).map(|n| Some(Stamp::Number(n))).ok_or_else(unreadable),
            _ => return Err(unreadable()),
        };
        Stamp::by(self.options.time_format.as_ref(), text).map(Some).ok_or_else(unreadable)
    }

    /// Starts a series for a recognised tag; keeps the other tags for messages.
    fn series(&mut self, tag: &str, axis: usize) -> Option<usize> {
        if let Some(known) = self.by_tag.get(tag) {
            return *known;
        }
        let at = role_of(tag, self.options.map.as_ref()).map(|role| {
            self.open.push(Series {
                tag: tag.to_owned(),
                role,
                unit: None,
                quality: None,
                samples: Vec::new(),
                axis,
                first_text: None,
                of_cells: unit(tag).filter(|unit| is_unit(unit)).map(|unit| Some(unit.to_owned())),
                by_heading: unit(tag).is_some_and(is_unit),
            });
            self.open.len() - 1
        });
        if at.is_none() {
            self.ignored.push(tag.to_owned());
        }
        self.by_tag.insert(tag.to_owned(), at);
        at
    }

    fn take_wide(&mut self, table: &Table<'_>, layout: &Layout, stem: &str) -> Result<(), ExportError> {
        let Shape::Wide(columns) = &layout.shape else { return Ok(()) };
        let mut wanted: Vec<(&ValueColumn, usize)> = Vec::new();
        for column in columns {
            let tag = tag_of(&column.tag, columns.len() == 1, stem, self.options.map.as_ref());
            if self.open.iter().any(|open| open.tag.eq_ignore_ascii_case(&tag)) {
                let text = format!("the header names {tag:?} twice");
                return Err(ExportError::at(table.line, text, "name the columns by number: --map op=2,pv=3"));
            }
            if let Some(series) = self.series(&tag, column.time) {
                let open = &mut self.open[series];
                open.unit = table.unit_of(column.at);
                let below = open.unit.clone().filter(|unit| !open.by_heading && is_unit(unit));
                open.by_heading |= below.is_some();
                open.of_cells = open.of_cells.take().or(below.map(Some));
                if let Some(at) = column.quality {
                    self.quality = table.names.get(at).cloned().unwrap_or_default();
                    self.open[series].quality = Some(self.quality.clone());
                }
                wanted.push((column, series));
            }
        }
        table.rows.each(&mut |line, cells| {
            let mut rows = Vec::with_capacity(layout.times.len());
            for (axis, time) in layout.times.iter().enumerate() {
                let stamp = self.stamp(line, cells, time)?;
                rows.push(stamp.map(|stamp| self.axes[axis].push(stamp, line)));
            }
            let cell_at = |at: usize| cells.get(at).copied().unwrap_or(Cell::Empty);
            for (column, series) in &wanted {
                let cell = cell_at(column.at);
                self.open[*series].take_unit(line, column.unit.map(cell_at))?;
                match rows[column.time] {
                    Some(row) => {
                        let mark = (column.quality.map(cell_at), doubt(line, &column.doubts, &cell_at)?);
                        self.take(*series, row, line, cell, mark)?;
                    }
                    None if cell == Cell::Empty => {}
                    None => {
                        let text = format!("value {:?} without a time", cell.shown());
                        return Err(ExportError::at(line, text, "add the time of every row"));
                    }
                }
            }
            Ok(true)
        })
    }

    fn take_long(&mut self, table: &Table<'_>, layout: &Layout) -> Result<(), ExportError> {
        let Shape::Long { tag, of, value, quality, unit, ref doubts } = layout.shape else { return Ok(()) };
        let quality = quality.filter(|_| self.options.codes != Some(Codes::Ignore));
        if let Some(name) = quality.and_then(|at| table.names.get(at)) {
            self.quality.clone_from(name);
        }
        table.rows.each(&mut |line, cells| {
            let cell = |at: usize| cells.get(at).copied().unwrap_or(Cell::Empty);
            let shown;
            let name = match cell(tag) {
                Cell::Text(text) => text,
                Cell::Empty => return Err(ExportError::at(line, "a row without a tag", "add the tag of every row")),
                other => {
                    shown = other.shown();
                    &shown
                }
            };
            let whole = of.map(|of| format!("{}.{name}", cell(of).shown()));
            let Some(series) = self.series(whole.as_deref().unwrap_or(name), 0) else { return Ok(true) };
            let Some(stamp) = self.stamp(line, cells, &layout.times[0])? else {
                return Err(ExportError::at(line, "a row without a time", "add the time of every row"));
            };
            let row = self.axes[0].push(stamp, line);
            let doubted = doubt(line, doubts, &cell)?;
            self.open[series].take_unit(line, unit.map(cell))?;
            self.take(series, row, line, cell(value), (quality.map(cell), doubted))?;
            Ok(true)
        })
    }

    fn take(
        &mut self,
        at: usize,
        row: u32,
        line: u64,
        cell: Cell<'_>,
        (mark, doubted): (Option<Cell<'_>>, Option<bool>),
    ) -> Result<(), ExportError> {
        let mark = mark.map(|mark| match mark {
            Cell::Text(text) => Mark::read(text).ok_or_else(|| {
                let what = format!("{:?} contains {text:?}, which is no known word for a quality", self.quality);
                ExportError::at(line, what, "if the column is no quality, use --quality ignore")
            }),
            Cell::Integer(code) => Ok(Mark::Code(code)),
            Cell::Number(code) => Ok(Mark::Code(code as i64)),
            _ => Ok(Mark::None),
        });
        let mark = match (mark.transpose()?, doubted) {
            (_, Some(true)) => Some(Mark::Bad),
            (mark, flags) => mark.or(flags.map(|_| Mark::Good)),
        };
        // A number with a bad quality must not be used as a value.
        let value = match mark {
            Some(Mark::Bad) => Value::Missing,
            _ => self.value(at, line, cell)?,
        };
        if let Some(Mark::Code(code)) = mark {
            *self.codes.entry(code).or_default() += 1;
            self.first_code = if self.first_code == 0 { line } else { self.first_code };
        }
        let mark = mark.unwrap_or(Mark::None);
        self.open[at].samples.push(Taken { row, t_ns: 0, value, empty: cell == Cell::Empty, mark });
        Ok(())
    }

    fn value(&mut self, at: usize, line: u64, cell: Cell<'_>) -> Result<Value, ExportError> {
        let open = &mut self.open[at];
        let text = match cell {
            Cell::Empty => return Ok(Value::Missing),
            Cell::Number(v) => return open.take_number(line, cell, None).map(|()| self.counted(Value::number(v))),
            Cell::Integer(v) => {
                return open.take_number(line, cell, None).map(|()| self.counted(Value::number(v as f64)));
            }
            Cell::Local(_) | Cell::Instant(_) => {
                let what = format!("{:?} contains the date {}, not a number", open.tag, cell.shown());
                return Err(ExportError::at(
                    line,
                    what,
                    "format its cells as numbers, and correct those that became dates",
                ));
            }
            Cell::Text(text) => text,
        };
        let is_missing = |text: &str| is_missing_word(text) || self.options.missing.iter().any(|word| word == text);
        let (figures, unit) = with_unit(text);
        if let Some(v) = number(figures, self.decimal).filter(|_| !is_missing(text)) {
            open.take_number(line, cell, unit)?;
            return Ok(self.counted(Value::Number(v)));
        }
        if !is_missing(text) {
            if open.role.signal == Signal::Mode {
                return Ok(Value::Mode(Mode::from_word(text)));
            }
            return Err(unreadable(&open.tag, text, self.decimal, line));
        }
        open.first_text.get_or_insert_with(|| (line, text.chars().take(40).collect()));
        if self.words.len() < 100 || self.words.contains_key(text) {
            *self.words.entry(text.chars().take(40).collect()).or_default() += 1;
        }
        Ok(Value::Missing)
    }

    /// The value, or missing if `--missing` lists this number.
    fn counted(&mut self, value: Value) -> Value {
        let missing = |v: f64| self.options.missing.iter().any(|word| word.parse::<f64>().is_ok_and(|m| m == v));
        match value {
            Value::Number(v) if missing(v) => {
                *self.words.entry(v.to_string()).or_default() += 1;
                Value::Missing
            }
            other => other,
        }
    }

    /// A column of a signal has numbers, and none that loggers write for missing ones.
    fn check_values(&self) -> Result<(), ExportError> {
        for open in self.open.iter().filter(|open| open.role.signal != Signal::Mode) {
            let needed = matches!(open.role.signal, Signal::Op | Signal::Pv);
            let values = open.samples.iter().filter_map(|taken| taken.value.as_number());
            if let (true, Some((line, text)), None) = (needed, &open.first_text, values.clone().next()) {
                let what = format!("{:?} contains {text:?}, and no number in any row", open.tag);
                return Err(ExportError::at(*line, what, "name another column or tag: --map op=TAG,pv=TAG"));
            }
            let missing = &self.options.missing;
            if let Some(found) = sentinel(values).filter(|_| !missing.iter().any(|word| word == "none")) {
                let first = open.samples.iter().find(|taken| taken.value == Value::Number(found));
                let line = first.and_then(|taken| self.axes[open.axis].lines.get(taken.row as usize));
                let what = format!(
                    "{:?} contains {found:?}, far from its other values, as loggers write where none is",
                    open.tag
                );
                let all = missing.iter().cloned().chain([format!("{found:?}")]).collect::<Vec<_>>().join(",");
                let remedy = format!("use --missing={all}, or --missing=none if it is a value");
                return Err(ExportError::at(line.copied().unwrap_or(0), what, remedy));
            }
        }
        Ok(())
    }

    fn close(mut self, table: &Table<'_>, layout: &Layout, end_s: i64) -> Result<Contents, ExportError> {
        self.judge_marks()?;
        self.check_values()?;
        let mut words = table.words.clone();
        if self.decimal == Decimal::Comma {
            words.push("decimal comma".to_owned());
        }
        let t_ns = self.times(layout, end_s, &mut words)?;
        let counts = self.missing_in_words();
        let shape = match &layout.shape {
            Shape::Wide(columns) if columns.len() == 1 => "one signal",
            Shape::Wide(_) => "one column per tag",
            Shape::Long { .. } => "one row per value",
        };
        words.push(shape.to_owned());
        for open in &mut self.open {
            let stamps = &t_ns[open.axis];
            open.samples.iter_mut().for_each(|taken| taken.t_ns = stamps[taken.row as usize]);
            open.unit = open.unit.take().or(open.of_cells.take().flatten());
            check_once(open, &self.axes[open.axis])?;
        }
        let own = super::is_own(&table.names) && !self.options.overrules();
        let warnings = table.warnings.clone();
        Ok(Contents { series: self.open, words, counts, warnings, ignored: self.ignored, own })
    }

    /// Makes values of bad quality missing.
    fn judge_marks(&mut self) -> Result<(), ExportError> {
        let codes = if self.codes.is_empty() {
            self.options.codes.unwrap_or(Codes::Ua)
        } else {
            convention(&self.codes, &self.quality, self.first_code, self.options.codes)?
        };
        for taken in self.open.iter_mut().flat_map(|open| &mut open.samples) {
            if taken.mark.is_bad(codes) {
                self.marked_bad += u64::from(!taken.empty);
                *taken = Taken { value: Value::Missing, empty: false, mark: Mark::Bad, ..*taken };
            }
        }
        Ok(())
    }

    fn missing_in_words(&self) -> Vec<String> {
        let mut words = Vec::new();
        if !self.words.is_empty() {
            let mut counted: Vec<(&String, &u64)> = self.words.iter().collect();
            counted.sort_by_key(|(word, count)| (std::cmp::Reverse(**count), (*word).clone()));
            let shown: Vec<String> = counted.iter().take(MOST_WORDS).map(|(w, n)| format!("{n} {w:?}")).collect();
            let more = if counted.len() > MOST_WORDS { " and others" } else { "" };
            words.push(format!("missing: {}{more}", shown.join(", ")));
        }
        if self.marked_bad > 0 {
            words.push(format!("{} values of bad quality count as missing", self.marked_bad));
        }
        words
    }

    /// Instants of every time axis.
    fn times(&self, layout: &Layout, end_s: i64, words: &mut Vec<String>) -> Result<Vec<Vec<i64>>, ExportError> {
        let mut all = Vec::with_capacity(self.axes.len());
        for (at, axis) in self.axes.iter().enumerate() {
            let groups: Vec<Vec<u32>> = match &layout.shape {
                Shape::Wide(_) => vec![(0..axis.stamps.len() as u32).collect()],
                Shape::Long { .. } => {
                    self.open.iter().map(|o| o.samples.iter().map(|taken| taken.row).collect()).collect()
                }
            };
            let zone = self.options.zone.as_ref();
            let asked = TimeOptions { form: self.options.time_format.as_ref(), zone, end_s };
            let times = axis.times(&groups, asked)?;
            if at == 0 {
                words.push(format!("times {}", times.words));
                if times.backward > times.forward && times.forward == 0 {
                    words.push("newest first, sorted".to_owned());
                } else if times.backward > 0 {
                    words.push(format!("out of order {} times, sorted", times.backward.min(times.forward)));
                }
            }
            all.push(times.t_ns);
        }
        Ok(all)
    }
}
