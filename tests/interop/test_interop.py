"""stictiond observed with Zenoh and MCAP libraries that share no code with it.

Run by tests/interop/run.sh; with the name of a test as an argument it runs only that one.
"""

import csv
import json
import math
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from datetime import datetime, timezone
from pathlib import Path

import zenoh
from mcap.reader import make_reader

from board import test_the_board_fits_grafanas_schema  # noqa: F401
from bridge import test_the_mqtt_bridge_loses_nothing  # noqa: F401
from compact_store import (  # noqa: F401, found by name below
    test_a_solver_in_python,
    test_scipy_reads_the_manuals_example,
    test_the_greatest_byte_may_come_first,
    test_what_scipy_writes_is_read,
)
from daemon import ROOT, Daemon, close_sessions, eventually, free_port, session, stictiond
from documents import check_document, test_documents_fit_their_schemas  # noqa: F401
from opcua import (  # noqa: F401
    test_a_cut_of_the_network_costs_the_opcua_bridge_nothing,
    test_the_opcua_bridge_accounts_for_every_value,
)
from plant import Loop
from others import (  # noqa: F401
    test_results_come_into_pandas_from_recordings_and_live,
    test_the_foxglove_layout_finds_its_topics_in_a_recording,
)
from receivers import test_an_alarm_arrives_where_operators_look  # noqa: F401

PREFIX = "plant1/area1"
PLANE = f"{PREFIX}/@stiction/v1"
START_NS = 1_546_300_800 * 10**9  # 2019-01-01T00:00:00Z, a whole hop
SCANS = 1900
HOP_S = 300

BUSY = f"""
[gap]
budget_evaluations = 3000
[window]
hop_s = {HOP_S}
lateness_s = 3
[alarm]
raise = [2, 3]
[input.modes]
1 = "auto"
2 = "manual"
[[loop]]
name = "FIC101"
op_range = [0, 100]
area = "Area 1"
equipment = "FV-101"
[[loop]]
name = "PIC103"
op = "gateway/opc/PIC103.MV"
pv = "gateway/opc/PIC103.PV"
mode = "gateway/opc/PIC103.MODE"
"""

ESTIMATE = {
    "schema": str, "loop": str, "window": dict, "oscillation": dict, "verdict": str, "contributing": list,
    "stiction": (bool, None), "p_stiction": (float, None), "p_calibrated": (float, None), "prevalence": float, "confidence": (float, None), "gates": list,
    "grade": (str, None), "fs": (float, None), "fd": (float, None), "s": (float, None), "j": (float, None),
    "fs_interval": (list, None), "fd_interval": (list, None), "s_interval": (list, None), "j_interval": (list, None),
    "interval_level": (float, None), "j_identifiable": (bool, None), "s_detectable": (float, None),
    "stiction_index": (float, None), "s_over_span": (float, None), "region": (str, None), "strength_by_span": (str, None),
    "severity_by_range": (str, None), "op_range": (list, None), "op_unit": (str, None), "valve_model": (str, None), "process": (dict, None), "controller": (dict, None),
    "indicators": list, "elapsed_ms": (None,), "version": str, "config_hash": str,
}
WINDOW = {"start_ns": int, "end_ns": int, "samples": int, "ts_s": float}
OSCILLATION = {
    "oscillating": bool, "period_s": (float, None), "periods": (float, None), "samples_per_period": (float, None),
    "regularity": (float, None),
}
PROCESS = {
    "order": int, "gain": float, "time_constants_s": list, "dead_time_s": float, "integrating": bool, "mse": float,
    "fit_pct": float,
}
ALARM = {
    "schema": str, "loop": str, "alarm": str, "event_id": str, "occurrence_id": (str, None), "event": str, "state": str,
    "active": bool, "priority": (str, None), "criticality": (int, None), "area": (str, None), "equipment": (str, None),
    "ne107": str, "class": (str, None), "unit": str, "verdict": (str, None), "s": (float, None),
    "s_interval": (list, None), "s_limit": (float, None), "p": (float, None), "p_calibrated": (float, None), "prevalence": (float, None), "size": (str, None), "limit": (str, None), "probability": (str, None), "stiction_index": (float, None),
    "window": (dict, None), "why": (str, None), "what_to_do": (str, None), "since_ns": (int, None),
    "since": (str, None), "changed_ns": int, "changed": str, "by": (str, None), "detail": str,
    "acknowledged": (dict, None), "shelved": (dict, None), "suppressed": (dict, None), "out_of_service": (dict, None),
}
VERDICTS = {"stiction", "deadband", "disturbance", "tuning", "not_oscillating", "cause_unknown", "inconclusive"}


