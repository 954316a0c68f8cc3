//! The running bridge: opens one session after another, takes messages apart, and passes values to the bus.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{anyhow, bail};
use opcua::client::Session;
use opcua::types::{DataChangeNotification, DataValue, NotificationMessage, StatusChangeNotification};
use sd_notify::NotifyState;
use tokio::sync::mpsc::UnboundedReceiver;
use tokio::time::{Instant, MissedTickBehavior, interval};

use super::browse;
use super::figures::{Figures, Presence, Sequence};
use super::hold::Hold;
use super::nodes::Node;
use super::server::{Event, Link, open};
use super::subscription::Subscription;
use super::values::{ENCODING, Trust, overflowed, payload, reading, trust};
use super::with::Args;
use crate::bus::{Bus, PAUSE, Teller};

/// Silence of a subscription, in s, after which its session is given up; a live one reports every five seconds.
const SILENCE_S: f64 = 30.0;
/// Interval between retries of rejected nodes.
const RETRIED_EVERY: Duration = Duration::from_secs(60);
/// Time limit for closing the session and for publishing the values that still wait.
const GOODBYE: Duration = Duration::from_secs(2);

fn now_ns() -> i64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(now.as_nanos()).unwrap_or(i64::MAX)
}

/// A node in operation.
struct Signal {
    key: Arc<str>,
    /// Timestamp and status of the last value: a new subscription begins with it.
    last: Option<(i64, u32)>,
    /// Whether its non-numeric value has been logged.
    told: bool,
}

struct Bridge<'a> {
    args: &'a Args,
    nodes: Vec<Node>,
    signals: Vec<Signal>,
    hold: Arc<Hold>,
    published: Arc<AtomicU64>,
    link: Option<Link>,
    sequence: Sequence,
    lost_before: u64,
    presence: Presence,
    figures: Figures,
    teller: Teller,
}

