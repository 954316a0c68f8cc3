//! What a server shows of a running daemon. The daemon starts the server and does not know it.

use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::{Arc, RwLock};

use crossbeam_channel::Sender;
use prometheus_client::registry::Registry;

use crate::control::Control;
use crate::faults::Faults;
use crate::health::HealthSnapshot;
use crate::last_values::LastValues;
use crate::overview::Overview;
use stiction_monitor::config::{Commands, Config};

/// What there is to see, and the way to the engine.
pub struct View {
    /// The configuration.
    pub config: Arc<Config>,
    /// Every loop as it is now; `None` where the page is switched off.
    pub overview: Option<Overview>,
    /// Last documents as they were published.
    pub last: LastValues,
    /// The way to the engine.
    pub control: Sender<Control>,
    /// `[commands]` as it is now: a reload changes it.
    pub commands: Arc<RwLock<Commands>>,
    /// The daemon's health.
    pub snapshot: HealthSnapshot,
    /// Where a server says what is wrong with it.
    pub faults: Arc<Faults>,
    /// What to know of the data before anything else.
    pub note: Option<&'static str>,
}

/// A running server.
pub struct Served {
    /// Where it listens; `None` if it is switched off, or its address cannot be used yet.
    pub address: Option<SocketAddr>,
    /// Ends it.
    pub stop: Box<dyn FnOnce() + Send>,
}

/// What starts a server of a view and of the daemon's metrics.
pub type Serve = fn(View, Registry) -> Pin<Box<dyn Future<Output = anyhow::Result<Served>> + Send>>;
