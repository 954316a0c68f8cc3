"""`demo` and `top` on a terminal of their own: what they show, and that they give it back as it was."""

import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import termios
import time

import pyte

from daemon import PROGRAM, ROOT, Daemon, free_port, stictiond

ENTER, LEAVE, SHOW = b"\x1b[?1049h", b"\x1b[?1049l", b"\x1b[?25h"


class Terminal:
    """A program on a pseudo terminal of 100 columns."""

    def __init__(self, *arguments, cwd=ROOT, rows=30, columns=100):
        self.ours, self.its = pty.openpty()
        fcntl.ioctl(self.its, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        self.before = termios.tcgetattr(self.its)
        self.told = b""
        # What a person would see: only cells that change are written again.
        self.screen = pyte.Screen(columns, rows)
        self.emulator = pyte.ByteStream(self.screen)
        self.process = subprocess.Popen(
            [PROGRAM, *map(str, arguments)], stdin=self.its, stdout=self.its, stderr=self.its, cwd=cwd,
            env={**os.environ, "TERM": "xterm-256color", "LC_ALL": "C.UTF-8"}, start_new_session=True,
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self.ours)
        os.close(self.its)

    def read(self, wait=0.1):
        if select.select([self.ours], [], [], wait)[0]:
            new = os.read(self.ours, 65536)
            self.told += new
            self.emulator.feed(new)
            return True
        return False

    def seen(self):
        return "\n".join(line.rstrip() for line in self.screen.display)

    def until(self, pattern, within=90.0):
        end = time.monotonic() + within
        while not re.search(pattern, self.seen()):
            assert self.process.poll() is None, f"it ended with {self.process.returncode}:\n{self.seen()}"
            assert time.monotonic() < end, f"not within {within} s: {pattern}\n{self.seen()}"
            self.read()

    def press(self, keys):
        os.write(self.ours, keys)

    def ends(self, within=15.0):
        """It ends with 0, and the terminal is as it was. Gives what it wrote behind the picture."""
        end = time.monotonic() + within
        while self.process.poll() is None:
            assert time.monotonic() < end, f"it goes on:\n{self.seen()}"
            self.read()
        while self.read():
            pass
        assert self.process.returncode == 0, f"{self.process.returncode}\n{self.seen()}"
        assert termios.tcgetattr(self.its) == self.before, "the terminal's settings were not put back"
        assert self.told.count(ENTER) == 1 and self.told.rfind(LEAVE) > self.told.rfind(ENTER)
        behind = self.told[self.told.rfind(LEAVE):]
        assert SHOW in behind, "the cursor stays hidden"
        return behind.decode(errors="replace")


def test_the_demo_shows_a_table_and_gives_the_terminal_back(folder):
    with Terminal("demo", "--for", "45", cwd=folder) as terminal:
        terminal.until(r"M ◆ +FIC101 +the valve sticks")
        assert "healthy valve, controller tuned too tight" in terminal.seen(), terminal.seen()
        assert re.search(r"Page http://127\.0\.0\.1:\d+", terminal.seen()), terminal.seen()
        behind = terminal.ends(within=60.0)
    assert re.search(r"FIC101 +stiction +stiction +yes", behind), behind


def test_plain_text_comes_where_it_is_wished_or_nobody_looks(folder):
    with Terminal("demo", "--plain", "--for", "3", cwd=folder) as terminal:
        end = time.monotonic() + 30
        while terminal.process.poll() is None and time.monotonic() < end:
            terminal.read()
        while terminal.read():
            pass
        assert terminal.process.returncode == 0
        assert ENTER not in terminal.told and b"A simulated plant of 4 loops" in terminal.told


def test_top_shows_running_daemons_through_a_restart_and_ends_in_order(folder):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    zenoh_table = f'[zenoh]\nlisten = ["{endpoint}"]'
    more = "[window]\nhop_s = 300.0\n[alarm]\nraise = [2, 3]\n"
    code, out, err = stictiond("top", "--connect", endpoint)
    assert code == 1 and "start a daemon with" in err and out == "", (code, out, err)
    with Daemon(folder, "plant1/area1", zenoh_table, more) as first:
        with Terminal("top", "--connect", endpoint) as terminal:
            terminal.until(r"plant1/area1 +daemon")
            recording = ROOT / "recordings" / "sticking.mcap"
            arguments = ("play", recording, "--connect", endpoint, "--prefix", "plant1/area1", "--speed", "max")
            assert stictiond(*arguments)[0] == 0
            terminal.until(r"FIC101 +the valve sticks and slips")
            terminal.until(r"UNACK")
            terminal.press(b"a")
            terminal.until(r"acknowledge FIC101; your name:")
            terminal.press(b"\x08" * 64 + b"Ann\r")
            terminal.until(r"FIC101: acknowledged by Ann")
            terminal.press(b"\r")
            terminal.until(r"Stiction almost certain")
            terminal.press(b"\x1b")
            code, out, err = stictiond("top", "--connect", endpoint)
            assert code == 0 and re.search(r"M .\s+FIC101 .*acked", out), (code, out, err)
            code, out, err = stictiond("top", "--config", first.config, "--format", "json")
            assert code == 0 and '"alarm_state":"acked"' in out and out.count("\n") == 1, (code, out, err)
            assert first.stop() < 5
            terminal.until(r"STALE: (connection lost|the daemon stopped)")
            with Daemon(folder, "plant1/area1", zenoh_table, more):
                terminal.until(r"stictiond \d\S+  plant1/area1  daemon [0-9a-f]{8}  up \d")
                assert "STALE" not in terminal.seen() and "acked" in terminal.seen(), terminal.seen()
                terminal.process.send_signal(signal.SIGTERM)
                terminal.ends()
