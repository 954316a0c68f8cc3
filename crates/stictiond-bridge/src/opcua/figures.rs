//! Counters, and every outage of the session.

use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Instant;

use serde::Serialize;

/// Most outages listed; earlier ones are only counted.
const LISTED: usize = 1000;
/// Most messages requested again at once; any beyond are lost.
const AGAIN: u32 = 10_000;

/// Counters as reported.
#[derive(Debug, Default, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Nodes that the server reports.
    pub nodes: usize,
    /// Nodes that the server rejects; retried every minute.
    pub refused_nodes: usize,
    /// Nodes that the server reports only on change.
    pub on_change_only: usize,
    /// Values from the server.
    pub received: u64,
    /// Of these, repeats: a subscription begins with the last value.
    pub again: u64,
    /// Bad values, published as missing.
    pub bad: u64,
    /// Uncertain values.
    pub uncertain: u64,
    /// Arrays, texts and other values that are not a measurement; not published.
    pub refused: u64,
    /// Values preceded by a queue overflow at the server.
    pub overflows: u64,
    /// Published on the bus.
    pub published: u64,
    /// Dropped because nobody subscribed and the hold was full.
    pub dropped: u64,
    /// Still held when the bridge ended.
    pub unsent: u64,
    /// Missing messages that were requested again and received.
    pub republished: u64,
    /// Missing messages that the server no longer had.
    pub lost_messages: u64,
    /// Sessions at the server.
    pub sessions: u64,
    /// Reconnections after which the server had kept session and queue.
    pub resumed: u64,
    /// Time of the first subscription.
    pub subscribed_ns: Option<i64>,
    /// Number of outages.
    pub outages: u64,
    /// Total duration of the outages, s.
    pub away_s: f64,
    /// The latest outages, the current one included.
    pub outage_list: Vec<Outage>,
}

/// Time without a session.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outage {
    /// When the server was last heard.
    pub start_ns: i64,
    /// When the nodes were subscribed again; none while the outage lasts.
    pub end_ns: Option<i64>,
    /// Latest source timestamp before the outage.
    pub last_stamp_ns: Option<i64>,
    /// Whether the server had kept the session. If so, only `overflows` and `lost_messages` count as losses.
    pub resumed: bool,
    /// The reason that was logged.
    pub why: String,
}

impl Figures {
    /// One line for the log.
    pub fn line(&self) -> String {
        format!(
            "{} nodes; {} received ({} repeated, {} bad, {} uncertain, {} rejected), {} published, {} dropped; \
             {} overflows, {} messages lost; {} sessions, {} resumed, {} outages of {:.1} s",
            self.nodes,
            self.received,
            self.again,
            self.bad,
            self.uncertain,
            self.refused,
            self.published,
            self.dropped,
            self.overflows,
            self.lost_messages,
            self.sessions,
            self.resumed,
            self.outages,
            self.away_s
        )
    }
}

/// The current outage, if any, and when the server was last heard.
#[derive(Debug)]
pub struct Presence {
    heard: Instant,
    heard_ns: i64,
    newest_ns: Option<i64>,
    away: bool,
    /// The reason logged for the current outage.
    told: BTreeSet<String>,
}

impl Presence {
    /// Nothing received yet: away, although nothing was lost.
    pub fn new(now_ns: i64) -> Self {
        Self { heard: Instant::now(), heard_ns: now_ns, newest_ns: None, away: false, told: BTreeSet::new() }
    }

    /// The server has sent something.
    pub fn heard(&mut self, now_ns: i64) {
        (self.heard, self.heard_ns) = (Instant::now(), now_ns);
    }

    /// A value with this timestamp was received.
    pub fn stamped(&mut self, t_ns: i64) {
        self.newest_ns = self.newest_ns.max(Some(t_ns));
    }

    /// Seconds since the server was last heard.
    pub fn silent_s(&self) -> f64 {
        self.heard.elapsed().as_secs_f64()
    }

    /// Whether an outage is going on.
    pub fn is_away(&self) -> bool {
        self.away
    }

