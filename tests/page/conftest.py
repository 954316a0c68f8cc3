"""Shared by the page tests: a browser that records every error, and daemons with a plant simulated in Python."""

import json
import os
import re
import subprocess
import threading
import time
from pathlib import Path

import pytest
import zenoh
from playwright.sync_api import expect, sync_playwright

from daemon import PROGRAM, ROOT, Daemon, close_sessions, eventually, free_port, session
from plant import Loop

NS = 10**9
PREFIX = "works/north"
TOKEN = "a-token-for-the-test-of-the-page"
SKIPPED = []
# Set by tests/run.sh --all: every width, scheme and name; otherwise one of each.
LONG = bool(os.environ.get("STICTIOND_LONG"))
# Machines that are busy with other tests are slow.
expect.set_options(timeout=30_000)
# The browser's error when the daemon is down.
AWAY = r"net::ERR_"
# Its error for a refusal that the page shows in words: no closed loop can be simulated.
REFUSED = r"422 .*/repair\)"
# Malicious names for loops.
HOSTILE = [
    "<img src=x onerror=alert(1)>",
    "\"quoted\" 'name' & more",
    "../../x",
    "\u202eesrever \u05d0\u05d1\u05d2",
    "N" * 200,
]


def skipped(why):
    """Reports skipped tests prominently at the end."""
    SKIPPED.append(why)


def pytest_terminal_summary(terminalreporter):
    for why in dict.fromkeys(SKIPPED):
        terminalreporter.write_line(f"!! SKIPPED: {why}")


@pytest.fixture(scope="session")
def chromium():
    with sync_playwright() as playwright:
        # Requests of the browser to its vendor are not those of the page.
        browser = playwright.chromium.launch(
            executable_path=os.environ["CHROMIUM"],
            args=["--no-sandbox", "--disable-background-networking", "--disable-component-update"],
        )
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def axe_source():
    path = Path(os.environ.get("AXE", ""))
    return path.read_text() if path.is_file() else None


@pytest.fixture
def open_page(chromium, axe_source):
    """Opens pages; at the end none may have logged an error or made a request to another host.

    `lossy` are errors that are allowed, such as [`AWAY`].
    """
    opened = []

    def opener(daemon, path="", lossy=None, **options):
        context = chromium.new_context(**{"viewport": {"width": 1400, "height": 900}, **options})
        context.set_default_timeout(30_000)
        if axe_source:
            context.add_init_script(axe_source)
        if token := getattr(daemon, "token", None):
            # As if the user had entered it before. A sandboxed frame has no storage.
            context.add_init_script(f"try {{ sessionStorage.setItem('stictiond.token', '{token}') }} catch {{}}")
        said = []

        def console(message):
            if message.type not in ("error", "warning"):
                return
            words = f"console {message.type}: {message.text} ({message.location.get('url', '')})"
            if not re.search(REFUSED, words) and not (lossy and re.search(lossy, words)):
                said.append(words)

        own = (f"http://{daemon.web}/", "data:", f"blob:http://{daemon.web}/")
        context.on("console", console)
        context.on("weberror", lambda error: said.append(f"script: {error.error}"))
        context.on("request", lambda r: r.url.startswith(own) or said.append(f"asked another host: {r.url}"))
        context.on("dialog", lambda dialog: (said.append(f"a script ran: {dialog.message}"), dialog.dismiss()))
        opened.append((context, said))
        page = context.new_page()
        page.goto(f"http://{daemon.web}/{path}")
        return page

    yield opener
    complaints = [complaint for _, said in opened for complaint in said]
    for context, _ in opened:
        context.close()
    assert not complaints, "\n".join(dict.fromkeys(complaints))


def api(daemon, path):
    return json.loads(daemon.get(f"/api/v1{path}"))


def loop_path(name):
    from urllib.parse import quote

    return f"/loops/{quote(name, safe='')}"


def put(bus, key, samples):
    """Publishes samples, and waits if a busy daemon has no room for them: a lost message would be a data gap."""
    patient = zenoh.CongestionControl.BLOCK
    bus.put(key, json.dumps(samples), encoding="application/json", congestion_control=patient)


