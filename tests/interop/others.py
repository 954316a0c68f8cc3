"""Third-party tools: the layout for Foxglove and Lichtblick, results in pandas."""

import json
import re
import sys
import time
from collections import defaultdict

from mcap.reader import make_reader

from daemon import ROOT, Daemon, free_port, stictiond

RECORDING = ROOT / "recordings" / "four-loops.mcap"
LAYOUT = ROOT / "config" / "foxglove-layout.json"
# Panels that both programs have.
PANELS = {"Plot", "StateTransitions", "Table", "RawMessages", "RosOut"}
# Topic of the log panel, called RosOut in layouts; only a daemon records it.
LOG_TOPIC = "area2/@stiction/v1/@plant/log"


def message_path(text):
    """Topic and steps of a message path, by the grammar of both programs: "topic".name[index].name."""
    whole = re.fullmatch(r'"([^"\\]+)"((?:\.[A-Za-z0-9_-]+(?:\[-?\d+\])?)*)', text)
    assert whole, f"no message path: {text}"
    steps = []
    for name, index in re.findall(r"\.([A-Za-z0-9_-]+)(?:\[(-?\d+)\])?", whole[2]):
        steps += [name] + ([int(index)] if index else [])
    return whole[1], steps


def resolved(value, steps):
    for step in steps:
        try:
            value = value[step]
        except (KeyError, IndexError, TypeError):
            return None
    return value


def leaves(layout):
    if isinstance(layout, str):
        return [layout]
    assert set(layout) == {"direction", "first", "second", "splitPercentage"}, layout
    assert layout["direction"] in ("row", "column") and 0 < layout["splitPercentage"] < 100
    return leaves(layout["first"]) + leaves(layout["second"])


def test_the_foxglove_layout_finds_its_topics_in_a_recording(folder):
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    assert {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"} <= set(layout)
    panels = layout["configById"]
    assert sorted(leaves(layout["layout"])) == sorted(panels), "each panel stands in the mosaic once"
    messages, schemas = defaultdict(list), {}
    with RECORDING.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            messages[channel.topic].append(json.loads(message.data))
            schemas[channel.topic] = (schema.encoding, json.loads(schema.data), channel.message_encoding)
    checked = 0
    for name, panel in panels.items():
        kind = name.split("!")[0]
        assert kind in PANELS, name
        if kind == "RosOut":
            assert panel["topicToRender"] == LOG_TOPIC
            continue
        paths = [p["value"] for p in panel["paths"]] if "paths" in panel else [panel["topicPath"]]
        assert paths, name
        for text in paths:
            topic, steps = message_path(text)
            assert topic in messages, f"{name}: {text}: no such topic"
            encoding, schema, message_encoding = schemas[topic]
            assert (encoding, message_encoding) == ("jsonschema", "json") and schema["type"] == "object"
            found = [v for v in (resolved(m, steps) for m in messages[topic]) if v is not None]
            assert found, f"{name}: {text}: null in every message"
            wanted = {"Plot": (int, float), "StateTransitions": (str, int, bool), "Table": list, "RawMessages": dict}[kind]
            assert all(isinstance(v, wanted) for v in found), f"{name}: {text}: {found[0]!r}"
            if kind == "Table":
                assert all(isinstance(row, dict) for rows in found for row in rows)
            checked += 1
    assert checked > 12, checked
    # Replacing the loop as shown on the page leaves no reference to the old one.
    text = LAYOUT.read_text(encoding="utf-8").replace("area2", "plant1/area1").replace("FIC201", "FIC101")
    assert "area2" not in text and '\\"plant1/area1/@stiction/v1/FIC101/estimate\\".s"' in text


def logged(recordings):
    """Log messages of a daemon's recordings, as the log panel needs them."""
    found = []
    for path in sorted(recordings.glob("*.mcap")):
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages(topics=[LOG_TOPIC]):
                assert (schema.name, schema.encoding, channel.message_encoding) == ("foxglove.Log", "jsonschema", "json")
                assert json.loads(schema.data)["type"] == "object" and "http" not in schema.data.decode()
                found.append(json.loads(message.data))
    return found


def test_results_come_into_pandas_from_recordings_and_live(folder):
    sys.path.insert(0, str(ROOT / "examples"))
    from results_to_pandas import Live, from_recording

    recorded = from_recording(RECORDING)
    estimates = recorded.estimates
    newest = estimates.groupby("loop").tail(1).set_index("loop")
    assert newest["verdict"].to_dict()["FIC201"] == "stiction" and len(newest) == 4
    assert (newest["s_low"] <= newest["s"]).all() and (newest["s"] <= newest["s_high"]).all()
    assert list(recorded.alarms["loop"]) == ["FIC201", "LIC202"]
    counts = recorded.samples.groupby(["loop", "signal"]).size()
    assert counts.loc[("area2/FIC201", "op")] == 1800 and len(counts) == 12

    endpoint = f"tcp/127.0.0.1:{free_port()}"
    more = "[window]\nhop_s = 300.0\n[alarm]\nraise = [3, 4]\n"
    with Daemon(folder, "area2", f'[zenoh]\nlisten = ["{endpoint}"]', more) as daemon:
        with Live(endpoint, "area2") as live:
            time.sleep(0.5)
            played = stictiond("play", RECORDING, "--connect", endpoint, "--prefix", "area2", "--speed", "100")
            assert played[0] == 0, played
            end = time.monotonic() + 120
            wanted = len(estimates), len(recorded.samples)
            while time.monotonic() < end:
                if len(live.frames.estimates) >= wanted[0] and len(live.frames.samples) >= wanted[1]:
                    break
                time.sleep(0.5)
            samples = live.frames.samples
        # A late subscriber begins with the last answers.
        with Live(endpoint, "area2") as late:
            assert len(late.frames.estimates) == 4
        daemon.stop()
    log = logged(daemon.recordings)
    assert {(one["name"], one["level"]) for one in log} >= {("FIC201", 4), ("LIC202", 4)}, log
    assert all(one["message"] and 0 <= one["timestamp"]["nsec"] < 10**9 for one in log)
    both = live.frames.estimates.merge(estimates, on=["loop", "time"], suffixes=("_live", "_recorded"))
    both = both[both["verdict_live"] != "inconclusive"]
    assert len(both) >= 12, len(both)
    assert (both["verdict_live"] == both["verdict_recorded"]).all()
    assert len(samples) == len(recorded.samples), (len(samples), len(recorded.samples))
