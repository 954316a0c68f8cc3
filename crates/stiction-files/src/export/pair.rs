//! Series to loops: tags that belong together by name or by --map.

use std::collections::HashMap;

use super::columns::listed;

use super::map::{Map, Part};
use super::quality::Mark;
use super::series::{Series, Taken};
use super::{Contents, Export, ExportError, ReadOptions, Recognised};
use crate::{BAD, LoadedLoop};
use stiction::core::record::{Sample, Signal};
use stiction::core::units::loop_name_from;
use stiction_engine::analysis::rows::Rows;

/// Fewer equal values may be by chance.
const ENOUGH: usize = 10;
/// Most tags named in a warning.
const SHOWN: usize = 8;

/// A loop under construction.
struct Group {
    name: String,
    series: Vec<Series>,
}

/// Joins the series of files to loops. An unnamed loop gets the name of its file.
///
/// # Errors
/// No loop has both OP and PV.
pub(super) fn loops(files: Vec<(String, Contents)>, options: &ReadOptions) -> Result<Export, ExportError> {
    let mut export = Export::default();
    let (mut groups, mut by_name): (Vec<Group>, HashMap<String, usize>) = (Vec::new(), HashMap::new());
    let (mut words, mut counts, mut ignored, mut columns) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let own = matches!(&files[..], [(_, contents)] if contents.own);
    for (stem, contents) in files {
        export.warnings.extend(contents.warnings);
        ignored.extend(contents.ignored);
        counts.extend(contents.counts);
        if words.is_empty() {
            words = contents.words;
        }
        for series in contents.series {
            let name = if series.role.loop_name.is_empty() {
                named(&stem, options.map.as_ref())
            } else {
                series.role.loop_name.clone()
            };
            let at = *by_name.entry(name.to_uppercase()).or_insert(groups.len());
            if at == groups.len() {
                groups.push(Group { name, series: Vec::new() });
            }
            let group = &mut groups[at];
            // Files of consecutive days bring the same tag again.
            match group.series.iter_mut().find(|known| known.tag == series.tag && known.role == series.role) {
                Some(known) => known.samples.extend(series.samples),
                None => {
                    columns.push(in_words(&series, &group.name));
                    group.series.push(series);
                }
            }
        }
    }
    check_map(options.map.as_ref(), &groups)?;
    let tags: Vec<String> = groups.iter().flat_map(|g| g.series.iter().map(|s| s.tag.clone())).collect();
    let (mut lonely, mut copied): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
    for group in groups {
        let tags = || group.series.iter().map(|s| s.tag.as_str()).collect::<Vec<_>>().join(" and ");
        if is_one_signal_twice(&group) {
            copied.push(tags());
            continue;
        }
        match close(group, own, &mut export.warnings) {
            Ok(one) => export.loops.push(one),
            Err(tags) => lonely.extend(tags),
        }
    }
    if let Some(both) = copied.first() {
        let what = format!("{both} hold the same values, so they are one signal");
        let fault = ExportError::at(0, what, "name the other one: --map op=TAG,pv=TAG");
        if export.loops.is_empty() {
            return Err(fault);
        }
        export.warnings.push(format!("not read: {fault}"));
    }
    if export.loops.is_empty() {
        return Err(nothing(&tags, &ignored));
    }
    if !lonely.is_empty() {
        export.warnings.push(format!("skipped tags of loops without OP or PV: {}", shown(&lonely)));
    }
    if !ignored.is_empty() {
        export.warnings.push(format!("ignored columns or tags: {}", shown(&ignored)));
    }
    // The program's own tables are as their documentation says: there is nothing to tell.
    export.recognised = (!own || !counts.is_empty()).then(|| Recognised { form: words.join(", "), counts, columns });
    Ok(export)
}

/// The role that a tag is read as.
fn in_words(series: &Series, loop_name: &str) -> String {
    let unit = series.unit.as_ref().map_or_else(String::new, |unit| format!(" in {unit}"));
    let quality = series.quality.as_ref().map_or_else(String::new, |name| format!(", quality by {name:?}"));
    format!("{:?} is {} of {loop_name}{unit}{quality}", series.tag, series.role.signal.name())
}

fn shown(names: &[String]) -> String {
    let first: Vec<&str> = names.iter().take(SHOWN).map(String::as_str).collect();
    let more = names.len().saturating_sub(SHOWN);
    if more == 0 { first.join(", ") } else { format!("{} and {more} more", first.join(", ")) }
}

/// A mapped loop is named after the common part of the tags of OP and PV, else after its file.
fn named(stem: &str, map: Option<&Map>) -> String {
    let tag = |signal| map.and_then(|m| m.of(Part::Signal(signal)));
    if let (Some(op), Some(pv)) = (tag(Signal::Op), tag(Signal::Pv)) {
        let shared: String = op.chars().zip(pv.chars()).take_while(|(a, b)| a == b).map(|(a, _)| a).collect();
        let shared = shared.trim_end_matches(|c: char| !c.is_alphanumeric());
        if shared.len() >= 3 {
            return loop_name_from(shared);
        }
    }
    loop_name_from(stem)
}

