//! A subscription: created in every new session, in requests that servers accept, and its messages in order.

use std::sync::Arc;
use std::time::Duration;

use anyhow::anyhow;
use opcua::client::{MonitoredItemMap, OnSubscriptionNotificationCore, Session};
use opcua::types::{
    DataChangeFilter, DataChangeTrigger, ExtensionObject, MonitoredItemCreateRequest, MonitoringMode,
    MonitoringParameters, NamespaceMap, NodeId, NotificationMessage, ReadValueId, StatusCode, TimestampsToReturn,
};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

use super::browse::node_id;
use super::nodes::Node;
use super::with::Args;

/// Items per request, which servers limit.
const CHUNK: usize = 500;
/// Keep-alive interval of a silent subscription, ms.
const ALIVE_MS: u32 = 5_000;
/// Most rejected nodes named in the log.
const NAMED: usize = 10;

/// An active subscription.
pub struct Subscription {
    /// Its identifier at the server.
    pub id: u32,
    /// Its messages in order of arrival.
    pub messages: UnboundedReceiver<NotificationMessage>,
    /// Nodes that the server rejected, by index in the list.
    pub refused: Vec<usize>,
    /// Nodes that it reports only on change.
    pub on_change_only: usize,
}

/// Forwards messages unchanged, because the client's lock is held meanwhile.
struct Handing(UnboundedSender<NotificationMessage>);

impl OnSubscriptionNotificationCore for Handing {
    fn on_subscription_notification(&mut self, message: NotificationMessage, _: MonitoredItemMap<'_>) {
        // After the session is given up, there is no receiver.
        let _ = self.0.send(message);
    }
}

impl Subscription {
    /// Subscribes to all nodes.
    ///
    /// # Errors
    /// The server does not answer or rejects the subscription.
    pub async fn make(session: &Arc<Session>, args: &Args, nodes: &[Node]) -> anyhow::Result<Self> {
        let every_ms = args.publishing_ms();
        let alive = (ALIVE_MS / every_ms).max(1);
        let lifetime = (args.server.session_ms() / every_ms).max(3 * alive);
        let (hand, messages) = unbounded_channel();
        let interval = Duration::from_millis(u64::from(every_ms));
        let id = session
            .create_subscription(interval, lifetime, alive, 0, 0, true, Handing(hand))
            .await
            .map_err(|e| anyhow!("cannot create a subscription: {}", e.status()))?;
        let mut subscription = Self { id, messages, refused: (0..nodes.len()).collect(), on_change_only: 0 };
        subscription.add_refused(session, args, nodes).await?;
        Ok(subscription)
    }

    /// Retries the nodes that are not subscribed yet. Returns how many were added.
    ///
    /// # Errors
    /// The server does not answer.
    pub async fn add_refused(&mut self, session: &Arc<Session>, args: &Args, nodes: &[Node]) -> anyhow::Result<usize> {
        let (mut spaces, mut refused) = (None, Vec::new());
        let all = std::mem::take(&mut self.refused);
        let count = all.len();
        for chunk in all.chunks(CHUNK) {
            // A sample with an unchanged value counts too, so a new timestamp counts as a change if the server supports that.
            let (bare, unknown) = self.create(session, args, nodes, chunk, true, &mut spaces).await?;
            refused.extend(unknown);
            if !bare.is_empty() {
                let places: Vec<usize> = bare.iter().map(|(place, _)| *place).collect();
                let (still, unknown) = self.create(session, args, nodes, &places, false, &mut spaces).await?;
                self.on_change_only += places.len() - still.len() - unknown.len();
                refused.extend(still.into_iter().chain(unknown));
            }
        }
        for (place, status) in refused.iter().take(NAMED) {
            tracing::warn!(node = nodes[*place].id, %status, "the server rejects this node; retrying every minute");
        }
        if refused.len() > NAMED {
            tracing::warn!("the server rejects {} more nodes", refused.len() - NAMED);
        }
        self.refused = refused.into_iter().map(|(place, _)| place).collect();
        Ok(count - self.refused.len())
    }

    /// Requests nodes. Returns those whose filter the server rejects, and those that it rejects.
    async fn create(
        &self,
        session: &Arc<Session>,
        args: &Args,
        nodes: &[Node],
        places: &[usize],
        by_time: bool,
        spaces: &mut Option<NamespaceMap>,
    ) -> anyhow::Result<(Vec<(usize, StatusCode)>, Vec<(usize, StatusCode)>)> {
        let (mut items, mut asked, mut unfiltered, mut refused) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for place in places {
            match node_id(session, &nodes[*place].id, spaces).await {
                Ok(id) => {
                    items.push(item(id, *place, args, by_time));
                    asked.push(*place);
                }
                Err(_) => refused.push((*place, StatusCode::BadNodeIdUnknown)),
            }
        }
        if items.is_empty() {
            return Ok((unfiltered, refused));
        }
        let created = session
            .create_monitored_items(self.id, TimestampsToReturn::Both, items)
            .await
            .map_err(|e| anyhow!("the server rejects the monitored items: {}", e.status()))?;
        for (place, created) in asked.iter().zip(&created) {
            match created.result.status_code {
                status if !status.is_bad() => {}
                status @ (StatusCode::BadMonitoredItemFilterUnsupported
                | StatusCode::BadMonitoredItemFilterInvalid
                | StatusCode::BadFilterNotAllowed) => unfiltered.push((*place, status)),
                status => refused.push((*place, status)),
            }
        }
        // If the server answers for fewer nodes than requested, it has not taken the rest.
        refused.extend(asked.iter().skip(created.len()).map(|place| (*place, StatusCode::BadUnexpectedError)));
        Ok((unfiltered, refused))
    }
}

fn item(id: NodeId, place: usize, args: &Args, by_time: bool) -> MonitoredItemCreateRequest {
    let filter = DataChangeFilter { trigger: DataChangeTrigger::StatusValueTimestamp, ..DataChangeFilter::default() };
    MonitoredItemCreateRequest {
        item_to_monitor: ReadValueId::from(id),
        monitoring_mode: MonitoringMode::Reporting,
        requested_parameters: MonitoringParameters {
            // The client assigns its own number to handle 0.
            client_handle: u32::try_from(place + 1).unwrap_or(u32::MAX),
            sampling_interval: f64::from(args.sampling_ms),
            filter: if by_time { ExtensionObject::from_message(filter) } else { ExtensionObject::null() },
            queue_size: args.queue(),
            discard_oldest: true,
        },
    }
}
