//! Whether this build has TLS, on the bus and for webhooks.

use anyhow::ensure;

/// Fails if this build lacks the TLS that `by` needs.
///
/// # Errors
/// This build has none.
pub fn required(by: &str) -> anyhow::Result<()> {
    ensure!(
        cfg!(feature = "tls"),
        "{by}: this build has no TLS; packages have it, as has cargo build --release --features tls"
    );
    Ok(())
}
