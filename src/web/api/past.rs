//! A loop's past, from the recordings: curves, windows, and changes of its alarm.

use std::collections::{BTreeSet, HashSet};
use std::sync::Arc;
use std::time::Instant;

use axum::Json;
use axum::extract::State;
use axum::routing::get;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::curves::{Curves, PATIENCE, recorded_within};
use super::{Answered, Live, Operation, Parameter, ResponseKind, Shared, of};
use crate::runtime::clock::now_ns;
use crate::web::error::ApiError;
use crate::web::extract::{PathName, QueryParams};
use crate::web::thin::thin;
use stiction::core::record::Signal;
use stiction::core::units::{ms_from_ns, ns_from_ms, ns_from_s};
use stiction::over_time::WindowResult;
use stiction_engine::analysis::{Points, Section};
use stiction_engine::codec::topic::{self, Kind};
use stiction_files::archive::{Archive, Reach, Wanted};

/// Default number of points of a curve, and the most.
const POINTS: usize = 2_000;
const MOST_POINTS: usize = 20_000;
/// Default time before the newest sample.
const PAST_S: f64 = 90.0 * 86_400.0;
/// Most windows and changes returned; the newest ones.
const MOST_WINDOWS: usize = 5_000;

/// Curves over a period.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct Trend {
    /// First stamp asked for, ms since 1970.
    from_ms: f64,
    /// Last stamp asked for, ms since 1970.
    to_ms: f64,
    /// The curves, thinned with their extremes kept.
    #[serde(flatten)]
    curves: Curves,
    /// Whether all recordings of the time were read; if not, ask again.
    complete: bool,
}

/// Windows of a period.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct History {
    /// First window end asked for, ms since 1970.
    from_ms: f64,
    /// Last window end asked for, ms since 1970.
    to_ms: f64,
    /// Whether all recordings of the time were read; if not, ask again.
    complete: bool,
    /// Oldest first.
    windows: Vec<PastWindow>,
}

/// The retained part of a recorded estimate; fields as in `stictiond.estimate.v1`.
#[derive(Debug, Clone, Serialize, Deserialize, schemars::JsonSchema)]
#[allow(missing_docs)] // defined in docs/read-a-result.md
pub(super) struct PastWindow {
    #[serde(skip_deserializing)]
    pub start_ms: f64,
    #[serde(skip_deserializing)]
    pub end_ms: f64,
    #[serde(skip_serializing)]
    #[schemars(skip)]
    window: Bounds,
    pub verdict: String,
    /// The part by which windows are taken together.
    #[serde(flatten)]
    #[schemars(skip)]
    pub result: WindowResult,
    pub fs: Option<f64>,
    pub fs_interval: Option<[f64; 2]>,
    pub fd: Option<f64>,
    pub fd_interval: Option<[f64; 2]>,
    pub stiction_index: Option<f64>,
    #[serde(skip_deserializing)]
    pub period_s: Option<f64>,
    #[serde(skip_serializing)]
    #[schemars(skip)]
    oscillation: Cycle,
}

#[derive(Debug, Clone, Copy, Deserialize)]
struct Bounds {
    start_ns: i64,
    end_ns: i64,
}

#[derive(Debug, Clone, Copy, Deserialize)]
struct Cycle {
    period_s: Option<f64>,
}

/// Changes of an alarm.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct Changes {
    /// Whether all recordings of the time were read; if not, ask again.
    complete: bool,
    /// `stictiond.alarm.v2`, newest first.
    changes: Vec<Value>,
}

/// A period, and the number of points.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Range {
    from_ms: Option<f64>,
    to_ms: Option<f64>,
    points: Option<usize>,
}

pub(super) const FROM: Parameter =
    Parameter { name: "from_ms", words: "first stamp, ms since 1970; 90 days before the newest sample if absent" };
pub(super) const TO: Parameter =
    Parameter { name: "to_ms", words: "last stamp, ms since 1970; now, or a later newest sample, if absent" };
const FEWER: Parameter = Parameter { name: "points", words: "about how many points; 2000 if absent, 20000 at most" };

pub(super) fn operations() -> Vec<Operation<Shared>> {
    let json = |path, summary, query, response, handler| Operation {
        method: "get",
        path,
        summary,
        query,
        body: None,
        response,
        handler,
    };
    vec![
        json(
            "/loops/{name}/trend",
            "OP, PV and SP of a stretch of time, from the recordings",
            &[FROM, TO, FEWER],
            ResponseKind::Json(of::<Trend>),
            || get(trend),
        ),
        json(
            "/loops/{name}/history",
            "Every window of a stretch of time, from the recordings",
            &[FROM, TO],
            ResponseKind::Json(of::<History>),
            || get(history),
        ),
        json(
            "/loops/{name}/alarms",
            "Changes of the alarm, from the recordings",
            &[FROM, TO],
            ResponseKind::Json(of::<Changes>),
            || get(changes),
        ),
    ]
}

