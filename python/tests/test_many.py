"""Many loops at once; threads, progress, Ctrl-C."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from conftest import timeless

import stiction


@pytest.fixture(scope="module")
def frame(sticking: stiction.Simulation) -> pd.DataFrame:
    parts = []
    for name, start, shape in (("FIC9", 0, 1.0), ("TIC1", 300, 0.5), ("none", 0, np.nan), ("FIC2", 900, 2.0)):
        rows = slice(start, start + 400)
        part = {"t": sticking.t[rows], "op": shape * sticking.op[rows], "pv": sticking.pv[rows], "sp": sticking.sp[rows]}
        parts.append(pd.DataFrame({"loop": name, **part}))
    return pd.concat(parts, ignore_index=True)


def told(results: Any) -> list[Any]:
    return [timeless(r.to_dict()) if r.ok else (r.loop, r.error) for r in results]


@pytest.fixture(scope="module")
def expected(frame: pd.DataFrame) -> list[Any]:
    one_by_one: list[Any] = []
    for name, rows in frame.groupby("loop", sort=False):
        try:
            one_by_one.append(stiction.assess(rows["op"], rows["pv"], t=rows["t"], sp=rows["sp"], name=str(name)))
        except stiction.StictionError as why:
            one_by_one.append(stiction.Failure(str(name), str(why)))
    return told(one_by_one)


def test_equal_to_one_by_one_for_every_kind_of_table(frame: pd.DataFrame, expected: list[Any]) -> None:
    assert [type(one) for one in expected] == [str, str, tuple, str]
    as_dict = {name: frame[name].to_numpy() for name in frame}
    arrow = pa.Table.from_pandas(frame)
    dictionary = arrow.set_column(0, "loop", arrow["loop"].dictionary_encode())
    shuffled = frame.iloc[np.argsort(np.arange(len(frame)) % 400, kind="stable")]
    for table in (frame, as_dict, arrow, dictionary, arrow.combine_chunks().to_batches()[0], frame.to_records(index=False), shuffled,
                  frame.astype({"loop": "category"})):  # fmt: skip
        assert told(stiction.assess_many(table)) == expected, type(table)


def test_threads_change_nothing(frame: pd.DataFrame, expected: list[Any]) -> None:
    for threads in (1, 2, 7):
        assert told(stiction.assess_many(frame, threads=threads)) == expected


def test_columns_by_other_names_and_without_times(frame: pd.DataFrame, expected: list[Any]) -> None:
    other = frame.rename(columns={"loop": "tag", "op": "MV", "t": "when"})
    assert told(stiction.assess_many(other, loop="tag", op="MV", t="when")) == expected
    one = frame[frame["loop"] == "FIC9"].drop(columns=["loop", "t"])
    timed = stiction.assess(one["op"], one["pv"], 1.0, sp=one["sp"])
    assert told(stiction.assess_many(one, ts_s=1.0)) == told([timed])
    mixed = frame.drop(columns="t").sample(frac=1, random_state=1).sort_index(kind="stable")
    assert [r.ok for r in stiction.assess_many(mixed, ts_s=1.0, model="fopdt")] == [True, True, False, True]
    for table, said in ((frame.drop(columns="pv"), 'the table has no column \'pv\'; name one of loop, t, op, sp with pv="..."'),
                        ([1, 2], "list has no named columns")):  # fmt: skip
        with pytest.raises(stiction.StictionError) as caught:
            stiction.assess_many(table)
        assert said in str(caught.value)


def test_results_make_a_table(frame: pd.DataFrame) -> None:
    table = pd.DataFrame(stiction.as_columns(stiction.assess_many(frame)))
    assert list(table["loop"]) == ["FIC9", "TIC1", "none", "FIC2"]
    assert table["error"].notna().tolist() == [False, False, True, False]
    assert (table["s_low"].dropna() <= table["s_high"].dropna()).all()


def test_no_loop_at_all() -> None:
    assert stiction.assess_many({"loop": [], "t": [], "op": [], "pv": []}) == []


def test_progress_is_told_and_may_end_the_work(frame: pd.DataFrame) -> None:
    calls: list[tuple[int, int]] = []
    stiction.assess_many(frame, progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (4, 4) and calls == sorted(calls)

    def enough(done: int, total: int) -> None:
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        stiction.assess_many(frame, progress=enough)


def test_progress_of_the_gap(sticking: stiction.Simulation) -> None:
    calls: list[tuple[int, int]] = []
    found = stiction.diagnose(
        sticking.op[:600], sticking.pv[:600], 1.0, budget_s=0.3, progress=lambda done, total: calls.append((done, total))
    )
    assert calls and all(0 <= done and total > 0 for done, total in calls) and calls == sorted(calls)
    assert found.to_dict()["evaluations"] > 0


def test_other_threads_of_python_go_on(frame: pd.DataFrame) -> None:
    counted, stop = [0], threading.Event()

    def count() -> None:
        while not stop.is_set():
            counted[0] += 1
            time.sleep(0.001)

    counter = threading.Thread(target=count)
    counter.start()
    try:
        before, started = counted[0], time.perf_counter()
        stiction.assess_many(pd.concat([frame, frame.assign(loop=frame["loop"] + "b")]))
        elapsed = time.perf_counter() - started
        made = counted[0] - before
    finally:
        stop.set()
        counter.join()
    # With the lock held there would be a handful; a busy machine still allows some.
    assert made > 20 * elapsed, f"{made} in {elapsed:.2f} s"


def test_several_threads_of_python_at_once(frame: pd.DataFrame, expected: list[Any]) -> None:
    rows = frame[frame["loop"] == "FIC9"]
    found: list[Any] = []

    def one() -> None:
        found.append(stiction.assess(rows["op"], rows["pv"], t=rows["t"], sp=rows["sp"], name="FIC9"))

    threads = [threading.Thread(target=one) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert told(found) == [expected[0]] * 4


def test_ctrl_c_ends_it_within_ten_seconds_of_the_last() -> None:
    program = (
        "import signal, sys, numpy as np, stiction\n"
        # Background processes of a shell ignore Ctrl-C from the start, and Python leaves it so.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "x = np.arange(2_000) % 97\n"
        "table = {'loop': np.repeat(np.arange(400), 2_000), 't': np.tile(np.arange(2_000), 400),\n"
        "         'op': np.tile(x, 400), 'pv': np.tile(np.roll(x, 9), 400)}\n"
        "print('go', flush=True)\n"
        "try:\n"
        "    stiction.assess_many(table)\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted', flush=True)\n"
    )
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "go\n"
    time.sleep(0.5)
    child.send_signal(signal.SIGINT)
    try:
        out, _ = child.communicate(timeout=10)
    except subprocess.TimeoutExpired:
        child.kill()
        raise
    assert out == "interrupted\n" and child.returncode == 0


def test_loops_of_one_plant_are_judged_together(sticking: stiction.Simulation) -> None:
    rng = np.random.default_rng(1)
    rows = slice(0, 1600)
    t, op, pv = sticking.t[rows], sticking.op[rows], sticking.pv[rows]
    follower = np.convolve(pv - pv.mean(), np.full(5, 0.2), "same") + 0.05 * rng.normal(size=len(pv))
    parts = {"source": (op, pv), "follower": (50 - 0.5 * np.roll(follower, 2), 30 + np.roll(follower, 3)),
             "calm": (50 + 0.1 * rng.normal(size=len(pv)), 20 + rng.normal(size=len(pv)))}  # fmt: skip
    frame = pd.concat([pd.DataFrame({"loop": n, "t": t, "op": o, "pv": p}) for n, (o, p) in parts.items()], ignore_index=True)
    plant = stiction.assess_plant(frame)
    assert [one.loop for one in plant.loops] == list(parts)
    (group,) = plant.groups
    assert group["schema"] == "stictiond.group.v1" and set(group["members"]) == {"source", "follower"}
    in_group = {one.loop: one.to_dict().get("group") for one in plant.loops if one.ok}
    assert in_group["calm"] is None and in_group["follower"]["loop"] == "follower"
    assert timeless(plant.loops[2].to_dict()) == timeless(stiction.assess_many(frame)[2].to_dict())
