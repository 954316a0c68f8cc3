//! Sentences written from finished documents.

pub mod gap_text;
