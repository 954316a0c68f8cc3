//! What came, what became of it, and every stretch of time without a session.

use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Instant;

use serde::Serialize;

/// Outages that are listed; earlier ones are only counted.
const LISTED: usize = 1000;
/// Messages that are asked for again at once; what is missing beyond is lost.
const AGAIN: u32 = 10_000;

/// Counters, as they are told.
#[derive(Debug, Default, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Nodes that the server reports.
    pub nodes: usize,
    /// Nodes that it refuses; they are tried again every minute.
    pub refused_nodes: usize,
    /// Nodes that it reports when they change only.
    pub on_change_only: usize,
    /// Values from the server.
    pub received: u64,
    /// Those of them that had come before: a subscription begins with the last value.
    pub again: u64,
    /// Those that were bad and went as missing.
    pub bad: u64,
    /// Those that were uncertain.
    pub uncertain: u64,
    /// Arrays, texts and other values that measure nothing; not sent.
    pub refused: u64,
    /// Values before which the server dropped others, as its queue was full.
    pub overflows: u64,
    /// Put onto the bus.
    pub published: u64,
    /// Dropped, as nobody listened on the bus and the hold was full.
    pub dropped: u64,
    /// Held when the bridge ended.
    pub unsent: u64,
    /// Messages that were missing and came when asked for again.
    pub republished: u64,
    /// Messages that were missing and that the server had no more.
    pub lost_messages: u64,
    /// Sessions at the server.
    pub sessions: u64,
    /// Connections after which the server had kept session and queue.
    pub resumed: u64,
    /// When the first subscription stood.
    pub subscribed_ns: Option<i64>,
    /// Stretches without a session.
    pub outages: u64,
    /// How long they took together, s.
    pub away_s: f64,
    /// The latest of them, the present one included.
    pub outage_list: Vec<Outage>,
}

/// A stretch without a session.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outage {
    /// When the server was last heard of.
    pub start_ns: i64,
    /// When the nodes were subscribed to again; none while it lasts.
    pub end_ns: Option<i64>,
    /// Greatest source stamp before it.
    pub last_stamp_ns: Option<i64>,
    /// Whether the server had kept the session: then nothing is lost but what `overflows` and `lost_messages` say.
    pub resumed: bool,
    /// What was told of it.
    pub why: String,
}

impl Figures {
    /// In one line.
    pub fn line(&self) -> String {
        format!(
            "{} nodes; {} received ({} again, {} bad, {} uncertain, {} refused), {} published, {} dropped; \
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

/// The present outage, if there is one, and when the server was last heard of.
#[derive(Debug)]
pub struct Presence {
    heard: Instant,
    heard_ns: i64,
    newest_ns: Option<i64>,
    away: bool,
    /// What was told of the present outage.
    told: BTreeSet<String>,
}

impl Presence {
    /// Nothing was heard yet: away, though nothing was lost of that.
    pub fn new(now_ns: i64) -> Self {
        Self { heard: Instant::now(), heard_ns: now_ns, newest_ns: None, away: false, told: BTreeSet::new() }
    }

    /// The server has said something.
    pub fn heard(&mut self, now_ns: i64) {
        (self.heard, self.heard_ns) = (Instant::now(), now_ns);
    }

    /// A value of that stamp has come.
    pub fn stamped(&mut self, t_ns: i64) {
        self.newest_ns = self.newest_ns.max(Some(t_ns));
    }

    /// Seconds since the server was heard.
    pub fn silent_s(&self) -> f64 {
        self.heard.elapsed().as_secs_f64()
    }

    /// Whether there is an outage.
    pub fn is_away(&self) -> bool {
        self.away
    }

    /// The session is gone, or cannot be had; gives whether that was not told of this outage yet.
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

    /// The nodes are subscribed to; gives how long they were not, s.
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

/// Numbers of a subscription's messages: what is missing shows by them.
#[derive(Debug, Default)]
pub struct Sequence {
    next: Option<u32>,
    missing: BTreeSet<u32>,
}

impl Sequence {
    /// Takes a message; gives the numbers before it that have not come. One without data names the number that will be
    /// next.
    pub fn take(&mut self, number: u32, has_data: bool) -> Range<u32> {
        let next = self.next.unwrap_or(number);
        if number < next {
            self.missing.remove(&number);
            return 0..0;
        }
        self.next = Some(number.saturating_add(u32::from(has_data)));
        next..number.min(next.saturating_add(AGAIN))
    }

    /// The server has that message no more.
    pub fn lose(&mut self, number: u32) {
        self.missing.insert(number);
    }

    /// Messages that are lost.
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
        // One that came late after all.
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
