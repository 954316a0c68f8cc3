"""Installs the package in a Debian root, runs it as in its unit, upgrades, removes and purges it.

Usage: install.py ROOT PACKAGE NEWER-PACKAGE, as root, in separate namespaces for mounts, processes and the network.
There is no systemd in the root: the unit's ExecStart is run here, as its user, with a socket for its notifications.
"""

import fcntl
import os
import shlex
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

ROOT, FIRST, SECOND = (Path(p).resolve() for p in sys.argv[1:4])
UNIT = ROOT / "usr/lib/systemd/system/stictiond.service"
CONFIG = ROOT / "etc/stictiond/monitor.toml"
STATE = ROOT / "var/lib/stictiond"
# Records of dpkg, adduser and the loader's cache.
RECORDS = ("var/lib/dpkg/", "var/log/", "var/cache/", "etc/passwd-", "etc/group-", "etc/shadow-", "etc/gshadow-")


def inside(*command, check=True):
    """Runs a command in the root; returns its output on both channels."""
    environment = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"}
    done = subprocess.run(
        ["chroot", ROOT, *command], env=environment, text=True, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    if check and done.returncode != 0:
        raise AssertionError(f"{shlex.join(command)}: exit {done.returncode}\n{done.stdout}")
    return done.stdout


def dpkg(action, what):
    if isinstance(what, Path):
        shutil.copy(what, ROOT / "package.deb")
        said = inside("dpkg", "--force-unsafe-io", action, "/package.deb")
        (ROOT / "package.deb").unlink()
        return said
    return inside("dpkg", action, what)


def everything():
    """Every path of the root with its mode and owner, except those in `RECORDS`."""
    found = {}
    for folder, folders, files in os.walk(ROOT):
        if Path(folder) == ROOT:
            folders[:] = [name for name in folders if name not in ("proc", "dev", "sys", "run", "tmp")]
        for name in folders + files:
            path = Path(folder, name)
            short = str(path.relative_to(ROOT))
            if not short.startswith(RECORDS):
                about = path.lstat()
                found[short] = (oct(about.st_mode), about.st_uid, about.st_gid)
    return found


def loopback_up():
    with socket.socket() as s:
        fcntl.ioctl(s, 0x8914, struct.pack("16sh14x", b"lo", 0x1 | 0x40))  # SIOCSIFFLAGS: up, running


def eventually(what, check, within):
    until = time.monotonic() + within
    while not (result := check()):
        if time.monotonic() > until:
            raise AssertionError(f"not within {within} s: {what}")
        time.sleep(0.05)
    return result


def unit():
    """The unit's settings; of a repeated key the last one."""
    lines = (line.partition("=") for line in UNIT.read_text().splitlines() if not line.startswith("#"))
    return {key: value for key, equals, value in lines if equals}


class Service:
    """The unit's ExecStart, with the environment that systemd would provide."""

    def __init__(self, log):
        settings = unit()
        assert settings["Type"] == "notify" and int(settings["WatchdogSec"]) > 0, settings
        self.told = []
        (ROOT / "run").mkdir(exist_ok=True)
        self.path = ROOT / "run/told"
        self.path.unlink(missing_ok=True)
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        # A socket's path may have at most 107 bytes, however deep the root is.
        folder = os.open(self.path.parent, os.O_RDONLY)
        self.socket.bind(f"/proc/self/fd/{folder}/{self.path.name}")
        os.close(folder)
        self.socket.setblocking(False)
        self.path.chmod(0o666)
        user = settings["User"]
        rights = ["setpriv", f"--reuid={user}", f"--regid={user}", "--init-groups", "--no-new-privs",
                  "--bounding-set=-all", "--inh-caps=-all"]
        # A watchdog of one second instead of the unit's, which determines how often it is fed.
        environment = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "NOTIFY_SOCKET": "/run/told", "WATCHDOG_USEC": "1000000"}
        start = f"cd {settings['WorkingDirectory']}; umask {settings['UMask']}; exec {settings['ExecStart']}"
        self.log = log
        self.process = subprocess.Popen(
            ["chroot", ROOT, *rights, "sh", "-c", start], env=environment, stdin=subprocess.DEVNULL,
            stdout=log.open("w"), stderr=subprocess.STDOUT)

    def has_told(self, word):
        if self.process.poll() is not None and self.process.returncode != 0:
            raise AssertionError(f"it ended with {self.process.returncode}:\n{self.log.read_text()}")
        try:
            while True:
                self.told += self.socket.recv(65536).decode().split("\n")
        except BlockingIOError:
            return self.told.count(word)

    def wait_for(self, word, times=1, within=20.0):
        eventually(f"{word} (told: {self.told})", lambda: self.has_told(word) >= times, within)

    def stop(self):
        started = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(timeout=5) == 0, self.log.read_text()
        self.wait_for("STOPPING=1", within=1)
        return time.monotonic() - started


