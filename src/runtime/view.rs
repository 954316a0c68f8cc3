//! The server's view of a running daemon. The daemon starts the server through it and does not depend on `web`.

use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::{Arc, PoisonError, RwLock};

use crossbeam_channel::Sender;
use prometheus_client::registry::Registry;

use crate::runtime::control::Control;
use crate::runtime::faults::Faults;
use crate::runtime::health::HealthSnapshot;
use crate::runtime::last_values::LastValues;
use crate::runtime::overview::Overview;
use stiction_engine::config::Config;

/// The configuration in force, which a reload replaces. Copies are the same one.
#[derive(Debug, Clone)]
pub struct CurrentConfig(Arc<RwLock<Arc<Config>>>);

impl CurrentConfig {
    /// This configuration until another one is set.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self(Arc::new(RwLock::new(Arc::new(config))))
    }

    /// The configuration as it is now.
    #[must_use]
    pub fn get(&self) -> Arc<Config> {
        self.0.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Puts another one in its place.
    pub fn set(&self, config: Arc<Config>) {
        *self.0.write().unwrap_or_else(PoisonError::into_inner) = config;
    }
}

/// What there is to see, and the way to the engine.
pub struct View {
    /// The configuration in force.
    pub config: CurrentConfig,
    /// Every loop as it is now; `None` where the page is switched off.
    pub overview: Option<Overview>,
    /// Last documents as they were published.
    pub last: LastValues,
    /// The way to the engine.
    pub control: Sender<Control>,
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
