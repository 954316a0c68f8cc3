//! The role of each column: times, values of tags, quality codes; in wide, long and single-signal tables.

use super::ExportError;
use super::cell::{Cell, Table};
use super::clock::TimeFormat;
use super::map::{Map, Part, same};
use super::names::{doubt_of, is_date, is_ending, is_tag, is_time, is_value, plain, quality_of, role, time_unit};
use super::quality::Mark;
use super::stamp::{Stamp, is_clock};
use super::zone::{self, Said, Zone};
use crate::conventions::{UNIT_HEADS, ZONES, is_one_of, unit_of_time};
use stiction::core::units::NS_PER_S;

/// Rows examined to recognise columns.
const LOOKED_AT: usize = 60;

/// Where the time of a row is.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct TimeColumn {
    /// The column.
    pub at: usize,
    /// The column of the time of day, if separate from the date.
    pub clock_at: Option<usize>,
    /// The column of the zone, if separate.
    pub zone_at: Option<usize>,
    /// Name for messages.
    pub name: String,
    /// The unit in its name: numbers then count from any start.
    pub unit: Option<TimeFormat>,
    /// Whether it is called `t`: numbers may count seconds from any start.
    pub is_t: bool,
    /// The zone that its name, the row of units or a line above says.
    pub said: Said,
    /// Whether --map chose it, whatever its name says.
    pub chosen: bool,
    /// Whether day numbers count from 1904.
    pub since_1904: bool,
}

impl TimeColumn {
    /// Whether a column is a part of it.
    fn holds(&self, at: usize) -> bool {
        self.at == at || self.clock_at == Some(at) || self.zone_at == Some(at)
    }
}

/// A value column in a wide table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ValueColumn {
    /// The column.
    pub at: usize,
    /// Its time, as an index into [`Layout::times`].
    pub time: usize,
    /// Its quality codes, if any.
    pub quality: Option<usize>,
    /// Flags that are set where it is bad.
    pub doubts: Vec<usize>,
    /// Its unit, if a column has it.
    pub unit: Option<usize>,
    /// The tag.
    pub tag: String,
}

/// Layout of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Shape {
    /// One column per tag.
    Wide(Vec<ValueColumn>),
    /// One row per value.
    Long {
        tag: usize,
        /// The column of the loops, where the tags are those of signals.
        of: Option<usize>,
        value: usize,
        quality: Option<usize>,
        unit: Option<usize>,
        doubts: Vec<usize>,
    },
}

/// Time and value columns of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Layout {
    /// Time columns; several if signals have their own.
    pub times: Vec<TimeColumn>,
    /// The rest.
    pub shape: Shape,
}

/// Contents of the first rows, by column.
struct Seen {
    /// Cells that are written dates or typed times.
    dates: usize,
    /// Written dates without a time of day.
    days: usize,
    /// Cells that are times of day only.
    clocks: usize,
    /// Non-empty cells.
    filled: usize,
    /// Distinct texts that are not numbers.
    texts: std::collections::BTreeSet<String>,
}

impl Seen {
    fn is_dates(&self) -> bool {
        self.filled > 0 && 5 * self.dates >= 4 * self.filled
    }

    fn is_clocks(&self) -> bool {
        self.filled > 0 && 5 * self.clocks >= 4 * self.filled
    }
}

fn look(table: &Table<'_>) -> Result<Vec<Seen>, ExportError> {
    let mut seen: Vec<Seen> = Vec::new();
    let mut rows = 0;
    table.rows.each(&mut |_, cells| {
        while seen.len() < cells.len() {
            seen.push(Seen { dates: 0, days: 0, clocks: 0, filled: 0, texts: std::collections::BTreeSet::new() });
        }
        for (column, cell) in seen.iter_mut().zip(cells) {
            column.filled += usize::from(*cell != Cell::Empty);
            match cell {
                Cell::Local(_) | Cell::Instant(_) => column.dates += 1,
                Cell::Text(text) => {
                    let dated = Stamp::read(text).is_some_and(Stamp::is_dated);
                    column.dates += usize::from(dated);
                    column.days += usize::from(dated && !text.contains(':'));
                    column.clocks += usize::from(is_clock(text));
                    if !dated && column.texts.len() < LOOKED_AT {
                        column.texts.insert((*text).to_owned());
                    }
                }
                _ => {}
            }
        }
        rows += 1;
        Ok(rows < LOOKED_AT)
    })?;
    Ok(seen)
}

