"""An alarm as operators see it: a webhook, Prometheus with the shipped rules and board."""

import json
import os
import re
import shutil
import subprocess
import sys
import threading
import time
import urllib.parse
import urllib.request
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import zenoh

from daemon import PROGRAM, ROOT, Daemon, eventually, free_port, session
from documents import check_document
from plant import Loop

TOOLS = PROGRAM.parents[1] / "tools"
# Debian's packages, with libraries that a minimal system lacks.
MOSQUITTO = [
    "mosquitto", "mosquitto-clients", "libmosquitto1", "libcjson1", "libdlt2", "libwebsockets17", "libev4", "libwrap0",
    "libnsl2", "libtirpc3", "libuv1",
]
PROMETHEUS = ["prometheus"]
RULES = ["alerts.yml", "recording.yml"]
PREFIX = "plant1/area1"
START_NS = 1_546_300_800 * 10**9


def tool(name, packages):
    """A program: the system's, or unpacked from Debian's packages below the target folder; None if neither is available."""
    def found():
        places = [shutil.which(name), *(TOOLS / place / name for place in ("usr/bin", "usr/sbin"))]
        return next((str(p) for p in places if p and Path(p).exists() and works(p)), None)

    if not found() and shutil.which("apt-get") and shutil.which("dpkg"):
        fresh = TOOLS / "deb"
        fresh.mkdir(parents=True, exist_ok=True)
        try:
            subprocess.run(["apt-get", "download", *packages], cwd=fresh, check=True, capture_output=True, timeout=120)
            for package in fresh.glob("*.deb"):
                subprocess.run(["dpkg", "-x", package, TOOLS], check=True, capture_output=True, timeout=120)
        except (OSError, subprocess.SubprocessError):
            pass
        shutil.rmtree(fresh, ignore_errors=True)
    if not found():
        print(f"\nSKIPPED: {name} cannot be had (Debian's {packages[0]}): what needs it was not tried\n", flush=True)
    return found()


def works(program):
    """Whether it starts, since an unpacked one may lack a library."""
    done = subprocess.run([program, "--help"], capture_output=True, env=environment(), stdin=subprocess.DEVNULL)
    return done.returncode != 127


def environment():
    """Environment with the unpacked libraries."""
    libraries = [str(p) for p in TOOLS.glob("usr/lib/*") if p.is_dir()]
    return {**os.environ, "LD_LIBRARY_PATH": ":".join(libraries)}


class Hook:
    """A webhook that answers 503 twice, then takes everything."""

    def __init__(self):
        self.events, self.refused, hook = [], 0, self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_POST(self):  # noqa: N802, the library's name
                body = self.rfile.read(int(self.headers["content-length"]))
                hook.refused += 1
                code = 503 if hook.refused <= 2 else 202
                if code == 202:
                    hook.events.append((dict(self.headers), json.loads(body)))
                self.send_response(code)
                self.send_header("content-length", "0")
                self.end_headers()

            def log_message(self, *_):
                pass

        self.server = HTTPServer(("127.0.0.1", 0), Handler)
        self.port = self.server.server_port
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


def raise_alarm(bus, seed):
    """Sends a sticking loop, and waits for its alarm."""
    loop = Loop(fs=5.0, fd=2.0, seed=seed).run(1000)
    heard = []
    subscriber = bus.declare_subscriber(f"{PREFIX}/@stiction/v1/FIC101/alarm", lambda s: heard.append(json.loads(s.payload.to_string())))
    time.sleep(0.5)

    def sent_and_heard():
        # Sent again, since samples sent before the daemon's subscription has propagated are lost.
        for name, values in (("op", loop.op), ("pv", loop.pv)):
            rows = [{"t": START_NS + k * 10**9, "v": v} for k, v in enumerate(values)]
            bus.put(f"{PREFIX}/FIC101/{name}", json.dumps(rows), encoding=zenoh.Encoding.APPLICATION_JSON)
        end = time.monotonic() + 60
        while not heard and time.monotonic() < end:
            time.sleep(0.2)
        return heard

    eventually("an alarm", sent_and_heard, 400)
    subscriber.undeclare()
    check_document(heard[0])
    return heard[0]


def metrics_of(daemon, accept=None):
    request = urllib.request.Request(f"http://{daemon.web}/metrics", headers={"Accept": accept} if accept else {})
    with urllib.request.urlopen(request, timeout=5) as response:
        return response.read().decode(), response.headers["content-type"]


def board_queries():
    board = json.loads((ROOT / "config" / "grafana.json").read_text())
    queries = [target["expr"] for panel in board["panels"] for target in panel["targets"]]
    return [q.replace("$__rate_interval", "5m").replace("$loop", ".*") for q in queries]


