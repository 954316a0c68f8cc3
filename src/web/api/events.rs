//! Changes as they come, in one stream per page. Changes within a second are sent together, and only the newest of each kind,
//! so a slow reader uses no more memory. After a reconnection everything is sent again.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{Event, Sse};
use axum::routing::get;
use bytes::Bytes;
use futures_util::stream::{self, Stream};
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio::time::{Interval, MissedTickBehavior, interval};

use super::site::site_of;
use super::window::curves_after;
use super::{Operation, Parameter, ResponseKind, Shared};
use crate::runtime::clock::now_ns;
use crate::runtime::overview::Changes;
use crate::web::error::ApiError;
use crate::web::extract::QueryParams;
use crate::web::guard::Permission;
use crate::web::server::{IdleTimer, Peer};
use stiction::core::units::ms_from_ns;
use stiction_engine::alarm::AlarmDocument;
use stiction_engine::codec::topic::Kind;

/// Pause between two checks for changes.
const EVERY: Duration = Duration::from_secs(1);
/// Checks between two events about the daemon itself.
const SITE_EVERY: u32 = 5;
/// Rows in one event, so that the first screen appears before all rows have come.
const ROWS_AT_ONCE: usize = 250;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Watching {
    r#loop: Option<String>,
}

pub(super) fn operations() -> Vec<Operation<Shared>> {
    vec![Operation {
        method: "get",
        path: "/events",
        summary: "Changes as they come, as server-sent events: site, loops (rows; the first with full: true, which replaces all \
                  before it, and the plant's headline), alarm (document), groups (loops were compared), and of one loop samples, estimate and gap (another diagnosis)",
        query: &[Parameter { name: "loop", words: "a loop whose samples and estimates are wanted too" }],
        body: None,
        response: ResponseKind::Events,
        handler: || get(events),
    }]
}

/// The loop that a page shows, and what was already sent of it.
struct Watched {
    name: String,
    /// Newest stamp of its samples, ns.
    newest_ns: i64,
    /// End of its newest window, ns.
    window_ns: i64,
    /// Its last diagnosis.
    gap: Option<Bytes>,
}

/// State of a stream.
struct Watch {
    live: Shared,
    token: Permission,
    idle: IdleTimer,
    ticks: Interval,
    count: u32,
    version: u64,
    full: bool,
    watched: Option<Watched>,
    ready: VecDeque<Ready>,
}

/// An event to send. It is serialized only when it is taken, so that little waits for a reader that stops.
enum Ready {
    Event(Event),
    Rows(Rows),
    Alarm(Arc<AlarmDocument>),
}

/// Rows that changed since a version, from the names after `after` on.
#[derive(Default)]
struct Rows {
    version: u64,
    after: Option<String>,
    full: bool,
    gone: Vec<String>,
}

async fn events(
    State(live): State<Shared>,
    QueryParams(watching): QueryParams<Watching>,
    Extension(peer): Extension<Peer>,
    Extension(idle): Extension<IdleTimer>,
    headers: HeaderMap,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, ApiError> {
    let token = live.guard.permission(peer, &headers);
    let crowded = || ApiError::new(StatusCode::TOO_MANY_REQUESTS, "too many pages are open: close some");
    let slot = live.streams.take(peer).ok_or_else(crowded)?;
    let mut ticks = interval(EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let watched = watching.r#loop.map(|name| Watched {
        gap: live.last_bytes(&name, Kind::Gap),
        name,
        newest_ns: i64::MIN,
        window_ns: i64::MIN,
    });
    let watch = Watch { live, token, idle, ticks, count: 0, version: 0, full: true, watched, ready: VecDeque::new() };
    let stream = stream::unfold((watch, slot), |(mut watch, slot)| async {
        let event = watch.next().await;
        Some((Ok(event), (watch, slot)))
    });
    Ok(Sse::new(stream))
}

