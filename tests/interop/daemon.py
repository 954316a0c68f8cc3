"""Runs the program under test, with helpers to observe it from outside."""

import json
import os
import re
import shlex
import signal
import socket
import subprocess
import threading
import time
import urllib.request
from pathlib import Path

import zenoh

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = Path(ROOT, os.environ.get("CARGO_TARGET_DIR", "target"), "debug", "stictiond")
BRIDGE = PROGRAM.with_name("stictiond-bridge")
SESSIONS = []


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def eventually(what, check, within=60.0):
    """Waits until `check` gives a true value, and returns it."""
    until = time.monotonic() + within
    while True:
        result = check()
        if result:
            return result
        if time.monotonic() > until:
            raise AssertionError(f"not within {within} s: {what}")
        time.sleep(0.05)


def typed(start, places):
    """The command of docs/connect.md with this start, without the program; `places` has the reader's replacements."""
    text = re.sub(r"\\\n\s*", "", (ROOT / "docs" / "connect.md").read_text())
    (line,) = (line.strip() for line in text.splitlines() if line.strip().startswith(start))
    words = shlex.split(line)[1:]
    assert set(places) <= set(words), set(places) - set(words)
    return [str(places.get(word, word)) for word in words]


def session(mode, connect=(), listen=()):
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps(list(connect)))
    config.insert_json5("listen/endpoints", json.dumps(list(listen)))
    opened = zenoh.open(config)
    SESSIONS.append(opened)
    return opened


def close_sessions():
    """Closes sessions that a test left open, which would keep Python from exiting."""
    while SESSIONS:
        bus = SESSIONS.pop()
        if not bus.is_closed():
            bus.close()


class Daemon:
    """`stictiond run` with a separate configuration, stopped in order at the end of a `with`."""

    def __init__(self, folder, prefix, zenoh_table, more=""):
        self.prefix = prefix
        self.recordings = Path(folder) / "recordings"
        self.web = f"127.0.0.1:{free_port()}"
        self.config = Path(folder) / "monitor.toml"
        self.config.write_text(
            f'[site]\nprefix = "{prefix}"\n{zenoh_table}\n[recording]\ndir = "{self.recordings}"\n'
            f'[web]\nlisten = "{self.web}"\n{more}\n'
        )
        self.log = []

    def __enter__(self):
        self.process = subprocess.Popen(
            [PROGRAM, "run", "--config", self.config, "--health-every-s", "1"], stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=ROOT,
            env={**os.environ, "RUST_LOG": os.environ.get("RUST_LOG", "info,zenoh=error")},
        )
        threading.Thread(target=lambda: self.log.extend(self.process.stderr), daemon=True).start()
        try:
            eventually("the web server", self.healthz)
        except AssertionError as error:
            self.__exit__(type(error))
            raise
        return self

    def __exit__(self, kind, *_):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        if kind is not None:
            print("".join(self.log[-30:]))

    def get(self, path):
        with urllib.request.urlopen(f"http://{self.web}{path}", timeout=5) as response:
            assert response.status == 200, response.status
            return response.read().decode()

    def healthz(self):
        assert self.process.poll() is None, "the daemon ended:\n" + "".join(self.log)
        try:
            return json.loads(self.get("/healthz"))
        except OSError:
            return None

    def stop(self):
        """Stops it in order, by SIGTERM."""
        self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(timeout=60)
        assert code == 0, f"exit {code}\n" + "".join(self.log)


def stictiond(*arguments, program=PROGRAM):
    """Runs a command to the end; returns exit code, stdout, stderr."""
    done = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, cwd=ROOT, timeout=300)
    return done.returncode, done.stdout, done.stderr


def stiction_lab(*arguments):
    """The same for `stiction-lab`."""
    return stictiond(*arguments, program=PROGRAM.with_name("stiction-lab"))
