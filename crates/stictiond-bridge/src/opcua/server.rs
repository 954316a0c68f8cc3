//! The server side: endpoint, security, trusted certificates, session events.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use clap::ValueEnum;
use futures_util::StreamExt;
use opcua::client::{
    Client, ClientBuilder, IdentityToken, Password, Session, SessionConnectMode, SessionPollResult,
    SubscriptionActivity,
};
use opcua::crypto::{CertificateStore, SecurityPolicy, X509};
use opcua::types::{EndpointDescription, MessageSecurityMode, StatusCode};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

use stictiond::cli::UsageError;
use stictiond::runtime::secrets::secret;

/// Time limit for a response from the server.
const ANSWER: Duration = Duration::from_secs(10);
/// Pause between connection attempts to a server that may still hold the session.
const PAUSE: Duration = Duration::from_secs(1);
/// Interval between keep-alive requests.
const KEEP_ALIVE: Duration = Duration::from_secs(5);
/// Unanswered keep-alives after which the connection counts as lost.
const KEEP_ALIVES: u64 = 3;
/// Longest array accepted: results of a request, notifications in a message.
const MAX_ARRAY: usize = 1_000_000;

/// Server options.
#[derive(Debug, clap::Args)]
pub struct ServerArgs {
    /// Server: opc.tcp://HOST[:PORT][/PATH].
    #[arg(long, value_parser = address)]
    pub from: String,
    /// Security mode of messages [default: encrypt if --cert-file is given, else none].
    #[arg(long, value_enum)]
    pub security: Option<Security>,
    /// Security policy for signing and encryption.
    #[arg(long, value_enum, default_value_t)]
    pub policy: Policy,
    /// User name at the server.
    #[arg(long, default_value = "", requires = "secret_file")]
    pub user: String,
    /// File with the password of --user.
    #[arg(long, default_value = "", value_name = "FILE", requires = "user")]
    pub secret_file: String,
    /// Client certificate (.der or .pem); must contain the URI of --application-uri.
    #[arg(long, value_name = "FILE", requires = "key_file")]
    pub cert_file: Option<PathBuf>,
    /// Private key of the client certificate (PEM).
    #[arg(long, value_name = "FILE", requires = "cert_file")]
    pub key_file: Option<PathBuf>,
    /// Trusted server certificates (.der, .pem): a file or a folder.
    #[arg(long, value_name = "FILE|FOLDER")]
    pub trust: Option<PathBuf>,
    /// Application URI, as in the client certificate.
    #[arg(long, default_value = "urn:stictiond:bridge", value_name = "URI")]
    pub application_uri: String,
}

/// `--security`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Security {
    /// Neither signed nor encrypted.
    None,
    /// Signed.
    Sign,
    /// Signed and encrypted.
    Encrypt,
}

/// `--policy`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Policy {
    /// Basic256Sha256.
    #[default]
    Basic256sha256,
    /// Aes128_Sha256_RsaOaep.
    Aes128sha256,
    /// Aes256_Sha256_RsaPss.
    Aes256sha256,
}

fn address(text: &str) -> Result<String, String> {
    let host = text.strip_prefix("opc.tcp://").is_some_and(|rest| !rest.is_empty() && !rest.starts_with(['/', ':']));
    let sound = host && !text.contains(char::is_whitespace);
    if sound { Ok(text.to_owned()) } else { Err("write the server as opc.tcp://HOST[:PORT][/PATH]".to_owned()) }
}

impl ServerArgs {
    fn security(&self) -> Security {
        let given = if self.cert_file.is_some() { Security::Encrypt } else { Security::None };
        self.security.unwrap_or(given)
    }

    /// How long the server is asked to keep a session without a connection, ms. The client library cannot resume a signed
    /// session: it signs with the new channel's nonce, not the session's. Keeping such sessions would only use up the server's limit.
    pub fn session_ms(&self) -> u32 {
        if self.security() == Security::None { 300_000 } else { 30_000 }
    }

    fn policy(&self) -> SecurityPolicy {
        match (self.security(), self.policy) {
            (Security::None, _) => SecurityPolicy::None,
            (_, Policy::Basic256sha256) => SecurityPolicy::Basic256Sha256,
            (_, Policy::Aes128sha256) => SecurityPolicy::Aes128Sha256RsaOaep,
            (_, Policy::Aes256sha256) => SecurityPolicy::Aes256Sha256RsaPss,
        }
    }

    /// Rejects invalid combinations of options.
    ///
    /// # Errors
    /// What is missing or cannot be read.
    pub fn check(&self) -> anyhow::Result<()> {
        secret(&self.secret_file)?;
        if self.security() == Security::None {
            if !self.user.is_empty() {
                tracing::warn!(
                    "--security none: the password may cross the network unencrypted; use --security encrypt"
                );
            }
            return Ok(());
        }
        let (Some(cert), Some(_), Some(trust)) = (&self.cert_file, &self.key_file, &self.trust) else {
            let why = "--security sign and encrypt need --cert-file, --key-file and --trust";
            return Err(UsageError(why.to_owned()).into());
        };
        let own = certificate(cert)?;
        if own.is_application_uri_valid(&self.application_uri).is_err() {
            bail!(
                "{} does not contain the URI {}; give the certificate's URI with --application-uri, or make a certificate with subjectAltName=URI:…",
                cert.display(),
                self.application_uri
            );
        }
        trusted(trust).map(drop)
    }

