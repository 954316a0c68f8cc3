#!/usr/bin/env python3
"""A simulated fleet as Parquet, laid out as `fleet.py` reads it: loop=NAME/day=YYYY-MM-DD/part.parquet.

    pip install ./python pyarrow
    python examples/fleet/make.py FOLDER --loops 50 --sticking 1 --days 40

The first loops stick, the others only pass noise on.
"""

import argparse
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import stiction


def scenario(name, seed, sticks, start, days, ts_s):
    """One slow loop; with a sampling time of 10 s a sticking one has a period of some 1,000 s."""
    return {
        "site": {"prefix": "plant"},
        "run": {
            "start": f"{start}T00:00:00Z", "duration_s": days * 86_400.0, "ts_s": ts_s, "seed": seed, "warmup_s": 180 * ts_s,
        },
        "loop": [{
            "name": name, "operating_point": {"op": 50.0, "pv": 60.0}, "setpoint": 61.0,
            "process": {"gain": 2.0, "time_constants_s": [20 * ts_s], "dead_time_s": 6 * ts_s},
            "controller": {"kc": 0.8 if sticks else 0.5, "ti_s": (8 if sticks else 20) * ts_s, "op_resolution": 0.01},
            "valve": {"law": "he", "fs": 5.0, "fd": 3.0} if sticks else {"law": "none"},
            "noise": {"pv_sd": 0.05 if sticks else 0.5}, "recording": {"pv_quantum": 0.01},
        }],
    }  # fmt: skip


def write(folder, loop):
    """A file a day."""
    days = loop.t.astype("datetime64[D]")
    for day in np.unique(days):
        rows = days == day
        columns = {"t": pa.array(loop.t[rows], pa.timestamp("ns", "UTC"))}
        columns.update({name: getattr(loop, name)[rows] for name in ("op", "pv", "sp")})
        place = Path(folder) / f"loop={quote(loop.loop, safe='')}" / f"day={day}"
        place.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table(columns), place / "part.parquet", compression="zstd")


def make(folder, loops, sticking, days, start="2026-01-01", ts_s=10.0):
    """Writes the whole fleet."""
    for at in range(loops):
        plant = scenario(f"TIC{at + 1:04}", at + 1, at < sticking, start, days, ts_s)
        write(folder, stiction.simulate(plant))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--loops", type=int, default=50)
    parser.add_argument("--sticking", type=int, default=1)
    parser.add_argument("--days", type=int, default=40)
    parser.add_argument("--start", default="2026-01-01")
    parser.add_argument("--ts-s", type=float, default=10.0)
    made = parser.parse_args()
    make(made.folder, made.loops, made.sticking, made.days, made.start, made.ts_s)
