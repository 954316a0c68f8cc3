//! Which valves to work on first, and whether earlier work on them helped; as JSON and as a table.

use std::collections::HashMap;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::{Deserialize, Serialize};

use super::reviews::current;
use super::worth::{COMPARED, look};
use super::{Operation, Parameter, ResponseKind, Shared, of};
use crate::runtime::clock::now_ns;
use crate::runtime::maintenance::{Outcome, Work};
use crate::web::error::ApiError;
use crate::web::extract::QueryParams;
use stiction::core::units::{Moment, format_rfc3339, ms_from_ns, number};
use stiction_files::reviews::{Label, Method, Review, escaped};

/// Name of the table format.
const CSV: &str = "csv";

/// The maintenance list.
#[derive(Debug, Serialize, schemars::JsonSchema)]
struct Maintenance {
    /// Loops that may need work, most costly to leave alone first.
    work: Vec<Work>,
    /// Reviewed loops, newest review first, with their windows before and after it.
    reviewed: Vec<Reviewed>,
    /// Items still being computed: ask again.
    pending: usize,
}

/// A loop that a person has reviewed.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
struct Reviewed {
    /// The loop's name.
    #[serde(rename = "loop")]
    loop_name: String,
    /// Part of the plant.
    area: Option<String>,
    /// The valve's name in the maintenance system.
    equipment: Option<String>,
    /// When the review was written, ms since 1970.
    at_ms: f64,
    #[serde(skip)]
    at: Moment,
    /// When the valve was repaired, ms since 1970; null if it was not.
    work_at_ms: Option<f64>,
    #[serde(skip)]
    work_at: Option<Moment>,
    /// Who wrote it.
    by: String,
    /// The finding.
    label: Label,
    /// How it was established.
    method: Method,
    /// Comment in that person's words.
    note: Option<String>,
    /// What changed since the review; null while that is being computed.
    outcome: Option<Outcome>,
    /// Whether all recordings of that time were read.
    complete: bool,
}

#[derive(Debug, Deserialize)]
struct Wanted {
    format: Option<String>,
}

const FORMAT: Parameter =
    Parameter { name: "format", words: "`csv` for a table, as with `Accept: text/csv`; JSON if absent" };

pub(super) fn operations() -> Vec<Operation<Shared>> {
    vec![Operation {
        method: "get",
        path: "/maintenance",
        summary: "Which valves to work on first, what to do, why and how sure, and whether earlier work helped",
        query: &[FORMAT],
        body: None,
        response: ResponseKind::Json(of::<Maintenance>),
        handler: || get(maintenance),
    }]
}

/// Whether the client asks for a table.
fn wants_table(wanted: &Wanted, headers: &HeaderMap) -> Result<bool, ApiError> {
    match wanted.format.as_deref() {
        Some(CSV) => Ok(true),
        Some("json") => Ok(false),
        Some(other) => Err(ApiError::unfit(format!("format {other:?} is not known; use csv or json"))),
        None => Ok(headers.get(header::ACCEPT).is_some_and(|kinds| kinds.as_bytes().starts_with(b"text/csv"))),
    }
}

