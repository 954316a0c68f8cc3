//! Commands through a proxy: a plain TCP forwarder leaves nothing that distinguishes them from local ones, so only the token
//! and `behind_proxy` stop them.

use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use serde_json::Value;
use zenoh::Wait;

use crate::live::{Daemon, PREFIX, command_headers, free_port, http, request, skipped, wait_for};

const TOKEN: &str = "a-token-for-this-test";
/// The server's name in docs/page.md.
const NAME: &str = "stiction.plant1.example";
/// Every request that changes something, with a valid body.
const COMMANDS: [(&str, &str); 3] = [
    ("alarm", r#"{"cmd":"shelve","by":"mallory","why":"x","for_s":60}"#),
    ("gap", r#"{"by":"mallory"}"#),
    ("review", r#"{"label":"no_stiction","method":"other","by":"mallory"}"#),
];

/// Forwards bytes unchanged, like `socat` and TCP load balancers; returns the address to call.
fn forward(to: &str) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (address, to) = (listener.local_addr().unwrap().to_string(), to.to_owned());
    std::thread::spawn(move || {
        for near in listener.incoming() {
            let (near, far) = (near.unwrap(), TcpStream::connect(&to).unwrap());
            for (mut from, mut into) in [(near.try_clone().unwrap(), far.try_clone().unwrap()), (far, near)] {
                std::thread::spawn(move || {
                    let _ = std::io::copy(&mut from, &mut into);
                    let _ = into.shutdown(std::net::Shutdown::Write);
                });
            }
        }
    });
    address
}

/// A daemon with these keys of `[web]` and a loop A.
fn daemon(dir: &Path, web: &str) -> Daemon {
    let daemon = Daemon::start(dir, &format!("hosts = [{NAME:?}]\n{web}"));
    let bus = daemon.session();
    bus.put(format!("{PREFIX}/A/op"), "1").wait().unwrap();
    wait_for("the loop", || http(&daemon.web, "/api/v1/loops/A").contains("alarm_state").then_some(()));
    bus.close().wait().unwrap();
    daemon
}

fn token_file(dir: &Path) -> String {
    let path = dir.join("token");
    fs::write(&path, format!("{TOKEN}\n")).unwrap();
    format!("token_file = {path:?}\n")
}

/// The status of every command sent with these headers.
fn sent(stream: impl Fn() -> TcpStream, host: &str, more: &[(&str, &str)]) -> Vec<u16> {
    let send = |(what, body): &(&str, &str)| {
        request(stream(), &["POST", &format!("/api/v1/loops/A/{what}")], &command_headers(host, more), body).0
    };
    COMMANDS.iter().map(send).collect()
}

fn state_of_a(daemon: &Daemon) -> String {
    let row: Value = serde_json::from_str(&http(&daemon.web, "/api/v1/loops/A")).unwrap();
    row["row"]["alarm_state"].as_str().unwrap_or_else(|| panic!("{row}")).to_owned()
}

#[test]
fn through_a_plain_tcp_proxy_nobody_commands_without_the_token() {
    for (keys, with_token, refused) in
        [("", true, 401), ("behind_proxy = true\n", true, 401), ("behind_proxy = true\n", false, 403)]
    {
        let dir = tempfile::tempdir().unwrap();
        let token = if with_token { token_file(dir.path()) } else { String::new() };
        let daemon = daemon(dir.path(), &format!("{keys}{token}"));
        let proxy = forward(&daemon.web);
        let connect = || TcpStream::connect(&proxy).unwrap();
        let wrong = ("Authorization", "Bearer a-token-that-somebody-guessed");
        for host in [NAME, "localhost", &daemon.web] {
            for more in [&[][..], &[wrong], &[("X-Forwarded-For", "127.0.0.1")], &[("Via", "1.1 p")]] {
                assert_eq!(sent(connect, host, more), [refused; 3], "{keys} token {with_token}, {host}, {more:?}");
            }
        }
        // Loopback is not a way around it.
        assert_eq!(sent(|| TcpStream::connect(&daemon.web).unwrap(), "localhost", &[]), [refused; 3]);
        assert_eq!(state_of_a(&daemon), "normal");
        // Reading is open, as docs/page.md states.
        assert_eq!(request(connect(), &["GET", "/api/v1/loops"], &[("Host", NAME)], "").0, 200);
        if with_token {
            let bearer = format!("Bearer {TOKEN}");
            let command = format!("/api/v1/loops/A/{}", COMMANDS[0].0);
            let headers = command_headers(NAME, &[("Authorization", &bearer)]);
            let (status, body) = request(connect(), &["POST", &command], &headers, COMMANDS[0].1);
            assert_eq!(status, 200, "{body}");
            wait_for("the shelved alarm", || (state_of_a(&daemon) == "shelved").then_some(()));
        }
        daemon.stop();
    }
}

#[test]
fn without_a_token_a_proxy_that_says_so_and_a_foreign_name_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = daemon(dir.path(), "");
    let direct = || TcpStream::connect(&daemon.web).unwrap();
    assert_eq!(sent(direct, NAME, &[]), [403; 3]);
    for header in ["Forwarded", "Via", "X-Real-IP", "X-Forwarded-For", "X-Forwarded-Host", "X-Forwarded-Proto"] {
        assert_eq!(sent(direct, "localhost", &[(header, "x")]), [403; 3], "{header}");
    }
    assert_eq!(state_of_a(&daemon), "normal");
    // The log states who was refused what, at a limited rate.
    (0..100).for_each(|_| assert_eq!(sent(direct, NAME, &[]), [403; 3]));
    let log = daemon.logged();
    let refused: Vec<&str> = log.lines().filter(|line| line.contains("refused") && line.contains("403")).collect();
    assert!(refused.iter().any(|line| line.contains("/api/v1/loops/A/alarm") && line.contains("127.0.0.1")), "{log}");
    assert!((10..100).contains(&refused.len()), "{} lines of 321", refused.len());
    let (status, body) =
        request(direct(), &["POST", "/api/v1/loops/A/alarm"], &command_headers("localhost", &[]), COMMANDS[0].1);
    assert_eq!(status, 200, "{body}");
    daemon.stop();
}

#[test]
fn behind_a_proxy_the_unix_socket_takes_commands_of_whoever_may_open_it() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("web.sock");
    // A socket left by a killed daemon.
    drop(std::os::unix::net::UnixListener::bind(&path).unwrap());
    let daemon = daemon(dir.path(), &format!("behind_proxy = true\nsocket = {path:?}\n"));
    let mode = wait_for("the socket", || {
        UnixStream::connect(&path).ok()?;
        Some(fs::metadata(&path).unwrap().permissions().mode() & 0o777)
    });
    assert_eq!(mode, 0o660);
    let shelve = |more: &[(&str, &str)]| {
        let stream = UnixStream::connect(&path).unwrap();
        request(stream, &["POST", "/api/v1/loops/A/alarm"], &command_headers("localhost", more), COMMANDS[0].1)
    };
    assert_eq!(shelve(&[("X-Forwarded-For", "10.0.0.7")]).0, 403);
    let (status, body) = shelve(&[]);
    assert_eq!(status, 200, "{body}");
    daemon.stop();
}

