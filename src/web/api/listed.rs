//! Sends a long list in parts, each made only when the reader takes it, so that little waits for one who does not read.

use std::convert::Infallible;
use std::iter;

use axum::body::Body;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::stream;
use serde::Serialize;

use crate::web::server::IdleTimer;

/// Entries in one part.
pub(super) const PART: usize = 50;

/// The object `empty`, whose last field is an empty list, with the entries inserted part by part.
pub(super) fn listed<T: Serialize + 'static>(
    empty: &impl Serialize,
    idle: IdleTimer,
    parts: impl Iterator<Item = Vec<T>> + Send + 'static,
) -> Response {
    let empty = serde_json::to_vec(empty).unwrap_or_default();
    let pieces = pieces(empty, parts).inspect(move |_| idle.touch());
    let body = Body::from_stream(stream::iter(pieces.map(Ok::<Bytes, Infallible>)));
    ([(header::CONTENT_TYPE, "application/json")], body).into_response()
}

fn pieces<T: Serialize>(mut head: Vec<u8>, parts: impl Iterator<Item = Vec<T>>) -> impl Iterator<Item = Bytes> {
    let tail = head.split_off(head.len().saturating_sub("]}".len()));
    let mut is_first = true;
    let entries = parts.map(move |part| {
        let mut piece = Vec::new();
        for json in part.iter().filter_map(|entry| serde_json::to_vec(entry).ok()) {
            if !std::mem::take(&mut is_first) {
                piece.push(b',');
            }
            piece.extend(json);
        }
        piece
    });
    iter::once(head).chain(entries).chain(iter::once(tail)).map(Bytes::from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    #[test]
    fn the_pieces_are_the_object_with_its_list_and_none_is_made_before_it_is_taken() {
        for parts in [vec![], vec![vec![1]], vec![vec![], vec![1, 2], vec![], vec![3]]] {
            let made = std::cell::Cell::new(0);
            let count = parts.iter().flatten().count();
            let counted = parts.clone().into_iter().inspect(|_| made.set(made.get() + 1));
            let mut pieces = pieces(br#"{"a":1,"list":[]}"#.to_vec(), counted);
            assert!(pieces.next().is_some() && made.get() == 0);
            let rest: Vec<u8> = pieces.flatten().collect();
            let whole: Value = serde_json::from_slice(&[br#"{"a":1,"list":["#.as_slice(), &rest].concat()).unwrap();
            assert_eq!(whole, json!({"a": 1, "list": (1..=count).collect::<Vec<_>>()}));
        }
    }
}
