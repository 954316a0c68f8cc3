"""The fleet's examples: the same files by a process pool and by Dask, the same numbers as the command line's."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, Command

pytest.importorskip("pyarrow")
distributed = pytest.importorskip("distributed")
sys.path.insert(0, str(ROOT / "examples" / "fleet"))

import dask_fleet  # noqa: E402
import fleet  # noqa: E402
import make  # noqa: E402
import pool_fleet  # noqa: E402
import pyarrow.parquet as pq  # noqa: E402

START, DAYS, LOOPS, HOP_S = "2026-01-31", 3, 3, 43_200.0
SETTINGS = {"hop_s": HOP_S}
MONTHS = [(f"TIC000{k + 1}", month) for k in range(LOOPS) for month in ("2026-01", "2026-02")]
Run = dict[tuple[str, str], str]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    make.make(folder, loops=LOOPS, sticking=1, days=DAYS, start=START)
    return folder


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with dask_fleet.local(2) as cluster, distributed.Client(cluster) as client:
        yield client


@pytest.fixture(scope="module")
def results(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pool's results for the data."""
    folder = tmp_path_factory.mktemp("results")
    assert states(pool_fleet.run(data, folder, 2, **SETTINGS)) == dict.fromkeys(MONTHS, "done")
    return folder


def states(said: Any) -> Run:
    return {(one["loop"], one["month"]): one["state"] for one in said}


def contents(folder: Path) -> dict[str, bytes]:
    """Every file by name, except partial files of killed workers, which the next run clears."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.suffix != ".part")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def ages(folder: Path) -> dict[str, int]:
    return {str(path.relative_to(folder)): path.stat().st_mtime_ns for path in folder.rglob("*.parquet")}


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml(one)}" for key, one in value.items()) + "}"
    return f"[{', '.join(map(toml, value))}]" if isinstance(value, list) else json.dumps(value)


def test_dask_makes_the_same_files_to_the_byte(cluster: Any, data: Path, results: Path, tmp_path: Path) -> None:
    assert states(dask_fleet.run(cluster, data, tmp_path, **SETTINGS)) == dict.fromkeys(MONTHS, "done")
    made = contents(tmp_path)
    assert len(made) == len(MONTHS) and made == contents(results)


@pytest.mark.parametrize(("loop", "sticks"), [("TIC0001", True), ("TIC0002", False)])
def test_rows_are_the_documents_of_replay(command: Command, results: Path, tmp_path: Path, loop: str, sticks: bool) -> None:
    seed = int(loop[-1])
    plant = make.scenario(loop, seed, sticks, START, DAYS, 10.0)
    scenario, config = tmp_path / "plant.toml", tmp_path / "monitor.toml"
    scenario.write_text("\n".join(f"{key} = {toml(value)}" for key, value in plant.items()))
    config.write_text(f'[site]\nprefix = "plant"\n[window]\nhop_s = {HOP_S}\n')
    recording = tmp_path / "plant.mcap"
    command("simulate", scenario, "--raw", "--config", config, "--out", recording)
    lines = command("replay", recording, "--format", "json").splitlines()
    told = [line for line in lines if json.loads(line)["schema"] == "stictiond.estimate.v1"]
    table = pq.read_table(results, filters=[("loop", "=", loop)])
    rows = sorted(table.to_pylist(), key=lambda row: row["end"])
    assert [row["document"] for row in rows] == told and len(told) == DAYS * 86_400 // HOP_S
    for row in rows:
        document = json.loads(row["document"])
        assert row["end"].value == document["window"]["end_ns"] and row["verdict"] == document["verdict"]
        assert row["s"] == document["s"] and [row["s_low"], row["s_high"]] == (document["s_interval"] or [None, None])
        assert row["process_gain"] == (document["process"] or {"gain": None})["gain"]
    assert any(row["stiction"] for row in rows) == sticks
    assert [field for field in table.schema if field.name != "loop"] == list(fleet.SCHEMA)


def typed(program: str, places: dict[str, object]) -> list[str]:
    """The line of the fleet's page that calls a program; `places` has the replacements."""
    page = (ROOT / "examples" / "fleet" / "README.md").read_text()
    (line,) = (line for line in page.splitlines() if line.startswith(f"python examples/fleet/{program} "))
    words = line.split()[1:]
    assert set(places) <= set(words), set(places) - set(words)
    return [str(places.get(word, word)) for word in words]