#[test]
fn metrics_and_health_answer_under_known_names_alone() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = daemon(dir.path(), "");
    for path in ["/metrics", "/healthz", "/", "/api/v1/loops", "/api/v1/obstacles"] {
        for (host, wanted) in [(NAME, 200), ("localhost", 200), ("10.1.2.3:8080", 200), ("evil.example", 421)] {
            let stream = TcpStream::connect(&daemon.web).unwrap();
            assert_eq!(request(stream, &["GET", path], &[("Host", host)], "").0, wanted, "{path} as {host}");
        }
    }
    daemon.stop();
}

/// A running nginx, killed on drop.
struct Nginx(Child);

impl Drop for Nginx {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn nginx() -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = std::env::split_paths(&path).chain(["/usr/sbin".into(), "/usr/local/sbin".into()]);
    folders.map(|folder| folder.join("nginx")).find(|file| file.is_file())
}

/// The block in docs/page.md, for these addresses and without TLS, which needs certificates.
fn shown_block(listen: &str, daemon: &str) -> String {
    let docs = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/page.md")).unwrap();
    let block = docs.split("```nginx\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    assert!(block.contains("listen 443 ssl;") && block.contains("http://127.0.0.1:8080;"), "{block}");
    let lines = block.lines().filter(|line| !line.trim_start().starts_with("ssl_"));
    let block = lines.map(|line| format!("{line}\n")).collect::<String>();
    block.replace("listen 443 ssl;", &format!("listen {listen};")).replace("127.0.0.1:8080", daemon)
}

#[test]
fn through_the_nginx_of_the_docs_people_read_and_command_with_the_token_alone() {
    let Some(program) = nginx() else {
        return skipped("through_the_nginx_of_the_docs", "no nginx (apt-get install nginx)");
    };
    let dir = tempfile::tempdir().unwrap();
    let token = token_file(dir.path());
    let daemon = daemon(dir.path(), &format!("behind_proxy = true\n{token}"));
    let listen = format!("127.0.0.1:{}", free_port());
    let block = shown_block(&listen, &daemon.web);
    let conf = dir.path().join("nginx.conf");
    let folders: String = ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"]
        .map(|kind| format!("{kind}_temp_path {:?};\n", dir.path().join(kind)))
        .concat();
    let main = format!("daemon off;\npid {:?};\nevents {{}}\n", dir.path().join("nginx.pid"));
    fs::write(&conf, format!("{main}http {{\naccess_log off;\n{folders}{block}}}\n")).unwrap();
    let log = fs::File::create(dir.path().join("nginx.log")).unwrap();
    let arguments = [Path::new("-e"), Path::new("stderr"), Path::new("-p"), dir.path(), Path::new("-c"), &conf];
    let _nginx = Nginx(Command::new(program).args(arguments).stdout(Stdio::null()).stderr(log).spawn().unwrap());
    let connect = || TcpStream::connect(&listen).unwrap();
    wait_for("nginx", || TcpStream::connect(&listen).ok());
    assert_eq!(request(connect(), &["GET", "/api/v1/loops"], &[("Host", NAME)], "").0, 200);
    let origin = format!("https://{NAME}");
    assert_eq!(sent(connect, NAME, &[]), [401; 3]);
    assert_eq!(sent(connect, NAME, &[("Origin", &origin), ("Authorization", "Bearer wrong")]), [401; 3]);
    assert_eq!(state_of_a(&daemon), "normal");
    let bearer = format!("Bearer {TOKEN}");
    let headers = command_headers(NAME, &[("Origin", &origin), ("Authorization", &bearer)]);
    let (status, body) = request(connect(), &["POST", "/api/v1/loops/A/alarm"], &headers, COMMANDS[0].1);
    assert_eq!(status, 200, "{body}");
    // Events are forwarded as they come.
    let mut stream = connect();
    stream.set_read_timeout(Some(std::time::Duration::from_secs(30))).unwrap();
    write!(stream, "GET /api/v1/events HTTP/1.1\r\nHost: {NAME}\r\n\r\n").unwrap();
    let mut seen = Vec::new();
    while !String::from_utf8_lossy(&seen).contains("event: loops") {
        let mut part = [0; 4096];
        let length = stream.read(&mut part).unwrap();
        assert!(length > 0, "{}", String::from_utf8_lossy(&seen));
        seen.extend_from_slice(&part[..length]);
    }
    daemon.stop();
}
