//! `--map`: the roles of tags or columns, given by the user.

use std::fmt;

use super::names::bare;
use stiction::core::record::Signal;

/// Role of a column that is not a signal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// Times.
    Time,
    /// Tags of a long table.
    Tag,
    /// Values of a long table.
    Value,
    /// Quality codes of a long table.
    Quality,
    /// A signal of the one loop.
    Signal(Signal),
}

/// `op=TAG,pv=TAG[,sp=TAG][,position=TAG][,mode=TAG][,t=COLUMN][,tag=COLUMN][,value=COLUMN][,quality=COLUMN]`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Map {
    parts: Vec<(Part, String)>,
}

fn part(word: &str) -> Option<Part> {
    match word.trim() {
        "t" | "time" => Some(Part::Time),
        "tag" => Some(Part::Tag),
        "value" => Some(Part::Value),
        "quality" => Some(Part::Quality),
        "position" => Some(Part::Signal(Signal::Mv)),
        other => Signal::from_name(other).map(Part::Signal),
    }
}

impl Map {
    /// Parses the value of --map. A tag may contain commas: a part begins only where a comma is followed by a keyword and `=`.
    ///
    /// # Errors
    /// A sentence that shows what is valid.
    pub fn parse(text: &str) -> Result<Self, String> {
        let known = "write op=TAG,pv=TAG[,sp=TAG][,position=TAG][,mode=TAG][,t=COLUMN], with columns by name or by number from 1";
        let mut parts: Vec<(Part, String)> = Vec::new();
        for piece in text.split(',') {
            match piece.split_once('=').and_then(|(word, tag)| part(word).map(|p| (p, tag.trim()))) {
                Some((part, _)) if parts.iter().any(|(p, _)| *p == part) => {
                    return Err(format!("{piece:?} repeats an earlier part; {known}"));
                }
                Some((part, tag)) if !tag.is_empty() => parts.push((part, tag.to_owned())),
                _ => match parts.last_mut() {
                    Some((_, tag)) => *tag = format!("{tag},{piece}"),
                    None => return Err(format!("{piece:?} is not valid; {known}")),
                },
            }
        }
        let signals: Vec<&(Part, String)> = parts.iter().filter(|(p, _)| matches!(p, Part::Signal(_))).collect();
        if let Some((_, twice)) = signals.iter().enumerate().find(|(at, s)| signals[..*at].iter().any(|o| o.1 == s.1)) {
            return Err(format!("{:?} cannot be two signals; {known}", twice.1));
        }
        Ok(Self { parts })
    }

    /// The value of a part.
    pub(super) fn of(&self, part: Part) -> Option<&str> {
        self.parts.iter().find(|(p, _)| *p == part).map(|(_, tag)| tag.as_str())
    }

    /// Whether it names a column, by name or by number from 0.
    pub(super) fn takes(&self, name: &str, at: usize) -> bool {
        self.parts.iter().any(|(_, wanted)| same(wanted, name) || wanted.parse() == Ok(at + 1))
    }

    /// Whether it names signals, not only time, tag and value columns.
    pub(super) fn names_signals(&self) -> bool {
        self.parts.iter().any(|(p, _)| matches!(p, Part::Signal(_)))
    }

    /// Signals with their tags.
    pub(super) fn signals(&self) -> impl Iterator<Item = (Signal, &str)> {
        self.parts.iter().filter_map(|(p, tag)| if let Part::Signal(s) = p { Some((*s, tag.as_str())) } else { None })
    }

    /// The signal of a tag.
    pub(super) fn signal_of(&self, tag: &str) -> Option<Signal> {
        self.signals().find(|(_, wanted)| same(wanted, tag)).map(|(signal, _)| signal)
    }
}

/// Whether two names are the same, ignoring letter case and units in brackets.
pub(super) fn same(wanted: &str, name: &str) -> bool {
    wanted.eq_ignore_ascii_case(name.trim()) || bare(wanted).eq_ignore_ascii_case(bare(name))
}

impl fmt::Display for Map {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, (part, tag)) in self.parts.iter().enumerate() {
            let word = match part {
                Part::Time => "t",
                Part::Tag => "tag",
                Part::Value => "value",
                Part::Quality => "quality",
                Part::Signal(signal) => signal.name(),
            };
            write!(f, "{}{word}={tag}", if at > 0 { "," } else { "" })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_are_read_or_refused_with_what_would_do() {
        let map = Map::parse("op=Valve, main,pv=41FI101,t=1").unwrap();
        assert_eq!(map.of(Part::Signal(Signal::Op)), Some("Valve, main"));
        assert_eq!((map.signal_of("41fi101 (m3/h)"), map.signal_of("t")), (Some(Signal::Pv), None));
        assert_eq!(map.to_string(), "op=Valve, main,pv=41FI101,t=1");
        for text in ["", "x", "op=", "op=1,op=2", "op=2,pv=2"] {
            assert!(Map::parse(text).unwrap_err().contains("op=TAG"), "{text}");
        }
    }
}
