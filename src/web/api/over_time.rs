//! The result of many windows of one valve taken together.

use axum::Json;
use axum::extract::State;
use axum::routing::get;
use serde::Serialize;

use super::past::{FROM, Range, TO, windows};
use super::{Answered, Operation, ResponseKind, Shared, of};
use crate::web::extract::{PathName, QueryParams};
use stiction::core::units::ms_from_ns;
use stiction::over_time::{Change, ChangeKind, Contradicting, Pooled, Trend, WindowResult, over_time};
use stiction_files::archive::Reach;

/// A valve over time; all times in ms since 1970.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct OverTime {
    /// Number of windows with an answer.
    windows: usize,
    /// Size of stiction since the last change.
    pooled: Option<Pooled>,
    /// Date of the last change.
    since_ms: Option<f64>,
    /// Changes, oldest first.
    changes: Vec<Changed>,
    /// Windows that contradict the others of their segment, oldest first.
    contradicting: Vec<Contradicts>,
    /// Growth of s since the last change.
    trend: Option<Trend>,
    /// The same in words.
    sentences: Vec<String>,
    /// Whether all recordings of the time were read; if not, ask again.
    complete: bool,
}

/// A change of the valve.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct Changed {
    /// Most likely date.
    at_ms: f64,
    /// Lower end of the date's interval.
    from_ms: f64,
    /// Upper end of the date's interval.
    to_ms: f64,
    kind: ChangeKind,
    /// s before the change; null where no stiction was found.
    s_before: Option<f64>,
    /// s after the change.
    s_after: Option<f64>,
    /// Fraction of histories without any change that show a step at least as clear.
    p: f64,
}

/// A window that contradicts the others of its segment.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct Contradicts {
    /// The window's end.
    end_ms: f64,
    s: Option<f64>,
    s_interval: Option<[f64; 2]>,
    /// The contradiction in words.
    why: String,
}

impl From<Change> for Changed {
    fn from(c: Change) -> Self {
        let [at_ms, from_ms, to_ms] = [c.at_ns, c.from_ns, c.to_ns].map(ms_from_ns);
        Self { at_ms, from_ms, to_ms, kind: c.kind, s_before: c.s_before, s_after: c.s_after, p: c.p }
    }
}

impl From<Contradicting> for Contradicts {
    fn from(c: Contradicting) -> Self {
        Self { end_ms: ms_from_ns(c.end_ns), s: c.s, s_interval: c.s_interval, why: c.why }
    }
}

pub(super) fn operations() -> Vec<Operation<Shared>> {
    vec![Operation {
        method: "get",
        path: "/loops/{name}/over-time",
        summary: "What the recorded windows of a stretch of time say together: pooled size, when the valve changed, windows that contradict it",
        query: &[FROM, TO],
        body: None,
        response: ResponseKind::Json(of::<OverTime>),
        handler: || get(together),
    }]
}

async fn together(
    State(live): State<Shared>,
    PathName(name): PathName,
    QueryParams(range): QueryParams<Range>,
) -> Answered<OverTime> {
    let range_ns = range.ns(&live, &name)?;
    let all = live.clone();
    live.looks
        .run(move || {
            let (windows, reach) = windows(&all, &name, range_ns);
            let results: Vec<WindowResult> = windows.into_iter().map(|window| window.result).collect();
            let found = over_time(&results);
            Json(OverTime {
                windows: found.windows,
                pooled: found.pooled,
                since_ms: found.since_ns.map(ms_from_ns),
                changes: found.changes.into_iter().map(Changed::from).collect(),
                contradicting: found.contradicting.into_iter().map(Contradicts::from).collect(),
                trend: found.trend,
                sentences: found.sentences,
                complete: reach == Reach::All,
            })
        })
        .await
}
