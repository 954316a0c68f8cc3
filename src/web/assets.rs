//! The page's files, embedded in the program.

use axum::extract::Request;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use stiction_engine::short_hash;

/// A table of embedded files with their bytes.
macro_rules! embedded {
    ($($name:literal)*) => { &[$(($name, include_bytes!(concat!("assets/", $name)))),*] };
}

/// Every file of the page.
static FILES: &[(&str, &[u8])] = embedded! {
    "actions.js"
    "alarms.js"
    "api.js"
    "app.css"
    "app.js"
    "chart-gestures.js"
    "chart-marks.js"
    "chart-phase.js"
    "chart-table.js"
    "charts.js"
    "dialog.js"
    "dom.js"
    "format.js"
    "groups.js"
    "icon.svg"
    "index.html"
    "ink.js"
    "live.js"
    "loop-alarm.js"
    "loop-gap.js"
    "loop-head.js"
    "loop-history.js"
    "loop-repair.js"
    "loop-trend.js"
    "loop-why.js"
    "loop.js"
    "maintenance.js"
    "obstacles.js"
    "overview.js"
    "picture-values.js"
    "pictures.js"
    "print.css"
    "spark.js"
    "store.js"
    "strip.js"
    "theme-button.js"
    "theme.js"
    "tiles.js"
    "vendor/uPlot-LICENSE"
    "vendor/uPlot.iife.min.js"
    "vendor/uPlot.min.css"
    "verdicts.js"
    "views.css"
    "words.js"
    "workbench-files.js"
    "workbench-form.js"
    "workbench-gap.js"
    "workbench-help.js"
    "workbench-link.js"
    "workbench-preview.js"
    "workbench-result.js"
    "workbench-runs.js"
    "workbench-solver.js"
    "workbench-state.js"
    "workbench-trend.js"
    "workbench.css"
    "workbench.js"
};

/// The media type by file extension.
fn kind_of(name: &str) -> &'static str {
    match name.rsplit_once('.').map(|(_, end)| end) {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "text/plain; charset=utf-8",
    }
}

/// Serves one of the page's files, or 404.
pub async fn asset(request: Request) -> Response {
    let path = request.uri().path().trim_start_matches('/');
    let wanted = if path.is_empty() { "index.html" } else { path };
    let Some((name, bytes)) = FILES.iter().find(|(name, _)| *name == wanted) else {
        return (StatusCode::NOT_FOUND, "no such page; the page is at /\n").into_response();
    };
    let tag = format!("\"{}\"", short_hash(bytes));
    let known = request.headers().get(header::IF_NONE_MATCH).is_some_and(|seen| seen.as_bytes() == tag.as_bytes());
    // The browser asks every time and gets a short answer if nothing changed, so an update of the program shows at once.
    let headers =
        [(header::CONTENT_TYPE, kind_of(name)), (header::CACHE_CONTROL, "no-cache"), (header::ETAG, tag.as_str())];
    if known {
        return (StatusCode::NOT_MODIFIED, headers).into_response();
    }
    (headers, *bytes).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// References between the page's files.
    fn named(text: &str) -> impl Iterator<Item = &str> {
        text.split(['"', '\'', '`'])
            .filter_map(|part| part.strip_prefix("./").or_else(|| part.strip_prefix('/')))
            .filter(|name| [".js", ".css", ".svg"].iter().any(|end| name.ends_with(end)) && !name.contains("${"))
    }

    #[test]
    fn the_page_is_whole_and_loads_nothing_from_elsewhere() {
        let names: BTreeSet<&str> = FILES.iter().map(|(name, _)| *name).collect();
        assert!(names.contains("index.html"), "{names:?}");
        for (name, bytes) in FILES.iter().filter(|(name, _)| !name.contains("vendor/")) {
            let text = std::str::from_utf8(bytes).unwrap();
            assert!(text.lines().count() <= 500, "{name}: {} lines", text.lines().count());
            for other in named(text) {
                assert!(names.contains(other), "{name} names {other}");
            }
            let foreign = text.replace("http://www.w3.org/", "").replace("http://127.0.0.1", "");
            assert!(!foreign.contains("http://") && !foreign.contains("https://"), "{name}");
        }
    }
}
