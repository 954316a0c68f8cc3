//! Tag names: the loop and signal of a column or tag.

use crate::conventions::{
    BLOCKS, DATES, DOUBTS, ENDS, HEADS, QUALITIES, SEPARATORS, TAGS, TIMES, VALUES, is_one_of, unit_of_time,
};
use stiction::core::record::Signal;
use stiction::core::units::loop_name_from;

/// The role of a tag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Role {
    /// Loop name; empty if the tag names only a signal.
    pub loop_name: String,
    /// The signal.
    pub signal: Signal,
    /// Position in the list of its signal's endings: smaller is stronger.
    pub rank: usize,
}

/// A tag without its unit in brackets (Seeq's `41FIC101.OP (%)`), server and namespace.
pub(super) fn bare(tag: &str) -> &str {
    let mut tag = tag.trim().trim_matches('"').trim();
    for (open, close) in [('(', ')'), ('[', ']'), ('{', '}')] {
        if let (true, Some(at)) = (tag.ends_with(close), tag.rfind(open)) {
            tag = if at > 0 { tag[..at].trim_end() } else { tag };
        }
    }
    if let Some((_, after)) = tag.rsplit_once(";s=") {
        tag = after;
    }
    // \\server\tag of PI, \\AF\database\unit|loop|attribute of its asset framework.
    if let (true, Some((_, last))) = (tag.starts_with("\\\\"), tag.rsplit_once('\\')) {
        tag = last;
    }
    tag
}

/// The unit in brackets after a name.
pub(super) fn unit(name: &str) -> Option<&str> {
    let name = name.trim();
    [('(', ')'), ('[', ']')].into_iter().find_map(|(open, close)| {
        let inside = name.strip_suffix(close)?;
        inside.rfind(open).map(|at| inside[at + 1..].trim())
    })
}

/// A text without an ending (ignoring letter case) that follows a separator or is the whole text.
fn without<'t>(text: &'t str, end: &str) -> Option<&'t str> {
    let at = text.len().checked_sub(end.len())?;
    if !text.is_char_boundary(at) || !text[at..].eq_ignore_ascii_case(end) {
        return None;
    }
    let stem = &text[..at];
    if stem.is_empty() {
        return Some("");
    }
    stem.strip_suffix(|c: char| SEPARATORS.contains(c))
}

/// Loop and signal of a tag; `None` if its ending is unknown.
#[must_use]
pub fn role(tag: &str) -> Option<Role> {
    let tag = bare(tag);
    let plain = VALUES.split('|').find_map(|end| without(tag, end).filter(|stem| !stem.is_empty()));
    let found = longest_end(tag).or_else(|| longest_end(plain?))?;
    let (stem, signal, rank) = found;
    let stem = BLOCKS.split('|').find_map(|block| without(stem, block).filter(|s| !s.is_empty())).unwrap_or(stem);
    let loop_name = if stem.is_empty() { String::new() } else { loop_name_from(stem) };
    // A column called mv alone is the program's own word for the valve's position.
    let signal = if stem.is_empty() && tag.get(..2).is_some_and(|start| start.eq_ignore_ascii_case("MV")) {
        Signal::Mv
    } else {
        signal
    };
    Some(Role { loop_name, signal, rank })
}

/// Splits off the longest known ending: the rest of the tag, the signal, and the ending's rank for that signal.
fn longest_end(tag: &str) -> Option<(&str, Signal, usize)> {
    let ends =
        ENDS.iter().flat_map(|(signal, ends)| ends.split('|').enumerate().map(|(rank, end)| (end, *signal, rank)));
    let fits = ends.filter_map(|(end, signal, rank)| Some((without(tag, end)?, signal, rank, end.len())));
    fits.max_by_key(|(.., length)| *length).map(|(stem, signal, rank, _)| (stem, signal, rank))
}

/// A heading in lower case without units and punctuation.
pub(super) fn plain(name: &str) -> String {
    let words = bare(name).to_lowercase();
    words.split(|c: char| !c.is_alphanumeric()).filter(|w| !w.is_empty()).collect::<Vec<_>>().join(" ")
}

/// Whether a heading is one of a time column.
pub(super) fn is_time(name: &str) -> bool {
    let name = plain(name);
    is_one_of(&name, TIMES)
        || name.ends_with(" timestamp")
        || name.starts_with("timestamp ")
        || ["t ", "ts ", "time ", "timestamp ", "epoch "]
            .iter()
            .any(|start| name.strip_prefix(start).is_some_and(|unit| unit_of_time(unit).is_some()))
}

/// Whether a heading is one of a date column without time of day.
pub(super) fn is_date(name: &str) -> bool {
    is_one_of(&plain(name), DATES)
}

/// Whether a heading is one of a tag column.
pub(super) fn is_tag(name: &str) -> bool {
    is_one_of(&plain(name), TAGS)
}

/// Whether a heading is one of a value column.
pub(super) fn is_value(name: &str) -> bool {
    is_one_of(&plain(name), HEADS)
}

