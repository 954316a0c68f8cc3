//! The page's files, which lie inside the program.

use axum::extract::Request;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use rust_embed::{EmbeddedFile, RustEmbed};

/// Every file of the page.
#[derive(RustEmbed)]
#[folder = "src/web/assets"]
struct Assets;

/// Answers with one of the page's files, or says that there is none.
pub async fn asset(request: Request) -> Response {
    let path = request.uri().path().trim_start_matches('/');
    let Some(file) = Assets::get(if path.is_empty() { "index.html" } else { path }) else {
        return (StatusCode::NOT_FOUND, "no such page; the page is at /\n").into_response();
    };
    let tag = tag_of(&file);
    let known = request.headers().get(header::IF_NONE_MATCH).is_some_and(|seen| seen.as_bytes() == tag.as_bytes());
    let kind = match file.metadata.mimetype() {
        text if text.starts_with("text/") => format!("{text}; charset=utf-8"),
        other => other.to_owned(),
    };
    // Asked again each time, answered in a few bytes: an update of the program shows at once.
    let headers = [(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, "no-cache".to_owned()), (header::ETAG, tag)];
    if known {
        return (StatusCode::NOT_MODIFIED, headers).into_response();
    }
    (headers, file.data.into_owned()).into_response()
}

fn tag_of(file: &EmbeddedFile) -> String {
    let hash = file.metadata.sha256_hash();
    hash[..8].iter().fold(String::from("\""), |tag, byte| format!("{tag}{byte:02x}")) + "\""
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// What the page's files name of one another.
    fn named(text: &str) -> impl Iterator<Item = &str> {
        text.split(['"', '\'', '`'])
            .filter_map(|part| part.strip_prefix("./").or_else(|| part.strip_prefix('/')))
            .filter(|name| [".js", ".css", ".svg"].iter().any(|end| name.ends_with(end)) && !name.contains("${"))
    }

    #[test]
    fn the_page_is_whole_and_loads_nothing_from_elsewhere() {
        let names: BTreeSet<String> = Assets::iter().map(|name| name.to_string()).collect();
        assert!(names.contains("index.html"), "{names:?}");
        for name in names.iter().filter(|name| !name.contains("vendor/")) {
            let text = String::from_utf8(Assets::get(name).unwrap().data.into_owned()).unwrap();
            assert!(text.lines().count() <= 500, "{name}: {} lines", text.lines().count());
            for other in named(&text) {
                assert!(names.contains(other), "{name} names {other}");
            }
            let foreign = text.replace("http://www.w3.org/", "").replace("http://127.0.0.1", "");
            assert!(!foreign.contains("http://") && !foreign.contains("https://"), "{name}");
        }
    }
}
