//! `play` reports samples as published only once the receiver has them.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use zenoh::Wait;

use crate::live::{free_port, ok, sticking};

/// Longer than Zenoh waits at its end for a receiver that takes nothing.
const BUSY: Duration = Duration::from_secs(4);

#[test]
fn a_receiver_that_is_busy_for_seconds_has_all_samples_when_play_ends() {
    let dir = tempfile::tempdir().unwrap();
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let mut config = zenoh::Config::default();
    config.insert_json5("listen/endpoints", &format!("[{endpoint:?}]")).unwrap();
    config.insert_json5("scouting/multicast/enabled", "false").unwrap();
    let receiver = zenoh::open(config).wait().unwrap();
    let taken = Arc::new(AtomicUsize::new(0));
    let count = taken.clone();
    let take = move |_| {
        if count.fetch_add(1, Ordering::SeqCst) == 0 {
            // Block the thread that reads the socket, as on a very busy machine.
            std::thread::sleep(BUSY);
        }
    };
    let _samples = receiver.declare_subscriber("p/*/*").callback(take).wait().unwrap();
    let key = "p/@stiction/v1/@daemon/d/health";
    let reply = move |query: zenoh::query::Query| query.reply(key, "{}").wait().unwrap();
    let _health = receiver.declare_queryable(key).callback(reply).wait().unwrap();
    let said = ok(&["play", &sticking(dir.path()), "--connect", &endpoint, "--prefix", "p", "--speed", "max"]);
    assert!(said.contains("8000 of 8000"), "{said}");
    assert_eq!(taken.load(Ordering::SeqCst), 8000);
}