impl Range {
    /// First and last stamp for a loop.
    pub(super) fn ns(&self, live: &Shared, name: &str) -> Result<[i64; 2], ApiError> {
        self.with_newest(live.overview.newest(name).and_then(|n| n.newest_ns), now_ns())
    }

    /// First and last stamp. Plants with a clock ahead of ours, and simulated ones, have samples later than now; played
    /// recordings have samples long before now.
    fn with_newest(&self, newest_ns: Option<i64>, now_ns: i64) -> Result<[i64; 2], ApiError> {
        let to = self.to_ms.map_or(now_ns.max(newest_ns.unwrap_or(i64::MIN)), ns_from_ms);
        let end = newest_ns.map_or(to, |newest_ns| newest_ns.min(to));
        let from = self.from_ms.map_or(end.saturating_sub(ns_from_s(PAST_S)), ns_from_ms);
        let finite = [self.from_ms, self.to_ms].iter().flatten().all(|ms| ms.is_finite());
        if finite && from <= to { Ok([from, to]) } else { Err(ApiError::unfit("from_ms must be before to_ms")) }
    }
}

async fn trend(
    State(live): State<Shared>,
    PathName(name): PathName,
    QueryParams(range): QueryParams<Range>,
) -> Answered<Trend> {
    let [from_ns, to_ns] = range.ns(&live, &name)?;
    let points = range.points.unwrap_or(POINTS).clamp(2, MOST_POINTS);
    let (archive, config) = (live.archive.clone(), live.config.get());
    let (curves, reach) = live
        .looks
        .run(move || {
            let signals = [Signal::Op, Signal::Pv, Signal::Sp];
            let (one, reach) = recorded_within(&archive, &name, &signals, [from_ns, to_ns]);
            let joined = Points::of(&name, &one.samples, &config).samples(Section::Whole).unwrap_or_default();
            let column = |of: fn(&stiction::samples::align::Point) -> f64| joined.iter().map(of).collect::<Vec<f64>>();
            let (op, pv, sp) = (column(|p| p.op), column(|p| p.pv), column(|p| p.sp.unwrap_or(f64::NAN)));
            let places = thin(&[&op, &pv, &sp], points);
            let shown = |values: &[f64]| places.iter().map(|k| Some(values[*k]).filter(|v| v.is_finite())).collect();
            let curves = Curves {
                t_ms: places.iter().map(|k| ms_from_ns(joined[*k].t_ns)).collect(),
                op: shown(&op),
                pv: shown(&pv),
                sp: sp.iter().any(|v| v.is_finite()).then(|| shown(&sp)),
            };
            (curves, reach)
        })
        .await?;
    let complete = reach == Reach::All;
    Ok(Json(Trend { from_ms: ms_from_ns(from_ns), to_ms: ms_from_ns(to_ns), curves, complete }))
}

/// Documents of one kind in the recordings, oldest first; the newest of them if there are too many. Includes the current one,
/// since recordings lack the last few seconds until they are flushed.
fn documents<T>(
    archive: &Archive,
    topic: String,
    [from_ns, to_ns]: [i64; 2],
    at_hand: &[Arc<impl Serialize>],
    read: impl Fn(&[u8]) -> Option<(i64, T)>,
) -> (Vec<T>, Reach) {
    let until = Instant::now() + PATIENCE;
    let wanted = Wanted { topics: BTreeSet::from([topic]), range_ns: [from_ns, to_ns], until };
    let mut found = Vec::new();
    let reach = archive.read(&wanted, &mut |message| found.extend(read(message.data)));
    let recorded: HashSet<i64> = found.iter().map(|(t_ns, _)| *t_ns).collect();
    let at_hand = at_hand.iter().filter_map(|document| read(&serde_json::to_vec(document.as_ref()).ok()?));
    found.extend(at_hand.filter(|(t_ns, _)| (from_ns..=to_ns).contains(t_ns) && !recorded.contains(t_ns)));
    found.sort_by_key(|(t_ns, _)| *t_ns);
    let surplus = found.len().saturating_sub(MOST_WINDOWS);
    (found.into_iter().skip(surplus).map(|(_, document)| document).collect(), reach)
}

