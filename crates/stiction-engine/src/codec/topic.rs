//! Topics: the loop and the kind of a message.
//!
//! Raw signals are at `{prefix}/{loop}/op` and so on, the daemon's documents at `{prefix}/@stiction/v1/{loop}/estimate` and
//! so on. In foreign recordings the last level names the signal and everything before it the loop.

use std::fmt;
use stiction::core::record::Signal;

/// Topic levels below which the daemon publishes.
pub const OUTPUT_CHUNKS: &str = "@stiction/v1";

/// Takes the place of the loop's name for many loops together. Groups are below it, each under the first of its members' names.
pub const PLANT: &str = "@plant";

/// Schema name of a loop's health.
pub const LOOP_HEALTH_SCHEMA: &str = "stictiond.loop_health.v1";
/// Schema name of the daemon's own health.
pub const DAEMON_HEALTH_SCHEMA: &str = "stictiond.daemon_health.v1";
/// Schema name of the summary of obstacles that keep loops from being judged.
pub const DATA_HEALTH_SCHEMA: &str = "stictiond.data_health.v1";

/// Kind of a message; each has its own schema in a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// One sample of a signal.
    Sample,
    /// One sample of a controller mode.
    Mode,
    /// An estimate of one window.
    Estimate,
    /// A change of an alarm.
    Alarm,
    /// A gap diagnosis.
    Gap,
    /// A group of loops that share one oscillation.
    Group,
    /// The daemon's or a loop's health.
    Health,
    /// The summary of obstacles that keep loops from being judged.
    DataHealth,
    /// Initial state of a run.
    State,
    /// A command or clock event that entered a run.
    Input,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Self; 10] = [
        Self::Sample,
        Self::Mode,
        Self::Estimate,
        Self::Alarm,
        Self::Gap,
        Self::Group,
        Self::Health,
        Self::DataHealth,
        Self::State,
        Self::Input,
    ];

    /// The kind's word; for documents also the last level of the topic.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sample => "sample",
            Self::Mode => "mode",
            Self::Estimate => "estimate",
            Self::Alarm => "alarm",
            Self::Gap => "gap",
            Self::Group => "group",
            Self::Health => "health",
            Self::DataHealth => "data_health",
            Self::State => "state",
            Self::Input => "input",
        }
    }

    /// Name of the schema.
    #[must_use]
    pub const fn schema(self) -> &'static str {
        match self {
            Self::Sample => "stictiond.sample.v1",
            Self::Mode => "stictiond.mode.v1",
            Self::Estimate => "stictiond.estimate.v1",
            Self::Alarm => "stictiond.alarm.v2",
            Self::Gap => "stictiond.gap.v1",
            Self::Group => "stictiond.group.v1",
            Self::Health => LOOP_HEALTH_SCHEMA,
            Self::DataHealth => DATA_HEALTH_SCHEMA,
            Self::State => "stictiond.state.v1",
            Self::Input => "stictiond.input.v1",
        }
    }

    /// The kind for samples of a signal.
    #[must_use]
    pub const fn of_signal(signal: Signal) -> Self {
        if matches!(signal, Signal::Mode) { Self::Mode } else { Self::Sample }
    }

    /// The document kind whose topics end in `chunk`.
    #[must_use]
    pub fn of_document(chunk: &str) -> Option<Self> {
        Self::ALL[2..].iter().copied().find(|kind| kind.name() == chunk)
    }

    /// Whether it is raw data.
    #[must_use]
    pub const fn is_raw(self) -> bool {
        matches!(self, Self::Sample | Self::Mode)
    }
}

/// Last level of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Leaf {
    /// A raw signal.
    Raw(Signal),
    /// A document of the daemon.
    Document(Kind),
}

/// A parsed topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topic<'a> {
    /// Prefix of the site; empty in foreign recordings.
    pub prefix: &'a str,
    /// Loop name; `@daemon/{id}` for the daemon's own documents, [`PLANT`] or below it for those of many loops.
    pub loop_name: &'a str,
    /// Kind of its messages.
    pub leaf: Leaf,
}

impl<'a> Topic<'a> {
    /// Parses a topic. With a prefix, only topics below it are accepted. Without one, raw signals are recognised by their last
    /// level, and everything before it is the loop.
    #[must_use]
    pub fn parse(prefix: Option<&'a str>, topic: &'a str) -> Option<Self> {
        let (prefix, rest) = match prefix {
            Some(prefix) => (prefix, topic.strip_prefix(prefix)?.strip_prefix('/')?),
            None => ("", topic.trim_start_matches('/')),
        };
        if let Some(output) = rest.strip_prefix(OUTPUT_CHUNKS) {
            let (loop_name, chunk) = output.strip_prefix('/')?.rsplit_once('/')?;
            let leaf = Leaf::Document(Kind::of_document(chunk)?);
            return (!loop_name.is_empty()).then_some(Self { prefix, loop_name, leaf });
        }
        let (loop_name, chunk) = rest.rsplit_once('/')?;
        if loop_name.is_empty() || loop_name.split('/').any(|chunk| chunk.starts_with('@')) {
            return None;
        }
        let signal = Signal::from_name(&chunk.to_ascii_lowercase())?;
        Some(Self { prefix, loop_name, leaf: Leaf::Raw(signal) })
    }

