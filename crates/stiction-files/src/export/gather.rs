//! Rows to series: each tag's values in time order.

use std::collections::{BTreeMap, HashMap};

use super::cell::{Cell, Table};
use super::clock::{Axis, TimeFormat, TimeOptions, by_pattern};
use super::columns::{Layout, Shape, TimeColumn};
use super::map::Map;
use super::names::{Role, is_value, plain, role};
use super::quality::{Codes, Mark, convention};
use super::stamp::{Number, Stamp};
use super::zone::Zone;
use super::{Contents, ExportError, ReadOptions};
use crate::number::{Decimal, Hint, hint, is_missing_word, number};
use stiction::core::record::{Mode, Signal, Value};

/// Rows after which the search for the decimal separator stops, whether found or not.
const ENOUGH_ROWS: u64 = 20_000;
/// Most words for missing values listed.
const MOST_WORDS: usize = 6;

/// The values of one tag in time order.
#[derive(Debug, Clone)]
pub(super) struct Series {
    /// The tag.
    pub tag: String,
    /// Its loop and signal.
    pub role: Role,
    /// Its unit, if the file gives it.
    pub unit: Option<String>,
    /// Times, values, and whether the cell was empty.
    pub samples: Vec<(i64, Value, bool)>,
}

/// A series under construction.
struct Open {
    tag: String,
    role: Role,
    unit: Option<String>,
    axis: usize,
    rows: Vec<u32>,
    values: Vec<(Value, bool)>,
    marks: Vec<Mark>,
    texts: Texts,
}

/// Cells of a series that are not numbers.
#[derive(Default)]
struct Texts {
    numbers: u64,
    unknown: u64,
    first_unknown: Option<(u64, String)>,
}

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
    open: Vec<Open>,
    by_tag: HashMap<String, Option<usize>>,
    ignored: Vec<String>,
    words: BTreeMap<String, u64>,
    missing_words: u64,
    codes: BTreeMap<i64, u64>,
    first_code: u64,
    marked_bad: u64,
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
    let decimal = decimal_of(table, layout, options.decimal)?;
    let axes = layout.times.iter().map(|t| Axis {
        name: t.name.clone(),
        from_anywhere: t.from_anywhere.clone(),
        ..Axis::default()
    });
    let mut all = Gatherer {
        options,
        decimal,
        axes: axes.collect(),
        open: Vec::new(),
        by_tag: HashMap::new(),
        ignored: Vec::new(),
        words: BTreeMap::new(),
        missing_words: 0,
        codes: BTreeMap::new(),
        first_code: 0,
        marked_bad: 0,
    };
    match &layout.shape {
        Shape::Wide(_) => all.take_wide(table, layout, stem)?,
        Shape::Long { .. } => all.take_long(table, layout)?,
    }
    all.close(table, layout, end_s)
}

/// Decimal separator, from the value columns.
fn decimal_of(table: &Table<'_>, layout: &Layout, asked: Option<Decimal>) -> Result<Decimal, ExportError> {
    if let Some(decimal) = asked {
        return Ok(decimal);
    }
    let columns: Vec<usize> = match &layout.shape {
        Shape::Wide(columns) => columns.iter().map(|c| c.at).collect(),
        Shape::Long { value, .. } => vec![*value],
    };
    let (mut sure, mut either) = ([0_u64; 2], [0_u64; 2]);
    let place = |kind: Decimal| usize::from(kind == Decimal::Comma);
    let mut rows = 0;
    table.rows.each(&mut |line, cells| {
        rows += 1;
        for column in &columns {
            let Some(Cell::Text(text)) = cells.get(*column) else { continue };
            let first = |seen: &mut u64| {
                if *seen == 0 {
                    *seen = line;
                }
            };
            match hint(text) {
                Hint::Sure(kind) => first(&mut sure[place(kind)]),
                Hint::Either(kind) => first(&mut either[place(kind)]),
                Hint::None => {}
            }
        }
        Ok(rows < ENOUGH_ROWS || (sure == [0, 0] && either != [0, 0]))
    })?;
    match (sure, either) {
        ([0, 0], [_, 0]) => Ok(Decimal::Point),
        ([0, 0], [_, comma]) => {
            let text = "every number with a comma has three digits after it, which may be decimals or thousands";
            Err(ExportError::at(comma, text, "use --decimal comma (1,234 is 1.234) or --decimal point (1,234 is 1234)"))
        }
        ([point, comma], _) if point > 0 && comma > 0 => {
            let text = format!("line {point} has a decimal point, line {comma} a decimal comma");
            Err(ExportError::at(
                point.max(comma),
                text,
                "choose one with --decimal point or --decimal comma; the other numbers then count as missing",
            ))
        }
        ([_, comma], _) => Ok(if comma > 0 { Decimal::Comma } else { Decimal::Point }),
    }
}

