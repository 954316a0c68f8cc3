//! Signals that a service gets besides the one that ends it.

use std::future::Future;
use std::time::Duration;

use crossbeam_channel::{Sender, TrySendError};
use sd_notify::NotifyState;
use tokio::signal::unix::{Signal, SignalKind, signal};

use super::core::tell_system;
use super::reload::Reload;
use crate::source::askers::Askers;
use stiction_runtime::control::Control;
use stiction_runtime::faults::Faults;

/// Pause before the engine's queue is tried again.
const AGAIN_AFTER: Duration = Duration::from_millis(20);

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
pub async fn serve_until(
    mut stop: impl Future<Output = ()> + Unpin,
    mut hangups: Option<Signal>,
    mut reload: Option<Reload>,
    (control, askers): (&Sender<Control>, &Askers),
    faults: &Faults,
) {
    loop {
        tokio::select! {
            () = &mut stop => return,
            () = next(&mut hangups) => {}
        }
        let Some(reload) = &mut reload else { continue };
        match NotifyState::monotonic_usec_now() {
            Ok(now) => tell_system(&[NotifyState::Reloading, now]),
            Err(error) => tracing::debug!(%error, "systemd cannot be told"),
        }
        if let Some(config) = reload.read(faults) {
            askers.limit(&config.commands);
            tokio::select! {
                () = &mut stop => return,
                () = hand_over(control, Control::Settings(Box::new(config))) => {}
            }
        }
        tell_system(&[NotifyState::Ready]);
    }
}

/// Waits until the engine's queue has taken a wish, or the engine is gone.
async fn hand_over(control: &Sender<Control>, mut wish: Control) {
    while let Err(TrySendError::Full(refused)) = control.try_send(wish) {
        wish = refused;
        tokio::time::sleep(AGAIN_AFTER).await;
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
