//! The shipped hardened configuration, with certificates generated here: what is allowed works, everything else is refused.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::live::{PREFIX, ask, free_port, plane, wait_for};
use zenoh::Wait;

/// Runs openssl to make certificates.
fn openssl(dir: &Path, arguments: &[&str]) {
    let out = Command::new("openssl").args(arguments).current_dir(dir).output();
    let out =
        out.unwrap_or_else(|e| panic!("this test makes its certificates with openssl, which must be installed: {e}"));
    assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
}

/// A certificate authority, and a certificate from it for each name.
fn certificates(dir: &Path, names: &[&str]) {
    let ec = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"];
    let ca = ["req", "-x509", "-days", "2", "-keyout", "ca.key", "-out", "ca.pem", "-subj", "/CN=authority"];
    openssl(dir, &[&ca[..1], &ec, &ca[1..]].concat());
    fs::write(dir.join("ext"), "subjectAltName=DNS:localhost,IP:127.0.0.1\n").unwrap();
    for name in names {
        let [key, csr, pem, subject] =
            [format!("{name}.key"), format!("{name}.csr"), format!("{name}.pem"), format!("/CN={name}")];
        openssl(dir, &[&["req"], &ec[..], &["-keyout", &key, "-out", &csr, "-subj", &subject]].concat());
        let sign = ["x509", "-req", "-days", "2", "-in", &csr, "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial"];
        openssl(dir, &[&sign[..], &["-extfile", "ext", "-out", &pem]].concat());
    }
}

/// A shipped Zenoh file with the paths of this test.
fn placed(dir: &Path, name: &str, port: u16) -> String {
    let text = fs::read_to_string(format!("config/{name}.json5")).unwrap();
    let here = dir.to_str().unwrap();
    text.replace("/etc/stictiond/tls", here)
        .replace("/etc/zenoh/tls", here)
        .replace("/etc/zenoh/users.txt", &format!("{here}/users.txt"))
        .replace("tls/0.0.0.0:7447", &format!("tls/127.0.0.1:{port}"))
        .replace("tls/router.plant:7447", &format!("tls/localhost:{port}"))
}

/// A session with a certificate of the authority for this name.
fn session(dir: &Path, name: &str, port: u16) -> zenoh::Session {
    let text = placed(dir, "hardened-daemon", port)
        .replace("user: \"stictiond\"", &format!("user: \"{name}\""))
        .replace("/stictiond.pem", &format!("/{name}.pem"))
        .replace("/stictiond.key", &format!("/{name}.key"));
    let path = dir.join(format!("{name}.json5"));
    fs::write(&path, text).unwrap();
    zenoh::open(zenoh::Config::from_file(&path).unwrap()).wait().unwrap()
}

#[test]
fn each_party_has_its_own_keys_and_a_forbidden_put_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (dir, port) = (dir.path(), free_port());
    let names = ["router", "stictiond", "gateway", "operator", "stranger"];
    certificates(dir, &names);
    let users: String = names.iter().map(|name| format!("{name}:change-me\n")).collect();
    fs::write(dir.join("users.txt"), users).unwrap();
    fs::write(dir.join("router.json5"), placed(dir, "hardened-router", port)).unwrap();
    let router = zenoh::open(zenoh::Config::from_file(dir.join("router.json5")).unwrap()).wait().unwrap();

    // The shipped configuration with the paths of this test.
    fs::write(dir.join("daemon.json5"), placed(dir, "hardened-daemon", port)).unwrap();
    let text = fs::read_to_string("config/hardened.toml").unwrap();
    let text = text
        .replace("config/hardened-daemon.json5", dir.join("daemon.json5").to_str().unwrap())
        .replace("127.0.0.1:8080", "127.0.0.1:0");
    let config = dir.join("daemon.toml");
    fs::write(&config, format!("{text}\n[recording]\ndir = {:?}\n", dir.join("rec").to_str().unwrap())).unwrap();
    let log = dir.join("log");
    let mut daemon = Command::new(env!("CARGO_BIN_EXE_stictiond"))
        .args(["run", "--config", config.to_str().unwrap()])
        .stderr(fs::File::create(&log).unwrap())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let said = || fs::read_to_string(&log).unwrap();
    wait_for("the daemon", || said().contains("watching").then_some(()));
    let web = said().split("web=\"").nth(1).unwrap().split('"').next().unwrap().to_owned();
    let samples = || {
        let text = crate::live::http(&web, "/metrics");
        text.lines().find_map(|l| l.strip_prefix("stictiond_samples_total ")).unwrap().parse::<u64>().unwrap()
    };

    // The gateway is heard. Samples sent before the daemon's subscription has propagated are not.
    let gateway = session(dir, "gateway", port);
    let op = format!("{PREFIX}/FIC101/op");
    wait_for("the gateway's samples", || {
        gateway.put(&op, "1").wait().unwrap();
        (samples() > 0).then_some(())
    });
    // A stranger with a certificate of the same authority is connected, but its messages are dropped on the way.
    let stranger = session(dir, "stranger", port);
    let heard = Arc::new(Mutex::new(Vec::new()));
    let operator = session(dir, "operator", port);
    let (taking, forged) = (heard.clone(), plane("FIC101/alarm"));
    let listening = operator
        .declare_subscriber(&forged)
        // A session's messages to itself bypass the router.
        .allowed_origin(zenoh::sample::Locality::Remote)
        .callback(move |s| taking.lock().unwrap().push(s.payload().to_bytes().to_vec()))
        .wait()
        .unwrap();
    let before = samples();
    for _ in 0..20 {
        stranger.put(&op, "2").wait().unwrap();
        operator.put(&op, "3").wait().unwrap();
        for party in [&stranger, &gateway, &operator] {
            party.put(&forged, "{}").wait().unwrap();
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(samples(), before, "only the gateway writes the plant's keys");
    // An allowed message after them gets through, so they were not merely slow.
    wait_for("one more", || {
        gateway.put(&op, "4").wait().unwrap();
        (samples() > before).then_some(())
    });
    assert!(heard.lock().unwrap().is_empty(), "nobody forges the daemon's documents");
    // Whoever may query may send commands: the daemon answers the operator; the stranger gets no answer.
    let command = plane("FIC101/alarm?cmd=ack;by=ann");
    let answered = wait_for("an answer", || ask(&operator, &command).err().filter(|e| e != "no answer"));
    assert!(answered.contains("nothing to acknowledge"), "{answered}");
    assert_eq!(ask(&stranger, &command).unwrap_err(), "no answer");
    assert_eq!(ask(&gateway, &command).unwrap_err(), "no answer");
    listening.undeclare().wait().unwrap();
    daemon.kill().unwrap();
    daemon.wait().unwrap();
    for party in [gateway, stranger, operator, router] {
        party.close().wait().unwrap();
    }
}