class Plant:
    """Loops that Python simulates and publishes: their past at once, then a scan a second."""

    def __init__(self, bus, prefix, loops, past_s, future_s=900):
        self.bus, self.prefix, self.past_s = bus, prefix, past_s
        self.loops = {name: loop.run(past_s + future_s) for name, loop in loops.items()}
        self.start_s = int(time.time()) - past_s
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.live, daemon=True)

    def put(self, name, a, b, chunk=500):
        loop = self.loops[name]
        for signal, values in (("op", loop.op), ("pv", loop.pv)):
            for at in range(a, b, chunk):
                samples = [{"t": (self.start_s + k) * NS, "v": round(values[k], 4)} for k in range(at, min(b, at + chunk))]
                put(self.bus, f"{self.prefix}/{name}/{signal}", samples)

    def past(self):
        # In slices of time, as from a plant, so that the loops' clocks advance together.
        for at in range(0, self.past_s, 500):
            for name in self.loops:
                self.put(name, at, min(self.past_s, at + 500))

    def live(self):
        sent = self.past_s
        while not self.ended.wait(0.2):
            due = min(int(time.time()) - self.start_s, len(next(iter(self.loops.values())).op))
            if due > sent:
                for name in self.loops:
                    self.put(name, sent, due)
                sent = due


def bus_at(endpoint, prefix):
    """A session at a daemon that may not listen yet; returns once the daemon receives samples below the prefix."""

    def opened():
        try:
            return session("client", connect=[endpoint])
        except zenoh.ZError:
            return None

    bus = eventually(f"Zenoh at {endpoint}", opened, within=20)
    heard = bus.declare_publisher(f"{prefix}/first/op")
    eventually("that the daemon listens", lambda: heard.matching_status.matching, within=20)
    heard.undeclare()
    return bus


def zenoh_at(endpoint):
    return f'[zenoh]\nlisten = ["{endpoint}"]'


@pytest.fixture(scope="session")
def plant(tmp_path_factory):
    """A daemon that watches a sticking loop and loops with hostile names, with a past and live samples."""
    folder = tmp_path_factory.mktemp("plant")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    (folder / "token").write_text(f"{TOKEN}\n")
    more = (
        "[window]\nhop_s = 600\n[alarm]\nraise = [1, 1]\n[gap]\nbudget_evaluations = 1000\n"
        '[[loop]]\nname = "FIC101"\nop_range = [0, 100]\narea = "Area <b>1</b>"\nequipment = "FV-101"\n'
    )
    daemon = Daemon(folder, PREFIX, zenoh_at(endpoint), more)
    text = daemon.config.read_text()
    daemon.config.write_text(text.replace('[web]\nlisten = "127.0.0.1', f'[web]\ntoken_file = "{folder}/token"\nlisten = "0.0.0.0'))
    daemon.token = TOKEN
    with daemon:
        bus = bus_at(endpoint, PREFIX)
        loops = {name: Loop(fs=5.0, fd=3.0, seed=k + 1) for k, name in enumerate(["FIC101", *HOSTILE])}
        loops["TIC102"] = Loop(seed=9)
        daemon.plant = Plant(bus, PREFIX, loops, past_s=3000)
        daemon.plant.past()
        daemon.plant.thread.start()
        eventually("a window of every loop", lambda: windows_of_all(daemon, len(loops)), within=90)
        yield daemon
        daemon.plant.ended.set()
        close_sessions()


def windows_of_all(daemon, count):
    rows = api(daemon, "/loops")["loops"]
    return len(rows) == count and all(row["window_end_ms"] for row in rows)


class Demo:
    """`stictiond demo` in a separate folder."""

    def __init__(self, folder):
        self.log = folder / "log"
        with self.log.open("w") as log:
            self.process = subprocess.Popen(
                [PROGRAM, "demo", "--for", "900"], cwd=folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        self.started = time.monotonic()
        found = eventually("the demo's address", lambda: re.search(r"http://(127\.0\.0\.1:\d+)/", self.log.read_text()))
        self.web = found[1]
        eventually("the demo's page", self.answers)

    get = Daemon.get

    def answers(self):
        try:
            return self.get("/healthz")
        except OSError:
            return None


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    running = Demo(tmp_path_factory.mktemp("demo"))
    yield running
    running.process.terminate()
    assert running.process.wait(timeout=15) == 0, running.log.read_text()[-3000:]
