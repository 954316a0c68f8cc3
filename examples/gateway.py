#!/usr/bin/env python3
"""The shortest gateway for stictiond: reads loops, publishes their signals over Zenoh.

    pip install "eclipse-zenoh>=1.10,<2"
    python examples/gateway.py tcp/127.0.0.1:7447 plant1/area1 FIC101=fic101.csv TIC102=tic102.csv

Each file has the columns t (seconds since 1970), op, pv and, if the loop has them, sp, mv and mode; an empty cell sends
nothing. For a plant of your own put its reader in place of `samples`: any generator of (seconds, signal, value, good).
"""

import csv
import heapq
import json
import sys
import time

import zenoh

SIGNALS = ("op", "sp", "mode", "mv", "pv")  # pv last: it closes a scan
UA_GOOD, UA_BAD = 0, 0x80000000  # [input] quality = "ua"


def samples(path):
    """Yields (t_ns, signal, value, good), oldest first."""
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            whole, _, fraction = row["t"].partition(".")
            t_ns = int(whole) * 10**9 + int((fraction + "0" * 9)[:9])
            for signal in SIGNALS:
                if text := row.get(signal):
                    yield t_ns, signal, text if signal == "mode" else float(text), True


def labelled(loop, path):
    for t_ns, signal, value, good in samples(path):
        yield t_ns, SIGNALS.index(signal), loop, value, good


def main(endpoint, prefix, *loops):
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    with zenoh.open(config) as session:
        publishers, sent = {}, 0
        for t_ns, signal, loop, value, good in heapq.merge(*(labelled(*entry.split("=", 1)) for entry in loops)):
            key = f"{prefix}/{loop}/{SIGNALS[signal]}"
            if key not in publishers:
                # BLOCK: better late than never; the default drops what the network cannot take at once.
                publishers[key] = session.declare_publisher(
                    key, encoding=zenoh.Encoding.APPLICATION_JSON, congestion_control=zenoh.CongestionControl.BLOCK
                )
                while not publishers[key].matching_status.matching:  # wait for somebody who listens
                    time.sleep(0.05)
            # The plant's own time and quality: stictiond never uses the time of arrival if it has this.
            publishers[key].put(json.dumps({"t": t_ns, "v": value, "q": UA_GOOD if good else UA_BAD}))
            sent += 1
        time.sleep(0.5)  # what was put last is still on its way
    print(f"{sent} values of {len(publishers)} signals sent")


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
