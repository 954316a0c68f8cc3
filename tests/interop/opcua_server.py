"""An OPC UA server (asyncua) of some loops, run by opcua.py as a separate process: it writes every value with the
current stamp and keeps a list of them. SIGUSR1 stops writing.

Usage: opcua_server.py PORT LOOPS EVERY_S FOLDER, where FOLDER contains server.der and server.key and receives written.jsonl.
"""

import asyncio
import json
import signal
import sys
import time
from datetime import datetime, timedelta, timezone
from pathlib import Path

from asyncua import Server, ua
from asyncua.crypto.permission_rules import SimpleRoleRuleset
from asyncua.server.user_managers import User, UserRole

EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
BAD, UNCERTAIN = ua.StatusCodes.BadSensorFailure, ua.StatusCodes.UncertainLastUsableValue


class Users:
    def get_user(self, _, username=None, password=None, certificate=None):
        return User(role=UserRole.User) if (username, password) == ("plant", "s3cret") else None


async def make(port, loops, folder):
    server = Server(user_manager=Users())
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/plant")
    await server.set_application_uri("urn:test:server")
    policies = [ua.SecurityPolicyType.NoSecurity, ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt]
    server.set_security_policy(policies, permission_ruleset=SimpleRoleRuleset())
    await server.load_certificate(folder / "server.der")
    await server.load_private_key(folder / "server.key", format="pem")
    space = await server.register_namespace("urn:test:plant")
    plant = await server.nodes.objects.add_folder(ua.NodeId("Plant", space), ua.QualifiedName("Plant", space))
    nodes = []
    for k in range(loops):
        name = f"FIC{100 + k}"
        one = await plant.add_object(ua.NodeId(name, space), ua.QualifiedName(name, space))
        for end in ("OP", "PV"):
            kind = ua.VariantType.Double if end == "PV" else ua.VariantType.Float
            node = await one.add_variable(ua.NodeId(f"{name}.{end}", space), ua.QualifiedName(end, space), 0.0, kind)
            nodes.append((name, end.lower(), node.nodeid, kind))
    await plant.add_variable(ua.NodeId("Text", space), ua.QualifiedName("Text", space), "no number")
    await plant.add_variable(ua.NodeId("Array", space), ua.QualifiedName("Array", space), [1.0, 2.0])
    return server, nodes


async def write(server, nodes, tick):
    """Writes one value of each node; returns (loop, signal, stamp, what)."""
    written = []
    for place, (name, end, nodeid, kind) in enumerate(nodes):
        t_us = time.time_ns() // 1000
        stamp = EPOCH + timedelta(microseconds=t_us)
        what = "bad" if place == 0 and tick % 5 == 0 else "uncertain" if place == 1 and tick % 7 == 0 else "good"
        # Every other value is unchanged: sampling it again counts as a sample too.
        value = ua.Variant(float(tick // 2 % 50), kind)
        code = {"bad": BAD, "uncertain": UNCERTAIN, "good": ua.StatusCodes.Good}[what]
        data = ua.DataValue(None if what == "bad" else value, ua.StatusCode(code), SourceTimestamp=stamp)
        await server.write_attribute_value(nodeid, data)
        written.append((name, end, t_us * 1000, what))
    return written


async def main():
    port, loops, every_s, folder = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), Path(sys.argv[4])
    server, nodes = await make(port, loops, folder)
    ended, quiet = asyncio.Event(), asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, ended.set)
    asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, quiet.set)
    await server.start()
    print("ready", flush=True)
    with open(folder / "written.jsonl", "a", encoding="utf-8") as file:
        begun, tick = time.monotonic(), 0
        while not ended.is_set():
            if not quiet.is_set():
                file.write(json.dumps(await write(server, nodes, tick)) + "\n")
                file.flush()
            tick += 1
            try:
                await asyncio.wait_for(ended.wait(), max(begun + tick * every_s - time.monotonic(), 0.001))
            except TimeoutError:
                pass
    await server.stop()


asyncio.run(main())