    fn identity(&self) -> anyhow::Result<IdentityToken> {
        Ok(match self.user.as_str() {
            "" => IdentityToken::Anonymous,
            user => IdentityToken::UserName(user.to_owned(), Password(secret(&self.secret_file)?.unwrap_or_default())),
        })
    }

    /// The requested endpoint, at the given address: a server's own name for itself may not resolve here.
    fn choose(&self, endpoints: Vec<EndpointDescription>) -> anyhow::Result<EndpointDescription> {
        let mode = match self.security() {
            Security::None => MessageSecurityMode::None,
            Security::Sign => MessageSecurityMode::Sign,
            Security::Encrypt => MessageSecurityMode::SignAndEncrypt,
        };
        let policy_of = |e: &EndpointDescription| SecurityPolicy::from_uri(e.security_policy_uri.as_ref());
        let offered: Vec<String> =
            endpoints.iter().map(|e| format!("{} {:?}", policy_of(e).to_str(), e.security_mode)).collect();
        let found = endpoints.into_iter().find(|e| e.security_mode == mode && policy_of(e) == self.policy());
        let mut endpoint = found.ok_or_else(|| {
            anyhow!("the server does not offer {} {mode:?}; it offers {}", self.policy().to_str(), offered.join(", "))
        })?;
        endpoint.endpoint_url = self.from.as_str().into();
        Ok(endpoint)
    }

    /// Rejects a certificate that is not trusted and says how to trust it.
    fn trust(&self, endpoint: &EndpointDescription, store: &Path) -> anyhow::Result<()> {
        let Some(place) = &self.trust else {
            bail!("--trust is missing: name the folder of trusted server certificates")
        };
        let shown = X509::from_byte_string(&endpoint.server_certificate)
            .map_err(|e| anyhow!("cannot read the server's certificate: {e}"))?;
        let bytes = shown.to_der().map_err(|e| anyhow!("cannot read the server's certificate: {e}"))?;
        if trusted(place)?.contains(&bytes) {
            // The client checks again in its own folder, and also checks dates, host and application.
            let path = store.join("trusted").join(CertificateStore::cert_file_name(&shown));
            return std::fs::write(&path, &bytes).with_context(|| path.display().to_string());
        }
        let print = shown.thumbprint().as_hex_string();
        let mut how = format!("put it into {}", place.display());
        if place.is_dir() {
            let kept = place.join("rejected").join(format!("{print}.der"));
            let written = std::fs::create_dir_all(place.join("rejected")).and_then(|()| std::fs::write(&kept, &bytes));
            if written.is_ok() {
                how = format!("move {} into {}", kept.display(), place.display());
            }
        }
        bail!(
            "the server's certificate is not trusted ({}, SHA-1 {print}); compare the fingerprint with the one at the server, then {how}",
            shown.subject_name()
        )
    }
}

fn certificate(path: &Path) -> anyhow::Result<X509> {
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    let read = if bytes.starts_with(b"-----") { X509::from_pem(&bytes) } else { X509::from_der(&bytes) };
    read.map_err(|e| anyhow!("{}: not a certificate: {e}", path.display()))
}

/// The trusted certificates, read for each connection so that a new file takes effect at once.
fn trusted(place: &Path) -> anyhow::Result<Vec<Vec<u8>>> {
    let mut paths = vec![place.to_owned()];
    if place.is_dir() {
        let entries = std::fs::read_dir(place).with_context(|| place.display().to_string())?;
        let is_one =
            |path: &PathBuf| path.extension().is_some_and(|e| ["der", "pem", "crt", "cer"].iter().any(|k| e == *k));
        paths = entries.flatten().map(|entry| entry.path()).filter(is_one).collect();
    }
    let der = |path: &PathBuf| certificate(path)?.to_der().map_err(|e| anyhow!("{}: {e}", path.display()));
    paths.iter().map(der).collect()
}

/// Session events.
#[derive(Debug)]
pub enum Event {
    /// A new session without subscriptions.
    New,
    /// The server has kept the session with its subscription and queue.
    Resumed,
    /// The connection is lost or could not be restored.
    Lost(String),
    /// The server has answered a publish request.
    Published,
    /// The server has no such subscription.
    NoSubscription,
    /// The session has ended.
    Ended(String),
}

/// A session and its event loop.
pub struct Link {
    /// For requests.
    pub session: Arc<Session>,
    task: tokio::task::JoinHandle<()>,
    _store: Store,
}

