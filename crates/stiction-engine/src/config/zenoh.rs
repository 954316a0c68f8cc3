//! `[zenoh]`: the bus.

use serde::Serialize;

use super::reader::TableReader;

/// `[zenoh]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Zenoh {
    /// Part that the daemon takes on the bus.
    pub mode: ZenohMode,
    /// Endpoints to listen on.
    pub listen: Vec<String>,
    /// Endpoints to connect to.
    pub connect: Vec<String>,
    /// Whether to look for peers by multicast.
    pub multicast: bool,
    /// Path of a full Zenoh configuration; keys set here override it.
    pub config_file: String,
}

/// Part of a program on a Zenoh bus.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ZenohMode {
    /// Links to every other program, and routes for clients.
    #[default]
    Peer,
    /// Links to one router or peer.
    Client,
}

impl ZenohMode {
    /// Its word in configurations.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Peer => "peer",
            Self::Client => "client",
        }
    }
}

/// Start of the endpoints that this build supports.
const PROTOCOLS: [&str; 3] = ["tcp/", "tls/", "unixsock-stream/"];

pub(super) fn read_zenoh(r: &mut TableReader<'_, '_>) -> Zenoh {
    let mode = r.choice("mode", &[ZenohMode::Peer, ZenohMode::Client].map(|mode| (mode.name(), mode)));
    let (listen, connect) = (r.texts("listen"), r.texts("connect"));
    for (key, endpoints) in [("listen", &listen), ("connect", &connect)] {
        for (endpoint, line) in endpoints.iter().filter(|(e, _)| !PROTOCOLS.iter().any(|p| e.starts_with(p))) {
            let remedy = "write tcp/HOST:PORT, tls/HOST:PORT or unixsock-stream/PATH";
            r.refuse(*line, key, format!("{endpoint:?} is not an endpoint"), remedy);
        }
    }
    let multicast = r.boolean("multicast", false);
    let config_file = r.text("config_file").map(|(t, _)| t).unwrap_or_default();
    if mode == ZenohMode::Client && connect.is_empty() && config_file.is_empty() {
        let line = r.line();
        r.refuse(line, "connect", "a client needs a router", "write connect = [\"tcp/HOST:7447\"], or mode = \"peer\"");
    }
    let [listen, connect] = [listen, connect].map(|l| l.into_iter().map(|(endpoint, _)| endpoint).collect());
    Zenoh { mode, listen, connect, multicast, config_file }
}
