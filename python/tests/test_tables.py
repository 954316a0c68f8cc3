"""Loops from tables, wide and long, and times from an index."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from conftest import ROOT

import stiction
from stiction import _tables

pd = pytest.importorskip("pandas")
START = "2026-01-05T08:00:00"


@pytest.fixture(scope="module")
def frame(sticking: stiction.Simulation) -> Any:
    index = pd.date_range(START, periods=400, freq="2s", name="time")
    columns = {"op": sticking.op[:400], "pv": sticking.pv[:400], "sp": sticking.sp[:400]}
    return pd.DataFrame(columns, index=index)


def quick(*args: Any, **more: Any) -> stiction.Assessment:
    return stiction.assess(*args, model="fopdt", valve="tracking", delay=6, **more)


def numbers(found: stiction.Assessment) -> dict[str, Any]:
    return {**found.to_dict(), "elapsed_ms": None}


@pytest.fixture(scope="module")
def expected(frame: Any) -> dict[str, Any]:
    return numbers(quick(frame["op"].to_numpy(), frame["pv"].to_numpy(), t=frame.index.to_numpy(), sp=frame["sp"].to_numpy()))


def test_times_are_read_from_the_index(frame: Any, expected: dict[str, Any]) -> None:
    zoned = frame.tz_localize("UTC").tz_convert("Asia/Tokyo")
    for one in (frame, zoned):
        assert numbers(quick(one["op"], one["pv"], sp=one["sp"])) == expected
        assert numbers(quick(one)) == expected
    # Plain arrays next to a Series share its times, and an explicit time takes precedence over the index.
    assert numbers(quick(frame["op"], frame["pv"].to_numpy(), sp=frame["sp"])) == expected
    faster = quick(frame["op"], frame["pv"], 1.0)
    assert faster.period_s != expected["oscillation"]["period_s"] and str(faster.window[0]).startswith("1970")
    assert str(quick(frame, ts_s=1.0).window[0]).startswith("1970")


def test_other_times_of_pv_are_refused(frame: Any) -> None:
    late = frame["pv"].copy()
    late.index = late.index + pd.Timedelta("1s")
    with pytest.raises(stiction.StictionError, match=r"^pv: has other times than op; give pandas.concat"):
        quick(frame["op"], late)
    joined = pd.concat([frame["op"], late], axis=1, keys=["op", "pv"], sort=True)
    assert len(joined) == 800 and quick(joined).stiction is not None


def test_tables_of_one_loop(frame: Any, expected: dict[str, Any]) -> None:
    dated = frame.reset_index()
    for table in (dated, dated.rename(columns={"time": "t"}), dict(dated), dated.to_records(index=False)):
        assert numbers(quick(table)) == expected, type(table)
    pyarrow = pytest.importorskip("pyarrow")
    assert numbers(quick(pyarrow.Table.from_pandas(dated))) == expected
    tagged = frame.rename(columns={"op": "FIC7.OUT [%]", "pv": "FIC7.PV (m3/h)", "sp": "FIC7.SP"})
    named = quick(tagged)
    assert named.loop == "FIC7" and numbers(named) == numbers(quick(frame, name="FIC7"))
    # A letter of the tag chooses the kind of loop, unless the caller names it.
    assert quick(tagged, name="mine").loop == "mine"


def wide(frame: Any) -> Any:
    other = frame[["op", "pv"]].iloc[::-1].set_axis(frame.index)
    return pd.concat({"FIC1": frame, "LIC2": other}, axis=1)


def test_wide_and_long_tables_of_many_loops(frame: Any) -> None:
    both = wide(frame)
    flat = both.set_axis([".".join(name) for name in both.columns], axis=1)
    noisy = flat.assign(**{"41TI5": 20.0, "FIC1.MODE": "auto"})
    long = pd.concat({"FIC1": frame, "LIC2": both["LIC2"]}, names=["loop"])
    tags = flat.melt(ignore_index=False, var_name="tag").reset_index().sample(frac=1.0, random_state=1)
    results = {
        name: [numbers(one) for one in stiction.assess_many(table, model="fopdt", valve="tracking", delay=6)]  # type: ignore[arg-type]
        for name, table in {"levels": both, "flat": flat, "noisy": noisy, "long": long, "tags": tags}.items()
    }
    for name, found in results.items():
        assert sorted(one["loop"] for one in found) == ["FIC1", "LIC2"], name
        assert sorted(found, key=lambda one: str(one["loop"])) == results["levels"], name
    assert numbers(quick(both, name="FIC1")) == results["levels"][0]
    with pytest.raises(stiction.StictionError, match="name: the table has the loops FIC1, LIC2; give one of them"):
        quick(both)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f: f.rename(columns={"pv": "flow"}), "pv: the table has no pv column among op, flow, sp"),
        (lambda f: f.reset_index(drop=True), "ts_s: give either ts_s"),
        (lambda f: f.assign(op="x"), "op: is not a column of numbers"),
        (lambda f: f.set_axis(["F.OP", "F.PV", "F/PV"], axis=1), "table: 'F.PV' and 'F/PV' are both pv of F; drop one"),
        (lambda f: f.set_axis(["F.OP", "F.PV", "F.X"], axis=1).reset_index(drop=True), "t: the table has no column of times"),
        (lambda f: f.assign(date=0).reset_index(), "t: the table has the columns time and date; give t="),
        (lambda f: f.reset_index().astype({"time": str}), "t: is not a column of times"),
    ],
)
def test_a_fault_of_a_table_names_the_column(frame: Any, change: Any, said: str) -> None:
    with pytest.raises(stiction.StictionError) as caught:
        quick(change(frame))
    assert str(caught.value).startswith(said), caught.value


def test_endings_are_those_of_the_program() -> None:
    source = (ROOT / "crates" / "stiction-files" / "src" / "conventions.rs").read_text()
    lists = re.findall(r'\(\s*Signal::(\w+),\s*"([^"]+)",?\s*\)', source.split("const ENDS")[1].split("];")[0])
    known = {end: signal.lower() for signal, ends in lists for end in re.sub(r"\\\s+", "", ends).split("|")}
    assert len(known) > 30
    assert {end: known.get(end) for end in _tables.ENDINGS} == _tables.ENDINGS
    order = [end for end in known if end in _tables.ENDINGS]
    for signal in _tables.SIGNALS:
        mine = [end for end, one in _tables.ENDINGS.items() if one == signal]
        assert mine == [end for end in order if known[end] == signal]
    times = set(re.sub(r"\\\s+", "", source.split("const TIMES")[1].split('"')[1]).split("|"))
    assert set(_tables.TIMES) <= times


def test_gap_windows_repair_and_screen_read_tables(frame: Any) -> None:
    assert not stiction.screen(frame)
    windows = stiction.assess_windows(frame, hop_s=400)
    assert isinstance(windows, stiction.Results) and str(windows[0].window[0])[:10] == "2026-01-05"
    assert stiction.diagnose(frame, base="linear", budget_s=0.2).predictions.t[0] == np.datetime64(START)
