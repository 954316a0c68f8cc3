//! Signals that a service gets besides the one that ends it.

use std::future::Future;

use sd_notify::NotifyState;
use tokio::signal::unix::{Signal, SignalKind, signal};

use super::engine_thread::notify_system;
use super::reload::Reload;

/// A file that reaches the limit of the system (`ulimit -f`) is an error of that file, not the end of the process.
pub fn survive_file_size_limit() {
    #[cfg(target_os = "linux")]
    if let Err(error) = signal(SignalKind::from_raw(rustix::process::Signal::XFSZ.as_raw())) {
        tracing::debug!(%error, "SIGXFSZ cannot be taken");
    }
}

/// SIGHUPs from now on: without this the first one would end the process.
#[must_use]
pub fn hangups() -> Option<Signal> {
    signal(SignalKind::hangup()).inspect_err(|error| tracing::warn!(%error, "SIGHUP cannot be watched")).ok()
}

/// Waits for `stop`; until then SIGHUP reads the configuration again and begins new recordings.
pub async fn serve_until(mut stop: impl Future<Output = ()> + Unpin, mut hangups: Option<Signal>, reload: &mut Reload) {
    loop {
        tokio::select! {
            () = &mut stop => return,
            () = next(&mut hangups) => {}
        }
        match NotifyState::monotonic_usec_now() {
            Ok(now) => notify_system(&[NotifyState::Reloading, now]),
            Err(error) => tracing::debug!(%error, "systemd cannot be notified"),
        }
        tokio::select! {
            () = &mut stop => return,
            () = reload.run() => {}
        }
        notify_system(&[NotifyState::Ready]);
    }
}

/// The next signal; never where it cannot be watched.
async fn next(signals: &mut Option<Signal>) {
    match signals {
        Some(signals) => {
            signals.recv().await;
        }
        None => std::future::pending().await,
    }
}
