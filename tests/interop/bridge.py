"""`stictiond-bridge mqtt` against mosquitto with TLS, a user and a store: restarts of the broker and of the bridge lose nothing."""

import json
import os
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

import paho.mqtt.client as paho
from mcap.reader import make_reader

from daemon import BRIDGE, Daemon, eventually, free_port, typed
from receivers import MOSQUITTO, environment, tool

PREFIX = "plant1/area1"
LOOPS = int(os.environ.get("STICTIOND_BRIDGE_LOOPS", "20"))
SECONDS = float(os.environ.get("STICTIOND_BRIDGE_S", "24"))
EVERY_S = float(os.environ.get("STICTIOND_BRIDGE_EVERY_S", "0.1"))


class Broker:
    """mosquitto that keeps sessions on disk; certificates and password are made for the test."""

    def __init__(self, folder, program, passwords):
        self.folder, self.program, self.port = Path(folder), program, free_port()
        self.ca, certificate, key = self.certificates()
        users = self.folder / "users"
        subprocess.run([passwords, "-b", "-c", users, "plant", "s3cret"], check=True, capture_output=True, env=environment())
        (self.folder / "password").write_text("s3cret\n")
        store = self.folder / "store"
        store.mkdir()
        for file in (users, key, self.ca):
            file.chmod(0o644)
        user = "user root\n" if os.geteuid() == 0 else ""
        (self.folder / "mosquitto.conf").write_text(
            f"listener {self.port} 127.0.0.1\ncertfile {certificate}\nkeyfile {key}\nallow_anonymous false\npassword_file {users}\n"
            f"persistence true\npersistence_location {store}/\nmax_queued_messages 0\nmax_inflight_messages 0\n{user}"
        )
        self.start()

    def certificates(self):
        """An authority and a certificate for localhost, since an authority may not be a server itself."""
        ca, ca_key, certificate, key = (self.folder / name for name in ("ca.pem", "ca.key", "broker.pem", "broker.key"))
        new_key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
        extra = self.folder / "broker.ext"
        extra.write_text("basicConstraints=CA:FALSE\nsubjectAltName=DNS:localhost,IP:127.0.0.1\n")
        for words in (
            ["req", "-x509", *new_key, "-days", "30", "-subj", "/CN=test authority", "-keyout", ca_key, "-out", ca],
            ["req", *new_key, "-subj", "/CN=localhost", "-keyout", key, "-out", self.folder / "broker.csr"],
            ["x509", "-req", "-in", self.folder / "broker.csr", "-CA", ca, "-CAkey", ca_key, "-CAcreateserial", "-days", "30",
             "-extfile", extra, "-out", certificate],
        ):
            subprocess.run(["openssl", *words], check=True, capture_output=True)
        return ca, certificate, key

    def start(self):
        log = open(self.folder / "mosquitto.log", "a")
        self.process = subprocess.Popen([self.program, "-c", self.folder / "mosquitto.conf"], env=environment(), stderr=log, stdout=log)
        eventually("mosquitto", self.answers, 20)

    def answers(self):
        assert self.process.poll() is None, (self.folder / "mosquitto.log").read_text()
        with socket.socket() as s:
            return s.connect_ex(("127.0.0.1", self.port)) == 0

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(20)


class Bridge:
    def __init__(self, broker, endpoint, figures):
        self.figures = figures
        words = typed("stictiond-bridge mqtt", {
            "mqtts://broker.plant": f"mqtts://localhost:{broker.port}", "stiction": "plant", "broker.password": broker.folder / "password",
            "ca.pem": broker.ca, "spBv1.0/plant/#": "dcs/#", "dcs/+/+": "single/+", "tcp/127.0.0.1:7447": endpoint,
            "dcs/FIC101/out=plant1/area1/FIC101/op": f"single/op={PREFIX}/TIC9/op", "plant1/area1/mqtt": f"{PREFIX}/mqtt",
        })
        self.process = subprocess.Popen(
            [BRIDGE, "--format", "json", *words, "--figures", figures],
            stdout=subprocess.PIPE, stderr=open(broker.folder / "bridge.log", "a"), text=True,
        )

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        out, _ = self.process.communicate(timeout=20)
        assert self.process.returncode == 0, out
        return json.loads(out)["figures"]