/// Serves until asked to stop.
///
/// # Errors
/// Nothing answers on the bus, or its session ends; the counters' file cannot be written.
pub async fn serve(args: &Args, nodes: Vec<Node>, stop: impl Future<Output = ()>) -> anyhow::Result<Figures> {
    let bus = Arc::new(Bus::open(&args.bus).await?);
    let hold = Arc::new(Hold::new(args.hold));
    let published = Arc::new(AtomicU64::new(0));
    let mut delivering = tokio::spawn(deliver(bus.clone(), hold.clone(), published.clone()));
    let mut bridge = Bridge {
        args,
        nodes: Vec::new(),
        signals: Vec::new(),
        hold,
        published,
        link: None,
        sequence: Sequence::default(),
        lost_before: 0,
        presence: Presence::new(now_ns()),
        figures: Figures::default(),
        teller: Teller::new("opcua", &args.bus),
    };
    bridge.use_nodes(nodes);
    tokio::select! {
        served = bridge.sessions() => served?,
        ended = &mut delivering => ended.map_err(|e| anyhow!("{e}"))??,
        () = stop => {}
    }
    if let Some(link) = bridge.link.take() {
        link.close(GOODBYE).await;
    }
    let until = Instant::now() + GOODBYE;
    while bridge.waiting() > 0 && Instant::now() < until {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    delivering.abort();
    bus.close().await;
    bridge.figures.unsent = bridge.waiting();
    bridge.tell()?;
    Ok(bridge.figures)
}

/// Publishes waiting values, in order, while somebody subscribes.
async fn deliver(bus: Arc<Bus>, hold: Arc<Hold>, published: Arc<AtomicU64>) -> anyhow::Result<()> {
    loop {
        let (key, value) = hold.pop().await;
        bus.until_listened().await;
        bus.put(&key, payload(&value), Some(ENCODING.to_owned())).await?;
        published.fetch_add(1, Ordering::Relaxed);
    }
}

impl Bridge<'_> {
    fn use_nodes(&mut self, nodes: Vec<Node>) {
        let prefix = &self.args.bus.prefix;
        let signal = |node: &Node| Signal { key: format!("{prefix}/{}", node.key).into(), last: None, told: false };
        self.signals = nodes.iter().map(signal).collect();
        self.nodes = nodes;
    }

    /// Opens one session after another, for ever.
    async fn sessions(&mut self) -> anyhow::Result<()> {
        loop {
            if let Err(error) = self.session().await {
                self.gone(&format!("{error:#}"))?;
            }
            self.link = None;
            self.tell_when_due()?;
            tokio::time::sleep(PAUSE).await;
        }
    }

    /// One session from start to end, over any number of connections.
    async fn session(&mut self) -> anyhow::Result<()> {
        let (link, mut events) = open(&self.args.server).await?;
        let session = link.session.clone();
        self.link = Some(link);
        match events.recv().await {
            Some(Event::New) => {}
            Some(Event::Lost(why) | Event::Ended(why)) => bail!("cannot open a session: {why}"),
            other => bail!("cannot open a session: {other:?}"),
        }
        self.figures.sessions += 1;
        if self.nodes.is_empty() {
            self.browse(&session).await?;
        }
        self.lost_before += self.sequence.lost();
        self.sequence = Sequence::default();
        let mut subscription = Subscription::make(&session, self.args, &self.nodes).await?;
        self.count_nodes(&subscription);
        self.back(false)?;
        let ended = self.follow(&session, &mut subscription, &mut events).await;
        // Messages received before the end are still valid, but missing ones can no longer be requested.
        subscription.messages.close();
        while let Some(message) = subscription.messages.recv().await {
            self.take(None, &subscription, message).await?;
        }
        if let Err(error) = &ended {
            self.gone(&format!("{error:#}"))?;
        }
        if let Some(link) = self.link.take().filter(|_| self.presence.silent_s() < SILENCE_S) {
            link.close(GOODBYE).await;
        }
        ended
    }

    async fn browse(&mut self, session: &Arc<Session>) -> anyhow::Result<()> {
        let start = self.args.browse.as_deref().unwrap_or("/Objects");
        let found = browse::below(session, start).await?;
        if found.left_out > 0 {
            tracing::warn!(
                "{} variables below {start} have no unique key and are left out; list them with --nodes",
                found.left_out
            );
        }
        tracing::info!("{} variables below {start}", found.nodes.len());
        self.use_nodes(found.nodes);
        Ok(())
    }

    /// Handles messages until the session ends.
    async fn follow(
        &mut self,
        session: &Arc<Session>,
        subscription: &mut Subscription,
        events: &mut UnboundedReceiver<Event>,
    ) -> anyhow::Result<()> {
        let mut second = interval(Duration::from_secs(1));
        second.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut tried = Instant::now();
        loop {
            tokio::select! {
                // Messages before events, so that messages received before an end are taken first.
                biased;
                Some(message) = subscription.messages.recv() => self.take(Some(session), subscription, message).await?,
                event = events.recv() => match event {
                    Some(Event::Published) => self.presence.heard(now_ns()),
                    Some(Event::Lost(why)) => self.gone(&why)?,
                    Some(Event::Resumed) => {
                        // The client requests messages for new subscriptions, but not for those it has kept.
                        session.trigger_publish_now();
                        self.back(true)?;
                    }
                    Some(Event::New) => bail!("the server did not keep the session"),
                    Some(Event::NoSubscription) => bail!("the server did not keep the subscription"),
                    Some(Event::Ended(why)) => bail!("{why}"),
                    None => bail!("the session has ended"),
                },
                _ = second.tick() => {
                    self.tell_when_due()?;
                    let silent_s = self.presence.silent_s();
                    let longest_s = SILENCE_S.max(3e-3 * f64::from(self.args.publishing_ms()));
                    if !self.presence.is_away() && silent_s > longest_s {
                        bail!("the subscription is silent");
                    }
                    if self.presence.is_away() && silent_s > f64::from(self.args.server.session_ms()) / 1e3 {
                        bail!("the outage was longer than the server keeps a session");
                    }
                    let retry = !self.presence.is_away() && tried.elapsed() > RETRIED_EVERY;
                    if retry && !subscription.refused.is_empty() {
                        tried = Instant::now();
                        subscription.add_refused(session, self.args, &self.nodes).await?;
                        self.count_nodes(subscription);
                    }
                }
            }
        }
    }

    fn count_nodes(&mut self, subscription: &Subscription) {
        self.figures.refused_nodes = subscription.refused.len();
        self.figures.nodes = self.nodes.len() - subscription.refused.len();
        if subscription.on_change_only > self.figures.on_change_only {
            tracing::warn!(
                "the server reports {} nodes only on change; set max_gap_s for their loops",
                subscription.on_change_only
            );
        }
        self.figures.on_change_only = subscription.on_change_only;
    }

    /// Logs each reason once per outage, not every second.
    fn gone(&mut self, why: &str) -> anyhow::Result<()> {
        if self.presence.gone(&mut self.figures, why) {
            tracing::warn!(server = self.args.server.from, why, "no session at the server; retrying every second");
            self.count();
            self.teller.write(&self.figures)?;
        }
        Ok(())
    }

    fn back(&mut self, resumed: bool) -> anyhow::Result<()> {
        let away_s = self.presence.back(&mut self.figures, now_ns(), resumed);
        self.figures.resumed += u64::from(resumed);
        tracing::info!(nodes = self.figures.nodes, resumed, away_s, "subscribed at the server");
        let _ = sd_notify::notify(&[NotifyState::Ready]);
        self.count();
        self.teller.write(&self.figures)
    }

    /// Takes a message, after requesting those missing before it.
    async fn take(
        &mut self,
        session: Option<&Arc<Session>>,
        subscription: &Subscription,
        message: NotificationMessage,
    ) -> anyhow::Result<()> {
        let has_data = message.notification_data.as_ref().is_some_and(|data| !data.is_empty());
        for number in self.sequence.take(message.sequence_number, has_data) {
            let found = match session {
                Some(session) => session.republish(subscription.id, number).await.ok(),
                None => None,
            };
            match found {
                Some(message) => {
                    self.figures.republished += 1;
                    self.values(message)?;
                }
                None => {
                    if self.sequence.lost() == 0 {
                        tracing::warn!("messages from the server were lost; further ones are only counted");
                    }
                    self.sequence.lose(number);
                }
            }
        }
        self.values(message)
    }

    fn values(&mut self, message: NotificationMessage) -> anyhow::Result<()> {
        self.presence.heard(now_ns());
        for data in message.notification_data.into_iter().flatten() {
            if let Some(change) = data.inner_as::<StatusChangeNotification>() {
                bail!("the server ended the subscription: {}", change.status);
            }
            let changes = data.into_inner_as::<DataChangeNotification>();
            for item in changes.and_then(|changes| changes.monitored_items).into_iter().flatten() {
                // Handles are indices in the list plus 1.
                if let Some(place) = (item.client_handle as usize).checked_sub(1).filter(|p| *p < self.signals.len()) {
                    self.value(place, &item.value);
                }
            }
        }
        Ok(())
    }

    fn value(&mut self, place: usize, data: &DataValue) {
        let (signal, figures) = (&mut self.signals[place], &mut self.figures);
        figures.received += 1;
        let status = data.status.map_or(0, |status| status.bits());
        if overflowed(status) {
            if figures.overflows == 0 {
                let key = &signal.key;
                tracing::warn!(%key, "the server's queue overflowed; raise --queue (further overflows are only counted)");
            }
            figures.overflows += 1;
        }
        let Ok(reading) = reading(data, now_ns()) else {
            if !signal.told {
                let key = &signal.key;
                tracing::warn!(%key, "not a number, true or false; further values of this node are only counted");
                signal.told = true;
            }
            figures.refused += 1;
            return;
        };
        self.presence.stamped(reading.t_ns);
        if signal.last.replace((reading.t_ns, status)) == Some((reading.t_ns, status)) {
            figures.again += 1;
            return;
        }
        match trust(status) {
            Trust::Good => {}
            Trust::Uncertain => figures.uncertain += 1,
            Trust::Bad => figures.bad += 1,
        }
        self.hold.push((signal.key.clone(), reading));
    }

    /// Values received but neither published nor dropped so far.
    fn waiting(&self) -> u64 {
        let taken = self.figures.received - self.figures.again - self.figures.refused;
        taken.saturating_sub(self.published.load(Ordering::Relaxed) + self.hold.dropped())
    }

    fn count(&mut self) {
        self.figures.published = self.published.load(Ordering::Relaxed);
        if self.figures.dropped == 0 && self.hold.dropped() > 0 {
            tracing::warn!(
                "no subscriber for so long that the hold is full; dropping the oldest values (raise --hold to keep more)"
            );
        }
        self.figures.dropped = self.hold.dropped();
        self.figures.lost_messages = self.lost_before + self.sequence.lost();
    }

    fn tell_when_due(&mut self) -> anyhow::Result<()> {
        if self.teller.is_due() { self.tell() } else { Ok(()) }
    }

    fn tell(&mut self) -> anyhow::Result<()> {
        self.count();
        self.teller.tell(&self.figures.line(), &self.figures)
    }
}