def check_monitoring(daemon, folder, alarm):
    # The age of a loop's data first appears with the health document, some seconds after the start.
    eventually("health in /metrics", lambda: "stictiond_loop_data_age_seconds{" in metrics_of(daemon)[0], 60)
    text, kind = metrics_of(daemon, "text/plain")
    assert kind.startswith("text/plain"), kind
    assert metrics_of(daemon)[1].startswith("application/openmetrics-text")
    known = set(re.findall(r"^# TYPE (\S+) ", text, re.M))
    queries = board_queries()
    rules = "".join((ROOT / "config" / name).read_text() for name in RULES)
    # Families without a sample are not listed.
    unseen = {"stictiond_delivery_refused_total"}
    for name in set(re.findall(r"(?<![\w:])(?:stictiond|process)_[a-z_]+", " ".join(queries) + rules)):
        bare = re.sub(r"_bucket$", "", name)
        assert bare in known | unseen, f"{name} is in a query, and nowhere in /metrics"
    promtool, prometheus = tool("promtool", PROMETHEUS), tool("prometheus", PROMETHEUS)
    if not (promtool and prometheus):
        return
    done = subprocess.run([promtool, "check", "metrics"], input=text, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", ""), (done.stdout, done.stderr)
    checks = [["check", "rules", f"config/{name}"] for name in RULES]
    for arguments in (*checks, ["test", "rules", "config/alerts.test.yml"]):
        done = subprocess.run([promtool, *arguments], capture_output=True, text=True, cwd=ROOT)
        assert done.returncode == 0, done.stdout + done.stderr
    port, config = free_port(), Path(folder) / "prometheus.yml"
    files = json.dumps([f"{ROOT}/config/{name}" for name in RULES])
    config.write_text(
        f"global: {{scrape_interval: 1s, evaluation_interval: 1s}}\nrule_files: {files}\n"
        f"scrape_configs: [{{job_name: stictiond, static_configs: [{{targets: ['{daemon.web}']}}]}}]\n"
    )
    server = subprocess.Popen(
        [prometheus, f"--config.file={config}", f"--web.listen-address=127.0.0.1:{port}",
         f"--storage.tsdb.path={folder}/tsdb"], stderr=subprocess.DEVNULL,
    )

    def ask(path):
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/v1/{path}", timeout=5) as response:
                return json.load(response)["data"]
        except OSError:
            return None

    def firing():
        alerts = (ask("alerts") or {}).get("alerts", [])
        return next((a for a in alerts if a["labels"]["alertname"] == "ValveSticks"), None)

    try:
        alert = eventually("the Prometheus alert", firing, 60)
        assert alert["labels"]["loop"] == alarm["loop"] and alert["labels"]["equipment"] == alarm["equipment"], alert
        for query in queries:
            assert ask(f"query?query={urllib.parse.quote(query)}") is not None, f"not a query: {query}"
    finally:
        server.kill()
        server.wait()


def test_an_alarm_arrives_where_operators_look(folder):
    hook = Hook()
    try:
        check_delivery(folder, hook)
    finally:
        hook.server.shutdown()


def shown_alarm():
    """The document shown in docs/alarms.md."""
    page = (ROOT / "docs" / "alarms.md").read_text()
    return json.loads(re.search(r"```alarm\n(.*?)```", page, re.S).group(1))


def check_example(orders, alarm):
    """The consumer in the docs wrote one order for this alarm, although each post is sent twice."""
    row = eventually("a work order", lambda: orders.exists() and orders.read_text().splitlines(), 60)
    assert len(row) == 1 and json.loads(row[0])["id"] == alarm["event_id"], row
    assert alarm["what_to_do"] in json.loads(row[0])["long"], row


def check_delivery(folder, hook):
    port, example, orders = free_port(), free_port(), Path(folder) / "orders.jsonl"
    consumer = subprocess.Popen([sys.executable, ROOT / "examples" / "alarm_webhook.py", str(example), orders], stderr=subprocess.DEVNULL)
    try:
        check_receivers(folder, hook, port, example, orders)
    finally:
        consumer.kill()
        consumer.wait()


def check_receivers(folder, hook, port, example, orders):
    receivers = f"""
[window]
hop_s = 300
[alarm]
raise = [1, 1]
[[loop]]
name = "FIC101"
op_range = [0, 100]
area = "Area 1"
equipment = "FV-101"
[[deliver]]
name = "hook"
to = "http://127.0.0.1:{hook.port}/stiction"
[[deliver]]
name = "orders"
to = "http://127.0.0.1:{example}/"
[[deliver]]
name = "orders-again"
to = "http://127.0.0.1:{example}/"
"""
    with Daemon(folder, PREFIX, f'[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]', receivers) as daemon:
        bus = session("peer", connect=[f"tcp/127.0.0.1:{port}"])
        alarm = raise_alarm(bus, 1)
        headers, event = eventually("the webhook", lambda: hook.events, 60)[0]
        assert hook.refused >= 3 and event["data"] == alarm and event["id"] == alarm["event_id"], event
        assert event["specversion"] == "1.0" and event["type"] == alarm["schema"] and event["subject"] == "FIC101", event
        assert headers["content-type"].startswith("application/cloudevents+json"), headers
        check_example(orders, alarm)
        shown = shown_alarm()
        check_document(shown)
        assert set(shown) == set(alarm), set(shown) ^ set(alarm)
        eventually("no fault", lambda: daemon.healthz()["faults"] == [], 60)
        check_monitoring(daemon, folder, alarm)
        daemon.stop()


if __name__ == "__main__":
    tool("mosquitto", MOSQUITTO)
    tool("prometheus", PROMETHEUS)