def healthy():
    with urllib.request.urlopen("http://127.0.0.1:8080/healthz", timeout=5) as answer:
        return answer.status == 200


def run_once(run_number):
    """Runs from start to stop, as seen by systemd; returns the duration of the stop, s."""
    service = Service(ROOT.parent / f"run{run_number}.log")
    service.wait_for("READY=1")
    service.wait_for("WATCHDOG=1", times=3)
    assert healthy()
    status = Path("/proc", str(service.process.pid), "status").read_text()
    rights = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
    assert rights["Uid"].split()[0] == str(uid()) and rights["CapEff"].strip("0") == "" and rights["NoNewPrivs"] == "1", status
    service.process.send_signal(signal.SIGHUP)
    service.wait_for("RELOADING=1")
    service.wait_for("READY=1", times=2)
    seconds = service.stop()
    log = service.log.read_text()
    assert f'"run_number":{run_number}' in log, log
    return seconds


def uid():
    """The daemon's user id in the root, from its list of users."""
    with (ROOT / "etc/passwd").open() as users:
        return next((int(line.split(":")[2]) for line in users if line.startswith("stictiond:")), None)


def recordings():
    return {path.name: path.read_bytes() for path in (STATE / "recordings").glob("*.mcap")}


def main():
    loopback_up()
    subprocess.run(["mount", "-t", "proc", "proc", ROOT / "proc"], check=True)
    before = everything()

    said = dpkg("--install", FIRST)
    assert "systemctl enable --now stictiond" in said, said
    assert inside("dpkg", "--verify", "stictiond") == ""
    assert inside("stictiond", "--version").startswith("stictiond "), "version"
    assert inside("stictiond-bridge", "--version").startswith("stictiond-bridge "), "version"
    assert "--topic" in inside("stictiond-bridge", "mqtt", "--help"), "the bridge beside the program"
    assert "no faults" in inside("stictiond", "check", "/etc/stictiond/monitor.toml")
    for path in ["man/man1/stictiond.1.gz", "man/man1/stictiond-run.1.gz", "man/man1/stictiond-bridge-mqtt.1.gz", "bash-completion/completions/stictiond",
                 "zsh/vendor-completions/_stictiond", "fish/vendor_completions.d/stictiond.fish",
                 "doc/stictiond/copyright", "doc/stictiond/examples/monitor.toml"]:
        assert (ROOT / "usr/share" / path).stat().st_size > 500, path
    inside("bash", "-n", "/usr/share/bash-completion/completions/stictiond")
    assert uid() and STATE.stat().st_uid == uid() and STATE.stat().st_mode & 0o777 == 0o750
    number = uid()
    stops = [run_once(1)]
    kept = recordings()
    assert kept and all(path.stat().st_uid == number for path in STATE.rglob("*"))

    # An upgrade keeps the user's edits, the recordings and the alarm states.
    mine = CONFIG.read_text().replace('"plant1/area1"', '"my/plant"')
    assert mine != CONFIG.read_text()
    CONFIG.write_text(mine)
    for package in (SECOND, SECOND):  # the second time over itself
        dpkg("--install", package)
        assert inside("dpkg-query", "-W", "-f", "${Version}", "stictiond").endswith("-2")
        assert CONFIG.read_text() == mine and kept.items() <= recordings().items() and uid() == number
    CONFIG.write_text(mine.replace('"my/plant"', '"plant1/area1"'))
    stops.append(run_once(2))
    # A downgrade.
    dpkg("--install", FIRST)
    stops.append(run_once(3))
    CONFIG.write_text(mine)
    kept = recordings()

    said = dpkg("--remove", "stictiond")
    assert "stay in /var/lib/stictiond" in said, said
    assert not UNIT.exists() and not (ROOT / "usr/bin/stictiond").exists()
    assert CONFIG.read_text() == mine and recordings() == kept

    dpkg("--purge", "stictiond")
    assert not STATE.exists()
    for accounts in ("passwd", "group", "shadow", "gshadow"):
        assert "stictiond" not in (ROOT / "etc" / accounts).read_text(), accounts
    after = everything()
    left = {path: after[path] for path in after if before.get(path) != after[path]}
    gone = before.keys() - after.keys()
    assert not left and not gone, f"left: {left}, gone: {gone}"
    assert "stictiond" not in inside("dpkg-query", "-W")
    print(f"installed, run three times (stopped within {max(stops):.1f} s), upgraded, taken back, removed and purged on "
          f"{inside('sh', '-c', '. /etc/os-release; echo $PRETTY_NAME').strip()}: nothing is left")


main()
