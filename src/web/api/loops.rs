//! Loops: all of them in rows, and one with its newest documents and their meaning in words.

use axum::extract::State;
use axum::response::Response;
use axum::routing::get;
use axum::{Extension, Json};
use serde::Serialize;
use serde_json::Value;

use super::listed::{PART, listed};
use super::{Answered, Operation, ResponseKind, Shared, of};
use crate::runtime::clock::now_ns;
use crate::runtime::overview::Row;
use crate::web::error::ApiError;
use crate::web::extract::PathName;
use crate::web::server::IdleTimer;
use stiction::core::gap::document::GapDocument;
use stiction::core::units::ms_from_ns;
use stiction::core::verdict::{Assessment, EstimateDocument, answer};
use stiction::words;
use stiction::words::gap_text;
use stiction_engine::alarm::AlarmDocument;
use stiction_engine::codec::topic::Kind;
use stiction_engine::status::Headline;

/// Rows.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct Loops {
    /// The daemon's clock, ms since 1970.
    now_ms: f64,
    /// The plant in a few sentences.
    headline: Headline,
    /// Every loop, by name.
    loops: Vec<Row>,
}

/// One loop.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct Detail {
    /// Its row in the list.
    row: Row,
    /// `stictiond.estimate.v1` of its newest window.
    estimate: Option<EstimateDocument>,
    /// `stictiond.alarm.v2`, if its alarm ever changed.
    alarm: Option<AlarmDocument>,
    /// `stictiond.gap.v1` of its last diagnosis.
    gap: Option<Value>,
    /// `stictiond.loop_health.v1`.
    health: Option<Value>,
    /// Their meaning in words.
    words: Words,
}

/// Documents in plain words.
#[derive(Debug, Default, Serialize, schemars::JsonSchema)]
struct Words {
    /// The newest window's verdict.
    verdict: String,
    /// Its grade and what limits it, where stiction was found.
    grade: Option<String>,
    /// Its confidence, the evidence, and why numbers are missing.
    why: Vec<String>,
    /// How far it sticks, where stiction was found.
    size: Option<String>,
    /// What to do.
    what_to_do: Option<String>,
    /// The bump test that would settle it, one numbered step a line; null if none is proposed, for the reason in `what_to_do`.
    test: Option<String>,
    /// The quality gates of the newest window.
    gates: Vec<Explained>,
    /// Indicators that contribute to the verdict, the strongest first.
    indicators: Vec<Indicated>,
    /// The gap diagnosis.
    gap: Option<String>,
    /// The windows that were judged together, if there are several.
    windows: Option<String>,
    /// Result of the comparison with other loops.
    other_loops: Option<String>,
    /// The shares of PV's variance by cause, from that diagnosis.
    budget: Option<gap_text::BudgetText>,
    /// What can be concluded from the diagnosed record.
    tellable: Vec<String>,
}

/// A name and its meaning.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct Explained {
    name: &'static str,
    words: &'static str,
}

/// An indicator and its meaning.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct Indicated {
    name: &'static str,
    /// What it measures.
    words: &'static str,
    score: Option<f64>,
    vote: Option<bool>,
    /// Its contribution to the verdict, log-odds.
    contribution: f64,
}

pub(super) fn operations() -> Vec<Operation<Shared>> {
    vec![
        Operation {
            method: "get",
            path: "/loops",
            summary: "Every loop in a row: verdict, how sure, alarm, data health, its newest windows",
            query: &[],
            body: None,
            response: ResponseKind::Json(of::<Loops>),
            handler: || get(all),
        },
        Operation {
            method: "get",
            path: "/loops/{name}",
            summary: "One loop: its newest documents, and what they say in words",
            query: &[],
            body: None,
            response: ResponseKind::Json(of::<Detail>),
            handler: || get(one),
        },
    ]
}

async fn all(State(live): State<Shared>, Extension(idle): Extension<IdleTimer>) -> Response {
    let headline = live.overview.headline(&live.config.get().site.prefix);
    let empty = Loops { now_ms: ms_from_ns(now_ns()), headline, loops: Vec::new() };
    let mut after: Option<String> = None;
    let parts = std::iter::from_fn(move || {
        let rows = live.overview.rows_after(0, after.as_deref(), PART, now_ns());
        after = Some(rows.last()?.name.clone());
        Some(rows)
    });
    listed(&empty, idle, parts)
}

async fn one(State(live): State<Shared>, PathName(name): PathName) -> Answered<Detail> {
    let no_such = || ApiError::not_found(format!("no loop {name:?} has appeared"));
    let row = live.overview.row(&name, now_ns()).ok_or_else(no_such)?;
    let newest = live.overview.newest(&name).unwrap_or_default();
    let gap = live.last_document(&name, Kind::Gap);
    let mut words = newest.estimate.as_deref().map(|e| words_of(&e.assessment)).unwrap_or_default();
    if let Some(read) = gap.as_ref().and_then(|g| serde_json::from_value::<GapDocument>(g.clone()).ok()) {
        // About the valve, the page shows what its windows say together.
        words.gap = Some(gap_text::of_gap(&read));
        (words.windows, words.other_loops) = (gap_text::windows(&read), gap_text::other_loops(&read));
        words.budget = gap_text::budget(&read);
        words.tellable = gap_text::tellable(&read);
    }
    Ok(Json(Detail {
        row,
        estimate: newest.estimate.as_deref().cloned(),
        alarm: newest.alarm.as_deref().cloned(),
        health: live.last_document(&name, Kind::Health),
        gap,
        words,
    }))
}

fn words_of(a: &Assessment) -> Words {
    let mut indicators: Vec<_> = a.indicators.iter().filter(|i| i.contribution != 0.0).collect();
    indicators.sort_by(|x, y| y.contribution.abs().total_cmp(&x.contribution.abs()));
    let mut why = vec![words::sureness(a)];
    why.extend(words::evidence(a).into_iter().map(|(text, _)| text));
    why.extend(words::disbelief(a));
    Words {
        verdict: words::headline(a),
        grade: answer::grade(a).map(|grade| words::graded(a, grade)),
        why,
        size: words::size(a),
        what_to_do: Some(words::advice(a)),
        test: words::proposal(a),
        gates: a.gates.iter().map(|g| Explained { name: g.name(), words: words::gate(*g) }).collect(),
        indicators: indicators
            .into_iter()
            .map(|i| Indicated {
                name: i.name,
                words: words::looks_at(i.name),
                score: i.score,
                vote: i.vote,
                contribution: i.contribution,
            })
            .collect(),
        gap: None,
        windows: None,
        other_loops: None,
        budget: None,
        tellable: Vec::new(),
    }
}
