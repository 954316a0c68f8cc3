//! `stictiond workbench` run as a program: uploads, jobs with the commands' numbers, cancellation, hostile requests.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::{Value, json};

use crate::live::wait_for;

const PROGRAM: &str = env!("CARGO_BIN_EXE_stictiond");
const BASE: &str = "/api/v1/workbench";

/// A workbench under test, killed on drop.
struct Bench {
    child: Child,
    address: String,
    /// Folder for its uploads.
    folder: tempfile::TempDir,
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

struct Answer {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Answer {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&self.body)))
    }

    fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }
}

impl Bench {
    fn start(arguments: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut child = Command::new(PROGRAM)
            .args(["workbench", "--no-open", "--format", "json"])
            .args(arguments)
            .env("TMPDIR", folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let told: Value = serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line:?}"));
        Self { child, address: told["address"].as_str().unwrap().to_owned(), folder }
    }

    /// One request on a separate connection; `head` are additional header lines.
    fn send(&self, method: &str, path: &str, head: &[&str], body: &[u8]) -> Answer {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(120))).unwrap();
        let lines = head.iter().map(|line| format!("{line}\r\n")).collect::<String>();
        let host = if head.iter().any(|l| l.starts_with("Host:")) {
            String::new()
        } else {
            format!("Host: {}\r\n", self.address)
        };
        let length = if head.iter().any(|l| l.starts_with("Content-Length")) {
            String::new()
        } else {
            format!("Content-Length: {}\r\n", body.len())
        };
        let start = format!("{method} {path} HTTP/1.1\r\n{host}Connection: close\r\n{length}{lines}\r\n");
        stream.write_all(start.as_bytes()).unwrap();
        // A server that refuses at once may close before everything is sent.
        let _ = stream.write_all(body);
        read(stream)
    }

    fn get(&self, path: &str) -> Answer {
        self.send("GET", path, &[], b"")
    }

    fn own(&self, method: &str, path: &str, body: &[u8]) -> Answer {
        self.send(method, path, &["X-Stictiond: 1"], body)
    }

    fn upload(&self, name: &str, bytes: &[u8]) -> Value {
        let answer = self.own("POST", &format!("{BASE}/files?name={name}"), bytes);
        assert_eq!(answer.status, 200, "{}", answer.text());
        answer.json()
    }

    fn order(&self, request: &Value) -> String {
        let answer = self.own("POST", &format!("{BASE}/jobs"), request.to_string().as_bytes());
        assert_eq!(answer.status, 200, "{}", answer.text());
        answer.json()["id"].as_str().unwrap().to_owned()
    }

    fn job(&self, id: &str) -> Value {
        self.get(&format!("{BASE}/jobs/{id}")).json()
    }

    fn done(&self, id: &str) -> Value {
        wait_for("the job", || {
            let job = self.job(id);
            (!["queued", "running"].contains(&job["state"].as_str().unwrap())).then_some(job)
        })
    }
}

fn read(mut stream: TcpStream) -> Answer {
    let mut all = Vec::new();
    let _ = stream.read_to_end(&mut all);
    let split = all.windows(4).position(|four| four == b"\r\n\r\n").unwrap_or(all.len());
    let head = String::from_utf8_lossy(&all[..split]).to_lowercase();
    let status = head.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or(0);
    let rest = all.get(split + 4..).unwrap_or_default();
    let body = if head.contains("transfer-encoding: chunked") { unchunked(rest) } else { rest.to_vec() };
    Answer { status, head, body }
}

fn unchunked(mut rest: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    while let Some(end) = rest.windows(2).position(|two| two == b"\r\n") {
        let length = usize::from_str_radix(std::str::from_utf8(&rest[..end]).unwrap(), 16).unwrap();
        body.extend_from_slice(&rest[end + 2..end + 2 + length]);
        rest = &rest[(end + 4 + length).min(rest.len())..];
    }
    body
}

/// A document without its times.
fn timeless(mut document: Value) -> Value {
    if let Some(fields) = document.as_object_mut() {
        fields.remove("elapsed_ms");
        if let Some(solver) = fields.get_mut("solver").and_then(Value::as_object_mut) {
            solver.remove("elapsed_ms");
        }
    }
    document
}