fn event(name: &str, data: &impl Serialize) -> Event {
    Event::default().event(name).data(serde_json::to_string(data).unwrap_or_default())
}

impl Watch {
    async fn next(&mut self) -> Event {
        loop {
            if let Some(event) = self.take() {
                // Only a taken event is a sign of life: a client that stops reading is disconnected.
                self.idle.touch();
                return event;
            }
            self.ticks.tick().await;
            self.look().await;
        }
    }

    fn take(&mut self) -> Option<Event> {
        loop {
            match self.ready.pop_front()? {
                Ready::Event(event) => return Some(event),
                Ready::Alarm(document) => return Some(event("alarm", document.as_ref())),
                Ready::Rows(rows) => {
                    if let Some(event) = self.rows(rows) {
                        return Some(event);
                    }
                }
            }
        }
    }

    /// The next rows; the remaining ones go before all other events.
    fn rows(&mut self, Rows { version, after, full, gone }: Rows) -> Option<Event> {
        let now = now_ns();
        let rows = self.live.overview.rows_after(version, after.as_deref(), ROWS_AT_ONCE, now);
        if let Some(last) = rows.last().filter(|_| rows.len() == ROWS_AT_ONCE) {
            self.ready.push_front(Ready::Rows(Rows { version, after: Some(last.name.clone()), ..Rows::default() }));
        }
        let is_shown = full || !rows.is_empty() || !gone.is_empty();
        is_shown.then(|| {
            let headline = self.live.overview.headline(&self.live.config.get().site.prefix);
            let now_ms = ms_from_ns(now);
            event("loops", &json!({"now_ms": now_ms, "full": full, "loops": rows, "gone": gone, "headline": headline}))
        })
    }

    fn push(&mut self, name: &str, data: &impl Serialize) {
        self.ready.push_back(Ready::Event(event(name, data)));
    }

    async fn look(&mut self) {
        if self.count.is_multiple_of(SITE_EVERY) {
            self.push("site", &site_of(&self.live, self.token));
        }
        self.count = self.count.wrapping_add(1);
        let Changes { version, full, mut gone, mut alarms, compared } = self.live.overview.changes_after(self.version);
        self.full |= full;
        let after = if full { 0 } else { self.version };
        if self.full {
            // A new client has the alarms from the list, and no rows of loops that have left.
            alarms.clear();
            gone.clear();
        }
        let full = std::mem::take(&mut self.full);
        self.ready.push_back(Ready::Rows(Rows { version: after, after: None, full, gone }));
        self.ready.extend(alarms.into_iter().map(Ready::Alarm));
        if compared {
            // Says only that there are new groups; a page that shows them asks for them.
            self.push("groups", &json!({"now_ms": ms_from_ns(now_ns())}));
        }
        self.version = version;
        self.look_at_loop().await;
    }

    async fn look_at_loop(&mut self) {
        let Some(Watched { name, newest_ns: sent_ns, window_ns, gap }) = &mut self.watched else { return };
        if let Some(estimate) = self.live.overview.newest(name).and_then(|newest| newest.estimate) {
            let end_ns = estimate.assessment.window.end_ns;
            if end_ns > *window_ns {
                *window_ns = end_ns;
                self.ready.push_back(Ready::Event(event("estimate", estimate.as_ref())));
            }
        }
        let diagnosed = self.live.last_bytes(name, Kind::Gap);
        if diagnosed != *gap {
            *gap = diagnosed;
            // Says only that there is a new diagnosis; the page asks for it with its texts.
            self.ready.push_back(Ready::Event(event("gap", &json!({"loop": name}))));
        }
        // The stream continues if the loop has not appeared yet.
        let Ok(looked) = self.live.look(name, None).await else { return };
        let Some(record) = looked.record else { return };
        if let Some((curves, newest_ns)) = curves_after(&record, *sent_ns) {
            *sent_ns = newest_ns;
            self.ready.push_back(Ready::Event(event("samples", &curves)));
        }
    }
}