/// Windows of a loop, oldest first.
pub(super) fn windows(live: &Live, name: &str, range_ns: [i64; 2]) -> (Vec<PastWindow>, Reach) {
    let topic = topic::result(live.archive.prefix(), name, Kind::Estimate);
    let newest = live.overview.newest(name).and_then(|newest| newest.estimate);
    let (mut all, reach) = documents(&live.archive, topic, range_ns, newest.as_slice(), |data| {
        let mut window: PastWindow = serde_json::from_slice(data).ok()?;
        let Bounds { start_ns, end_ns } = window.window;
        (window.result.start_ns, window.result.end_ns) = (start_ns, end_ns);
        (window.start_ms, window.end_ms) = (ms_from_ns(start_ns), ms_from_ns(end_ns));
        window.period_s = window.oscillation.period_s;
        Some((end_ns, window))
    });
    // A window may be in the file that ended and again in the next one.
    all.dedup_by_key(|w| w.window.end_ns);
    (all, reach)
}

async fn history(
    State(live): State<Shared>,
    PathName(name): PathName,
    QueryParams(range): QueryParams<Range>,
) -> Answered<History> {
    let [from_ns, to_ns] = range.ns(&live, &name)?;
    let all = live.clone();
    let (windows, reach) = live.looks.run(move || windows(&all, &name, [from_ns, to_ns])).await?;
    let complete = reach == Reach::All;
    Ok(Json(History { from_ms: ms_from_ns(from_ns), to_ms: ms_from_ns(to_ns), complete, windows }))
}

async fn changes(
    State(live): State<Shared>,
    PathName(name): PathName,
    QueryParams(range): QueryParams<Range>,
) -> Answered<Changes> {
    let range_ns = range.ns(&live, &name)?;
    let all = live.clone();
    let (mut changes, reach) = live
        .looks
        .run(move || {
            let topic = topic::result(all.archive.prefix(), &name, Kind::Alarm);
            documents(&all.archive, topic, range_ns, &all.overview.alarm_changes(&name), |data| {
                let document: Value = serde_json::from_slice(data).ok()?;
                Some((document.get("changed_ns")?.as_i64()?, document))
            })
        })
        .await?;
    changes.reverse();
    // After a restart alarms are published again without a change.
    changes.retain(|document| document.get("event").and_then(Value::as_str) != Some("restored"));
    Ok(Json(Changes { complete: reach == Reach::All, changes }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::path::Path;

    #[test]
    fn a_past_ends_at_the_newest_sample_whatever_the_clock_says() {
        let days = |n: i64| n * 86_400_000_000_000;
        let all = Range { from_ms: None, to_ms: None, points: None };
        for (newest, want) in [(None, [910, 1000]), (Some(1200), [1110, 1200]), (Some(500), [410, 1000])] {
            assert_eq!(all.with_newest(newest.map(days), days(1000)).ok(), Some(want.map(days)), "{newest:?}");
        }
        let to_ms = Some(ms_from_ns(days(450)));
        let early = Range { from_ms: None, to_ms, points: None };
        assert_eq!(early.with_newest(Some(days(500)), days(1000)).ok(), Some([360, 450].map(days)));
        assert!(Range { from_ms: to_ms, to_ms: Some(0.0), points: None }.with_newest(None, 0).is_err());
    }

    #[test]
    fn what_no_file_shows_yet_counts_once_and_within_the_range_only() {
        let archive = Archive::new(&Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings"), "tour");
        let topic = topic::result("tour", "FIC101", Kind::Estimate);
        let window = |end_ns: i64| Arc::new(json!({"window": {"end_ns": end_ns}}));
        let ends = |to_ns: i64, at_hand: &[Arc<Value>]| {
            documents(&archive, topic.clone(), [0, to_ns], at_hand, |data| {
                let end_ns = serde_json::from_slice::<Value>(data).ok()?["window"]["end_ns"].as_i64()?;
                Some((end_ns, end_ns))
            })
        };
        let (recorded, reach) = ends(i64::MAX, &[]);
        assert!(recorded.len() > 3 && reach == Reach::All);
        let last = recorded[recorded.len() - 1];
        let with_newest = [recorded.clone(), vec![last + 5]].concat();
        assert_eq!(ends(i64::MAX, &[window(last), window(last + 5)]), (with_newest, Reach::All));
        assert_eq!(ends(last + 4, &[window(last + 5)]), (recorded, Reach::All));
    }
}