    /// The session is lost or cannot be opened. Returns whether this reason is new in this outage.
    pub fn gone(&mut self, figures: &mut Figures, why: &str) -> bool {
        let new = self.told.insert(why.to_owned());
        if self.away {
            return new;
        }
        self.away = true;
        // Before the first subscription there is nothing to lose.
        if figures.subscribed_ns.is_some() {
            figures.outages += 1;
            if figures.outage_list.len() >= LISTED {
                figures.outage_list.remove(0);
            }
            figures.outage_list.push(Outage {
                start_ns: self.heard_ns,
                end_ns: None,
                last_stamp_ns: self.newest_ns,
                resumed: false,
                why: why.to_owned(),
            });
        }
        new
    }

    /// The nodes are subscribed. Returns for how long they were not, s.
    pub fn back(&mut self, figures: &mut Figures, now_ns: i64, resumed: bool) -> f64 {
        let away_s = self.silent_s();
        if let Some(outage) = figures.outage_list.last_mut().filter(|outage| self.away && outage.end_ns.is_none()) {
            (outage.end_ns, outage.resumed) = (Some(now_ns), resumed);
            figures.away_s += away_s;
        }
        figures.subscribed_ns.get_or_insert(now_ns);
        self.away = false;
        self.told.clear();
        self.heard(now_ns);
        away_s
    }
}

/// Sequence numbers of a subscription's messages, which reveal missing ones.
#[derive(Debug, Default)]
pub struct Sequence {
    next: Option<u32>,
    missing: BTreeSet<u32>,
}

impl Sequence {
    /// Takes a message. Returns the numbers missing before it. A message without data carries the number of the next one.
    pub fn take(&mut self, number: u32, has_data: bool) -> Range<u32> {
        let next = self.next.unwrap_or(number);
        if number < next {
            self.missing.remove(&number);
            return 0..0;
        }
        self.next = Some(number.saturating_add(u32::from(has_data)));
        next..number.min(next.saturating_add(AGAIN))
    }

    /// The server no longer has that message.
    pub fn lose(&mut self, number: u32) {
        self.missing.insert(number);
    }

    /// Number of lost messages.
    pub fn lost(&self) -> u64 {
        self.missing.len() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_messages_show_by_their_numbers() {
        let mut sequence = Sequence::default();
        assert!(sequence.take(7, true).is_empty());
        assert!(sequence.take(8, false).is_empty(), "a keep-alive names the next number");
        assert!(sequence.take(8, true).is_empty());
        assert_eq!(sequence.take(11, true), 9..11);
        assert_eq!(sequence.take(13, false), 12..13);
        sequence.lose(9);
        sequence.lose(12);
        assert_eq!(sequence.lost(), 2);
        // A missing message that arrives late.
        assert!(sequence.take(9, true).is_empty());
        assert_eq!(sequence.lost(), 1);
        assert_eq!(sequence.take(u32::MAX, true), 13..13 + AGAIN);
    }

    #[test]
    fn outages_have_a_start_and_an_end() {
        let (mut figures, mut presence) = (Figures::default(), Presence::new(1));
        assert!(presence.gone(&mut figures, "refused") && !presence.gone(&mut figures, "refused"));
        presence.back(&mut figures, 10, false);
        assert_eq!((figures.outages, figures.subscribed_ns), (0, Some(10)));
        presence.heard(20);
        presence.stamped(19);
        presence.stamped(18);
        assert!(presence.gone(&mut figures, "lost") && presence.is_away());
        assert!(presence.gone(&mut figures, "not trusted") && !presence.gone(&mut figures, "lost"));
        presence.back(&mut figures, 30, true);
        let listed =
            Outage { start_ns: 20, end_ns: Some(30), last_stamp_ns: Some(19), resumed: true, why: "lost".into() };
        assert!(figures.line().contains("1 outages of "), "{}", figures.line());
        assert_eq!((figures.outages, figures.outage_list), (1, vec![listed]));
        assert!(!presence.is_away());
    }
}