/// A column given by name, or by number from 1.
fn find(wanted: &str, table: &Table<'_>, columns: usize) -> Result<Option<usize>, ExportError> {
    let found: Vec<usize> = (0..table.names.len()).filter(|at| same(wanted, &table.names[*at])).collect();
    match found[..] {
        [at] => return Ok(Some(at)),
        [] => {}
        _ => {
            let text = format!("the header names {wanted:?} {} times", found.len());
            return Err(ExportError::at(table.line, text, "give the column's number with --map, counted from 1"));
        }
    }
    let number: Option<usize> = wanted.trim_start_matches('#').parse().ok();
    Ok(number.filter(|n| (1..=columns).contains(n)).map(|n| n - 1))
}

/// Names of columns for a message.
pub(super) fn listed(names: &[String]) -> String {
    let shown: Vec<String> = names.iter().take(8).map(|n| format!("{n:?}")).collect();
    let more = names.len().saturating_sub(8);
    if more == 0 { shown.join(", ") } else { format!("{} and {more} more", shown.join(", ")) }
}

/// Recognises the role of each column of a table; `marks`: quality columns count.
///
/// # Errors
/// No time column, no value column, or a column of `--map` that does not exist.
pub(super) fn layout(table: &Table<'_>, map: Option<&Map>, marks: bool) -> Result<Layout, ExportError> {
    let seen = look(table)?;
    let finder = Finder { table, map, seen: &seen, marks };
    let mut times = finder.times()?;
    if let Some((at, zone)) = finder.zone_column()? {
        for time in &mut times {
            time.zone_at = Some(at).filter(|_| time.said.zone.is_none());
            time.said.zone = time.said.zone.take().or_else(|| zone.clone());
        }
    }
    finder.check_qualities()?;
    if let Some(shape) = finder.long(&times)? {
        return Ok(Layout { times, shape });
    }
    let values = finder.wide(&times)?;
    Ok(Layout { times, shape: Shape::Wide(values) })
}

struct Finder<'a, 'f> {
    table: &'a Table<'f>,
    map: Option<&'a Map>,
    seen: &'a [Seen],
    /// Whether quality columns count.
    marks: bool,
}

impl Finder<'_, '_> {
    fn columns(&self) -> usize {
        self.seen.len().max(self.table.names.len())
    }

    fn name(&self, at: usize) -> String {
        self.table.names.get(at).filter(|n| !n.is_empty()).cloned().unwrap_or_else(|| format!("column {}", at + 1))
    }

    fn mapped(&self, part: Part) -> Result<Option<usize>, ExportError> {
        let Some(wanted) = self.map.and_then(|m| m.of(part)) else { return Ok(None) };
        match find(wanted, self.table, self.columns())? {
            Some(at) => Ok(Some(at)),
            None => {
                let text = format!("--map names {wanted:?}, but the columns are {}", listed(&self.table.names));
                Err(ExportError::at(self.table.line, text, "use one of these names, or the column's number from 1"))
            }
        }
    }

    fn time(&self, at: usize, clock_at: Option<usize>) -> TimeColumn {
        let name = self.name(at);
        let is_t = name.trim().eq_ignore_ascii_case("t");
        let own = is_t && super::is_own(&self.table.names);
        let unit = time_unit(&name).or(own.then_some(NS_PER_S)).map(TimeFormat::Epoch);
        let clock = clock_at.map(|at| self.name(at));
        let below = [Some(at), clock_at].into_iter().flatten().filter_map(|at| self.table.units.get(at).cloned());
        let names = [Some(name.clone()), clock].into_iter().flatten().chain(below);
        let said = names.map(|name| Said::by_heading(&name)).chain([self.table.said.clone()]);
        let said = said.filter(|_| unit.is_none()).find(|said| !said.says_nothing()).unwrap_or_default();
        let chosen = self.map.is_some_and(|map| map.of(Part::Time).is_some());
        let since_1904 = self.table.since_1904;
        TimeColumn { at, clock_at, zone_at: None, name, unit, is_t, said, chosen, since_1904 }
    }