def check_fields(document, fields, where):
    for name, kinds in fields.items():
        assert name in document, f"{where}: no field {name}"
        value = document[name]
        kinds = kinds if isinstance(kinds, tuple) else (kinds,)
        fits = any(
            value is None if kind is None
            else isinstance(value, (int, float)) and not isinstance(value, bool) if kind is float
            else isinstance(value, kind) and (kind is bool or not isinstance(value, bool))
            for kind in kinds
        )
        assert fits, f"{where}: {name} is {value!r}"


def check_estimate(document):
    where = f"estimate of {document.get('loop')}"
    check_fields(document, ESTIMATE, where)
    check_fields(document["window"], WINDOW, where)
    check_fields(document["oscillation"], OSCILLATION, where)
    if document["process"] is not None:
        check_fields(document["process"], PROCESS, where)
    assert document["schema"] == "stictiond.estimate.v1"
    assert document["verdict"] in VERDICTS
    truth = {"stiction": True, "deadband": True, "inconclusive": None}
    assert document["stiction"] is truth.get(document["verdict"], False)
    assert document["window"]["end_ns"] % (HOP_S * 10**9) == 0


def objects(values, quality=0):
    return [(json.dumps({"t": START_NS + k * 10**9, "v": v, "q": quality}), None) for k, v in enumerate(values)]


def interleaved(bus, keys, columns, encoding=zenoh.Encoding.APPLICATION_JSON):
    """Several signals scan by scan (or batch by batch), as a gateway sends them."""
    publishers = [
        bus.declare_publisher(key, encoding=encoding, congestion_control=zenoh.CongestionControl.BLOCK) for key in keys
    ]
    for publisher in publishers:
        eventually("a subscriber", lambda p=publisher: p.matching_status.matching, 20)
    for rows in zip(*columns):
        for publisher, (payload, timestamp) in zip(publishers, rows):
            publisher.put(payload, timestamp=timestamp)