    /// Whether it concerns many loops together.
    #[must_use]
    pub fn is_of_plant(&self) -> bool {
        self.loop_name.strip_prefix(PLANT).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
    }
}

impl fmt::Display for Topic<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.prefix.is_empty() {
            write!(f, "{}/", self.prefix)?;
        }
        match self.leaf {
            Leaf::Raw(signal) => write!(f, "{}/{}", self.loop_name, signal.name()),
            Leaf::Document(kind) => write!(f, "{OUTPUT_CHUNKS}/{}/{}", self.loop_name, kind.name()),
        }
    }
}

/// Canonical topic of a signal.
#[must_use]
pub fn raw(prefix: &str, loop_name: &str, signal: Signal) -> String {
    Topic { prefix, loop_name, leaf: Leaf::Raw(signal) }.to_string()
}

/// Topic of a document.
#[must_use]
pub fn result(prefix: &str, loop_name: &str, kind: Kind) -> String {
    Topic { prefix, loop_name, leaf: Leaf::Document(kind) }.to_string()
}

/// A topic of the daemon itself, such as `@daemon/ID`.
#[must_use]
pub fn plane(prefix: &str, rest: &str) -> String {
    format!("{prefix}/{OUTPUT_CHUNKS}/{rest}")
}

/// Last level of a topic.
#[must_use]
pub fn leaf(topic: &str) -> &str {
    topic.rsplit('/').next().unwrap_or(topic)
}

/// Schema of the document on a topic.
#[must_use]
pub fn schema_of(topic: &str) -> Option<&'static str> {
    let kind = Kind::of_document(leaf(topic))?;
    let own = kind == Kind::Health && topic.contains("/@daemon/");
    Some(if own { DAEMON_HEALTH_SCHEMA } else { kind.schema() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn topics_come_apart_and_together() {
        let cases: [(Option<&str>, &str, &str, Leaf); 7] = [
            (Some("p/a"), "p/a/FIC101/op", "FIC101", Leaf::Raw(Signal::Op)),
            (Some("p"), "p/u1/FIC101/pv", "u1/FIC101", Leaf::Raw(Signal::Pv)),
            (Some("p"), "p/@stiction/v1/FIC101/estimate", "FIC101", Leaf::Document(Kind::Estimate)),
            (Some("p"), "p/@stiction/v1/u1/FIC101/alarm", "u1/FIC101", Leaf::Document(Kind::Alarm)),
            (Some("p"), "p/@stiction/v1/@daemon/d1/health", "@daemon/d1", Leaf::Document(Kind::Health)),
            (Some("p"), "p/@stiction/v1/@plant/u1/FIC101/group", "@plant/u1/FIC101", Leaf::Document(Kind::Group)),
            (None, "site/FIC101/mode", "site/FIC101", Leaf::Raw(Signal::Mode)),
        ];
        for (prefix, text, loop_name, leaf) in cases {
            let topic = Topic::parse(prefix, text).unwrap();
            assert_eq!((topic.loop_name, topic.leaf), (loop_name, leaf), "{text}");
            assert_eq!(topic.to_string(), text);
        }
    }

    #[test]
    fn each_topic_has_one_schema() {
        assert_eq!(schema_of("p/@stiction/v1/u1/FIC101/alarm"), Some("stictiond.alarm.v2"));
        assert_eq!(schema_of("p/@stiction/v1/A/health"), Some("stictiond.loop_health.v1"));
        assert_eq!(schema_of("p/@stiction/v1/@daemon/d1/health"), Some("stictiond.daemon_health.v1"));
        assert_eq!(schema_of("p/@stiction/v1/@daemon/d1/data_health"), Some("stictiond.data_health.v1"));
        assert_eq!(schema_of("p/FIC101/op"), None);
    }

    #[test]
    fn other_topics_are_left_alone() {
        for (prefix, text) in [
            (Some("p"), "q/FIC101/op"),
            (Some("p"), "p/op"),
            (Some("p"), "prefix/FIC101/op"),
            (Some("p"), "p/FIC101/flow"),
            (Some("p"), "p/@stiction/v1/FIC101/op"),
            (Some("p"), "p/@stiction/v1/estimate"),
            (Some("p"), "p/@other/FIC101/op"),
            (None, "op"),
            (None, "/op"),
        ] {
            assert_eq!(Topic::parse(prefix, text), None, "{text}");
        }
        assert_eq!(Topic::parse(None, "/Plant/FIC101/PV").unwrap().leaf, Leaf::Raw(Signal::Pv));
    }

    proptest! {
        #[test]
        fn any_topic_is_answered(topic in "[a@/opv1stic]{0,30}", prefix in "[a/]{0,4}") {
            let _ = Topic::parse(Some(&prefix), &topic);
            if let Some(parsed) = Topic::parse(None, &topic) {
                prop_assert!(!parsed.loop_name.is_empty());
            }
        }
    }
}
