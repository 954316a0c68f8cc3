//! Webhook: sends each document as a JSON CloudEvent (CloudEvents 1.0, structured mode) by HTTP POST.

use std::time::Duration;

#[cfg(feature = "tls")]
use anyhow::Context;
use anyhow::bail;
use serde_json::json;
use ureq::Agent;
#[cfg(feature = "tls")]
use ureq::tls::{Certificate, ClientCert, PemItem, PrivateKey, RootCerts, TlsConfig, parse_pem};

use super::{Failure, Item, SEND_WITHIN, Target};
#[cfg(feature = "tls")]
use crate::runtime::secrets::pem;
use crate::runtime::secrets::secret;
use crate::runtime::tls;
use stiction_engine::config::Deliver;

/// Content type of the body.
const CONTENT_TYPE: &str = "application/cloudevents+json; charset=utf-8";
/// 4xx answers that concern the address, the sender or the moment, not the document: these are tried again. All others mean
/// that this document will never be taken.
const MAY_CHANGE: [u16; 11] = [401, 403, 404, 407, 408, 410, 421, 423, 425, 426, 429];

pub(super) struct Webhook {
    agent: Agent,
    url: String,
    token: Option<String>,
}

impl Webhook {
    pub fn new(d: &Deliver) -> anyhow::Result<Self> {
        if d.to.starts_with("https:") {
            tls::required(&d.to)?;
        }
        let token = secret(&d.secret_file)?;
        if token.as_ref().is_some_and(|t| t.is_empty() || !t.chars().all(|c| c.is_ascii_graphic())) {
            bail!("secret_file {}: no bearer token found; write one line of printable characters", d.secret_file);
        }
        let agent = Agent::config_builder()
            .timeout_global(Some(SEND_WITHIN))
            .http_status_as_error(false)
            // The token must not be sent to another server.
            .max_redirects(0)
            .max_redirects_will_error(false)
            .user_agent(concat!("stictiond/", env!("CARGO_PKG_VERSION")));
        #[cfg(feature = "tls")]
        let agent = agent.tls_config(encrypted(d)?);
        Ok(Self { agent: agent.build().into(), url: d.to.clone(), token })
    }
}

/// Certificates to trust, and the daemon's client certificate.
#[cfg(feature = "tls")]
fn encrypted(d: &Deliver) -> anyhow::Result<TlsConfig> {
    let mut settings = TlsConfig::builder();
    if let Some(ca) = pem("ca_file", &d.ca_file)? {
        let roots = certificates(&ca).with_context(|| format!("ca_file {}", d.ca_file))?;
        settings = settings.root_certs(RootCerts::from(roots));
    }
    if let (Some(own), Some(key)) = (pem("cert_file", &d.cert_file)?, pem("key_file", &d.key_file)?) {
        let chain = certificates(&own).with_context(|| format!("cert_file {}", d.cert_file))?;
        let key = PrivateKey::from_pem(&key).with_context(|| format!("key_file {}", d.key_file))?;
        settings = settings.client_cert(Some(ClientCert::new_with_certs(&chain, key)));
    }
    Ok(settings.build())
}

#[cfg(feature = "tls")]
fn certificates(bytes: &[u8]) -> anyhow::Result<Vec<Certificate<'static>>> {
    let items = parse_pem(bytes).collect::<Result<Vec<_>, _>>()?;
    let found: Vec<_> =
        items.into_iter().filter_map(|i| if let PemItem::Certificate(c) = i { Some(c) } else { None }).collect();
    if found.is_empty() { bail!("no certificate found; write PEM") } else { Ok(found) }
}

impl Target for Webhook {
    fn send(&mut self, item: &Item) -> Result<(), Failure> {
        let mut request = self.agent.post(&self.url).header("content-type", CONTENT_TYPE);
        if let Some(token) = &self.token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        let response = request.send(cloud_event(item).as_bytes());
        let response = response.map_err(|error| Failure::Unanswered(format!("{}: {error}", self.url)))?;
        let status = response.status();
        if status.is_success() {
            return Ok(());
        }
        let why = format!("{} answers {status}", self.url);
        if status.is_client_error() && !MAY_CHANGE.contains(&status.as_u16()) {
            return Err(Failure::Refused(why));
        }
        let after = response.headers().get("retry-after").and_then(|v| v.to_str().ok()?.trim().parse::<u64>().ok());
        Err(Failure::Later(why, after.map(Duration::from_secs)))
    }
}

/// The event around a document.
fn cloud_event(item: &Item) -> String {
    let data: serde_json::Value = serde_json::from_str(&item.document).unwrap_or_default();
    let mut event = json!({
        "specversion": "1.0",
        "id": item.id,
        "source": source(&item.prefix),
        "type": item.schema,
        "subject": item.loop_name,
        "datacontenttype": "application/json",
        "dataschema": format!("urn:stictiond:{}", item.schema),
        "data": data,
    });
    // An invalid time is left out.
    if item.time.ends_with('Z') {
        event["time"] = json!(item.time);
    }
    event.to_string()
}

/// The site as a URI, percent-encoded where necessary.
fn source(prefix: &str) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-._~/".contains(&b);
    let part = |b: u8| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") };
    format!("urn:stictiond:site:{}", prefix.bytes().map(part).collect::<String>())
}
