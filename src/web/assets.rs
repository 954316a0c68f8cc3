//! The page's files, which lie inside the program.

use axum::extract::Request;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use sha2::{Digest, Sha256};

/// Name below `/`, kind, content.
type Asset = (&'static str, &'static str, &'static [u8]);

macro_rules! assets {
    ($($name:literal $kind:expr;)*) => {
        &[$(($name, $kind, include_bytes!(concat!("assets/", $name)) as &[u8])),*]
    };
}

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";

/// Every file of the page; a test holds that none of the folder is missing.
const ASSETS: &[Asset] = assets! {
    "actions.js" JS;
    "alarms.js" JS;
    "api.js" JS;
    "app.css" CSS;
    "app.js" JS;
    "chart-gestures.js" JS;
    "chart-marks.js" JS;
    "chart-phase.js" JS;
    "chart-table.js" JS;
    "charts.js" JS;
    "dialog.js" JS;
    "dom.js" JS;
    "format.js" JS;
    "headline.js" JS;
    "icon.svg" "image/svg+xml";
    "index.html" HTML;
    "ink.js" JS;
    "live.js" JS;
    "loop-alarm.js" JS;
    "loop-gap.js" JS;
    "loop-head.js" JS;
    "loop-history.js" JS;
    "loop-repair.js" JS;
    "loop-trend.js" JS;
    "loop-why.js" JS;
    "loop.js" JS;
    "overview.js" JS;
    "picture-values.js" JS;
    "pictures.js" JS;
    "print.css" CSS;
    "spark.js" JS;
    "store.js" JS;
    "strip.js" JS;
    "theme-button.js" JS;
    "theme.js" JS;
    "tiles.js" JS;
    "vendor/uPlot.iife.min.js" JS;
    "vendor/uPlot.min.css" CSS;
    "views.css" CSS;
    "words.js" JS;
    "workbench-files.js" JS;
    "workbench-form.js" JS;
    "workbench-gap.js" JS;
    "workbench-result.js" JS;
    "workbench-runs.js" JS;
    "workbench-state.js" JS;
    "workbench-trend.js" JS;
    "workbench.css" CSS;
    "workbench.js" JS;
};

/// Answers with one of the page's files, or says that there is none.
pub async fn asset(request: Request) -> Response {
    let path = request.uri().path().trim_start_matches('/');
    let wanted = if path.is_empty() { "index.html" } else { path };
    let Some((_, kind, content)) = ASSETS.iter().find(|(name, _, _)| *name == wanted) else {
        return (StatusCode::NOT_FOUND, "no such page; the page is at /\n").into_response();
    };
    let digest = Sha256::digest(content);
    let tag = digest[..8].iter().fold(String::from("\""), |tag, byte| format!("{tag}{byte:02x}")) + "\"";
    let known = request.headers().get(header::IF_NONE_MATCH).is_some_and(|seen| seen.as_bytes() == tag.as_bytes());
    // Asked again each time, answered in a few bytes: an update of the program shows at once.
    let headers = [(header::CONTENT_TYPE, *kind), (header::CACHE_CONTROL, "no-cache"), (header::ETAG, &tag)];
    if known {
        return (StatusCode::NOT_MODIFIED, headers).into_response();
    }
    (headers, *content).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::path::Path;

    #[test]
    fn every_file_of_the_folder_is_inside() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/web/assets");
        let mut open = vec![folder.clone()];
        let mut there = BTreeSet::new();
        while let Some(dir) = open.pop() {
            for entry in std::fs::read_dir(dir).unwrap().flatten() {
                let path = entry.path();
                let name = path.strip_prefix(&folder).unwrap().to_string_lossy().into_owned();
                if path.is_dir() {
                    open.push(path);
                } else if !["md", "txt"].iter().any(|e| name.ends_with(e)) && !name.contains("LICENSE") {
                    there.insert(name);
                }
            }
        }
        assert_eq!(there, ASSETS.iter().map(|(name, _, _)| (*name).to_owned()).collect::<BTreeSet<_>>());
    }
}
