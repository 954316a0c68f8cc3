//! The summary of the obstacles that keep loops from being judged, for receivers and the bus.

use serde::Serialize;

use crate::runtime::overview::{Obstacle, ObstacleKind, Obstacles, SharePoint};
use stiction::core::units::{Moment, ms_from_ns};
use stiction_engine::codec::topic::DATA_HEALTH_SCHEMA;
use stiction_engine::short_hash;

/// Most obstacles listed in a summary.
const LISTED: usize = 100;

/// `stictiond.data_health.v1`.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct DataHealthDocument {
    /// Schema name.
    pub schema: &'static str,
    /// The daemon that watches the loops.
    pub daemon: String,
    /// Identity of this summary: a consumer that has it already can drop the document.
    pub event_id: String,
    /// When it came due, ns since 1970.
    pub due_ns: i64,
    /// The same as RFC 3339.
    #[schemars(with = "String")]
    pub due: Moment,
    /// Loops that have appeared, and those that the configuration names.
    pub loops: usize,
    /// Loops that can be judged.
    pub judged: usize,
    /// `judged` over `loops`; null without loops.
    pub share: Option<f64>,
    /// The share a day before, or at the summary before where these come at another interval; null where it is unknown.
    pub share_before: Option<f64>,
    /// `share` less `share_before`; null where one of them is.
    pub change: Option<f64>,
    /// Loops by kind of obstacle.
    pub kinds: Vec<KindCount>,
    /// The first obstacles: those that block first, then by kind and by loop.
    pub obstacles: Vec<Obstacle>,
    /// Obstacles that are not listed.
    pub more: usize,
    /// Version of the program.
    pub version: &'static str,
}

/// Loops with one kind of obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, schemars::JsonSchema)]
pub struct KindCount {
    /// Kind.
    pub kind: ObstacleKind,
    /// Loops.
    pub loops: usize,
}

/// Identifies a summary.
#[derive(Debug, Clone, Copy)]
pub struct Due<'a> {
    /// Prefix of the site.
    pub prefix: &'a str,
    /// The daemon's id.
    pub daemon: &'a str,
    /// The daemon's part of the loops, from 0. Unlike the id, it does not change at a restart.
    pub part: u32,
    /// When it came due, ns since 1970.
    pub due_ns: i64,
    /// Time since the previous one, ns.
    pub every_ns: i64,
}

impl DataHealthDocument {
    /// The summary of these obstacles.
    #[must_use]
    pub fn new(due: Due<'_>, found: &Obstacles) -> Self {
        let mut obstacles = found.obstacles.clone();
        // A stable sort, so that obstacles of one kind remain sorted by name.
        obstacles.sort_by_key(|obstacle| !obstacle.blocks);
        let more = obstacles.len().saturating_sub(LISTED);
        obstacles.truncate(LISTED);
        let kinds = found.obstacles.chunk_by(|a, b| a.kind == b.kind);
        let share_before = share_before(&found.trend, due);
        Self {
            schema: DATA_HEALTH_SCHEMA,
            daemon: due.daemon.to_owned(),
            event_id: short_hash(format!("{}\ndata_health\n{}\n{}", due.prefix, due.part, due.due_ns).as_bytes()),
            due_ns: due.due_ns,
            due: Moment(due.due_ns),
            loops: found.loops,
            judged: found.judged,
            share: found.share,
            share_before,
            change: found.share.zip(share_before).map(|(now, before)| now - before),
            kinds: kinds.map(|of| KindCount { kind: of[0].kind, loops: of.len() }).collect(),
            obstacles,
            more,
            version: stiction::core::VERSION,
        }
    }

    /// One line for people.
    #[must_use]
    pub fn line(&self) -> String {
        let Some(share) = self.share else { return "data: no loop has appeared".to_owned() };
        let percent = |x: f64| format!("{:.1} %", 100.0 * x);
        let before = self.share_before.map(|before| format!(", {} before", percent(before))).unwrap_or_default();
        let kinds: Vec<String> = self.kinds.iter().map(|of| format!("{} {}", of.loops, of.kind.words())).collect();
        let kinds = if kinds.is_empty() { String::new() } else { format!(": {}", kinds.join(", ")) };
        format!("data: {} of {} loops can be judged{before}{kinds}", percent(share), self.loops)
    }
}

/// The share one interval earlier: the nearest point of the trend.
fn share_before(trend: &[SharePoint], due: Due<'_>) -> Option<f64> {
    let (at_ms, most_ms) = (ms_from_ns(due.due_ns - due.every_ns), ms_from_ns(due.every_ns) / 2.0);
    let distance = |point: &SharePoint| (point.t_ms - at_ms).abs();
    let nearest = trend.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    (distance(nearest) < most_ms).then_some(nearest.share)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR_NS: i64 = 3_600_000_000_000;

    fn obstacle(k: usize, blocks: bool) -> Obstacle {
        let kind = if blocks { ObstacleKind::TooSlow } else { ObstacleKind::Compressed };
        let (loop_name, text) = (format!("L{k:03}"), String::new());
        Obstacle {
            loop_name,
            area: None,
            kind,
            appeared: true,
            blocks,
            since_ms: None,
            words: text.clone(),
            remedy: text,
        }
    }

    fn summary(obstacles: Vec<Obstacle>, trend: Vec<SharePoint>, share: Option<f64>) -> DataHealthDocument {
        let found = Obstacles { loops: 200, judged: 190, share, obstacles, trend };
        let due = Due { prefix: "p", daemon: "d", part: 0, due_ns: 48 * HOUR_NS, every_ns: 24 * HOUR_NS };
        DataHealthDocument::new(due, &found)
    }

    #[test]
    fn the_list_is_bounded_and_begins_with_what_blocks() {
        let mut obstacles: Vec<Obstacle> = (0..10).map(|k| obstacle(k, true)).collect();
        obstacles.extend((10..150).map(|k| obstacle(k, false)));
        obstacles.reverse();
        let document = summary(obstacles, Vec::new(), Some(0.95));
        assert_eq!((document.obstacles.len(), document.more), (100, 50));
        assert!(document.obstacles[..10].iter().all(|o| o.blocks) && !document.obstacles[10].blocks);
        assert_eq!(document.line(), "data: 95.0 % of 200 loops can be judged: 140 compressed, 10 sampled too slowly");
        assert_eq!((document.share_before, document.change), (None, None));
        assert_eq!(summary(Vec::new(), Vec::new(), None).line(), "data: no loop has appeared");
    }

    #[test]
    fn the_change_is_that_since_the_summary_before() {
        let point = |hour: i64, share: f64| SharePoint { t_ms: ms_from_ns(hour * HOUR_NS), judged: 1, loops: 1, share };
        let document = summary(Vec::new(), vec![point(3, 0.1), point(25, 0.75), point(47, 0.9)], Some(1.0));
        assert_eq!((document.share_before, document.change), (Some(0.75), Some(0.25)));
        assert!(document.line().contains("100.0 % of 200 loops can be judged, 75.0 % before"), "{}", document.line());
        assert_eq!(summary(Vec::new(), vec![point(47, 0.9)], Some(1.0)).change, None, "no point near the day before");
    }
}
