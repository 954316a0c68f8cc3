//! Watches for a shortage of file descriptors: connections use them, and without free ones nothing is recorded and nobody can
//! connect.

use std::sync::Arc;
use std::time::Duration;

use crate::runtime::faults::Faults;

/// Interval between checks.
const EVERY: Duration = Duration::from_secs(2);
/// Fraction of the limit in use that is a fault, and how long it remains one.
const MANY: f64 = 0.8;
const SHOWN: Duration = Duration::from_secs(60);

/// Watches this process's descriptors for ever, on systems that report them.
pub async fn watch(faults: Arc<Faults>) {
    loop {
        tokio::time::sleep(EVERY).await;
        if let Some([open, limit]) = counts() {
            judge(open, limit, &faults);
        }
    }
}

/// Open descriptors, and their limit.
fn counts() -> Option<[u64; 2]> {
    #[cfg(target_os = "linux")]
    {
        let limit = rustix::process::getrlimit(rustix::process::Resource::Nofile).current?;
        let open = match std::fs::read_dir("/proc/self/fd") {
            Ok(entries) => entries.count() as u64,
            // Not even one was left for reading the list.
            Err(error) if error.raw_os_error() == Some(rustix::io::Errno::MFILE.raw_os_error()) => limit,
            Err(_) => return None,
        };
        Some([open, limit])
    }
    #[cfg(not(target_os = "linux"))]
    None
}

fn judge(open: u64, limit: u64, faults: &Faults) {
    if open as f64 >= MANY * limit as f64 {
        let remedy = "see who connects to its ports; LimitNOFILE of the unit raises the limit";
        let text = format!("{open} of {limit} file descriptors are in use: without any nothing is recorded; {remedy}");
        faults.raise_for("descriptors", text, SHOWN);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_fifths_of_the_descriptors_are_a_fault() {
        let faults = Faults::default();
        judge(3276, 4096, &faults);
        assert!(faults.list().is_empty());
        judge(3277, 4096, &faults);
        assert!(faults.list()[0].contains("3277 of 4096"), "{:?}", faults.list());
        if cfg!(target_os = "linux") {
            let [open, limit] = counts().unwrap();
            assert!(open > 2 && open < limit, "{open} of {limit}");
        }
    }
}
