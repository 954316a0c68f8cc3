//! Queries over the bus: last documents and schemas, commands on alarms, gap diagnoses.
//!
//! The callbacks run on the threads that also bring samples, so they only read the query and pass it on: to the engine through
//! the control queue, or to the threads that reply.

use std::sync::{Arc, PoisonError};
use std::time::Instant;

use anyhow::anyhow;
use crossbeam_channel::Sender;
use zenoh::query::{Query, Queryable};

use super::askers::Askers;
use super::replies::{PendingQuery, Replies, Reply};
use crate::daemon::documents;
use crate::runtime::control::{Answer, Control};
use crate::runtime::last_values::{LastValue, LastValues};
use crate::runtime::metrics::Metrics;
use stiction_engine::alarm::Command;
use stiction_engine::codec::topic::{self, Kind, Leaf, Topic};
use stiction_engine::config::Config;
use stiction_engine::shard::Shard;

/// Handles the queries.
#[derive(Clone)]
pub struct Queries {
    /// The site's prefix, and which of its loops this daemon serves.
    prefix: Arc<str>,
    shard: Shard,
    control: Sender<Control>,
    replies: Replies,
    askers: Askers,
    metrics: Arc<Metrics>,
    started: Instant,
}

impl Queries {
    /// For this configuration, with the engine's control queue and the threads that reply.
    #[must_use]
    pub fn new(
        config: &Config,
        control: Sender<Control>,
        (replies, askers): (Replies, Askers),
        metrics: Arc<Metrics>,
    ) -> Self {
        let prefix = config.site.prefix.as_str().into();
        Self { prefix, shard: config.shard, control, replies, askers, metrics, started: Instant::now() }
    }

    /// Answers queries for as long as the queryables live. Also puts the schemas of this build's documents among the last
    /// documents.
    ///
    /// # Errors
    /// Zenoh refuses a key.
    pub async fn answer(
        self,
        session: &zenoh::Session,
        daemon_id: &str,
        last: &LastValues,
    ) -> anyhow::Result<Vec<Queryable<()>>> {
        for (name, schema) in documents::schemas() {
            let key = topic::plane(&self.prefix, &format!("@schema/{name}"));
            let value = LastValue { document: documents::text(&schema).into() };
            last.write().unwrap_or_else(PoisonError::into_inner).insert(key, value);
        }
        let mut queryables = Vec::new();
        // No wildcard matches a verbatim chunk: the daemon's own health, the groups of loops and the schemas. We do not answer
        // for another daemon's health.
        for rest in ["**", &format!("@daemon/{daemon_id}/**"), "@plant/**", "@schema/*"] {
            let (key, queries) = (topic::plane(&self.prefix, rest), self.clone());
            let queryable = session.declare_queryable(key.clone()).callback(move |query| queries.take(query)).await;
            queryables.push(queryable.map_err(|e| anyhow!("cannot answer queries on {key:?}: {e}"))?);
        }
        Ok(queryables)
    }

    fn take(&self, query: Query) {
        self.metrics.queries.inc();
        let Some(asked) = self.replies.admit(query) else { return };
        let Some(query) = asked.query() else { return };
        let parameters = query.parameters();
        match (parameters.get("cmd").map(str::to_owned), parameters.contains_key("run")) {
            (Some(cmd), _) => self.forward_command(cmd, asked),
            (None, true) => self.forward_run(asked),
            (None, false) => asked.reply(Reply::Last),
        }
    }

    fn forward_command(&self, cmd: String, asked: PendingQuery) {
        let Some(loop_name) = self.loop_of(&asked, Kind::Alarm) else {
            let example = topic::plane(&self.prefix, "LOOP/alarm");
            return self.refuse(asked, format!("commands go to one loop's alarm key, such as {example}"));
        };
        // The daemon of the loop's shard answers.
        if !self.shard.owns(&loop_name) {
            return;
        }
        let parameter = |name: &str| asked.query()?.parameters().get(name).map(str::to_owned);
        let for_s = match parameter("for_s").map(|text| text.parse::<u64>()) {
            None => None,
            Some(Ok(for_s)) => Some(for_s),
            Some(Err(_)) => {
                return self.refuse(asked, "for_s is a whole number of seconds, such as for_s=3600".to_owned());
            }
        };
        let command = cmd.parse().and_then(|action| {
            let command = Command { action, by: parameter("by"), why: parameter("why"), for_s };
            command.check().map(|()| command)
        });
        let command = match command {
            Ok(command) => command,
            Err(why) => return self.refuse(asked, why.to_string()),
        };
        if !self.askers.may_command(asked.link(), self.started.elapsed()) {
            return self.refuse(asked, "this link sends more commands than one may: try again later".to_owned());
        }
        self.pass_on(asked, |answer| Control::Command { loop_name, command, answer });
    }

    fn forward_run(&self, asked: PendingQuery) {
        let Some(loop_name) = self.loop_of(&asked, Kind::Gap) else {
            let example = topic::plane(&self.prefix, "LOOP/gap");
            return self.refuse(asked, format!("run goes to one loop's gap key, such as {example}?run"));
        };
        if !self.shard.owns(&loop_name) {
            return;
        }
        let by = asked.query().and_then(|q| q.parameters().get("by")).filter(|by| !by.is_empty()).map(str::to_owned);
        let pool = asked.query().is_some_and(|q| q.parameters().contains_key("pool"));
        self.pass_on(asked, |answer| Control::GapRun { loop_name, by, pool, answer });
    }

    /// Passes a request to the engine. If the queue is full, the request is dropped, and with it the query is refused.
    fn pass_on(&self, asked: PendingQuery, request: impl FnOnce(Answer) -> Control) {
        let refused = self.metrics.clone();
        let pending = Pending { asked: Some(asked), refused };
        if self.control.try_send(request(pending.into_answer())).is_err() {
            tracing::debug!("the control queue is full");
        }
    }

    fn refuse(&self, asked: PendingQuery, why: String) {
        self.metrics.commands_refused.inc();
        asked.reply(Reply::Refusal(why));
    }

    /// The single loop whose document of this kind a query names.
    fn loop_of(&self, asked: &PendingQuery, kind: Kind) -> Option<String> {
        let key = asked.query()?.key_expr().as_str();
        let parsed = Topic::parse(Some(&self.prefix), key).filter(|t| t.leaf == Leaf::Document(kind))?;
        Some(parsed.loop_name.to_owned()).filter(|name| !name.contains('*'))
    }
}

/// A request held by the engine. If it is dropped unanswered, the query is refused.
struct Pending {
    asked: Option<PendingQuery>,
    refused: Arc<Metrics>,
}

impl Pending {
    fn into_answer(mut self) -> Answer {
        Box::new(move |result| {
            if let Some(asked) = self.asked.take() {
                asked.reply(match result {
                    Ok(document) => Reply::Document(document),
                    Err(why) => Reply::Refusal(why),
                });
            }
        })
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        if let Some(asked) = self.asked.take() {
            self.refused.commands_refused.inc();
            asked.reply(Reply::Refusal("the daemon is too busy for this: try again".to_owned()));
        }
    }
}
