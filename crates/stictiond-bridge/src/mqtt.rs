//! `stictiond-bridge mqtt`: republishes a broker's messages on Zenoh, payloads unchanged.
//!
//! The broker keeps unacknowledged messages (persistent session, QoS 1). The bridge acknowledges a message only when it is
//! on the bus and somebody subscribes there. So an outage of the broker or the bus, or a restart of the bridge, loses no
//! message that the broker accepted. Some arrive twice; the daemon drops repeats by their timestamps.

use std::collections::HashMap;
use std::time::Duration;

use anyhow::{Context, anyhow};
use rumqttc::mqttbytes::v5::{Packet, Publish, RetainForwardRule, SubscribeFilter};
use rumqttc::{
    AckMode, AsyncClient, BrokerSessionResumePolicy, Event, EventLoop, MqttOptions, QoS, SessionMode, TlsConfiguration,
    Transport,
};
use sd_notify::NotifyState;

use crate::bus::{Bus, BusArgs, PAUSE, TOLD_EVERY, Teller, document, is_key};
use stiction_engine::codec::MAX_PAYLOAD;
use stiction_engine::config::Address;
use stiction_engine::short_hash;
use stictiond::cli::{Format, Outcome, asked_to_stop, block_on, say};
use stictiond::runtime::secrets::{pem, secret};

/// Most unacknowledged messages that the broker may send.
const UNCONFIRMED: u16 = 1000;
/// Most requests waiting for the connection: more than can be unacknowledged, so an acknowledgement always fits.
const REQUESTS: usize = 4 * UNCONFIRMED as usize;
/// Time limit for disconnecting.
const GOODBYE: Duration = Duration::from_millis(500);

/// Republish an MQTT broker's messages on Zenoh: each topic below --prefix or as --map maps it, payloads unchanged.
///
/// Messages stay at the broker (persistent session, QoS 1) until they are on the bus and somebody subscribes there.
/// Retained messages are not requested: they are old values without their time.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example: stictiond-bridge mqtt --from mqtts://broker.plant --user stiction --secret-file pw \\\n           \
                        --topic 'spBv1.0/plant/#' --connect tcp/127.0.0.1:7447 --prefix plant1/mqtt"
)]
pub struct Args {
    /// Broker: mqtt://HOST[:PORT] or mqtts://HOST[:PORT].
    #[arg(long, value_parser = broker)]
    pub from: Address,
    /// Topic filter to subscribe to, with the wildcards + and #; repeatable.
    #[arg(long = "topic", required = true, value_name = "FILTER")]
    pub topics: Vec<String>,
    /// Zenoh key for one topic; repeatable [default: the topic below --prefix].
    #[arg(long, value_name = "TOPIC=KEY", value_parser = mapping)]
    pub map: Vec<(String, String)>,
    /// User name at the broker.
    #[arg(long, default_value = "")]
    pub user: String,
    /// File with the password of --user.
    #[arg(long, default_value = "", value_name = "FILE")]
    pub secret_file: String,
    /// CA certificates (PEM) to trust [default: those of the system].
    #[arg(long, default_value = "", value_name = "FILE")]
    pub ca_file: String,
    /// Client certificate (PEM).
    #[arg(long, default_value = "", value_name = "FILE", requires = "key_file")]
    pub cert_file: String,
    /// Private key of the client certificate (PEM).
    #[arg(long, default_value = "", value_name = "FILE", requires = "cert_file")]
    pub key_file: String,
    /// Client identifier; the broker keeps the session under it [default: made from broker, topics and prefix].
    #[arg(long)]
    pub id: Option<String>,
    /// Time in seconds that the broker keeps the session while the bridge is away.
    #[arg(long, default_value_t = 86_400)]
    pub session_s: u32,
    /// Bus options.
    #[command(flatten)]
    pub bus: BusArgs,
}

fn broker(text: &str) -> Result<Address, String> {
    Address::parse(text, "mqtt", [1883, 8883])
        .ok()
        .filter(|address| address.path.is_empty())
        .ok_or_else(|| "write mqtt://HOST[:PORT] or mqtts://HOST[:PORT]".to_owned())
}

fn mapping(text: &str) -> Result<(String, String), String> {
    let (topic, key) = text.split_once('=').ok_or("write TOPIC=KEY")?;
    if !is_key(key) {
        return Err(format!("{key:?} is not a valid key; use no empty parts, wildcards or @"));
    }
    Ok((topic.to_owned(), key.to_owned()))
}