impl Link {
    /// Closes the session, also at the server.
    pub async fn close(&self, within: Duration) {
        let _ = tokio::time::timeout(within, self.session.disconnect()).await;
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// The certificate folder that the client library needs; holds server certificates only and is deleted with the session.
struct Store(PathBuf);

impl Store {
    fn new() -> anyhow::Result<Self> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        use std::os::unix::fs::DirBuilderExt;
        let name = format!("stictiond-opcua-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let path = std::env::temp_dir().join(name);
        // Left over from a process with the same id; a symbolic link is not followed.
        let _ = std::fs::remove_dir_all(&path);
        let mut builder = std::fs::DirBuilder::new();
        builder.mode(0o700).create(&path).with_context(|| path.display().to_string())?;
        let store = Self(path);
        builder.create(store.0.join("trusted")).with_context(|| store.0.display().to_string())?;
        Ok(store)
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Opens a session; its events arrive until it ends.
///
/// # Errors
/// No answer, no matching endpoint, or an untrusted certificate.
pub async fn open(args: &ServerArgs) -> anyhow::Result<(Link, UnboundedReceiver<Event>)> {
    let store = Store::new()?;
    let mut client = client(args, &store.0)?;
    let endpoints = tokio::time::timeout(ANSWER, client.get_server_endpoints_from_url(args.from.as_str())).await;
    let endpoints = endpoints.map_err(|_| anyhow!("no answer within {} s", ANSWER.as_secs()))?;
    let endpoint = args.choose(endpoints.map_err(|e| anyhow!("cannot connect: {}", e.status()))?)?;
    if args.security() != Security::None {
        args.trust(&endpoint, &store.0)?;
    }
    let (session, events) =
        client.connect_to_endpoint_directly(endpoint, args.identity()?).map_err(|e| anyhow!("{e}"))?;
    let (told, events_told) = unbounded_channel();
    let task = tokio::spawn(tell(events.enter(), told));
    Ok((Link { session, task, _store: store }, events_told))
}

fn client(args: &ServerArgs, store: &Path) -> anyhow::Result<Client> {
    let mut builder = ClientBuilder::new()
        .application_name("stictiond bridge")
        .application_uri(args.application_uri.clone())
        .product_uri("urn:stictiond")
        .session_name("stictiond bridge")
        .pki_dir(store)
        .trust_server_certs(false)
        .verify_server_certs(true)
        .session_retry_limit(-1)
        .session_retry_initial(PAUSE)
        .session_retry_max(PAUSE)
        .session_timeout(args.session_ms())
        .keep_alive_interval(KEEP_ALIVE)
        .max_failed_keep_alive_count(KEEP_ALIVES)
        .request_timeout(ANSWER)
        .max_array_length(MAX_ARRAY)
        .max_message_size(64 << 20)
        .max_chunk_count(0)
        .ignore_clock_skew(true)
        // The client's own resubscription gives no data after a restart of the server.
        .recreate_subscriptions(false);
    if let (Some(cert), Some(key)) = (&args.cert_file, &args.key_file) {
        // The client would resolve relative paths against the store.
        builder = builder.certificate_path(std::path::absolute(cert)?).private_key_path(std::path::absolute(key)?);
    }
    builder.client().map_err(|faults| anyhow!(faults.join("; ")))
}

async fn tell(
    events: impl futures_util::Stream<Item = Result<SessionPollResult, StatusCode>>,
    told: UnboundedSender<Event>,
) {
    let mut events = std::pin::pin!(events);
    loop {
        let event = match events.next().await {
            Some(Ok(SessionPollResult::Reconnected(SessionConnectMode::NewSession(_)))) => Event::New,
            Some(Ok(SessionPollResult::Reconnected(SessionConnectMode::ReactivatedSession(_)))) => Event::Resumed,
            Some(Ok(SessionPollResult::ConnectionLost(status) | SessionPollResult::ReconnectFailed(status))) => {
                Event::Lost(status.to_string())
            }
            Some(Ok(SessionPollResult::Subscription(SubscriptionActivity::Publish))) => Event::Published,
            Some(Ok(SessionPollResult::Subscription(SubscriptionActivity::PublishFailed(status)))) => match status {
                StatusCode::BadNoSubscription | StatusCode::BadSubscriptionIdInvalid => Event::NoSubscription,
                _ => continue,
            },
            Some(Ok(_)) => continue,
            Some(Err(status)) => Event::Ended(status.to_string()),
            None => Event::Ended("the session was closed".to_owned()),
        };
        let ended = matches!(event, Event::Ended(_));
        if told.send(event).is_err() || ended {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::address;

    #[test]
    fn addresses_are_those_of_servers() {
        assert_eq!(address("opc.tcp://plc:4840/a").as_deref(), Ok("opc.tcp://plc:4840/a"));
        assert!(
            ["plc:4840", "opc.tcp://", "opc.tcp:///x", "opc.tcp://a b", "https://a"]
                .iter()
                .all(|t| address(t).is_err())
        );
    }
}
