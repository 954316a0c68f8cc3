"""`stictiond-bridge opcua` with asyncua: every value that the server wrote during a session is in the recording, and every
time without a session is in the figures."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from mcap.reader import make_reader

from daemon import BRIDGE, Daemon, eventually, free_port, typed

PREFIX = "plant1/area1"
LOOPS = int(os.environ.get("STICTIOND_OPCUA_LOOPS", "10"))
SECONDS = float(os.environ.get("STICTIOND_OPCUA_S", "20"))
EVERY_S = float(os.environ.get("STICTIOND_OPCUA_EVERY_S", "0.2"))
URI = "urn:stictiond:bridge"


class Server:
    def __init__(self, folder):
        self.folder, self.port = Path(folder), free_port()
        certificate(self.folder, "server", "urn:test:server")
        self.start()

    def start(self):
        self.process = subprocess.Popen(
            [sys.executable, Path(__file__).with_name("opcua_server.py"), str(self.port), str(LOOPS), str(EVERY_S), self.folder],
            stdout=subprocess.PIPE, stderr=open(self.folder / "server.log", "a"), text=True,
        )
        line = self.process.stdout.readline()
        assert line == "ready\n", (self.folder / "server.log").read_text()[-2000:]

    def end(self, how):
        self.process.send_signal(how)
        self.process.wait(30)

    def written(self):
        lines = (self.folder / "written.jsonl").read_text().splitlines()
        return [tuple(value) for line in lines if line.endswith("]") for value in json.loads(line)]


class Wire:
    """The network between bridge and server, which can be cut."""

    def __init__(self, port):
        self.to, self.open, self.is_cut = port, [], False
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            near, _ = self.socket.accept()
            try:
                if self.is_cut:
                    raise OSError("cut")
                far = socket.create_connection(("127.0.0.1", self.to))
            except OSError:
                near.close()
                continue
            self.open += [near, far]
            for a, b in ((near, far), (far, near)):
                threading.Thread(target=self.carry, args=(a, b), daemon=True).start()

    def carry(self, a, b):
        try:
            while data := a.recv(65536):
                b.sendall(data)
        except OSError:
            pass
        for end in (a, b):
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass

    def cut(self, seconds):
        self.is_cut = True
        for end in self.open:
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
            end.close()
        self.open.clear()
        time.sleep(seconds)
        self.is_cut = False


def certificate(folder, name, uri):
    extra = f"subjectAltName=URI:{uri},DNS:localhost,IP:127.0.0.1"
    words = ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "30", "-subj", f"/CN={name}", "-addext", extra]
    pem, key = folder / f"{name}.pem", folder / f"{name}.key"
    subprocess.run(["openssl", *words, "-keyout", key, "-out", pem], check=True, capture_output=True)
    subprocess.run(["openssl", "x509", "-in", pem, "-outform", "der", "-out", folder / f"{name}.der"], check=True)


class Bridge:
    def __init__(self, folder, words):
        self.figures, self.log = folder / "figures.json", folder / "bridge.log"
        self.process = subprocess.Popen(
            [BRIDGE, "--format", "json", *words, "--sampling-ms", str(int(1000 * EVERY_S)), "--figures", self.figures],
            stdout=subprocess.PIPE, stderr=open(self.log, "a"), text=True, env={**os.environ, "NO_COLOR": "1"},
        )

    def said(self, words):
        assert self.process.poll() is None, self.log.read_text()[-2000:]
        return words in self.log.read_text()

    def now(self):
        try:
            return json.loads(self.figures.read_text())["figures"]
        except (OSError, ValueError):
            return {}

    def is_back(self, told):
        figures = self.now()
        return figures.get("outages", 0) > told and figures["outage_list"][-1]["end_ns"] is not None

    def cpu_s(self):
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        out, _ = self.process.communicate(timeout=20)
        assert self.process.returncode == 0, self.log.read_text()[-2000:]
        return json.loads(out)["figures"]


def recorded(folder):
    """Samples of all recordings: (loop, signal, stamp) with value and quality."""
    found = {}
    for path in Path(folder).glob("*.mcap"):
        with open(path, "rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                loop, _, name = channel.topic.removeprefix(PREFIX + "/").rpartition("/")
                if name in ("op", "pv"):
                    document = json.loads(message.data)
                    found[loop, name, message.publish_time] = document.get("v"), document.get("q")
    return found


def called(*arguments):
    done = subprocess.run([BRIDGE, *map(str, arguments)], capture_output=True, text=True, timeout=300)
    return done.returncode, done.stdout, done.stderr


def discovered(folder, from_):
    """The lists of nodes and loops from `discover`, with additional nodes that must be refused."""
    nodes, loops = folder / "nodes.txt", folder / "loops.toml"
    words = typed("stictiond-bridge discover", {"opc.tcp://plc:4840/ua": from_[1], "nodes.txt": nodes, "loops.toml": loops})
    code, out, err = called(*words, *from_[2:])
    assert code == 0 and f"{LOOPS} loops" in err, (out, err)
    text = loops.read_text()
    assert text.count("[[loop]]") == LOOPS and f'op = "{PREFIX}/opcua/FIC100/OP"' in text, text[:500]
    assert nodes.read_text().count("\nns=2;s=FIC") == 2 * LOOPS, nodes.read_text()[:500]
    with nodes.open("a") as file:
        file.write("\nnsu=urn:test:plant;s=Text\nns=2;s=Array\nns=2;s=Nothing # not there\n")
    return text


def disturb(server, wire, bridges, new_bridge):
    """Three restarts of the server, a cut of the network and a kill of the bridge; returns the time of the kill."""
    killed_ns, steps = 0, ("stop", "cut", "kill the server", "kill the bridge", "stop")
    for step in steps:
        time.sleep(SECONDS / (len(steps) + 1))
        told = bridges[-1].now()["outages"]
        if step == "cut":
            wire.cut(1.5)
        elif step == "kill the bridge":
            killed_ns = time.time_ns()
            bridges[-1].process.kill()
            bridges[-1].process.wait()
            bridges[-1].figures.rename(bridges[-1].figures.with_name("killed.json"))
            bridges.append(new_bridge())
            eventually("the new bridge", lambda: (bridges[-1].now().get("subscribed_ns") or 0) > killed_ns, 30)
        else:
            server.end(signal.SIGTERM if step == "stop" else signal.SIGKILL)
            server.start()
        if step != "kill the bridge":
            eventually(f"a session after: {step}", lambda: bridges[-1].is_back(told), 60)
    time.sleep(SECONDS / (len(steps) + 1))
    return killed_ns


def untrusted_first(folder, bridge):
    """The server's certificate is refused until it is copied to the place named in the log."""
    eventually("a refusal", lambda: bridge.said("certificate is not trusted"), 30)
    (refused,) = (folder / "trusted" / "rejected").glob("*.der")
    assert f"move {refused} into {folder / 'trusted'}" in bridge.log.read_text()
    refused.rename(folder / "trusted" / refused.name)
    eventually("the subscription", lambda: bridge.said("subscribed at the server"), 30)


