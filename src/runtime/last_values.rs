//! The last published document of each key, from which queries and the page are answered.

use std::collections::BTreeMap;
use std::sync::{Arc, RwLock};

use bytes::Bytes;

/// Last document by key. Only the publisher writes it; the engine does not use it.
pub type LastValues = Arc<RwLock<BTreeMap<String, LastValue>>>;

/// A document.
#[derive(Debug, Clone)]
pub struct LastValue {
    /// Its JSON.
    pub document: Bytes,
}