/// The tag that a quality column belongs to: `fic101 pv` for `FIC101.PV Status`, empty for `Quality`; `None` for other headings.
pub(super) fn quality_of(name: &str) -> Option<String> {
    let own = words_of_quality(name, QUALITIES);
    if let (Some(""), Some(tag)) = (own.as_deref(), unit(name).filter(|inside| role(inside).is_some())) {
        return Some(plain(tag));
    }
    own.or_else(|| {
        let name = unnumbered(name);
        let first = |word: &&str| name.strip_prefix(*word)?.strip_prefix(' ').map(str::to_owned);
        // Behind a tag, short words and DeltaV's `.ST` do too.
        let short = |word: &&str| name.strip_suffix(*word)?.strip_suffix(' ').map(str::to_owned);
        ["quality", "status"].iter().find_map(first).or_else(|| ["q", "st", "sts", "qc"].iter().find_map(short))
    })
}

/// As [`quality_of`], for headings of flags that are set where a value is bad, such as PI's `Questionable`.
pub(super) fn doubt_of(name: &str) -> Option<String> {
    words_of_quality(name, DOUBTS)
}

/// Whether words behind a plain heading are those for a value, such as DeltaV's `CV`.
pub(super) fn is_ending(words: &str) -> bool {
    words.strip_prefix(' ').is_some_and(|end| is_one_of(&end.to_uppercase().replace(' ', "_"), VALUES))
}

/// A plain heading without the number that data tools give to headings that occur twice.
fn unnumbered(name: &str) -> String {
    plain(name).trim_end_matches(|c: char| c.is_ascii_digit()).trim_end().to_owned()
}

/// The tag in a heading such as `FIC101.PV quality`: the heading without its last words, if they mean quality.
fn words_of_quality(name: &str, words: &str) -> Option<String> {
    let name = unnumbered(name);
    let parts = |word: &str| match name.strip_suffix(word)? {
        "" => Some(String::new()),
        of => of.strip_suffix(' ').map(str::to_owned),
    };
    words.split('|').filter_map(parts).min_by_key(String::len)
}

/// The unit of times that a heading names, ns: `Time [ms]`, `time_us`.
pub(super) fn time_unit(name: &str) -> Option<i64> {
    match unit(name) {
        Some(bracketed) => unit_of_time(bracketed),
        None => plain(name).rsplit_once(' ').and_then(|(_, last)| unit_of_time(last)).filter(|_| is_time(name)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Signal::{Mode, Mv, Op, Pv, Sp};
    use stiction::core::units::NS_PER_S;

    #[test]
    fn tags_of_the_usual_systems_are_told() {
        for (tag, name, signal) in [
            ("41FIC101.OP", "41FIC101", Op),
            ("41FIC101.PV (m³/h)", "41FIC101", Pv),
            ("41FIC101.SP [%]", "41FIC101", Sp),
            ("41fic101_out", "41fic101", Op),
            ("41LIC7.MV", "41LIC7", Op),
            ("41LIC7.PROCESS_VALUE", "41LIC7", Pv),
            ("41LIC7.ACTUAL", "41LIC7", Pv),
            ("41LIC7.SETPOINT", "41LIC7", Sp),
            ("41LIC7.SPT", "41LIC7", Sp),
            ("41LIC7.ZT", "41LIC7", Mv),
            ("41LIC7 Positioner Feedback", "41LIC7", Mv),
            (r"\\PISRV01\41FIC101.PV", "41FIC101", Pv),
            (r"\\AF\Plant\Unit 41|41FIC101|OP", "Unit_41|41FIC101", Op),
            ("FIC101/PID1/OUT.CV", "FIC101", Op),
            ("FIC101/PID1/MODE.ACTUAL", "FIC101", Mode),
            ("41FIC101.PIDA.OP", "41FIC101", Op),
            ("41FIC101.DACA.PV", "41FIC101", Pv),
            ("ns=2;s=Area1.FIC101.SP", "Area1.FIC101", Sp),
            ("mv", "", Mv),
            ("OP", "", Op),
        ] {
            let role = role(tag).unwrap_or_else(|| panic!("{tag}"));
            assert_eq!((role.loop_name.as_str(), role.signal), (name, signal), "{tag}");
        }
        for tag in ["41TI5", "STOP", "comment", "41FIC101.MODE.TARGET", "", "SHOP"] {
            assert!(role(tag).is_none(), "{tag}");
        }
    }

    #[test]
    fn headings_are_told() {
        assert!(is_time("Time Stamp") && is_time("time [s]") && is_time("Date/Time") && !is_time("41FIC101.PV"));
        assert!(is_tag("TagName") && is_value("Value") && quality_of("Quality").is_some());
        assert_eq!(unit("t [s]"), Some("s"));
        for (name, of) in [
            ("41FIC101.PV Status", "41fic101 pv"),
            ("pv_quality", "pv"),
            ("Quality.1", ""),
            ("Quality (41FIC101.PV)", "41fic101 pv"),
            ("Quality (OPC)", ""),
        ] {
            assert_eq!(quality_of(name).as_deref(), Some(of), "{name}");
        }
        assert_eq!(quality_of("pv"), None);
        assert!(is_ending(" cv") && is_ending(" f cv") && !is_ending("cv") && !is_ending(" x"));
        for (name, unit) in
            [("Time [ms]", Some(1_000_000)), ("t (days)", Some(86_400 * NS_PER_S)), ("time_us", Some(1_000))]
        {
            assert_eq!(time_unit(name), unit, "{name}");
        }
        assert_eq!([time_unit("Time"), time_unit("t"), time_unit("Timestamp (UTC)"), time_unit("s")], [None; 4]);
    }
}