/// Message counters.
#[derive(Debug, Default, Clone, PartialEq, Eq, serde::Serialize)]
struct Figures {
    /// From the broker, redelivered ones included.
    received: u64,
    /// Of these, those that the broker marked as redelivered.
    again: u64,
    /// Published on the bus.
    published: u64,
    /// Acknowledged to the broker.
    confirmed: u64,
    /// Rejected: too large, or a topic that makes no valid key.
    refused: u64,
    /// Connections to the broker.
    connections: u64,
    /// Of these, those with a session that the broker had kept.
    resumed: u64,
    /// Connections lost.
    lost_connections: u64,
}

/// Runs the command until SIGTERM or Ctrl-C.
///
/// # Errors
/// Nothing answers on the bus, or a file cannot be read. A broker that does not answer is retried for ever.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let options = options(args)?;
    let figures = block_on(async {
        let stop = asked_to_stop()?;
        let bus = Bus::open(&args.bus).await?;
        let (client, events) = AsyncClient::builder(options).capacity(REQUESTS).build();
        let keys = args.map.iter().cloned().collect();
        let mut bridge =
            Bridge { args, keys, bus, client, figures: Figures::default(), teller: Teller::new("mqtt", &args.bus) };
        let figures = bridge.serve(events, stop).await;
        bridge.bus.close().await;
        figures
    })?;
    match format {
        Format::Json => say(document("mqtt", &figures))?,
        Format::Text => say(line(&figures))?,
    }
    Ok(Outcome::Done)
}

fn line(f: &Figures) -> String {
    format!(
        "{} received ({} redelivered), {} published, {} acknowledged, {} rejected; {} connections, {} resumed",
        f.received, f.again, f.published, f.confirmed, f.refused, f.connections, f.resumed
    )
}

fn options(args: &Args) -> anyhow::Result<MqttOptions> {
    let own = format!("{} {:?} {}", args.from.host, args.topics, args.bus.prefix);
    let id = args.id.clone().unwrap_or_else(|| format!("stictiond-bridge-{}", &short_hash(own.as_bytes())[..12]));
    let mut options = MqttOptions::new(id, (args.from.host.clone(), args.from.port));
    options.set_keep_alive(15);
    options.set_session_mode(SessionMode::Persistent);
    options.set_session_expiry_interval(Some(args.session_s));
    options.set_receive_maximum(Some(UNCONFIRMED));
    options.set_ack_mode(AckMode::Manual);
    // A restarted bridge has no state that could contradict the broker's: it only receives.
    options.set_broker_session_resume_policy(BrokerSessionResumePolicy::AllowBrokerOnly);
    if !args.user.is_empty() {
        options.set_credentials(args.user.clone(), secret(&args.secret_file)?.unwrap_or_default());
    }
    if args.from.tls {
        options.set_transport(Transport::tls_with_config(tls_of(&args.ca_file, &args.cert_file, &args.key_file)?));
    }
    Ok(options)
}

/// TLS that trusts these certificates, or the system's; with a client certificate if one is given.
fn tls_of(ca_file: &str, cert_file: &str, key_file: &str) -> anyhow::Result<TlsConfiguration> {
    let Some(ca) = pem("ca_file", ca_file)? else {
        return TlsConfiguration::try_default_rustls().map_err(|e| anyhow!("this system's certificates: {e}"));
    };
    let own = pem("cert_file", cert_file)?.zip(pem("key_file", key_file)?);
    Ok(TlsConfiguration::Simple { ca, alpn: None, client_auth: own })
}

struct Bridge<'a> {
    args: &'a Args,
    keys: HashMap<String, String>,
    bus: Bus,
    client: AsyncClient,
    figures: Figures,
    teller: Teller,
}