def can_be_tried():
    if "this build has no" in called("opcua")[2]:
        print("\nSKIPPED: this build has no OPC UA bridge (cargo build -p stictiond-bridge --features opcua): it was not tried\n", flush=True)
    elif not shutil.which("openssl"):
        print("\nSKIPPED: openssl cannot be had: the OPC UA bridge was not tried\n", flush=True)
    else:
        return True
    return False


class Plant:
    """A server, the network to it, and the arguments of a bridge."""

    def __init__(self, folder):
        self.folder, self.server = folder, Server(folder)
        self.wire, self.port = Wire(self.server.port), free_port()
        self.endpoint = f"tcp/127.0.0.1:{self.port}"
        certificate(folder, "own", URI)
        (folder / "password").write_text("s3cret\n")
        (folder / "trusted").mkdir()
        self.open = ["--from", f"opc.tcp://127.0.0.1:{self.wire.port}/plant", "--user", "plant",
                     "--secret-file", folder / "password"]
        self.secret = [*self.open, "--cert-file", folder / "own.pem", "--key-file", folder / "own.key"]

    def bridge(self, secret):
        """A bridge as started in docs/connect.md, or without certificates."""
        nodes = self.folder / "nodes.txt"
        if not secret:
            return Bridge(self.folder, [
                "opcua", *self.open, "--nodes", nodes, "--connect", self.endpoint, "--prefix", f"{PREFIX}/opcua"])
        return Bridge(self.folder, typed("stictiond-bridge opcua", {
            "opc.tcp://plc:4840/ua": self.open[1], "stiction": "plant", "plc.password": self.folder / "password",
            "own.pem": self.folder / "own.pem", "own.key": self.folder / "own.key", "servers/": self.folder / "trusted",
            "nodes.txt": nodes, "tcp/127.0.0.1:7447": self.endpoint,
        }))

    def daemon(self, loops):
        return Daemon(self.folder, PREFIX, f'[zenoh]\nlisten = ["{self.endpoint}"]', "[window]\nhop_s = 3600\n" + loops)