/// Runs a job's command lines with `extra` appended; returns the documents.
fn pasted(job: &Value, folder: &Path, extra: &str) -> Vec<Value> {
    let mut documents = Vec::new();
    for line in job["command"].as_str().unwrap().lines() {
        let command = line.replacen("stictiond", PROGRAM, 1);
        let out = Command::new("sh")
            .arg("-c")
            .arg(format!("{command} --format json {extra}"))
            .current_dir(folder)
            .output()
            .unwrap();
        assert!(out.status.success(), "{line}: {}", String::from_utf8_lossy(&out.stderr));
        let text = String::from_utf8(out.stdout).unwrap();
        documents.extend(text.lines().map(|line| timeless(serde_json::from_str(line).unwrap())));
    }
    documents
}

fn documents(job: &Value) -> Vec<Value> {
    let results = job["results"].as_array().unwrap();
    results.iter().map(|result| timeless(result["document"].clone())).collect()
}

/// Checks that the preview shows the data that the run analysed.
fn previewed(bench: &Bench, request: &Value, job: &Value) {
    let answer = bench.own("POST", &format!("{BASE}/preview"), request.to_string().as_bytes());
    assert_eq!(answer.status, 200, "{}", answer.text());
    let sections = answer.json()["sections"].as_array().unwrap().clone();
    let results = job["results"].as_array().unwrap();
    let runs = results.len() / sections.len();
    for (shown, result) in sections.iter().zip(results.iter().step_by(runs)) {
        let document = &result["document"];
        assert_eq!((&shown["section"], &shown["s0"]), (&result["section"], &document["s0"]));
        let points = if document["selection"]["downsample"].is_null() {
            &shown["before"]["count"]
        } else {
            &document["selection"]["downsample"]["points"]
        };
        assert_eq!(&shown["after"]["count"], points, "{shown}");
        assert_eq!(shown["after"]["op"].as_array().unwrap().len(), shown["after"]["t_ms"].as_array().unwrap().len());
        let map = &result["maps"][0];
        let [low, high, best] = [&map["fs"][0], &map["fs"][1], &map["least"][0]].map(|v| v.as_f64().unwrap());
        assert!(low <= best && best <= high && map["s0"].as_f64().unwrap() >= best, "{map}");
    }
}

/// A table from the shipped recording, in a separate folder.
fn table(name: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    let out = Command::new(PROGRAM).args(["convert", "recordings/sticking.mcap"]).arg(&path).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    (folder, path)
}

#[test]
fn a_jobs_numbers_report_and_text_are_those_of_the_command_it_tells() {
    let bench = Bench::start(&[]);
    let (folder, path) = table("my loop.csv");
    let file = bench.upload("my%20loop.csv", &fs::read(&path).unwrap());
    assert_eq!((file["name"].as_str(), file["loops"][0]["name"].as_str()), (Some("my loop.csv"), Some("my_loop")));
    let one = json!({"kind": "analyze", "file": file["id"], "loop": "my_loop", "samples": [[1, 500], [300, 800]],
        "model": "both", "valve": "he", "delay": "2.5", "solver": "contour", "evaluations": 300, "fineness": 6.0,
        "seed": 7, "op_range": [0.0, 100.0], "prevalence": 0.1, "detrend": "linear"});
    let two = json!({"kind": "analyze", "file": file["id"], "loop": "my_loop", "downsample": 2.5, "like_toolbox": true, "delay": "3s"});
    for request in [one, two] {
        let job = bench.done(&bench.order(&request));
        assert_eq!(job["state"], "done", "{job}");
        let runs = if request["model"] == "both" { 2 } else { 1 };
        let (found, wanted) = (documents(&job), pasted(&job, folder.path(), ""));
        // The job is ordered by sections, the commands by models.
        let sections = found.len() / runs;
        assert_eq!((wanted.len(), sections), (found.len(), request["samples"].as_array().map_or(1, Vec::len)));
        for (k, document) in found.iter().enumerate() {
            assert_eq!(document, &wanted[(k % runs) * sections + k / runs], "{k}");
        }
        assert!(found[0]["s"].is_number(), "{}", found[0]);
        previewed(&bench, &request, &job);
        let result = &job["results"][0];
        assert!(
            result["text"].as_str().unwrap().contains("my_loop: ") && result["words"].as_array().unwrap().len() > 2
        );
        let titles: Vec<&str> =
            result["pictures"].as_array().unwrap().iter().map(|p| p["title"].as_str().unwrap()).collect();
        assert!(titles.contains(&"Trends"), "{titles:?}");
        for order in [1, 2] {
            let is_map =
                |title: &&str| title.starts_with("Error map, ") && title.ends_with(&format!("law, order {order}"));
            assert!(titles.iter().any(is_map), "{titles:?}");
        }
        let picture = bench.get(result["pictures"][1]["url"].as_str().unwrap());
        assert!(
            picture.head.contains("image/svg+xml") && picture.text().starts_with("<svg xmlns="),
            "{}",
            picture.head
        );
    }
    // The page that `--report` writes, except for the command and the time.
    let job = bench
        .done(&bench.order(&json!({"kind": "analyze", "file": file["id"], "loop": "my_loop", "samples": [[1, 400]]})));
    pasted(&job, folder.path(), "--report page.html");
    let between = |text: &str, from: &str, to: &str| -> String {
        let start = text.find(from).unwrap() + from.len();
        let end = start + text[start..].find(to).unwrap();
        format!("{}{}", &text[..start], &text[end..])
    };
    let bare =
        |text: String| between(&between(&text, "<pre><code>", "</code></pre>"), "<th>elapsed_ms</th><td>", "</td>");
    let report = bench.get(job["results"][0]["report_url"].as_str().unwrap());
    assert!(report.head.contains("sandbox"), "{}", report.head);
    assert_eq!(bare(report.text()), bare(fs::read_to_string(folder.path().join("page.html")).unwrap()));
}

