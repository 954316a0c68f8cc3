//! The last document under each key, as it was published: what queries and the page are answered from.

use std::collections::BTreeMap;
use std::sync::{Arc, RwLock};

use bytes::Bytes;

/// Last document by key. Written by the publisher alone; never touched by the engine.
pub type LastValues = Arc<RwLock<BTreeMap<String, LastValue>>>;

/// A document.
#[derive(Debug, Clone)]
pub struct LastValue {
    /// Its JSON.
    pub document: Bytes,
}