impl Bridge<'_> {
    async fn serve(&mut self, mut events: EventLoop, stop: impl Future<Output = ()>) -> anyhow::Result<Figures> {
        tokio::pin!(stop);
        let mut outage: Option<String> = None;
        loop {
            self.tell(false)?;
            let event = tokio::select! {
                event = events.poll() => event,
                () = tokio::time::sleep(TOLD_EVERY) => continue,
                () = &mut stop => break,
            };
            match event {
                Ok(Event::Incoming(Packet::ConnAck(ack))) => {
                    tracing::info!(resumed = ack.session_present, "connected to the broker");
                    outage = None;
                    self.connected(ack.session_present)?;
                }
                Ok(Event::Incoming(Packet::Publish(message))) => {
                    tokio::select! {
                        taken = self.take(&message) => taken?,
                        () = &mut stop => break,
                    }
                }
                Ok(_) => {}
                Err(error) => {
                    // Logged once per outage, not every second.
                    let text = error.to_string();
                    if outage.as_ref() != Some(&text) {
                        tracing::warn!(broker = %self.args.from.host, error = %text, "no connection to the broker; retrying every second");
                    }
                    self.figures.lost_connections += u64::from(outage.is_none());
                    outage = Some(text);
                    tokio::select! {
                        () = tokio::time::sleep(PAUSE) => {}
                        () = &mut stop => break,
                    }
                }
            }
        }
        let goodbye = async {
            if self.client.disconnect().await.is_ok() {
                while events.poll().await.is_ok() {}
            }
        };
        let _ = tokio::time::timeout(GOODBYE, goodbye).await;
        self.tell(true)?;
        Ok(self.figures.clone())
    }

    /// A new connection: subscribes unless the broker has kept the session.
    fn connected(&mut self, resumed: bool) -> anyhow::Result<()> {
        self.figures.connections += 1;
        self.figures.resumed += u64::from(resumed);
        let filters = self.args.topics.iter().map(|topic| SubscribeFilter {
            retain_forward_rule: RetainForwardRule::Never,
            ..SubscribeFilter::new(topic.clone(), QoS::AtLeastOnce)
        });
        // Subscribe even to a resumed session: the topics may have changed since.
        self.client.try_subscribe_many(filters).context("cannot subscribe at the broker")?;
        let _ = sd_notify::notify(&[NotifyState::Ready]);
        Ok(())
    }

    /// Publishes one message once somebody subscribes, then acknowledges it.
    async fn take(&mut self, message: &Publish) -> anyhow::Result<()> {
        self.figures.received += 1;
        self.figures.again += u64::from(message.dup);
        match self.key_of(&message.topic).filter(|_| message.payload.len() <= MAX_PAYLOAD) {
            None => {
                if self.figures.refused == 0 {
                    let topic = String::from_utf8_lossy(&message.topic).escape_debug().to_string();
                    tracing::warn!(
                        topic,
                        bytes = message.payload.len(),
                        "rejected a message: its topic makes no valid key, or it is too large; further ones are only counted"
                    );
                }
                self.figures.refused += 1;
            }
            Some(key) => {
                self.bus.until_listened().await;
                self.bus.put(&key, message.payload.to_vec(), encoding_of(message)).await?;
                self.figures.published += 1;
            }
        }
        if let Some(ack) = self.client.prepare_ack(message)
            && self.client.try_manual_ack(ack).is_ok()
        {
            self.figures.confirmed += 1;
        }
        Ok(())
    }

    fn key_of(&self, topic: &[u8]) -> Option<String> {
        let topic = std::str::from_utf8(topic).ok()?;
        let key = || format!("{}/{}", self.args.bus.prefix, topic.trim_matches('/'));
        Some(self.keys.get(topic).cloned().unwrap_or_else(key)).filter(|key| is_key(key))
    }

    fn tell(&mut self, at_the_end: bool) -> anyhow::Result<()> {
        if at_the_end || self.teller.is_due() {
            self.teller.tell(&line(&self.figures), &self.figures)?;
        }
        Ok(())
    }
}

/// The encoding that the sender states; Sparkplug B is recognised by its topic.
fn encoding_of(message: &Publish) -> Option<String> {
    let said = message.properties.as_ref().and_then(|p| p.content_type.clone());
    let sparkplug = message.topic.starts_with(b"spBv1.0/") && !message.topic.starts_with(b"spBv1.0/STATE/");
    said.or_else(|| sparkplug.then(|| "application/vnd.sparkplug-b".to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mappings_are_keys() {
        assert!(mapping("a/b=p/@stiction/v1/A/alarm").is_err() && mapping("a/b").is_err());
        assert_eq!(mapping("a/b=p/FIC101/op"), Ok(("a/b".to_owned(), "p/FIC101/op".to_owned())));
    }

    #[test]
    fn brokers_are_mqtt_alone() {
        assert_eq!(broker("mqtts://b").map(|a| (a.tls, a.port)), Ok((true, 8883)));
        assert!(["https://b", "mqtt://b/x", "b"].into_iter().all(|text| broker(text).is_err()));
    }
}