def test_the_lines_of_the_page_run(cluster: Any, tmp_path: Path) -> None:
    data, pool, dask = (tmp_path / name for name in ("data", "pool", "dask"))
    address = cluster.scheduler_info()["address"]
    for line in (
        typed("make.py", {"data": data, "20": 1, "40": 1}),
        typed("pool_fleet.py", {"data": data, "results": pool}),
        typed("dask_fleet.py", {"data": data, "results": dask, "tcp://SCHEDULER:8786": address}),
    ):
        subprocess.run([sys.executable, *line], cwd=ROOT, check=True, capture_output=True)
    assert contents(pool) == contents(dask) and [*pool.rglob("*.parquet")]


def test_what_is_done_is_not_done_again(data: Path, results: Path) -> None:
    before = ages(results)
    assert states(pool_fleet.run(data, results, 1, **SETTINGS)) == dict.fromkeys(MONTHS, "skipped")
    assert ages(results) == before and len(before) == len(MONTHS)


def test_what_came_later_is_done(data: Path, tmp_path: Path) -> None:
    folder, hop = tmp_path / "data", {"hop_s": 86_400.0, "max_window_s": 86_400.0}
    make.make(folder, loops=2, sticking=0, days=3, start="2026-01-28")
    first = states(pool_fleet.run(folder, tmp_path / "results", 1, **hop))
    assert set(first.values()) == {"done"} and len(first) == 2
    before = ages(tmp_path / "results")
    make.make(folder, loops=1, sticking=0, days=4, start="2026-01-28")
    again = states(pool_fleet.run(folder, tmp_path / "results", 1, **hop))
    assert again == {("TIC0001", "2026-01"): "done", ("TIC0002", "2026-01"): "skipped"}
    after = ages(tmp_path / "results")
    assert [name for name in after if after[name] != before[name]] == ["loop=TIC0001/2026-01.parquet"]


def test_a_worker_that_is_killed_costs_nothing(cluster: Any, data: Path, results: Path, tmp_path: Path) -> None:
    said, pool = pool_fleet.run(data, tmp_path / "pool", 2, **SETTINGS), []
    first = next(said)
    pool = [child.pid for child in active_children()]
    assert len(pool) >= 2
    for pid in pool:
        os.kill(pid, signal.SIGKILL)
    rest = states(said)
    assert {*rest, (first["loop"], first["month"])} == set(MONTHS) and "failed" not in rest.values()
    assert contents(tmp_path / "pool") == contents(results)

    said = dask_fleet.run(cluster, data, tmp_path / "dask", **SETTINGS)
    first, killed = next(said), list(cluster.run(os.getpid).values())
    os.kill(killed[0], signal.SIGKILL)
    rest = states(said)
    assert {*rest, (first["loop"], first["month"])} == set(MONTHS) and "failed" not in rest.values()
    assert contents(tmp_path / "dask") == contents(results)


def test_a_damaged_file_is_named_and_the_others_go_on(data: Path, results: Path, tmp_path: Path) -> None:
    bad = data / "loop=TIC0003" / "day=2026-02-02" / "part.parquet"
    whole, stamp = bad.read_bytes(), bad.stat()
    (tmp_path / "loop=TIC0003").mkdir()
    half_written = tmp_path / "loop=TIC0003" / ".2026-02.parquet.elsewhere.1.part"
    half_written.write_bytes(b"PAR1")
    try:
        bad.write_bytes(whole[: len(whole) // 2])
        expected = {**dict.fromkeys(MONTHS, "done"), ("TIC0003", "2026-02"): "failed"}
        assert states(pool_fleet.run(data, tmp_path, 2, **SETTINGS)) == expected
        error = json.loads((tmp_path / "_errors" / "loop=TIC0003" / "2026-02.json").read_text())
        assert (error["loop"], error["month"], error["place"]) == ("TIC0003", "2026-02", str(bad)) and error["error"]
        assert not (tmp_path / "loop=TIC0003" / "2026-02.parquet").exists() and not half_written.exists()
    finally:
        bad.write_bytes(whole)
        os.utime(bad, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert states(pool_fleet.run(data, tmp_path, 1, **SETTINGS))["TIC0003", "2026-02"] == "done"
    assert contents(tmp_path) == contents(results)