def test_the_opcua_bridge_accounts_for_every_value(folder):
    if not can_be_tried():
        return
    folder, bridges = Path(folder), []
    plant = Plant(folder)
    try:
        loops = discovered(folder, [*plant.secret, "--trust", folder / "server.pem"])
        with plant.daemon(loops) as daemon:
            bridges.append(plant.bridge(secret=True))
            untrusted_first(folder, bridges[0])
            begun_ns = eventually("figures", lambda: bridges[0].now().get("subscribed_ns"))
            killed_ns = disturb(plant.server, plant.wire, bridges, lambda: plant.bridge(secret=True))
            plant.server.process.send_signal(signal.SIGUSR1)
            time.sleep(2 + 2 * EVERY_S)
            before, cpu_s = json.loads((folder / "killed.json").read_text())["figures"], bridges[-1].cpu_s()
            figures = bridges.pop().stop()
            time.sleep(2)
            counters = daemon.healthz()["counters"]
            daemon.stop()
        # A killed bridge cannot report values it had not received yet: one publishing interval, and those in transit.
        killed = (killed_ns - int((1 + 2 * EVERY_S) * 1e9), figures["subscribed_ns"])
        # Three restarts and the cut: the client cannot resume a signed session.
        assert before["outages"] >= 3 and figures["outages"] >= 1, (before, figures)
        check(folder, plant.server.written(), begun_ns, [before, figures], [killed], counters)
        print(f"  CPU of the second bridge {cpu_s:.1f} s")
    finally:
        for one in bridges:
            one.process.kill()
        plant.server.process.kill()


def test_a_cut_of_the_network_costs_the_opcua_bridge_nothing(folder):
    if not can_be_tried():
        return
    folder = Path(folder)
    plant, bridge = Plant(folder), None
    try:
        with plant.daemon(discovered(folder, plant.open)) as daemon:
            bridge = plant.bridge(secret=False)
            begun_ns = eventually("the subscription", lambda: bridge.now().get("subscribed_ns"))
            for cut in range(2):
                time.sleep(3)
                plant.wire.cut(1.5)
                eventually("the session again", lambda: bridge.is_back(cut), 60)
            time.sleep(3)
            plant.server.process.send_signal(signal.SIGUSR1)
            time.sleep(2 + 2 * EVERY_S)
            figures = bridge.stop()
            time.sleep(2)
            counters = daemon.healthz()["counters"]
            daemon.stop()
        check(folder, plant.server.written(), begun_ns, [figures], [], counters)
        assert (figures["sessions"], figures["resumed"]) == (1, 2), figures
    finally:
        if bridge:
            bridge.process.kill()
        plant.server.process.kill()


def check(folder, written, begun_ns, all_figures, gaps, counters):
    found = recorded(folder / "recordings")
    for outage in (outage for figures in all_figures for outage in figures["outage_list"]):
        assert outage["end_ns"] > outage["start_ns"], outage
        if not outage["resumed"]:
            # An outage before the first value is described by its start.
            gaps.append((outage["last_stamp_ns"] or outage["start_ns"], outage["end_ns"]))
    due = [value for value in written if value[2] > begun_ns and not any(a < value[2] < b for a, b in gaps)]
    missing = [value for value in due if tuple(value[:3]) not in found]
    away_s = sum(b - a for a, b in gaps) / 1e9
    print(f"  {len(written)} values written, {len(due)} of them with a session, {len(missing)} of those lost; "
          f"{len(gaps)} stretches without one, {away_s:.1f} s")
    for figures in all_figures:
        print(f"  {figures}")
    assert not missing, f"{len(missing)} of {len(due)} are lost, such as {missing[:3]} beside {gaps}"
    # Otherwise there was hardly a session, and nothing was tested.
    assert len(due) > 0.1 * len(written), (len(due), len(written), gaps)
    for loop, name, stamp, what in due:
        value, quality = found[loop, name, stamp]
        wanted = {"good": None, "bad": 0x808C0000, "uncertain": 0x40900000}[what]
        assert (value is None) == (what == "bad") and quality == wanted, (loop, name, stamp, what, value, quality)
    for told in all_figures:
        assert told["refused"] >= 2 and told["refused_nodes"] == 1 and told["nodes"] == 2 * LOOPS + 2, told
        assert (told["lost_messages"], told["dropped"], told["unsent"], told["overflows"]) == (0, 0, 0, 0), told
    last = all_figures[-1]
    assert last["published"] == last["received"] - last["again"] - last["refused"], last
    assert (counters["undecodable"], counters["dropped_input"], counters["recording_lost"]) == (0, 0, 0), counters
