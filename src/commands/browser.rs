//! Opens the page in the user's browser.

use std::net::{SocketAddr, TcpStream};
use std::process::{Command, Stdio};
use std::time::Duration;

/// Checks whether the page is up, and the pause between them.
const LOOKS: u32 = 50;
const PAUSE: Duration = Duration::from_millis(200);

/// Opens the page as soon as something listens there, without blocking.
pub(super) fn open_once_there(address: SocketAddr) {
    std::thread::spawn(move || {
        let there = (0..LOOKS).any(|_| {
            std::thread::sleep(PAUSE);
            TcpStream::connect_timeout(&address, PAUSE).is_ok()
        });
        if there {
            open(&format!("http://{address}/"));
        }
    });
}

/// Opens the page in a browser if there is a desktop; the address is printed in any case.
pub(super) fn open(url: &str) {
    let program = if cfg!(target_os = "macos") {
        "open"
    } else if ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some_and(|v| !v.is_empty())) {
        "xdg-open"
    } else {
        return;
    };
    let mut command = Command::new(program);
    command.arg(url).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    match command.spawn() {
        // Wait for the process, so that it does not remain a zombie.
        Ok(mut child) => drop(std::thread::spawn(move || child.wait())),
        Err(error) => tracing::info!("no browser could be opened ({program}: {error}); open the address yourself"),
    }
}