#[test]
fn a_diagnosis_is_that_of_the_command_and_an_estimate_can_be_its_base() {
    let bench = Bench::start(&["recordings/sticking.mcap"]);
    let files = bench.get(&format!("{BASE}/files")).json();
    let file = &files["files"][0];
    assert_eq!((file["uploaded"].as_bool(), file["loops"][0]["name"].as_str()), (Some(false), Some("FIC101")));
    let order = |extra: &Value| {
        let mut request = json!({"kind": "gap", "file": file["id"], "loop": "FIC101", "samples": [[1, 600]]});
        extra.as_object().unwrap().iter().for_each(|(key, value)| request[key] = value.clone());
        bench.done(&bench.order(&request))
    };
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let job = order(&json!({"base": "linear", "without": ["extra_lag"], "seed": 3, "detrend": "mean"}));
    assert_eq!(job["state"], "done", "{job}");
    assert_eq!(documents(&job), pasted(&job, here, ""));
    let folder = tempfile::tempdir().unwrap();
    let rows = folder.path().join("rows.csv");
    pasted(&job, here, &format!("--predictions {}", rows.display()));
    let url = job["results"][0]["predictions_url"].as_str().unwrap().to_owned();
    assert_eq!(bench.get(&url.replace("predictions?", "predictions.csv?")).text(), fs::read_to_string(rows).unwrap());
    let drawn = bench.get(&format!("{url}&points=200")).json();
    assert!(
        drawn["t_ms"].as_array().unwrap().len() <= 220
            && drawn["pv_after"].as_array().unwrap().iter().any(Value::is_number)
    );
    // An estimate from another run, as the base model of the gap.
    let estimate = bench.done(&bench.order(&json!({"kind": "analyze", "file": file["id"], "loop": "FIC101"})));
    let job = order(&json!({"base": estimate["results"][0]["document"]}));
    assert!(job["results"][0]["document"]["given"].is_object(), "{job}");
    assert!(job["command"].as_str().unwrap().contains("--base base.json"));
}

#[test]
fn what_is_cancelled_ends_and_leaves_room() {
    let bench = Bench::start(&["recordings/sticking.mcap"]);
    let long =
        json!({"kind": "analyze", "file": "f1", "loop": "FIC101", "solver": "random", "evaluations": 10_000_000});
    let running = bench.order(&long);
    wait_for("its solver", || {
        bench.job(&running)["progress"]["words"].as_str().filter(|words| words.contains("solver random: ")).map(drop)
    });
    // More jobs than may wait.
    let mut last = 0;
    for _ in 0..20 {
        last = bench.own("POST", &format!("{BASE}/jobs"), long.to_string().as_bytes()).status;
    }
    assert_eq!(last, 429);
    for job in bench.get(&format!("{BASE}/jobs")).json()["jobs"].as_array().unwrap() {
        let path = format!("{BASE}/jobs/{}", job["id"].as_str().unwrap());
        assert_eq!(bench.own("DELETE", &path, b"").json()["state"], "cancelled");
        assert_eq!(bench.get(&path).json()["state"], "cancelled");
    }
    // Its thread is free again: a short job is done long before ten million models are.
    let short =
        bench.done(&bench.order(&json!({"kind": "gap", "file": "f1", "loop": "FIC101", "samples": [[1, 300]]})));
    assert_eq!(short["state"], "done", "{short}");
    // Its stream reports its state and ends.
    let events = bench.get(&format!("{BASE}/jobs/{running}/events")).text();
    assert!(events.contains("event: job") && events.contains("\"state\":\"cancelled\""), "{events}");
    // A finished job can be deleted.
    assert_eq!(bench.own("DELETE", &format!("{BASE}/jobs/{running}"), b"").status, 200);
    assert_eq!(bench.get(&format!("{BASE}/jobs/{running}")).status, 404);
}