fn check_map(map: Option<&Map>, groups: &[Group]) -> Result<(), ExportError> {
    let Some(map) = map.filter(|m| m.names_signals()) else { return Ok(()) };
    let missing =
        map.signals().find(|(signal, _)| !groups.iter().flat_map(|g| &g.series).any(|s| s.role.signal == *signal));
    missing.map_or(Ok(()), |(signal, tag)| {
        let text = format!("no column or tag {tag:?}, which --map gives as {}", signal.name());
        Err(ExportError::at(0, text, "use a name as in the file, or the column's number from 1"))
    })
}

fn nothing(tags: &[String], ignored: &[String]) -> ExportError {
    let all: Vec<String> = tags.iter().chain(ignored).cloned().collect();
    let text = match (tags, all.is_empty()) {
        (_, true) => "no rows of values".to_owned(),
        ([one], _) if ignored.is_empty() => format!("only one signal, {one:?}"),
        _ => format!("no loop with both OP and PV among {}", listed(&all)),
    };
    let remedy = "name them: --map op=TAG,pv=TAG[,sp=TAG]; if each signal has its own file, give the folder";
    ExportError::at(0, text, remedy)
}

/// Whether OP and PV change, and have equal values at all their times.
fn is_one_signal_twice(group: &Group) -> bool {
    let of = |signal| group.series.iter().find(|s| s.role.signal == signal).map_or(&[][..], |s| &s.samples[..]);
    let (op, pv) = (of(Signal::Op), of(Signal::Pv));
    let changes = op.windows(2).any(|w| w[0].value != w[1].value);
    changes
        && op.len() >= ENOUGH
        && op.len() == pv.len()
        && op.iter().zip(pv).all(|(a, b)| (a.t_ns, a.value) == (b.t_ns, b.value))
}

/// Samples of one loop in time order (of the program's own table in the order of its rows), or the tags of a loop without OP or PV.
fn close(group: Group, own: bool, warnings: &mut Vec<String>) -> Result<LoadedLoop, Vec<String>> {
    let mut by_signal: Vec<Option<Series>> = vec![None; Signal::ALL.len()];
    let mut tags = Vec::new();
    for series in group.series {
        tags.push(series.tag.clone());
        let place = Signal::ALL.iter().position(|s| *s == series.role.signal).unwrap_or(0);
        let left = match &by_signal[place] {
            Some(other) if other.role.rank <= series.role.rank => Some((other.tag.clone(), series.tag)),
            _ => {
                let tag = series.tag.clone();
                by_signal[place].replace(series).map(|weaker| (tag, weaker.tag))
            }
        };
        if let Some((kept, left)) = left {
            let signal = Signal::ALL[place].name();
            warnings.push(format!("{kept} is used for {signal}, {left} is ignored; choose with --map"));
        }
    }
    let has = |signal| Signal::ALL.iter().zip(&by_signal).any(|(s, found)| *s == signal && found.is_some());
    if !has(Signal::Op) || !has(Signal::Pv) {
        return Err(tags);
    }
    let unit = |wanted| by_signal.iter().flatten().find(|s| s.role.signal == wanted).and_then(|s| s.unit.clone());
    let units = [Signal::Op, Signal::Pv].map(unit);
    let of_row = |signal, taken: Taken| {
        let quality = (taken.mark == Mark::Bad).then_some(BAD);
        Sample { signal, t_ns: taken.t_ns, value: taken.value, quality }
    };
    if own {
        let series: Vec<(Signal, Series)> =
            Signal::ALL.into_iter().zip(by_signal).filter_map(|(signal, series)| Some((signal, series?))).collect();
        let mut rows = Rows::default();
        for row in 0..series.first().map_or(0, |(_, s)| s.samples.len()) {
            for (at, (signal, series)) in series.iter().enumerate() {
                let taken = series.samples[row];
                if at == 0 {
                    rows.begin(taken.t_ns);
                }
                rows.cell(*signal, (!taken.empty).then_some((taken.value, of_row(*signal, taken).quality)));
            }
        }
        let joined = rows.finish();
        warnings.extend(joined.warnings);
        return Ok(LoadedLoop { units, ..LoadedLoop::new(group.name, joined.samples) });
    }
    let mut samples: Vec<Sample> = Vec::new();
    for (signal, series) in Signal::ALL.into_iter().zip(by_signal) {
        let Some(series) = series else { continue };
        let empty = series.samples.iter().filter(|taken| taken.empty).count();
        // Where most cells are empty the rows are other tags' own; set points and modes are written when they change.
        let drop = !matches!(signal, Signal::Op | Signal::Pv) || 2 * empty > series.samples.len();
        let kept = series.samples.into_iter().filter(|taken| !(drop && taken.empty));
        let mut own: Vec<Sample> = kept.map(|taken| of_row(signal, taken)).collect();
        own.sort_by_key(|s| s.t_ns);
        // Overlapping exports bring rows twice.
        own.dedup();
        samples.append(&mut own);
    }
    // Stable: signals of one time stay in the order of `Signal::ALL`.
    samples.sort_by_key(|s| s.t_ns);
    Ok(LoadedLoop { units, ..LoadedLoop::new(group.name, samples) })
}
