"""A fleet's history: every window of every loop, one loop and month at a time, from Parquet to Parquet.

    DATA/loop=FIC101/day=2026-01-05/*.parquet    t (timestamp, UTC), op, pv; sp, mv, mode where there are any
    RESULTS/loop=FIC101/2026-01.parquet          a row per window: the numbers of its estimate, and the whole document
    RESULTS/_errors/loop=FIC101/2026-02.json     why that month has no such file

`assess_month` is the unit of work. `pool_fleet.py`, `dask_fleet.py` and `spark_fleet.py` hand it out; README.md.
"""

import datetime as dt
import json
import math
import os
import platform
import time
from pathlib import Path
from urllib.parse import unquote

import pyarrow as pa
import pyarrow.parquet as pq
import stiction

HOP_S, MAX_WINDOW_S = 3600.0, 604_800.0
DAY = dt.timedelta(days=1)
SIGNALS = ("op", "pv", "sp", "mv", "mode")
TEXT, NUMBER, COUNT, FLAG, TIME = pa.string(), pa.float64(), pa.int64(), pa.bool_(), pa.timestamp("ns", "UTC")
TEXTS, NUMBERS = (pa.list_(pa.field("element", kind)) for kind in (TEXT, NUMBER))
INTERVALS = ("s_interval", "j_interval", "fs_interval", "fd_interval")
FIELDS = {
    TEXT: "verdict grade reason region valve_model strength_by_span severity_by_range search.solver search.stopped version "
    "config_hash",
    TIME: "window.start_ns window.end_ns",
    COUNT: "window.samples window.box_samples process.order search.evaluations search.rounds",
    FLAG: "stiction oscillation.oscillating j_identifiable process.integrating",
    NUMBER: "window.ts_s p_stiction p_calibrated prevalence confidence s j fs fd interval_level s_detectable stiction_index "
    "s_over_span pv_span oscillation.period_s oscillation.periods oscillation.samples_per_period oscillation.regularity process.gain "
    "process.dead_time_s process.mse process.fit_pct controller.kc controller.ti_s controller.td_s "
    "controller.lag_samples controller.r2 controller.unexplained explanation.base explanation.logit",
    TEXTS: "gates contributing implausible",
    NUMBERS: "process.time_constants_s",
}
PATHS = [(path, kind) for kind, paths in FIELDS.items() for path in paths.split()]
SCHEMA = pa.schema(
    [(path.removeprefix("window.").removesuffix("_ns").replace(".", "_"), kind) for path, kind in PATHS]
    + [(name.replace("interval", side), NUMBER) for name in INTERVALS for side in ("low", "high")]
    + [("document", TEXT)]
)


def plan(data, results):
    """Every loop and month, sorted; removes what killed workers left half written."""
    for part in Path(results).rglob(".*.part"):
        part.unlink(missing_ok=True)
    for folder in sorted(Path(data).glob("loop=*")):
        months = {day.name.removeprefix("day=")[:7] for day in folder.glob("day=*")}
        yield from ((unquote(folder.name.removeprefix("loop=")), folder.name, month) for month in sorted(months))


def assess_month(data, results, task, hop_s=HOP_S, max_window_s=MAX_WINDOW_S):
    """Judges the windows of one loop that end in one month (UTC), unless a file made of the same samples is there.

    task: what `plan` gave. Returns what was done: `loop`, `month`, `state` (`done`, `skipped`, `failed`), `windows`, `cpu_s`.
    """
    loop, folder, month = task
    started = time.process_time()
    said = {"loop": loop, "month": month, "state": "done", "windows": 0, "cpu_s": 0.0}
    target = Path(results) / folder / f"{month}.parquet"
    failed = Path(results) / "_errors" / folder / f"{month}.json"
    place = str(Path(data) / folder)
    try:
        first = dt.date.fromisoformat(f"{month}-01")
        last = (first + 31 * DAY).replace(day=1)
        # As far as windows reach back, and the day on which the month's last one comes due.
        reach = math.ceil((max_window_s + 2 * hop_s) / DAY.total_seconds()) * DAY
        files = files_between(Path(data) / folder, first - reach, last)
        looked_at = [[f"{f.parent.name}/{f.name}", f.stat().st_size, f.stat().st_mtime_ns] for f in files]
        made_of = json.dumps([hop_s, max_window_s, looked_at])
        if made_of == said_of(target):
            return {**said, "state": "skipped"}
        tables = []
        for place in map(str, files):
            tables.append(read(place))
        place = str(Path(data) / folder)
        found = windows(pa.concat_tables(tables, promote_options="default"), loop, hop_s, max_window_s, (first, last))
        table = pa.Table.from_pylist([row(one) for one in found], schema=SCHEMA.with_metadata({"made_of": made_of}))
    except (OSError, RuntimeError, pa.ArrowException, stiction.StictionError) as why:
        error = json.dumps({"loop": loop, "month": month, "place": place, "error": str(why)})
        whole(failed, lambda part: part.write_text(error))
        return {**said, "state": "failed", "cpu_s": time.process_time() - started}
    whole(target, lambda part: pq.write_table(table, part, compression="zstd"))
    failed.unlink(missing_ok=True)
    return {**said, "windows": len(table), "cpu_s": time.process_time() - started}


def said_of(target):
    """The inputs of a result file; None where there is no readable one."""
    try:
        return (pq.read_schema(target).metadata or {}).get(b"made_of", b"").decode()
    except (OSError, pa.ArrowException):
        return None


def files_between(folder, first, last):
    """A loop's files of these days, both included, oldest first."""
    days = sorted(folder.glob("day=*"))
    wanted = [day for day in days if first <= dt.date.fromisoformat(day.name.removeprefix("day=")) <= last]
    return [file for day in wanted for file in sorted(day.glob("*.parquet"))]


def read(file):
    """A file's columns, in types that can be concatenated."""
    table = pq.ParquetFile(file).read()
    kinds = {"t": TIME, **dict.fromkeys(("op", "pv", "sp", "mv"), NUMBER), "mode": TEXT}
    there = [name for name in kinds if name in table.column_names]
    if not {"t", "op", "pv"} <= set(there):
        raise stiction.StictionError(f"columns t, op and pv are needed, there are {', '.join(table.column_names)}")
    return pa.table({name: table[name].cast(kinds[name]) for name in there})


def windows(table, loop, hop_s, max_window_s, ends):
    """The windows of a loop's samples, as the daemon cuts and judges them."""
    signals = {name: table[name] for name in SIGNALS if name in table.column_names}
    between = tuple(f"{day}T00:00:00Z" for day in ends)
    return stiction.assess_windows(
        **signals, t=table["t"], name=loop, hop_s=hop_s, max_window_s=max_window_s, ends=between, threads=1
    )


def row(found):
    """A window's row."""
    document = found.to_dict()

    def at(path):
        value = document
        for key in path.split("."):
            value = None if value is None else value[key]
        return value

    ends = [end for name in INTERVALS for end in document[name] or (None, None)]
    return dict(zip(SCHEMA.names, [*(at(path) for path, _ in PATHS), *ends, found.to_json()], strict=True))


def whole(target, write):
    """Writes a file that is there as a whole or not at all."""
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f".{target.name}.{platform.node()}.{os.getpid()}.part")
    write(part)
    os.replace(part, target)