    /// The column of the zone, with the zone if it names one; what is not understood must be passed over by the user.
    fn zone_column(&self) -> Result<Option<(usize, Option<Zone>)>, ExportError> {
        let named = |at: &usize| is_one_of(&plain(&self.table.names[*at]), ZONES);
        let unmapped = self.map.is_none_or(|map| map.of(Part::Time).is_none());
        let Some(at) = (0..self.table.names.len()).find(named).filter(|_| unmapped) else { return Ok(None) };
        let texts: Vec<&String> = self.seen.get(at).map(|seen| seen.texts.iter().collect()).unwrap_or_default();
        match (texts.iter().find(|text| !zone::is_known(text)), &texts[..]) {
            (None, _) => Ok(Some((at, None))),
            (Some(text), [one]) if Zone::parse(one).is_ok() => Ok(Some((at, Zone::parse(text).ok()))),
            (Some(text), _) => {
                let text = format!("the column {:?} gives the zone {text:?}, which is not read there", self.name(at));
                let remedy = "give it with --tz, and choose the time alone: --map t=COLUMN,op=…,pv=…";
                Err(ExportError::at(self.table.line, text, remedy))
            }
        }
    }

    /// Words such as Good and Bad are qualities, whatever their heading.
    fn check_qualities(&self) -> Result<(), ExportError> {
        let starts = ["good", "bad", "uncertain"];
        let is_word = |text: &String| starts.iter().any(|start| text.to_lowercase().starts_with(start));
        let is = |at: &usize| !self.seen[*at].texts.is_empty() && self.seen[*at].texts.iter().all(is_word);
        let told = |name: &str| quality_of(name).is_some() || doubt_of(name).is_some() || role(name).is_some();
        let told = |at: &usize| told(&self.name(*at)) || self.map.is_some_and(|map| map.takes(&self.name(*at), *at));
        let found = (0..self.seen.len()).find(|at| self.marks && is(at) && !told(at));
        found.map_or(Ok(()), |at| {
            let text = format!("the column {:?} contains words for quality", self.name(at));
            let remedy = format!("use --map quality={}, or --quality ignore", at + 1);
            Err(ExportError::at(self.table.line, text, remedy))
        })
    }

    /// The column of the time of day, where a column has dates alone.
    fn clock_of(&self, date: usize) -> Option<usize> {
        let seen = self.seen.get(date).filter(|seen| seen.days > 0 && seen.days == seen.dates)?;
        let mut clocks = (0..self.seen.len()).filter(|at| self.seen[*at].is_clocks());
        clocks.next().filter(|_| seen.is_dates() && clocks.next().is_none())
    }

    fn times(&self) -> Result<Vec<TimeColumn>, ExportError> {
        if let Some(at) = self.mapped(Part::Time)? {
            return Ok(vec![self.time(at, self.clock_of(at))]);
        }
        let small = |name: &&String| unit_of_time(&plain(name)).is_some_and(|unit_ns| unit_ns < NS_PER_S);
        if let Some(part) = self.table.names.iter().find(small) {
            let text = format!("the column {part:?} seems to be a part of the time");
            let remedy = "join it with the time in one column, or choose the time without it: --map t=COLUMN,op=…,pv=…";
            return Err(ExportError::at(self.table.line, text, remedy));
        }
        let mut dates: Vec<usize> = (0..self.seen.len()).filter(|at| self.seen[*at].is_dates()).collect();
        // Values that a spreadsheet shows as dates are no times.
        if dates.iter().any(|at| role(&self.name(*at)).is_none()) {
            dates.retain(|at| role(&self.name(*at)).is_none());
        }
        let clocks: Vec<usize> = (0..self.seen.len()).filter(|at| self.seen[*at].is_clocks()).collect();
        if let (&[date], &[clock]) = (&dates[..], &clocks[..]) {
            let named = self.table.names.get(date).is_none_or(|n| is_date(n) || is_time(n));
            if named {
                return Ok(vec![self.time(date, Some(clock))]);
            }
        }
        let named: Vec<usize> = (0..self.table.names.len())
            .filter(|at| is_time(&self.table.names[*at]) && self.seen.get(*at).is_some_and(|s| s.filled > 0))
            .collect();
        // Typed and written dates need no name; numbers do.
        let mut found = if dates.is_empty() { named } else { dates };
        if found.len() > 1 {
            let by_source = |at: &&usize| plain(&self.name(**at)).contains("source") || self.name(**at) == "_time";
            if let Some(source) = found.iter().find(by_source) {
                found = vec![*source];
            } else if self.is_long_by_names() {
                found.truncate(1);
            }
        }
        if found.is_empty() && self.table.names.is_empty() && !self.seen.is_empty() {
            // Without names the first column counts, as everywhere; its numbers are checked like others.
            found.push(0);
        }
        if found.is_empty() {
            let text = format!("no time column among {}", listed(&self.table.names));
            return Err(ExportError::at(self.table.line, text, "name it: --map t=COLUMN,op=…,pv=…"));
        }
        if let Some(pair) = found.windows(2).find(|w| w[1] == w[0] + 1) {
            let text = format!("{:?} and {:?} both contain times", self.name(pair[0]), self.name(pair[1]));
            return Err(ExportError::at(self.table.line, text, "choose one: --map t=COLUMN,op=…,pv=…"));
        }
        Ok(found.into_iter().map(|at| self.time(at, None)).collect())
    }