def publisher(broker):
    client = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id="plant", protocol=paho.MQTTv311, clean_session=False)
    client.username_pw_set("plant", "s3cret")
    client.tls_set(ca_certs=str(broker.ca))
    client.max_queued_messages_set(0)
    client.reconnect_delay_set(min_delay=0.2, max_delay=0.5)
    client.connect("localhost", broker.port, keepalive=5)
    client.loop_start()
    return client


def recorded(folder):
    """Samples of all recordings: (loop, signal, stamp)."""
    found = []
    for path in Path(folder).glob("*.mcap"):
        with open(path, "rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                loop, _, name = channel.topic.removeprefix(PREFIX + "/").rpartition("/")
                if name in ("op", "pv"):
                    found.append((loop, name, message.publish_time))
    return found


def send(client, broker, bridges, new_bridge, sent):
    """Samples of LOOPS loops, two in a payload, while the broker restarts three times and the bridge is killed once;
    returns the number of messages."""
    started, tick = time.monotonic(), 0
    restarts = [SECONDS * share for share in (0.2, 0.45, 0.7)]
    killed = False
    while time.monotonic() - started < SECONDS:
        t_ns = time.time_ns()
        for k in range(LOOPS):
            stamp = t_ns + k
            payload = json.dumps({"t": stamp, "op": tick % 50, "pv": tick % 40})
            client.publish(f"dcs/FIC{100 + k}", payload, qos=1)
            sent.update({(f"FIC{100 + k}", "op", stamp), (f"FIC{100 + k}", "pv", stamp)})
        client.publish("single/op", json.dumps({"t": t_ns, "v": tick % 30}), qos=1)
        sent.add(("TIC9", "op", t_ns))
        tick += 1
        if restarts and time.monotonic() - started > restarts[0]:
            restarts.pop(0)
            broker.stop()
            time.sleep(1.0)
            broker.start()
        if not killed and time.monotonic() - started > 0.55 * SECONDS:
            bridges[-1].process.kill()
            bridges[-1].process.wait()
            bridges.append(new_bridge())
            killed = True
        time.sleep(EVERY_S)
    return tick * (LOOPS + 1)


def test_the_mqtt_bridge_loses_nothing(folder):
    program, passwords = tool("mosquitto", MOSQUITTO), tool("mosquitto_passwd", MOSQUITTO)
    if not (program and passwords and shutil.which("openssl")):
        return
    broker, port = Broker(folder, program, passwords), free_port()
    more = f'[[bundle]]\nkey = "{PREFIX}/mqtt/dcs/*"\n'
    endpoint, bridges = f"tcp/127.0.0.1:{port}", []
    try:
        with Daemon(folder, PREFIX, f'[zenoh]\nlisten = ["{endpoint}"]', more) as daemon:
            def new_bridge():
                return Bridge(broker, endpoint, Path(folder) / "figures.json")

            bridges.append(new_bridge())
            eventually("the bridge at the broker", lambda: "connected to the broker" in (broker.folder / "bridge.log").read_text(), 30)
            time.sleep(1.0)
            client, confirmed = publisher(broker), []
            client.on_publish = lambda *_: confirmed.append(1)
            sent = set()
            published = send(client, broker, bridges, new_bridge, sent)
            eventually("everything at the broker", lambda: len(confirmed) >= published, 60)
            samples = lambda: daemon.healthz()["counters"]["samples"]  # noqa: E731
            eventually("all samples at the daemon", lambda: samples() >= len(sent), 120)
            time.sleep(2.0)
            figures, all_samples = bridges.pop().stop(), samples()
            client.disconnect()
            counters = daemon.healthz()["counters"]
            daemon.stop()
        found = recorded(Path(folder) / "recordings")
        missing = sent - {(loop.removeprefix("mqtt/dcs/"), name, stamp) for loop, name, stamp in found}
        assert not missing, f"{len(missing)} of {len(sent)} are lost, such as {sorted(missing)[:3]}"
        assert (counters["undecodable"], counters["dropped_input"], counters["recording_lost"]) == (0, 0, 0), counters
        assert figures["refused"] == 0 and figures["published"] == figures["received"], figures
        assert figures["connections"] >= 2 and figures["resumed"] >= 2, figures
        print(f"  {len(sent)} samples sent, {all_samples} came (those twice included), none lost; {figures}")
    finally:
        for one in bridges:
            one.process.kill()
        broker.stop()
