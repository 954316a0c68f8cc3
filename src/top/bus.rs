//! The connection to running daemons: discovered by liveliness tokens, followed by subscriptions and a query of last values.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{anyhow, bail};
use tokio::sync::mpsc::{Sender, UnboundedReceiver};
use zenoh::Session;
use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;

use super::board::News;
use super::view::Ask;
use stiction_core::record::Value;
use stiction_monitor::codec::topic::{self, Kind, Leaf, OUTPUT_CHUNKS, Topic};
use stiction_monitor::codec::{self};
use stiction_runtime::clock::now_ns;

/// Time limit for a daemon to answer at the start.
pub const ANSWER_WITHIN: Duration = Duration::from_secs(5);
/// Time limit for the query of all last values.
const LAST_WITHIN: Duration = Duration::from_secs(10);
/// Time limit for a command.
const COMMAND_WITHIN: Duration = Duration::from_secs(10);
/// How often the link is checked.
const LINK: Duration = Duration::from_secs(1);

/// Key patterns of all documents of loops and of the daemons themselves: no wildcard matches a part that begins with `@`.
fn documents(prefix: &str) -> [String; 2] {
    ["**", "@daemon/*/health"].map(|rest| topic::plane(prefix, rest))
}

fn tokens(prefix: &str) -> String {
    topic::plane(prefix, "@daemon/*")
}

/// Prefix and id of the daemon with this token.
fn of_token(key: &str) -> Option<(&str, &str)> {
    let (prefix, rest) = key.split_once(&format!("/{OUTPUT_CHUNKS}/@daemon/"))?;
    (!rest.contains('/')).then_some((prefix, rest))
}

/// The prefix of the daemons on the bus: the requested one, or the only one.
///
/// # Errors
/// No daemon answers in time, or there are several prefixes and none is requested; the message says what to do.
pub async fn prefix_of_daemons(session: &Session, wished: Option<&str>, where_to: &str) -> anyhow::Result<String> {
    let until = Instant::now() + ANSWER_WITHIN;
    let everywhere = tokens("**");
    loop {
        let asked = session.liveliness().get(everywhere.as_str()).timeout(ANSWER_WITHIN).await;
        let replies = asked.map_err(|e| anyhow!("cannot query for daemons: {e}"))?;
        let mut found = BTreeSet::new();
        while let Ok(reply) = replies.recv_async().await {
            let key = reply.result().ok().map(|sample| sample.key_expr().as_str().to_owned());
            found.extend(key.as_deref().and_then(of_token).map(|(prefix, _)| prefix.to_owned()));
        }
        let late = Instant::now() >= until;
        match (wished, found.len()) {
            (Some(wished), _) if found.contains(wished) => return Ok(wished.to_owned()),
            (Some(wished), n) if late && n > 0 => {
                bail!(
                    "no daemon publishes below {wished:?} at {where_to}; use one of these prefixes: {}",
                    joined(&found)
                )
            }
            (None, 1) => return Ok(found.into_iter().next().unwrap_or_default()),
            (None, n) if n > 1 => bail!("several plants share this bus; choose one with --prefix: {}", joined(&found)),
            _ if late => bail!(
                "no daemon answers at {where_to} within {} s; start one with `stictiond run --config \
                 FILE` or `stictiond demo`, and name its [zenoh] listen endpoint, or its router's, with --connect",
                ANSWER_WITHIN.as_secs()
            ),
            _ => tokio::time::sleep(Duration::from_millis(200)).await,
        }
    }
}

fn joined(names: &BTreeSet<String>) -> String {
    names.iter().map(String::as_str).collect::<Vec<_>>().join(", ")
}

/// The last document of every key, and the daemons present.
///
/// # Errors
/// The session is closed.
pub async fn last_values(session: &Session, prefix: &str) -> anyhow::Result<Vec<News>> {
    let mut news = Vec::new();
    let asked = session.liveliness().get(tokens(prefix)).timeout(LAST_WITHIN).await;
    let replies = asked.map_err(|e| anyhow!("cannot query for daemons: {e}"))?;
    while let Ok(reply) = replies.recv_async().await {
        let key = reply.result().ok().map(|sample| sample.key_expr().as_str().to_owned());
        news.extend(key.as_deref().and_then(of_token).map(|(_, id)| News::Came(id.to_owned())));
    }
    for key in documents(prefix) {
        let replies = session.get(key.as_str()).timeout(LAST_WITHIN).await.map_err(|e| anyhow!("{key}: {e}"))?;
        while let Ok(reply) = replies.recv_async().await {
            if let Ok(sample) = reply.result() {
                let key = sample.key_expr().as_str().to_owned();
                news.push(News::Document(key, sample.payload().to_bytes().into_owned()));
            }
        }
    }
    Ok(news)
}

/// Passes inputs on; what does not fit is queried again.
#[derive(Clone)]
struct Out {
    news: Sender<News>,
    missed: Arc<AtomicBool>,
}

impl Out {
    fn send(&self, news: News) {
        if self.news.try_send(news).is_err() {
            self.missed.store(true, Ordering::Relaxed);
        }
    }
}