    fn is_long_by_names(&self) -> bool {
        let names = &self.table.names;
        names.iter().any(|n| is_tag(n)) && names.iter().any(|n| is_value(n))
    }

    fn long(&self, times: &[TimeColumn]) -> Result<Option<Shape>, ExportError> {
        let names = &self.table.names;
        let is_time = |at: &usize| times.iter().any(|time| time.holds(*at));
        let by = |is: fn(&str) -> bool| (0..names.len()).find(|at| is(&names[*at]) && !is_time(at));
        let tag = self.mapped(Part::Tag)?.or_else(|| by(is_tag));
        let value = self.mapped(Part::Value)?.or_else(|| by(is_value));
        let quality = self.mapped(Part::Quality)?.or_else(|| by(|name| quality_of(name).is_some()));
        match (tag, value) {
            (Some(tag), Some(value)) if times.len() == 1 => {
                let doubts = (0..names.len()).filter(|at| self.marks && doubt_of(&names[*at]).is_some()).collect();
                let quality = quality.filter(|q| *q != tag && *q != value);
                // InfluxDB parts the name of a series.
                let of = names.iter().position(|name| name == "_measurement").filter(|_| names[tag] == "_field");
                let unit = names.iter().position(|name| is_one_of(&plain(name), UNIT_HEADS));
                Ok(Some(Shape::Long { tag, of, value, quality, unit, doubts }))
            }
            _ => Ok(None),
        }
    }

    fn wide(&self, times: &[TimeColumn]) -> Result<Vec<ValueColumn>, ExportError> {
        let is_time = |at: usize| times.iter().any(|time| time.holds(at));
        // A column's time stands before it; columns before the first time share that.
        let time_of = |at: usize| times.iter().rposition(|t| t.at < at).unwrap_or(0);
        let mut values: Vec<ValueColumn> = Vec::new();
        let mut mapped: Vec<(usize, &str)> = Vec::new();
        for (_, tag) in self.map.iter().flat_map(|map| map.signals()) {
            mapped.extend(find(tag, self.table, self.columns())?.map(|at| (at, tag)));
        }
        let quality = self.mapped(Part::Quality)?;
        let [mut marks, mut doubts, mut units]: [Vec<(usize, String)>; 3] = Default::default();
        for at in (0..self.columns()).filter(|at| !is_time(*at)) {
            let name = self.table.names.get(at).map_or("", String::as_str);
            let own = mapped.iter().find(|(column, _)| *column == at).map(|(_, tag)| *tag);
            let quality = if quality == Some(at) { Some(String::new()) } else { quality_of(name) };
            match (own, quality, doubt_of(name), plain(name).strip_suffix(" unit")) {
                (None, Some(of), ..) => marks.push((at, of)),
                (None, None, Some(of), _) => doubts.push((at, of)),
                (None, None, None, Some(of)) => units.push((at, of.to_owned())),
                _ if own.is_none() && name.is_empty() => {}
                _ => {
                    let (time, tag) = (time_of(at), own.unwrap_or(name).to_owned());
                    values.push(ValueColumn { at, time, quality: None, doubts: Vec::new(), unit: None, tag });
                }
            }
        }
        for value in &mut values {
            value.unit = units.iter().find(|(_, of)| *of == plain(&value.tag)).map(|(at, _)| *at);
        }
        self.own_times(times, &mapped)?;
        if self.marks {
            let all: Vec<usize> = marks.iter().chain(&doubts).map(|(at, _)| *at).collect();
            let among = |at: usize| all.contains(&at);
            self.judge(&mut values, &marks, &among, |value, at| value.quality = value.quality.or(Some(at)))?;
            let word = |at: usize| plain(&self.name(at));
            while let Some(first) = doubts.first().map(|(at, _)| word(*at)) {
                let (same, rest): (Vec<_>, Vec<_>) = doubts.into_iter().partition(|(at, _)| word(*at) == first);
                self.judge(&mut values, &same, &among, |value, at| value.doubts.push(at))?;
                doubts = rest;
            }
        }
        if values.is_empty() {
            let text = if self.table.names.is_empty() {
                "the file has no header".to_owned()
            } else {
                format!("no value column among {}", listed(&self.table.names))
            };
            let remedy = "name the columns by number, counted from 1: --map t=1,op=2,pv=3";
            return Err(ExportError::at(self.table.line, text, remedy));
        }
        Ok(values)
    }