/// The newest review of each loop, newest first.
fn newest_reviews(all: Vec<Review>) -> Vec<Review> {
    let by_loop: HashMap<String, Review> = all.into_iter().map(|review| (review.r#loop.clone(), review)).collect();
    let mut newest: Vec<Review> = by_loop.into_values().collect();
    newest.sort_by(|a, b| b.at.0.cmp(&a.at.0).then_with(|| a.r#loop.cmp(&b.r#loop)));
    newest.truncate(COMPARED);
    newest
}

async fn maintenance(
    State(live): State<Shared>,
    headers: HeaderMap,
    QueryParams(wanted): QueryParams<Wanted>,
) -> Result<Response, ApiError> {
    let as_table = wants_table(&wanted, &headers)?;
    let failed = |why: String| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, why);
    let reviews = newest_reviews(current(&live).await?.all().to_vec());
    let (work, outcomes, pending) = look(&live, &reviews);
    let now = now_ns();
    let reviewed = reviews.into_iter().zip(outcomes).map(|(review, compared)| {
        let row = live.overview.row(&review.r#loop, now);
        let (area, equipment) = row.map(|row| (row.area, row.equipment)).unwrap_or_default();
        let Review { r#loop: loop_name, at, by, label, method, why: note, work_at, .. } = review;
        let complete = compared.as_ref().is_none_or(|c| c.complete);
        let outcome = compared.map(|c| c.outcome);
        let at_ms = ms_from_ns(at.0);
        let work_at_ms = work_at.map(|at| ms_from_ns(at.0));
        Reviewed {
            loop_name,
            area,
            equipment,
            at_ms,
            at,
            work_at_ms,
            work_at,
            by,
            label,
            method,
            note,
            outcome,
            complete,
        }
    });
    let answer = Maintenance { work, reviewed: reviewed.collect(), pending };
    if !as_table {
        return Ok(Json(answer).into_response());
    }
    let name = "attachment; filename=\"maintenance.csv\"";
    let headers = [(header::CONTENT_TYPE, "text/csv; charset=utf-8"), (header::CONTENT_DISPOSITION, name)];
    Ok((headers, table(&answer).map_err(failed)?).into_response())
}

const COLUMNS: [&str; 27] = [
    "rank",
    "loop",
    "area",
    "equipment",
    "criticality",
    "alarm",
    "p_stiction",
    "grade",
    "s",
    "op_unit",
    "s_trend",
    "removed",
    "removed_low",
    "removed_high",
    "cost",
    "what_to_do",
    "why",
    "sure",
    "reviewed_at",
    "p_before",
    "p_after",
    "s_before",
    "s_after",
    "pv_sd_before",
    "pv_sd_after",
    "outcome",
    "work_at",
];

fn figure(value: Option<f64>) -> String {
    value.map_or_else(String::new, number)
}

/// The cells of a loop to work on, without those of a review.
fn cells_of(w: &Work) -> Vec<String> {
    let removed = |of: fn(&crate::runtime::maintenance::Removed) -> f64| figure(w.removed.as_ref().map(of));
    vec![
        w.rank.to_string(),
        w.loop_name.clone(),
        w.area.clone().unwrap_or_default(),
        w.equipment.clone().unwrap_or_default(),
        w.criticality.map_or_else(String::new, |c| c.to_string()),
        w.alarm.to_string(),
        figure(w.p_stiction),
        w.grade.map_or_else(String::new, String::from),
        figure(w.s),
        w.op_unit.clone().unwrap_or_default(),
        w.s_trend.unwrap_or_default().to_owned(),
        removed(|r| r.share),
        removed(|r| r.interval[0]),
        removed(|r| r.interval[1]),
        number(w.cost),
        w.what_to_do.clone(),
        w.why.clone(),
        w.sure.clone(),
    ]
}

/// The same for a loop that is only reviewed.
fn cells_without_work(r: &Reviewed) -> Vec<String> {
    let mut cells = vec![String::new(); 18];
    cells[1].clone_from(&r.loop_name);
    cells[2] = r.area.clone().unwrap_or_default();
    cells[3] = r.equipment.clone().unwrap_or_default();
    cells
}

/// The cells of a review.
fn cells_of_review(r: &Reviewed) -> Vec<String> {
    let outcome = r.outcome.as_ref();
    let [before, after] = [outcome.map(|o| o.before), outcome.map(|o| o.after)].map(Option::unwrap_or_default);
    let figures = [before.p, after.p, before.s, after.s, before.pv_sd, after.pv_sd].map(figure);
    let words = outcome.map_or_else(String::new, |o| o.words.clone());
    let work_at = r.work_at.map_or_else(String::new, |at| format_rfc3339(at.0));
    [format_rfc3339(r.at.0)].into_iter().chain(figures).chain([words, work_at]).collect()
}

/// One line for each loop: those to work on by rank, then those that are only reviewed. No cell is read as a formula.
fn table(answer: &Maintenance) -> Result<Vec<u8>, String> {
    let by_loop: HashMap<&str, &Reviewed> = answer.reviewed.iter().map(|r| (r.loop_name.as_str(), r)).collect();
    let listed = |r: &&Reviewed| !answer.work.iter().any(|w| w.loop_name == r.loop_name);
    let of_work = answer.work.iter().map(|w| (cells_of(w), by_loop.get(w.loop_name.as_str()).copied()));
    let of_reviews = answer.reviewed.iter().filter(listed).map(|r| (cells_without_work(r), Some(r)));
    let mut lines = csv::Writer::from_writer(Vec::new());
    lines.write_record(COLUMNS).map_err(|e| e.to_string())?;
    for (mut cells, review) in of_work.chain(of_reviews) {
        cells.extend(review.map(cells_of_review).unwrap_or_default());
        cells.resize(COLUMNS.len(), String::new());
        lines.write_record(cells.iter().map(|cell| escaped(cell))).map_err(|e| e.to_string())?;
    }
    lines.into_inner().map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runtime::maintenance::{Done, compare, rank};
    use crate::runtime::overview::Candidate;
    use std::collections::BTreeMap;
    use stiction_engine::alarm::LoopContext;

    const FORMULA: &str = "=HYPERLINK(\"http://x\")";

    fn reviewed(name: &str) -> Reviewed {
        Reviewed {
            loop_name: name.to_owned(),
            area: Some("@area".to_owned()),
            equipment: None,
            at_ms: 0.0,
            at: Moment(0),
            work_at_ms: None,
            work_at: None,
            by: "ann".to_owned(),
            label: Label::Stiction,
            method: Method::Inspection,
            note: None,
            outcome: Some(compare(&[], &[], Done::Found)),
            complete: true,
        }
    }

    #[test]
    fn the_table_has_every_loop_once_and_no_formula() {
        let place =
            LoopContext { area: Some(FORMULA.to_owned()), equipment: Some("+1".into()), ..LoopContext::default() };
        let candidate = |name: &str| Candidate { name: name.to_owned(), place: place.clone(), ..Candidate::default() };
        let benefits = BTreeMap::from([(FORMULA.to_owned(), Err("-cmd".to_owned()))]);
        let work = rank(&[candidate(FORMULA), candidate("B")], &benefits);
        let answer = Maintenance { work, reviewed: vec![reviewed("B"), reviewed("\tC")], pending: 0 };
        let bytes = table(&answer).unwrap();
        let mut lines = csv::Reader::from_reader(bytes.as_slice());
        let rows: Vec<Vec<String>> =
            lines.records().map(|row| row.unwrap().iter().map(str::to_owned).collect()).collect();
        assert_eq!(
            rows.iter().map(|row| row[1].as_str()).collect::<Vec<_>>(),
            [format!("'{FORMULA}").as_str(), "B", "'\tC"]
        );
        assert_eq!(rows.iter().map(|row| row[18].is_empty()).collect::<Vec<_>>(), [true, false, false]);
        assert!(
            rows.iter().flatten().all(|cell| !cell.starts_with(['=', '+', '-', '@', '\t', '\r', '\n'])),
            "{rows:#?}"
        );
    }

    #[test]
    fn the_newest_review_of_each_loop_counts() {
        let review = |name: &str, at_ns: i64| Review {
            file: String::new(),
            label: Label::Stiction,
            r#loop: name.to_owned(),
            method: Method::Other,
            by: "ann".to_owned(),
            why: None,
            at: Moment(at_ns),
            window_end: Moment(at_ns),
            verdict: "stiction".to_owned(),
            p_stiction: None,
            s: None,
            work_at: None,
        };
        let newest = newest_reviews(vec![review("A", 1), review("B", 2), review("A", 3)]);
        assert_eq!(newest.iter().map(|r| (r.r#loop.as_str(), r.at.0)).collect::<Vec<_>>(), [("A", 3), ("B", 2)]);
    }
}