#[test]
fn hostile_names_paths_and_bodies_are_refused_and_leave_nothing() {
    let mut bench = Bench::start(&[]);
    let rows: String = (0..200).map(|k| format!("{k},{},{}\n", (k / 20) % 2, (k / 25) % 2)).collect();
    let table = format!("t,op,pv\n{rows}");
    let file = bench.upload("..%2F..%2F..%2Fetc%2Fevil%0a.csv", table.as_bytes());
    assert_eq!(file["name"], "evil.csv");
    let inside: Vec<PathBuf> = fs::read_dir(bench.folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(inside.len(), 1, "{inside:?}");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        assert_eq!(fs::metadata(&inside[0]).unwrap().permissions().mode() & 0o777, 0o700);
    }
    let kept: Vec<_> = fs::read_dir(&inside[0]).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(kept, ["1"], "uploads are called by numbers");
    for path in [
        "/../../../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/api/v1/workbench/files/..%2F..%2Fetc%2Fpasswd/record?loop=x",
        "/api/v1/workbench/files/f1/record?loop=..%2F..%2Fetc%2Fpasswd",
        "/api/v1/workbench/jobs/..%2f/report",
        "/api/v1/workbench/jobs/j1/pictures/..%2F..%2Fx",
    ] {
        let answer = bench.get(path);
        assert_eq!(answer.status, 404, "{path}: {}", answer.text());
        assert!(!answer.text().contains("root:"));
    }
    let status = |method: &str, path: &str, head: &[&str], body: &[u8]| {
        let answer = bench.send(method, &format!("{BASE}{path}"), head, body);
        assert!(answer.head.contains("content-security-policy"), "{}", answer.head);
        (answer.status, answer.text())
    };
    let own = "X-Stictiond: 1";
    assert_eq!(status("POST", "/files?name=a.csv", &[], table.as_bytes()).0, 403);
    assert_eq!(status("POST", "/files?name=a.csv", &[own, "Origin: http://evil.example"], table.as_bytes()).0, 403);
    assert_eq!(status("GET", "/files", &["Host: evil.example"], b"").0, 421);
    assert_eq!(status("DELETE", "/files/f1", &[], b"").0, 403);
    for (query, part) in
        [("", "?name="), ("?name=a.csv&shell=rm", "is not an option"), ("?name=a.csv&decimal=dot", "decimal")]
    {
        let (code, text) = status("POST", &format!("/files{query}"), &[own], table.as_bytes());
        assert!(code == 422 && text.contains(part), "{query}: {code} {text}");
    }
    let (code, text) =
        status("POST", "/files?name=notes.csv", &[own], b"Dear all,\nplease find attached nothing at all.\n");
    assert!(
        code == 422 && text.contains("notes.csv") && !text.contains(bench.folder.path().to_str().unwrap()),
        "{text}"
    );
    // A stated size that is too large is refused before the data come.
    let (code, text) = status("POST", "/files?name=big.csv", &[own, "Content-Length: 300000000"], b"t,op,pv\n");
    assert!(code == 413 && text.contains("256 MiB"), "{code} {text}");
    // A user's own solver program is not available here, and nothing is guessed.
    for (field, value) in [
        ("solver", json!("cmd:touch /tmp/x")),
        ("valve", json!("hee")),
        ("samples", json!([[0, 50]])),
        ("speed", json!(1)),
        ("without", json!(["magic"])),
        ("downsample", json!(0.5)),
        ("base", json!("other.json")),
    ] {
        let mut request = json!({"kind": "analyze", "file": "f1", "loop": "evil"});
        request[field] = value.clone();
        let (code, text) = status("POST", "/jobs", &[own], request.to_string().as_bytes());
        // An invalid value is reported by field or by the value.
        let named = text.contains(field) || value.as_str().is_some_and(|word| text.contains(word));
        assert!(code == 422 && named, "{field}: {code} {text}");
    }
    assert_eq!(status("POST", "/jobs", &[own], &vec![b' '; 3 << 20]).0, 413);
    // A body that trickles is cut off.
    let mut slow = TcpStream::connect(&bench.address).unwrap();
    slow.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    let head = format!(
        "POST {BASE}/files?name=slow.csv HTTP/1.1\r\nHost: {}\r\n{own}\r\nContent-Length: 1000\r\n\r\nt,op",
        bench.address
    );
    slow.write_all(head.as_bytes()).unwrap();
    let mut line = String::new();
    BufReader::new(slow).read_line(&mut line).unwrap();
    assert!(line.contains(" 408 "), "{line:?}");
    assert_eq!(fs::read_dir(&inside[0]).unwrap().count(), 1, "what was refused is gone");
    // Ctrl-C stops it in order and deletes the uploads.
    let pid = bench.child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
    assert_eq!(bench.child.wait().unwrap().code(), Some(0));
    assert_eq!(fs::read_dir(bench.folder.path()).unwrap().count(), 0);
}