    /// With `t` in --map one time column counts: another one between the signals would be that of the second.
    fn own_times(&self, times: &[TimeColumn], mapped: &[(usize, &str)]) -> Result<(), ExportError> {
        let (first, last) = (mapped.iter().map(|m| m.0).min(), mapped.iter().map(|m| m.0).max());
        let (Some(first), Some(last)) = (first, last) else { return Ok(()) };
        let is_time = |at: usize| times.iter().any(|time| time.holds(at));
        let other = (first..last).find(|at| self.seen.get(*at).is_some_and(Seen::is_dates) && !is_time(*at));
        other.map_or(Ok(()), |at| {
            let what = format!("column {} also contains times, those of the signal behind it", at + 1);
            let remedy = "leave t= out of --map, so that each signal is read at its own times";
            Err(ExportError::at(self.table.line, what, remedy))
        })
    }

    /// Gives each quality column to the values that it judges: by name, or because
    /// it follows its value. A column that judges all values is the first or the last one.
    fn judge(
        &self,
        values: &mut [ValueColumn],
        marks: &[(usize, String)],
        among: &dyn Fn(usize) -> bool,
        give: impl Fn(&mut ValueColumn, usize),
    ) -> Result<(), ExportError> {
        let (unnamed, named): (Vec<_>, Vec<_>) = marks.iter().partition(|(_, of)| of.is_empty());
        let names = &self.table.names;
        for (at, of) in named {
            let own = |value: &ValueColumn| names.get(value.at).map_or_else(|| value.tag.clone(), |name| plain(name));
            let same =
                |v: &ValueColumn| own(v).strip_prefix(of.as_str()).is_some_and(|end| end.is_empty() || is_ending(end));
            let signal = |v: &ValueColumn| role(&v.tag).is_some_and(|role| role.signal.name() == of);
            let (whole, short) = (values.iter().any(same), values.iter().any(signal));
            if whole || short {
                values.iter_mut().filter(|v| if whole { same(v) } else { signal(v) }).for_each(|v| give(v, *at));
            } else if values.iter().any(|v| role(&v.tag).is_some() && own(v).starts_with(of.as_str()))
                || self.has_marks(*at)
            {
                return Err(self.whose(*at));
            }
        }
        let columns: Vec<usize> = values.iter().map(|v| v.at).collect();
        match &unnamed[..] {
            [] => {}
            [(at, _)] if columns.iter().all(|c| c < at) || columns.iter().all(|c| c > at) => {
                values.iter_mut().for_each(|value| give(value, *at));
            }
            several => {
                for (at, _) in several {
                    let before = values.iter_mut().rfind(|v| v.at < *at && (v.at + 1..*at).all(among));
                    give(before.ok_or_else(|| self.whose(*at))?, *at);
                }
            }
        }
        Ok(())
    }

    fn has_marks(&self, at: usize) -> bool {
        self.seen
            .get(at)
            .is_some_and(|seen| !seen.texts.is_empty() && seen.texts.iter().all(|text| Mark::read(text).is_some()))
    }

    fn whose(&self, at: usize) -> ExportError {
        let what = format!("column {}, {:?}, does not show which values it judges", at + 1, self.name(at));
        let remedy = "name it after its column, such as \"PV Quality\", or leave it out with --quality ignore";
        ExportError::at(self.table.line, what, remedy)
    }
}
