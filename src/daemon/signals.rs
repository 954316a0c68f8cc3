//! Signals to the service other than the one that stops it.

use std::future::Future;

use sd_notify::NotifyState;
use tokio::signal::unix::{Signal, SignalKind, signal};

use super::engine_thread::notify_system;
use super::reload::Reload;

/// Makes a file that reaches the system's size limit (`ulimit -f`) an error of that file instead of the end of the process.
pub fn survive_file_size_limit() {
    #[cfg(target_os = "linux")]
    if let Err(error) = signal(SignalKind::from_raw(rustix::process::Signal::XFSZ.as_raw())) {
        tracing::debug!(%error, "SIGXFSZ cannot be taken");
    }
}

/// A stream of SIGHUPs from now on. Without it the first SIGHUP would end the process.
#[must_use]
pub fn hangups() -> Option<Signal> {
    signal(SignalKind::hangup()).inspect_err(|error| tracing::warn!(%error, "SIGHUP cannot be watched")).ok()
}

/// Waits for `stop`. Until then, SIGHUP reloads the configuration and starts new recordings.
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

/// The next signal; pends for ever if signals cannot be watched.
async fn next(signals: &mut Option<Signal>) {
    match signals {
        Some(signals) => {
            signals.recv().await;
        }
        None => std::future::pending().await,
    }
}