#[test]
fn the_trend_keeps_extremes_and_numbers_samples_as_sections_count_them() {
    let bench = Bench::start(&[]);
    let spike = |k: usize| if k == 12_345 { 99.0 } else { (k % 50) as f64 };
    let rows: String = (0..20_000).map(|k| format!("{k},{},{}\n", spike(k), k % 60)).collect();
    let file = bench.upload("wave.csv", format!("t,op,pv\n{rows}").as_bytes());
    assert_eq!((file["loops"][0]["samples"].as_u64(), file["loops"][0]["ts_s"].as_f64()), (Some(20_000), Some(1.0)));
    let record = |query: &str| bench.get(&format!("{BASE}/files/f1/record?loop=wave{query}")).json();
    let whole = record("&points=300");
    let op: Vec<f64> = whole["op"].as_array().unwrap().iter().filter_map(Value::as_f64).collect();
    assert!(op.len() <= 310 && op.contains(&99.0), "{}", op.len());
    let part = record("&from_ms=1000000&to_ms=1999000&points=5000");
    assert_eq!((part["range"].clone(), part["index"][0].clone()), (json!([1001, 2000]), json!(1001)));
    let refused = bench.get(&format!("{BASE}/files/f1/record?loop=wave&from_ms=x"));
    assert!(refused.status == 422 && refused.json()["error"].is_string(), "{}", refused.text());
    // The page itself, and what it may load.
    let page = bench.get("/");
    assert!(page.status == 200 && page.text().contains("<!doctype html>") && page.head.contains("default-src 'self'"));
    let site = bench.get("/api/v1/site").json();
    assert_eq!((site["kind"].as_str(), site["workbench"].as_bool()), (Some("workbench"), Some(true)));
    let options = bench.get(&format!("{BASE}/options")).json();
    assert!(options["effects"].as_array().unwrap().len() > 20 && options["solvers"].as_array().unwrap().len() == 5);
}

#[cfg(target_os = "linux")]
#[test]
fn a_file_that_needs_more_memory_than_is_allowed_ends_the_program() {
    use std::os::unix::process::ExitStatusExt;
    let mut bench = Bench::start(&["--max-memory", "128"]);
    bench.upload("small.csv", b"t,op,pv\n0,1,2\n1,2,3\n2,3,4\n");
    let rows: String = (0..3_000_000).map(|k| format!("{k},{},{}\n", k % 97, k % 89)).collect();
    let head = format!("POST {BASE}/files?name=large.csv HTTP/1.1\r\nHost: {}\r\nX-Stictiond: 1\r\n", bench.address);
    let mut stream = TcpStream::connect(&bench.address).unwrap();
    let table = format!("t,op,pv\n{rows}");
    write!(stream, "{head}Content-Length: {}\r\n\r\n{table}", table.len()).unwrap();
    let mut answer = String::new();
    // The program ends without a response.
    let _ = stream.read_to_string(&mut answer);
    assert_eq!((answer.as_str(), bench.child.wait().unwrap().signal()), ("", Some(6)));
}