def batches(values, size, rfc3339=False):
    def stamp(k):
        t = START_NS + k * 10**9
        return datetime.fromtimestamp(t // 10**9, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ") if rfc3339 else t

    each = [{"t": stamp(k), "v": v} for k, v in enumerate(values)]
    return [(json.dumps(each[k : k + size]), None) for k in range(0, len(each), size)]


def raw(values):
    """Little-endian f64; the time travels as the Zenoh timestamp."""
    zid = bytes(16 - 1) + b"\x07"
    start = START_NS // 10**9
    return [
        (struct.pack("<d", v), zenoh.Timestamp(datetime.fromtimestamp(start + k, timezone.utc), zid[::-1]))
        for k, v in enumerate(values)
    ]


class Heard:
    """Everything that the daemon publishes."""

    def __init__(self, bus):
        self.by_key = defaultdict(list)
        self.encodings = Counter()
        # A wildcard never matches a chunk that starts with @.
        self.subscribers = [bus.declare_subscriber(f"{PLANE}/{k}", self.take) for k in ("**", "@daemon/*/health")]

    def take(self, sample):
        self.by_key[str(sample.key_expr)].append(json.loads(sample.payload.to_string()))
        self.encodings[str(sample.encoding)] += 1

    def estimates(self, loop):
        return self.by_key[f"{PLANE}/{loop}/estimate"]


def ask(bus, selector, timeout=5):
    """Answers to a query: documents by key, and errors."""
    good, bad = {}, []
    for reply in bus.get(selector, timeout=timeout):
        if reply.ok is not None:
            good[str(reply.ok.key_expr)] = json.loads(reply.ok.payload.to_string())
        else:
            bad.append(reply.err.payload.to_string())
    return good, bad


def test_live_recorded_replayed(folder):
    port = free_port()
    sticking = Loop(fs=5.0, fd=2.0, seed=1).run(SCANS)
    healthy = Loop(kc=0.3, ti_s=25.0, seed=2).run(SCANS)
    disturbed = Loop(gain=1.5, tau_s=12.0, dead_time_s=4, ti_s=14.0, sine=3.0, seed=3).run(SCANS)
    nested = Loop(fs=4.0, fd=1.5, seed=4).run(SCANS)
    raw_loop = Loop(fs=4.5, fd=1.0, seed=5).run(SCANS)
    shaky = Loop(fs=5.0, fd=2.0, seed=6).run(SCANS)
    history = Loop(fs=5.0, fd=2.0, seed=10).run(SCANS)
    loops = ["FIC101", "TIC102", "PIC103", "unit2/FIC201", "FIC105", "FIC106", "FIC108"]
    with Daemon(folder, PREFIX, f'[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]', BUSY) as daemon:
        bus = session("peer", connect=[f"tcp/127.0.0.1:{port}"])
        heard = Heard(bus)
        time.sleep(0.5)

        # One loop after another, all from the same instant years ago, in every form.
        fic101 = [f"{PREFIX}/FIC101/{s}" for s in ("op", "sp", "mode", "pv")]
        interleaved(bus, fic101, [
            objects(sticking.op), objects([61.0] * SCANS), objects(["AUTO"] * SCANS), objects(sticking.pv),
        ])
        interleaved(bus, [f"{PREFIX}/TIC102/{s}" for s in ("op", "pv")],
                    [batches(healthy.op, 100), batches(healthy.pv, 100, rfc3339=True)])
        pic103 = [f"gateway/opc/PIC103.{s}" for s in ("MV", "MODE", "PV")]
        interleaved(bus, pic103, [objects(disturbed.op), objects([1] * SCANS), objects(disturbed.pv)])
        interleaved(bus, [f"{PREFIX}/unit2/FIC201/{s}" for s in ("op", "pv")],
                    [batches(nested.op, 1), batches(nested.pv, 1)])
        interleaved(bus, [f"{PREFIX}/FIC105/{s}" for s in ("op", "pv")], [raw(raw_loop.op), raw(raw_loop.pv)], None)
        # A history all at once: all of OP, then all of PV.
        interleaved(bus, [f"{PREFIX}/FIC108/{s}" for s in ("op", "pv")],
                    [batches(history.op, SCANS), batches(history.pv, SCANS)])
        # Every third value of PV is bad and NaN: too many to judge.
        bad = [
            (json.dumps({"t": START_NS + k * 10**9, "v": v if k % 3 else math.nan, "q": 0 if k % 3 else 0x80000000}), None)
            for k, v in enumerate(shaky.pv)
        ]
        interleaved(bus, [f"{PREFIX}/FIC106/{s}" for s in ("op", "pv")], [objects(shaky.op), bad])
        interleaved(bus, [f"{PREFIX}/FIC107/op", f"{PREFIX}/FIC101/flow"], [[("not a number", None)], [("1.0", None)]])

        wanted = SCANS // HOP_S
        for loop in loops:
            # The first scan is on a whole hop, so it makes a window of one sample.
            eventually(f"{wanted + 1} estimates of {loop}", lambda l=loop: len(heard.estimates(l)) > wanted, 120)
        for loop in loops:
            for document in heard.estimates(loop):
                check_estimate(document)
                assert document["loop"] == loop
            ends = [d["window"]["end_ns"] for d in heard.estimates(loop)]
            assert ends == sorted(ends) and ends[-1] == START_NS + wanted * HOP_S * 10**9, (loop, ends)
        verdicts = {loop: heard.estimates(loop)[-1]["verdict"] for loop in loops}
        for loop in loops:
            d = heard.estimates(loop)[-1]
            print(f"    {loop}: {d['verdict']}, s {d['s']}, j {d['j']}, index {d['stiction_index']}, {d['gates']}")
        near = []
        for loop, truth in (("FIC101", 7.0), ("unit2/FIC201", 5.5), ("FIC105", 5.5), ("FIC108", 7.0)):
            last = heard.estimates(loop)[-1]
            assert last["verdict"] == "stiction" and last["stiction"] is True, (loop, last)
            near.append(abs(last["s"] - truth) < 0.25 * truth)
            assert 0 <= last["fd"] <= last["fs"] and last["stiction_index"] > 0.5
        # In one of four short windows the search may end at a wrong optimum.
        assert sum(near) >= 3, near
        assert abs(heard.estimates("FIC101")[-1]["oscillation"]["period_s"] - 77) < 8
        assert heard.estimates("FIC101")[-1]["severity_by_range"] == "strong"
        assert heard.estimates("FIC105")[-1]["severity_by_range"] is None
        for loop in ("TIC102", "PIC103"):
            assert heard.estimates(loop)[-1]["stiction"] is False, heard.estimates(loop)[-1]
        assert verdicts["FIC106"] == "inconclusive" and "bad_quality" in heard.estimates("FIC106")[-1]["gates"]
        assert set(heard.encodings) == {
            f"application/json;stictiond.{name}"
            for name in ("estimate.v1", "alarm.v2", "loop_health.v1", "daemon_health.v1")
        }, heard.encodings

        # The alarm, its acknowledgement, and commands that are refused.
        key = f"{PLANE}/FIC101/alarm"
        raised = eventually("an alarm", lambda: heard.by_key[key])[0]
        check_fields(raised, ALARM, key)
        assert (raised["schema"], raised["state"], raised["active"]) == ("stictiond.alarm.v2", "unack", True), raised
        assert raised["ne107"] == "M" and raised["by"] is None and raised["since_ns"] % (HOP_S * 10**9) == 0
        assert datetime.fromisoformat(raised["since"]).timestamp() == raised["since_ns"] / 10**9, raised["since"]
        assert (raised["unit"], raised["area"], raised["equipment"]) == ("%", "Area 1", "FV-101"), raised
        assert raised["s"] >= raised["s_limit"] > 0 and 0.5 < raised["p"] <= 1, raised
        good, bad = ask(bus, f"{key}?cmd=ack;by=ann;why=seen")
        assert not bad and good[key]["state"] == "acked" and good[key]["active"] is True, (good, bad)
        assert (good[key]["by"], good[key]["detail"], good[key]["why"]) == ("ann", "seen", raised["why"])
        assert (good[key]["acknowledged"]["by"], good[key]["acknowledged"]["why"]) == ("ann", "seen")
        assert good[key]["occurrence_id"] == raised["occurrence_id"] and good[key]["event_id"] != raised["event_id"]
        eventually("the acknowledgement on the bus", lambda: heard.by_key[key][-1]["state"] == "acked")
        for selector in (
            f"{key}?cmd=ack;by=ann", f"{key}?cmd=explode", f"{PLANE}/FIC999/alarm?cmd=ack",
            f"{PLANE}/*/alarm?cmd=ack", f"{PLANE}/FIC101/estimate?cmd=ack",
        ):
            good, bad = ask(bus, selector)
            assert not good and len(bad) == 1 and bad[0], (selector, good, bad)

        # A gap diagnosis on demand: answered, published, and the last value from then on.
        key = f"{PLANE}/FIC101/gap"
        good, bad = ask(bus, f"{key}?run;by=ann", timeout=300)
        assert not bad and set(good) == {key}, (good, bad)
        document = good[key]
        assert (document["schema"], document["loop"]) == ("stictiond.gap.v1", "FIC101"), document
        assert (document["reason"], document["by"], document["evaluations"] > 0) == ("operator", "ann", True), document
        assert document["cause"]["id"] and 0 <= document["cause"]["probability"] <= 1, document["cause"]
        eventually("the diagnosis on the bus", lambda: document in heard.by_key[key])
        good, bad = ask(bus, key)
        assert not bad and good[key] == heard.by_key[key][-1]
        for selector in (f"{PLANE}/FIC999/gap?run", f"{PLANE}/*/gap?run", f"{PLANE}/FIC101/estimate?run"):
            good, bad = ask(bus, selector)
            assert not good and len(bad) == 1 and bad[0], (selector, good, bad)

        # Last values.
        good, bad = ask(bus, f"{PLANE}/*/estimate")
        assert not bad and set(good) == {f"{PLANE}/{l}/estimate" for l in loops if "/" not in l}, (set(good), bad)
        assert good[f"{PLANE}/FIC101/estimate"] == heard.estimates("FIC101")[-1]
        good, _ = ask(bus, f"{PLANE}/unit2/FIC201/estimate")
        assert len(good) == 1
        assert ask(bus, f"{PLANE}/FIC999/estimate") == ({}, [])
        assert ask(bus, f"{PREFIX}/**") == ({}, [])  # plant wildcards never meet the daemon's plane

        # The schemas as printed by the program.
        good, bad = ask(bus, f"{PLANE}/@schema/*")
        names = stictiond("schema")[1].split()
        assert not bad and set(good) == {f"{PLANE}/@schema/{name}" for name in names}, (set(good), bad)
        assert good[f"{PLANE}/@schema/stictiond.alarm.v2"] == json.loads(stictiond("schema", "stictiond.alarm.v2")[1])

        # Health and liveliness.
        tokens = [str(r.ok.key_expr) for r in bus.liveliness().get(f"{PLANE}/@daemon/*", timeout=5)]
        assert len(tokens) == 1, tokens
        health_key = f"{tokens[0]}/health"
        eventually("health with everything counted", lambda: heard.by_key[health_key]
                   and heard.by_key[health_key][-1]["counters"]["undecodable"] == 1, 20)
        health = heard.by_key[health_key][-1]
        assert health["schema"] == "stictiond.daemon_health.v1" and health["loops"] == len(loops) + 1, health
        assert health["counters"]["foreign_keys"] == 1 and health["counters"]["dropped_input"] == 0, health
        assert health["faults"] == [] and {q["name"] for q in health["queues"]} >= {"input", "recorder"}, health
        good, _ = ask(bus, health_key)
        assert good[health_key]["daemon"] == health["daemon"] and tokens[0].endswith(health["daemon"])
        assert daemon.healthz()["config_hash"] == health["config_hash"]
        eventually("health of a loop", lambda: heard.by_key[f"{PLANE}/FIC106/health"], 70)
        of_loop = heard.by_key[f"{PLANE}/FIC106/health"][-1]
        check_fields(of_loop, {"schema": str, "loop": str, "data_age_s": float, "data_gaps": int, "dropped": int}, "health")
        text = daemon.get("/metrics")
        assert "stictiond_estimates_total" in text and text.rstrip().endswith("# EOF")
        samples = int(next(l for l in text.splitlines() if l.startswith("stictiond_samples_total")).split()[1])
        assert samples == SCANS * (4 + 2 + 3 + 2 + 2 + 2 + 2), samples

        alarms_heard = len(heard.by_key[f"{PLANE}/FIC101/alarm"])
        daemon.stop()
        bus.close()
    check_recording(daemon, sticking, heard, alarms_heard)
    documents = [d for of_key in heard.by_key.values() for d in of_key]
    assert {d["schema"] for d in documents} >= {
        f"stictiond.{name}" for name in ("estimate.v1", "alarm.v2", "gap.v1", "loop_health.v1", "daemon_health.v1")
    }
    for document in documents:
        check_document(document)


def check_recording(daemon, sticking, heard, alarms_heard):
    # The folder contains the recordings, the store of alarm states, and nothing else.
    files = sorted(f for f in daemon.recordings.iterdir() if f.name != "state.redb")
    assert files and all(f.suffix == ".mcap" and f.is_file() for f in files), files
    counts, op, estimates, alarms = Counter(), [], [], []
    for index, path in enumerate(files):
        with path.open("rb") as file:
            reader = make_reader(file)
            records = {m.name: m.metadata for m in reader.iter_metadata()}
            (metadata,) = [m for m in records.values() if "run_id" in m]
            for name in ("config", "version", "config_hash", "run_id", "file_index", "previous"):
                assert name in metadata, (name, sorted(metadata))
            assert metadata["config"] == daemon.config.read_text() and metadata["file_index"] == str(index)
            assert bool(metadata["previous"]) == (index > 0)
            summary = reader.get_summary()
            assert summary is not None and all(c.compression == "zstd" for c in summary.chunk_indexes)
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                assert channel.message_encoding == "json" and schema.encoding == "jsonschema", channel
                assert json.loads(schema.data)["type"] == "object"
                counts[channel.topic] += 1
                document = json.loads(message.data)
                if channel.topic == f"{PREFIX}/FIC101/op":
                    op.append((message.publish_time, document["v"]))
                    assert message.log_time > START_NS + 10**17 and document["t"] == message.publish_time
                if channel.topic == f"{PLANE}/FIC101/estimate":
                    estimates.append(document)
                if channel.topic == f"{PLANE}/FIC101/alarm":
                    alarms.append(document)
    raw = {f"{PREFIX}/FIC101/{s}" for s in ("op", "sp", "mode", "pv")}
    raw |= {f"{PREFIX}/PIC103/{s}" for s in ("op", "mode", "pv")}
    raw |= {f"{PREFIX}/{l}/{s}" for l in ("TIC102", "unit2/FIC201", "FIC105", "FIC106", "FIC108") for s in ("op", "pv")}
    for topic in raw:
        assert counts[topic] == SCANS, (topic, counts[topic])
    for topic in set(counts) - raw:
        assert topic.startswith(f"{PLANE}/"), topic
    assert op == [(START_NS + k * 10**9, v) for k, v in enumerate(sticking.op)], "values as sent"
    assert estimates == heard.estimates("FIC101")
    assert alarms == heard.by_key[f"{PLANE}/FIC101/alarm"] and len(alarms) == alarms_heard
    code, out, err = stictiond("replay", daemon.recordings, "--verify")
    assert code == 0, (code, out, err)
    print("   ", out.strip())


def test_waits_for_a_router_and_comes_back_to_it(folder):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = f'[zenoh]\nmode = "client"\nconnect = ["{endpoint}"]'
    with Daemon(folder, PREFIX, config, "[window]\nhop_s = 60\n") as daemon:
        time.sleep(3)
        sent = 0
        for life in range(2):
            router = session("router", listen=[endpoint])
            values = [50.0 + math.sin(k / 7) for k in range(100)]
            shift = [
                (json.dumps({"t": START_NS + (life * 1000 + k) * 10**9, "v": v}), None) for k, v in enumerate(values)
            ]
            interleaved(router, [f"{PREFIX}/FIC101/op"], [shift])
            sent += len(values)
            eventually(
                "every sample",
                lambda: (daemon.healthz()["counters"].get("samples", 0)) == sent, 20,
            )
            eventually("an answer by way of the router", lambda: list(ask(router, f"{PLANE}/@daemon/*/health")[0]), 20)
            router.close()
            time.sleep(1)
        daemon.stop()


def test_stops_without_its_router(folder):
    config = f'[zenoh]\nmode = "client"\nconnect = ["tcp/127.0.0.1:{free_port()}"]'
    with Daemon(folder, PREFIX, config) as daemon:
        time.sleep(1)
        daemon.stop()
    assert all(f.suffix == ".mcap" or f.name == "state.redb" for f in daemon.recordings.glob("*"))


def test_the_example_gateway(folder):
    port = free_port()
    loop = Loop(fs=5.0, fd=2.0, seed=9).run(700)
    table = Path(folder) / "fic101.csv"
    with table.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["t", "op", "pv", "mode"])
        rows = zip(loop.op, loop.pv)
        writer.writerows([f"{START_NS // 10**9 + k}.5", op, pv, "auto" if k == 0 else ""] for k, (op, pv) in enumerate(rows))
    config = f'[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]'
    with Daemon(folder, PREFIX, config, "[window]\nhop_s = 300\n") as daemon:
        done = subprocess.run(
            [sys.executable, ROOT / "examples" / "gateway.py", f"tcp/127.0.0.1:{port}", PREFIX, f"FIC101={table}"],
            capture_output=True, text=True, timeout=60,
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout == "1401 values of 3 signals sent\n", done.stdout
        eventually("every sample", lambda: daemon.healthz()["counters"].get("samples") == 1401, 20)
        eventually("two windows", lambda: daemon.healthz()["counters"]["estimates"] == 2, 60)
        daemon.stop()


GAP = {
    "schema": str, "loop": str, "window": dict, "base": dict, "gap": dict, "given": (dict, None), "where": dict,
    "effects": list, "cause": dict, "alternatives": list, "forward": (dict, None), "model_after": dict,
    "next_test": (dict, None), "evaluations": int, "version": str,
}
WHERE = {
    "stage": str, "segments": list, "phases": dict, "direction": dict, "bands": list, "level": list, "slips": dict,
    "onset_s": (float, None), "signatures": list, "excitation": dict, "op_to_mv": (dict, None),
    "mv_to_pv": (dict, None),
}


def test_the_gap_can_be_computed_from_the_predictions(folder):
    # No particular cause is expected: whatever is answered must follow from the rows.
    plant = Loop(fs=4.0, fd=1.5, sine=1.0, seed=5).run(1000)
    table, rows_file = Path(folder) / "loop.csv", Path(folder) / "rows.csv"
    with table.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["t", "op", "pv"])
        writer.writerows([START_NS // 10**9 + k, op, pv] for k, (op, pv) in enumerate(zip(plant.op, plant.pv)))
    code, out, err = stictiond("gap", table, "--predictions", rows_file, "--format", "json")
    assert code == 0, err
    document = json.loads(out)
    check_fields(document, GAP, "the gap document")
    check_document(document)
    check_fields(document["where"], WHERE, "where")
    with rows_file.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["t", "pv", "pv_base", "pv_after", "held_out"]
    assert len(rows) == 1000 and [float(r["pv"]) for r in rows] == plant.pv
    held = [r for r in rows if r["held_out"] == "1"]
    assert len(held) > 300

    def rmse(column):
        return math.sqrt(sum((float(r["pv"]) - float(r[column])) ** 2 for r in held) / len(held))

    floor = document["gap"]["noise_floor"] or 0.0

    def gap(column):
        return math.sqrt(max(rmse(column) ** 2 - floor**2, 0.0))

    same = lambda a, b: math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-9)
    assert same(rmse("pv_base"), document["gap"]["rmse"])
    assert same(gap("pv_base"), document["gap"]["gap"])
    named = [e for e in document["effects"] if e["id"] == document["cause"]["id"]]
    if named:
        # Near the floor a gap is a small difference of two squares, and the rows are rounded.
        assert math.isclose(gap("pv_after"), named[0]["gap_after"], rel_tol=1e-6, abs_tol=1e-6 * floor + 1e-6)
        if named[0]["closed_pct"] is not None:
            assert same(100 * (1 - gap("pv_after") / gap("pv_base")), named[0]["closed_pct"])
    else:
        assert document["cause"]["id"] in ("none", "unknown")
        assert all(r["pv_base"] == r["pv_after"] for r in rows)


def main():
    wanted = sys.argv[1:]
    tests = {name: test for name, test in globals().items() if name.startswith("test_")}
    assert not set(wanted) - set(tests), f"tests: {', '.join(tests)}"
    for name, test in tests.items():
        if wanted and name not in wanted:
            continue
        started = time.monotonic()
        print(f"{name} ...", flush=True)
        with tempfile.TemporaryDirectory(prefix="stictiond-interop-") as folder:
            try:
                test(folder)
            finally:
                close_sessions()
        print(f"{name} ok ({time.monotonic() - started:.1f} s)", flush=True)


if __name__ == "__main__":
    main()
