#!/usr/bin/env python3
"""What a fleet's history costs on this machine: CPU time a window, share of the engines, one and two workers.

    pip install ./python pyarrow dask distributed
    python examples/fleet/measure.py FOLDER [--loops 20 --sticking 1 --days 5]

CPU time is that of all processes, so other work on the machine hardly changes it; elapsed time it does.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq

from fleet import plan
from make import make

HERE = Path(__file__).resolve().parent
YEARS_WINDOWS = 15_000_000
SHARES_PCT = (0, 2, 10, 30, 100)


def timed(command):
    """Elapsed and CPU time of a program with all that it started, s, and what it printed."""
    started = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        lines = process.stdout.read().splitlines()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, command
    return time.perf_counter() - started, used.ru_utime + used.ru_stime, lines


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in sorted(folder.glob("loop=*/*.parquet"))}


def engines(folder, data):
    """A row an engine: all must make the same files. Gives what the first said of each month, and its files."""
    print(f"{'':10}{'elapsed s':>10}{'CPU s':>8}{'in months':>11}{'else':>7}{'nothing to do':>15}{'share of the engine':>21}")
    first = None
    for name in ("pool", "dask"):
        for workers in (1, 2):
            results = folder / f"{name}-{workers}"
            command = [sys.executable, str(HERE / f"{name}_fleet.py"), str(data), str(results), str(workers)]
            elapsed, cpu, lines = timed(command)
            said = [json.loads(line) for line in lines]
            assert all(one["state"] == "done" for one in said) and len(said) == len(list(plan(data, results)))
            # Again, with nothing to do: starting, ending, and looking at each month.
            idle = timed(command)[1]
            months = sum(one["cpu_s"] for one in said)
            print(f"{name} {workers:<5}{elapsed:>10.1f}{cpu:>8.1f}{months:>11.1f}{cpu - months:>7.1f}", end="")
            print(f"{idle:>15.1f}{100 * (cpu - months) / cpu:>19.1f} %", flush=True)
            first = first or (said, results, contents(results))
            assert contents(results) == first[2], "the results differ"
    return first[:2]


def costs(said, results, sticking):
    """CPU time a window, s, of calm and of sticking loops."""
    used, windows, fitted, screened, size = {}, {}, {}, {}, 0
    for one in said:
        target = results / f"loop={one['loop']}" / f"{one['month']}.parquet"
        made = pq.read_table(target, columns=["search_evaluations", "reason"], partitioning=None)
        kind = "sticking" if int(one["loop"][3:]) <= sticking else "calm"
        used[kind] = used.get(kind, 0.0) + one["cpu_s"]
        windows[kind] = windows.get(kind, 0) + one["windows"]
        fitted[kind] = fitted.get(kind, 0) + len(made) - made["search_evaluations"].null_count
        screened[kind] = screened.get(kind, 0) + made["reason"].to_pylist().count("screened")
        size += target.stat().st_size
    for kind, count in sorted(windows.items()):
        each = 1e3 * used[kind] / count
        let_go, fits = 100 * screened[kind] / count, 100 * fitted[kind] / count
        print(f"{kind} loops: {each:.1f} ms of CPU a window ({count} windows: {let_go:.0f} % screened, {fits:.0f} % fitted)")
    print(f"results: {size / sum(windows.values()):.0f} bytes a window")
    return {kind: used[kind] / count for kind, count in windows.items()}


def main():
    """Simulates the fleet, runs the engines, prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--loops", type=int, default=20)
    parser.add_argument("--sticking", type=int, default=1)
    parser.add_argument("--days", type=int, default=5)
    asked = parser.parse_args()
    data = asked.folder / "data"
    make(data, asked.loops, asked.sticking, asked.days, start="2026-01-29")
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; {json.dumps(vars(asked), default=str)}\n")
    each = costs(*engines(asked.folder, data), asked.sticking)
    print(f"\ncomputed from that: core-hours for {YEARS_WINDOWS:,} windows, by the share of sticking loops")
    for share in SHARES_PCT:
        seconds = share / 100 * each["sticking"] + (1 - share / 100) * each["calm"]
        print(f"{share:>4} %{YEARS_WINDOWS * seconds / 3600:>10.0f}")


if __name__ == "__main__":
    main()
