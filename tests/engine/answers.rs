//! Answers to requests, cached by record and settings: runs that differ only in their order ask for the same ones.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{LazyLock, Mutex};

use stiction::core::verdict::{Assessment, assess};
use stiction_engine::engine::{Request, WindowAnswer};

static ASSESSMENTS: LazyLock<Mutex<HashMap<u64, Assessment>>> = LazyLock::new(Mutex::default);

/// The result of [`Request::compute`].
pub fn compute(request: &Request) -> WindowAnswer {
    let (record, params) = (request.record(), &request.settings.assess);
    let mut hasher = DefaultHasher::new();
    format!("{record:?} {params:?}").hash(&mut hasher);
    let key = hasher.finish();
    let known = ASSESSMENTS.lock().unwrap().get(&key).cloned();
    let assessment = known.unwrap_or_else(|| {
        let assessment = assess(&record, params);
        ASSESSMENTS.lock().unwrap().insert(key, assessment.clone());
        assessment
    });
    request.answer(record, assessment)
}
