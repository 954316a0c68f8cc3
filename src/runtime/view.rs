//! What a running daemon passes to its web server, so that the daemon does not depend on `web`.

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

/// The configuration in force, which a reload replaces. Clones share it.
#[derive(Debug, Clone)]
pub struct CurrentConfig(Arc<RwLock<Arc<Config>>>);

impl CurrentConfig {
    /// Starts with this configuration.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self(Arc::new(RwLock::new(Arc::new(config))))
    }

    /// The current configuration.
    #[must_use]
    pub fn get(&self) -> Arc<Config> {
        self.0.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Replaces it.
    pub fn set(&self, config: Arc<Config>) {
        *self.0.write().unwrap_or_else(PoisonError::into_inner) = config;
    }
}

/// The data to show, and access to the engine.
pub struct View {
    /// The configuration in force.
    pub config: CurrentConfig,
    /// The state of every loop; `None` if the page is switched off.
    pub overview: Option<Overview>,
    /// The last published documents.
    pub last: LastValues,
    /// Sends to the engine.
    pub control: Sender<Control>,
    /// The daemon's health.
    pub snapshot: HealthSnapshot,
    /// Where the server reports its faults.
    pub faults: Arc<Faults>,
    /// A note about the data, shown first.
    pub note: Option<&'static str>,
}

/// A running server.
pub struct Served {
    /// Its address; `None` if it is switched off, or cannot bind its address yet.
    pub address: Option<SocketAddr>,
    /// Ends it.
    pub stop: Box<dyn FnOnce() + Send>,
}

/// Starts a server for a view and the daemon's metrics.
pub type Serve = fn(View, Registry) -> Pin<Box<dyn Future<Output = anyhow::Result<Served>> + Send>>;
