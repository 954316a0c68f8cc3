//! Ctrl-C for commands that compute: the first ends them after the current step, the second at once.

use std::sync::atomic::{AtomicBool, Ordering};

static ASKED: AtomicBool = AtomicBool::new(false);

/// Exit code after a second Ctrl-C, by the convention of shells.
const ENDED: i32 = 130;

/// Whether the user asked the command to stop.
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
