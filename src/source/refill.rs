//! Asks for what a loop sent before this daemon had it: of a storage that keeps history, and of the caches that Zenoh's
//! AdvancedPublishers keep of what they sent. Whoever answers, the same sample twice is taken once.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::query::{ConsolidationMode, QueryTarget, ReplyKeyExpr};
use zenoh::sample::{Sample as BusSample, SampleKind};

/// Messages of the past of one loop that are held at most.
const MOST: usize = 200_000;

/// A message as it was sent once.
#[derive(Debug)]
pub struct Past {
    /// Its key.
    pub key: Box<str>,
    /// Its bytes.
    pub payload: Vec<u8>,
    /// The encoding that it says it has, if it says one.
    pub encoding: Option<Box<str>>,
    /// The bus's time stamp, ns since 1970.
    pub bus_ns: Option<i64>,
}

impl Past {
    fn of(sample: &BusSample) -> Option<Self> {
        let encoding = (*sample.encoding() != Encoding::default()).then(|| sample.encoding().to_string().into());
        (sample.kind() == SampleKind::Put).then(|| Self {
            key: sample.key_expr().as_str().into(),
            payload: sample.payload().to_bytes().into_owned(),
            encoding,
            bus_ns: sample.timestamp().map(|t| t.get_time().to_duration().as_nanos() as i64),
        })
    }
}

/// What has come so far; handed over once the last of the queries that share it has ended.
struct Gathered<F: Fn(String, Vec<Past>)> {
    loop_name: String,
    messages: Mutex<Vec<Past>>,
    done: F,
}

impl<F: Fn(String, Vec<Past>)> Drop for Gathered<F> {
    fn drop(&mut self) {
        let messages = std::mem::take(&mut *self.messages.lock().unwrap_or_else(PoisonError::into_inner));
        (self.done)(std::mem::take(&mut self.loop_name), messages);
    }
}

/// Asks for the last `reach_s` of a loop's keys. What has come by then is handed over once, after `within` at the latest,
/// and also where nobody answers.
pub fn ask(
    session: &zenoh::Session,
    loop_name: &str,
    keys: &[String],
    (reach_s, within): (f64, Duration),
    done: impl Fn(String, Vec<Past>) + Send + Sync + 'static,
) {
    let gathered = Arc::new(Gathered { loop_name: loop_name.to_owned(), messages: Mutex::default(), done });
    for key in keys {
        for place in [key.clone(), format!("{key}/@adv/**")] {
            let selector = format!("{place}?_time=[now(-{reach_s}s)..]");
            let gathered = gathered.clone();
            let take = move |reply: zenoh::query::Reply| {
                let Some(past) = reply.result().ok().and_then(Past::of) else { return };
                let mut messages = gathered.messages.lock().unwrap_or_else(PoisonError::into_inner);
                if messages.len() < MOST {
                    messages.push(past);
                }
            };
            let asked = session
                .get(&selector)
                .target(QueryTarget::All)
                .consolidation(ConsolidationMode::None)
                .accept_replies(ReplyKeyExpr::Any)
                .timeout(within)
                .callback(take)
                .wait();
            if let Err(error) = asked {
                tracing::warn!(selector, %error, "a loop's past cannot be asked for");
            }
        }
    }
}
