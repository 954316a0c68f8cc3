//! MQTT 5: each document once at least (QoS 1), the last one of each topic kept by the broker, so that whoever comes later
//! knows how things stand.
//!
//! A connection is opened when there is something to send and let go after a while: alarms are rare, and a connection that
//! was never there cannot be half open.

use std::time::Duration;

use anyhow::{Context, anyhow};
use rumqttc::mqttbytes::v5::PublishProperties;
use rumqttc::{AsyncClient, EventLoop, MqttOptions, PublishOptions, QoS, TlsConfiguration, Transport};
use tokio::runtime::{Builder, Runtime};

use super::{Failure, Item, SEND_WITHIN, Target};
use stiction_monitor::codec::topic;
use stiction_monitor::config::Deliver;
use stiction_monitor::short_hash;
use stiction_runtime::secrets::{pem, secret};

/// Longer than a connection is held without anything to send: no ping is needed.
const KEEP_ALIVE_S: u16 = 60;
/// How long the broker may take to say goodbye.
const GOODBYE: Duration = Duration::from_millis(500);

pub(super) struct Mqtt {
    runtime: Runtime,
    options: MqttOptions,
    /// Head of every topic; empty: the Zenoh keys as they are.
    head: String,
    place: String,
    open: Option<(AsyncClient, EventLoop)>,
}

impl Mqtt {
    pub fn new(d: &Deliver, prefix: &str) -> anyhow::Result<Self> {
        let id = format!("stictiond-{}-{}", d.name, &short_hash(prefix.as_bytes())[..8]);
        let mut options = MqttOptions::new(id, (d.address.host.clone(), d.address.port));
        options.set_keep_alive(KEEP_ALIVE_S).set_clean_start(true);
        if !d.user.is_empty() {
            options.set_credentials(d.user.clone(), secret(&d.secret_file)?.unwrap_or_default());
        }
        if d.address.tls {
            options.set_transport(Transport::tls_with_config(tls_of(&d.ca_file, &d.cert_file, &d.key_file)?));
        }
        let runtime = Builder::new_current_thread().enable_all().build()?;
        Ok(Self { runtime, options, head: d.address.path.clone(), place: d.to.clone(), open: None })
    }

    /// The topic of a document. Loops may have a plus in their names, topics may not.
    fn topic(&self, item: &Item) -> String {
        let place = format!("{}/{}", item.loop_name, item.kind);
        let key =
            if self.head.is_empty() { topic::plane(&item.prefix, &place) } else { format!("{}/{place}", self.head) };
        key.replace(['+', '#'], "_")
    }
}

/// TLS that trusts these certificates, or the system's; with a certificate of our own where one is named.
///
/// # Errors
/// A file cannot be read or holds no certificate, or the system has none.
fn tls_of(ca_file: &str, cert_file: &str, key_file: &str) -> anyhow::Result<TlsConfiguration> {
    let Some(ca) = pem("ca_file", ca_file)? else {
        return TlsConfiguration::try_default_rustls().map_err(|e| anyhow!("this system's certificates: {e}"));
    };
    let own = pem("cert_file", cert_file)?.zip(pem("key_file", key_file)?);
    Ok(TlsConfiguration::Simple { ca, alpn: None, client_auth: own })
}

/// Sends one and waits until the broker has confirmed it.
async fn publish(client: &AsyncClient, events: &mut EventLoop, topic: String, item: &Item) -> anyhow::Result<()> {
    let properties = PublishProperties {
        payload_format_indicator: Some(1),
        content_type: Some(format!("application/json;{}", item.schema)),
        user_properties: vec![("event_id".to_owned(), item.id.clone())],
        ..PublishProperties::default()
    };
    let options = PublishOptions::new(QoS::AtLeastOnce).retained().properties(properties);
    let notice = client.publish_tracked(topic, item.document.clone(), options).await?;
    let confirmed = notice.wait_completion_async();
    tokio::pin!(confirmed);
    loop {
        tokio::select! {
            done = &mut confirmed => return done.context("the broker refuses it"),
            event = events.poll() => drop(event?),
        }
    }
}

impl Target for Mqtt {
    fn send(&mut self, item: &Item) -> Result<(), Failure> {
        let topic = self.topic(item);
        let (client, mut events) =
            self.open.take().unwrap_or_else(|| AsyncClient::builder(self.options.clone()).capacity(4).build());
        let sent = self
            .runtime
            .block_on(async { tokio::time::timeout(SEND_WITHIN, publish(&client, &mut events, topic, item)).await });
        let why = match sent {
            Ok(Ok(())) => {
                self.open = Some((client, events));
                return Ok(());
            }
            Ok(Err(error)) => format!("{error:#}"),
            Err(_) => "no answer in time".to_owned(),
        };
        // Whatever the connection's state is, the next attempt begins with a new one.
        Err(Failure::Unanswered(format!("{}: {why}", self.place)))
    }

    fn rest(&mut self) {
        let Some((client, mut events)) = self.open.take() else { return };
        let goodbye = async {
            if client.disconnect().await.is_ok() {
                while events.poll().await.is_ok() {}
            }
        };
        let _ = self.runtime.block_on(async { tokio::time::timeout(GOODBYE, goodbye).await });
    }
}
