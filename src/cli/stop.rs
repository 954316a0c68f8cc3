//! Ctrl-C for commands that compute: the first one ends them after what is under way, the second at once.

use std::sync::atomic::{AtomicBool, Ordering};

static ASKED: AtomicBool = AtomicBool::new(false);

/// Exit code of a process that a second Ctrl-C ends, as shells know it.
const ENDED: i32 = 130;

/// Whether somebody asked the command to stop.
pub fn asked() -> bool {
    ASKED.load(Ordering::Relaxed)
}

/// Watches for SIGINT and SIGTERM from now on, on a separate thread.
pub fn watch() {
    std::thread::spawn(|| {
        let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else { return };
        runtime.block_on(async {
            while let Ok(asked) = super::asked_to_stop() {
                asked.await;
                if ASKED.swap(true, Ordering::Relaxed) {
                    std::process::exit(ENDED);
                }
                tracing::warn!("stopping after what is under way; once more ends at once");
            }
        });
    });
}