/// Follows the daemons below a prefix and executes requests until the requests end.
///
/// # Errors
/// Zenoh rejects a key.
pub async fn follow(
    session: Session,
    prefix: String,
    news: Sender<News>,
    mut asks: UnboundedReceiver<Ask>,
) -> anyhow::Result<()> {
    let out = Out { news, missed: Arc::new(AtomicBool::new(true)) };
    let _documents = subscribe(&session, &prefix, &out).await?;
    let mut watched: Option<Subscriber<()>> = None;
    let mut connected = true;
    let mut look = tokio::time::interval(LINK);
    loop {
        tokio::select! {
            ask = asks.recv() => match ask {
                None | Some(Ask::Quit) => return Ok(()),
                Some(Ask::Watch(name)) => {
                    watched = None;
                    if let Some(name) = name {
                        watched = Some(watch(&session, &prefix, &name, &out).await?);
                    }
                }
                Some(Ask::Acknowledge { name, by }) => {
                    out.send(News::Said(acknowledge(&session, &prefix, &name, &by).await));
                }
            },
            _ = look.tick() => {
                let info = session.info();
                let links = info.routers_zid().await.count() + info.peers_zid().await.count();
                if (links > 0) != connected {
                    connected = links > 0;
                    out.send(News::Connected(connected));
                    out.missed.store(true, Ordering::Relaxed);
                }
                if connected && out.missed.swap(false, Ordering::Relaxed) {
                    for news in last_values(&session, &prefix).await? {
                        // The reader is quick: waiting for it is waiting for a picture at most.
                        if out.news.send(news).await.is_err() {
                            return Ok(());
                        }
                    }
                }
            }
        }
        // Held as long as it is looked at.
        let _ = &watched;
    }
}

async fn subscribe(session: &Session, prefix: &str, out: &Out) -> anyhow::Result<Vec<Subscriber<()>>> {
    let mut all = Vec::new();
    for key in documents(prefix) {
        let out = out.clone();
        let take = move |sample: zenoh::sample::Sample| {
            out.send(News::Document(sample.key_expr().as_str().to_owned(), sample.payload().to_bytes().into_owned()));
        };
        let declared = session.declare_subscriber(key.clone()).callback(take).await;
        all.push(declared.map_err(|e| anyhow!("cannot subscribe to {key:?}: {e}"))?);
    }
    let out = out.clone();
    let take = move |sample: zenoh::sample::Sample| {
        let Some((_, id)) = of_token(sample.key_expr().as_str()) else { return };
        if sample.kind() == SampleKind::Put {
            out.send(News::Came(id.to_owned()));
            // A daemon that starts knows the states of its last run.
            out.missed.store(true, Ordering::Relaxed);
        } else {
            out.send(News::Left(id.to_owned()));
        }
    };
    let declared = session.liveliness().declare_subscriber(tokens(prefix)).history(true).callback(take).await;
    all.push(declared.map_err(|e| anyhow!("cannot watch for daemons: {e}"))?);
    Ok(all)
}

/// The raw samples of a loop, if they are published under its own key.
async fn watch(session: &Session, prefix: &str, name: &str, out: &Out) -> anyhow::Result<Subscriber<()>> {
    let key = format!("{prefix}/{name}/*");
    let (out, prefix) = (out.clone(), prefix.to_owned());
    let take = move |message: zenoh::sample::Sample| {
        let key = message.key_expr().as_str();
        let Some(Topic { loop_name, leaf: Leaf::Raw(signal), .. }) = Topic::parse(Some(&prefix), key) else { return };
        let encoding = message.encoding().to_string();
        let encoding = (*message.encoding() != zenoh::bytes::Encoding::default()).then_some(encoding.as_str());
        let mut samples = Vec::new();
        // What the daemon cannot read either, it counts and names.
        if codec::decode(signal, &message.payload().to_bytes(), encoding, None, now_ns(), &mut samples).is_err() {
            return;
        }
        for sample in samples {
            if let Value::Number(value) = sample.value {
                out.send(News::Sample(loop_name.to_owned(), signal, sample.t_ns, value));
            }
        }
    };
    session
        .declare_subscriber(key.clone())
        .callback(take)
        .await
        .map_err(|e| anyhow!("cannot subscribe to {key:?}: {e}"))
}

/// Requests an acknowledgement and returns its outcome in words.
async fn acknowledge(session: &Session, prefix: &str, name: &str, by: &str) -> String {
    let key = topic::result(prefix, name, Kind::Alarm);
    let asked = session.get(format!("{key}?cmd=ack;by={by}")).timeout(COMMAND_WITHIN).await;
    let replies = match asked {
        Ok(replies) => replies,
        Err(error) => return format!("{name}: not acknowledged: {error}"),
    };
    match replies.recv_async().await.map(zenoh::query::Reply::into_result) {
        Ok(Ok(_)) => format!("{name}: acknowledged by {by}"),
        Ok(Err(error)) => format!("{name}: not acknowledged: {}", String::from_utf8_lossy(&error.payload().to_bytes())),
        Err(_) => format!("{name}: not acknowledged: no daemon answers; try again when it is back"),
    }
}