impl Gatherer<'_> {
    fn stamp(&self, line: u64, cells: &[Cell<'_>], time: &TimeColumn) -> Result<Option<Stamp>, ExportError> {
        let cell = |at: usize| cells.get(at).copied().unwrap_or(Cell::Empty);
        let unreadable = || {
            let text = format!("{:?} contains {:?}, which is not a time", time.name, cell(time.at).shown());
            let remedy = "give the form with --time-format, such as \"%d/%m/%Y %H:%M:%S\", or another column with --map t=COLUMN";
            ExportError::at(line, text, remedy)
        };
        let joined;
        let text = match (cell(time.at), time.clock_at.map(cell)) {
            (Cell::Empty, _) => return Ok(None),
            (Cell::Text(date), Some(Cell::Text(clock))) => {
                joined = format!("{date} {clock}");
                &joined
            }
            (Cell::Text(text), None) => text,
            (Cell::Local(ns), None) => return Ok(Some(Stamp::Local(ns))),
            (Cell::Instant(ns), None) => return Ok(Some(Stamp::Instant(ns))),
            (Cell::Integer(v), None) => return Ok(Some(Stamp::Number(Number::of_i64(v)))),
            (Cell::Number(v), None) => return Number::of_f64(v).map(|n| Some(Stamp::Number(n))).ok_or_else(unreadable),
            _ => return Err(unreadable()),
        };
        let read = match &self.options.time_format {
            Some(TimeFormat::Pattern(pattern)) => by_pattern(pattern, text),
            _ => Stamp::read(text),
        };
        read.map(Some).ok_or_else(unreadable)
    }

    /// Starts a series for a recognised tag; keeps the other tags for messages.
    fn series(&mut self, tag: &str, axis: usize) -> Option<usize> {
        if let Some(known) = self.by_tag.get(tag) {
            return *known;
        }
        let at = role_of(tag, self.options.map.as_ref()).map(|role| {
            let tag = tag.to_owned();
            let texts = Texts::default();
            let unit = None;
            self.open.push(Open {
                tag,
                role,
                unit,
                axis,
                rows: Vec::new(),
                values: Vec::new(),
                marks: Vec::new(),
                texts,
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
        let mut wanted: Vec<(usize, usize, Option<usize>, usize)> = Vec::new();
        for column in columns {
            let tag = tag_of(&column.tag, columns.len() == 1, stem, self.options.map.as_ref());
            if self.by_tag.get(&tag).is_some_and(Option::is_some) {
                let text = format!("the header names {tag:?} twice");
                return Err(ExportError::at(table.line, text, "name the columns by number: --map op=2,pv=3"));
            }
            if let Some(series) = self.series(&tag, column.time) {
                self.open[series].unit = table.unit_of(column.at);
                wanted.push((column.at, column.time, column.quality, series));
            }
        }
        table.rows.each(&mut |line, cells| {
            let mut rows = Vec::with_capacity(layout.times.len());
            for (axis, time) in layout.times.iter().enumerate() {
                let stamp = self.stamp(line, cells, time)?;
                rows.push(stamp.map(|stamp| self.axes[axis].push(stamp, line)));
            }
            for (at, axis, quality, series) in &wanted {
                let cell = cells.get(*at).copied().unwrap_or(Cell::Empty);
                match rows[*axis] {
                    Some(row) => {
                        let mark = quality.map(|q| cells.get(q).copied().unwrap_or(Cell::Empty));
                        self.take(*series, row, line, cell, mark);
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
        let Shape::Long { tag, value, quality } = layout.shape else { return Ok(()) };
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
            let Some(series) = self.series(name, 0) else { return Ok(true) };
            let Some(stamp) = self.stamp(line, cells, &layout.times[0])? else {
                return Err(ExportError::at(line, "a row without a time", "add the time of every row"));
            };
            let row = self.axes[0].push(stamp, line);
            self.take(series, row, line, cell(value), quality.map(cell));
            Ok(true)
        })
    }

    fn take(&mut self, at: usize, row: u32, line: u64, cell: Cell<'_>, mark: Option<Cell<'_>>) {
        let value = self.value(at, line, cell);
        let open = &mut self.open[at];
        open.rows.push(row);
        open.values.push((value, cell == Cell::Empty));
        if let Some(mark) = mark {
            let mark = match mark {
                Cell::Text(text) => Mark::read(text),
                Cell::Integer(code) => Mark::Code(code),
                Cell::Number(code) => Mark::Code(code as i64),
                _ => Mark::None,
            };
            if let Mark::Code(code) = mark {
                *self.codes.entry(code).or_default() += 1;
                if self.first_code == 0 {
                    self.first_code = line;
                }
            }
            open.marks.push(mark);
        }
    }

    fn value(&mut self, at: usize, line: u64, cell: Cell<'_>) -> Value {
        let open = &mut self.open[at];
        let text = match cell {
            Cell::Empty => return Value::Missing,
            Cell::Number(v) => return Value::number(v),
            Cell::Integer(v) => return Value::number(v as f64),
            Cell::Local(_) | Cell::Instant(_) => "a time",
            Cell::Text(text) => text,
        };
        if let Some(v) = number(text, self.decimal) {
            open.texts.numbers += 1;
            return Value::Number(v);
        }
        if open.role.signal == Signal::Mode && !is_missing_word(text) {
            return Value::Mode(Mode::from_word(text));
        }
        if is_missing_word(text) {
            self.missing_words += 1;
            if self.words.len() < 100 || self.words.contains_key(text) {
                *self.words.entry(text.chars().take(40).collect()).or_default() += 1;
            }
        } else {
            open.texts.unknown += 1;
            open.texts.first_unknown.get_or_insert_with(|| (line, text.chars().take(40).collect()));
        }
        Value::Missing
    }

    fn close(mut self, table: &Table<'_>, layout: &Layout, end_s: i64) -> Result<Contents, ExportError> {
        let mut warnings = Vec::new();
        for open in &self.open {
            if let Some((line, text)) = &open.texts.first_unknown {
                let (unknown, numbers, tag) = (open.texts.unknown, open.texts.numbers, &open.tag);
                if unknown > numbers {
                    let what = format!(
                        "{tag:?} contains {text:?}, and more such cells than numbers ({unknown} against {numbers})"
                    );
                    let remedy =
                        "give the decimal separator with --decimal, or another column with --map op=TAG,pv=TAG";
                    return Err(ExportError::at(*line, what, remedy));
                }
                warnings.push(format!(
                    "{tag}: {unknown} cells without a number count as missing, first {text:?} in line {line}"
                ));
            }
        }
        self.judge_marks(layout, table)?;
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
        let series = self.open.into_iter().map(|open| {
            let stamps = &t_ns[open.axis];
            let samples =
                open.rows.iter().zip(open.values).map(|(row, (value, empty))| (stamps[*row as usize], value, empty));
            let mut samples: Vec<(i64, Value, bool)> = samples.collect();
            samples.sort_by_key(|(t, _, _)| *t);
            Series { tag: open.tag, role: open.role, unit: open.unit, samples }
        });
        Ok(Contents { series: series.collect(), words, counts, warnings, ignored: self.ignored })
    }

    /// Makes values of bad quality missing.
    fn judge_marks(&mut self, layout: &Layout, table: &Table<'_>) -> Result<(), ExportError> {
        let name = match &layout.shape {
            Shape::Long { quality: Some(at), .. } => {
                table.names.get(*at).map_or_else(|| "quality".to_owned(), |n| plain(n))
            }
            _ => "status".to_owned(),
        };
        let codes = if self.codes.is_empty() {
            self.options.codes.unwrap_or(Codes::Ua)
        } else {
            convention(&self.codes, &name, self.first_code, self.options.codes)?
        };
        for open in &mut self.open {
            for (mark, (value, _)) in open.marks.iter().zip(&mut open.values) {
                if mark.is_bad(codes) && *value != Value::Missing {
                    *value = Value::Missing;
                    self.marked_bad += 1;
                }
            }
        }
        Ok(())
    }

    fn missing_in_words(&self) -> Vec<String> {
        let mut words = Vec::new();
        if self.missing_words > 0 {
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
        let utc = Zone::parse("UTC").ok();
        let mut all = Vec::with_capacity(self.axes.len());
        for (at, (axis, column)) in self.axes.iter().zip(&layout.times).enumerate() {
            let groups: Vec<Vec<u32>> = match &layout.shape {
                Shape::Wide(_) => vec![(0..axis.stamps.len() as u32).collect()],
                Shape::Long { .. } => self.open.iter().map(|o| o.rows.clone()).collect(),
            };
            let zone = self.options.zone.as_ref().or_else(|| utc.as_ref().filter(|_| column.is_utc));
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
