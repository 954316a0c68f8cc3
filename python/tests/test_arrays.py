"""Valid inputs, and the errors for invalid ones."""

from __future__ import annotations

import datetime as dt
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

import stiction


@pytest.fixture(scope="module")
def short(sticking: stiction.Simulation) -> tuple[Any, Any]:
    # Values that every type can hold.
    return np.round(sticking.op[:400]), np.round(4 * sticking.pv[:400])


@pytest.fixture(scope="module")
def plain(short: tuple[Any, Any]) -> str:
    return numbers(quick(*short, 1.0))


def numbers(found: stiction.Assessment) -> str:
    document = found.to_dict()
    document["elapsed_ms"] = None
    return str(document)


def quick(*args: Any, **more: Any) -> stiction.Assessment:
    """A fit that takes a tenth of the time."""
    return stiction.assess(*args, model="fopdt", valve="tracking", delay=6, **more)


def test_any_kind_of_number_and_layout(short: tuple[Any, Any], plain: str) -> None:
    op, pv = short
    for kind in ("float64", "float32", "int16", "uint16", "int64", ">f8", ">i4", "object"):
        assert numbers(quick(op.astype(kind), pv.astype(kind), 1)) == plain, kind
    both = np.stack([op, pv], axis=1)
    assert numbers(quick(both[:, 0], both[:, 1], 1.0)) == plain
    assert numbers(quick(op[::-1][::-1], np.asfortranarray(pv), np.float32(1.0))) == plain
    for make in (list, tuple, pd.Series, pa.array, lambda x: pa.chunked_array([x[:100], x[100:]]), memoryview):
        assert numbers(quick(make(op), make(pv), 1.0)) == plain, make
    indexed = pd.Series(pv, index=np.arange(len(pv)) * 7, dtype="Float64")
    assert numbers(quick(pd.Series(op, dtype="Int64"), indexed, 1.0)) == plain


def test_any_kind_of_time(short: tuple[Any, Any], plain: str) -> None:
    n = len(short[0])
    stamps = np.arange(n).astype("datetime64[s]")
    zoned = pd.Series(pd.to_datetime(np.arange(n), unit="s", utc=True)).dt.tz_convert("Europe/Berlin")
    east = dt.timezone(dt.timedelta(hours=5))
    own = [dt.datetime.fromtimestamp(k, tz=east) for k in range(n)]
    for t in (np.arange(n), np.arange(n, dtype=float), stamps, stamps.astype("datetime64[us]"), zoned, own, list(range(n)),
              pd.DatetimeIndex(stamps), pa.array(stamps.astype("datetime64[ms]"))):  # fmt: skip
        assert numbers(quick(*short, t=t)) == plain, type(t)


def test_what_is_missing_is_missing_in_every_form(short: tuple[Any, Any]) -> None:
    op, pv = short
    holed = pv.copy()
    holed[[20, 21, 200]] = np.nan
    expected = numbers(quick(op, holed, 1.0))
    assert expected != numbers(quick(op, pv, 1.0))
    nothing = [None if np.isnan(v) else v for v in holed]
    masked = np.ma.masked_invalid(holed)
    nullable = pd.Series(nothing, dtype="Float64")
    for form in (nothing, masked, nullable, pa.array(nothing), pd.Series(holed), np.array(nothing, dtype=object),
                 pd.Series(nothing, dtype="Float64").astype("Int64")):  # fmt: skip
        assert numbers(quick(op, form, 1.0)) == expected, type(form)
    # A set point without any value counts as absent.
    assert numbers(quick(op, holed, 1.0, sp=np.full(len(op), np.nan))) == expected


def test_manual_is_heard(short: tuple[Any, Any]) -> None:
    n = len(short[0])
    for mode in (["manual"] * n, pd.Series(["MAN"] + [None] * (n - 1))):
        found = stiction.assess(*short, 1.0, mode=mode)
        assert found.gates[0] == "manual" and found.verdict == "inconclusive" and found.s is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"op": "abc"}, "op: is not a column of numbers"),
        ({"op": ["a"] * 400}, "op: is not a column of numbers"),
        ({"op": None}, "op: is None"),
        ({"pv": np.zeros((400, 1))}, "pv: has 2 dimensions; give one column"),
        ({"pv": np.zeros(399)}, "pv: 399 values, op has 400; give columns of one length"),
        ({"pv": np.zeros(400, complex)}, "pv: is not a column of numbers"),
        ({"sp": [1.0]}, "sp: 1 values, op has 400"),
        ({"mode": ["auto"]}, "mode: 1 values, op has 400"),
        ({"ts_s": 0}, "ts_s: 0.0 must be above 0"),
        ({"ts_s": "1s"}, "ts_s: '1s' is not a number"),
        ({"ts_s": 1e9}, "ts_s: 1000000000.0 s for 400 samples are more than 292 years"),
        ({"ts_s": None}, "ts_s: give either ts_s, the seconds between samples, or t, their times"),
        ({"t": np.arange(400)}, "ts_s: give either"),
        ({"ts_s": None, "t": np.full(400, np.nan)}, "t: row 0: \"NaN\" is not a time"),
        ({"ts_s": None, "t": ["x"] * 400}, "t: is not a column of times"),
        ({"ts_s": None, "t": np.arange(400) * 10**9 + 1e18}, "outside the years 1678 to 2261"),
        ({"ts_s": None, "t": np.array(["1066-01-01"] * 400, "datetime64[D]")}, "t: is outside the years 1678"),
        ({"ts_s": None, "t": np.array(["NaT"] * 400, "datetime64[s]")}, "t: row 0 has no time"),
        ({"op_range": 5}, "op_range: 5 is not a pair of numbers"),
        ({"op_range": (5, 5)}, "op_range: (5, 5) is empty; give (low, high), such as (0, 100)"),
        ({"kind": "fluid"}, 'kind: "fluid" is not a valid value; write one of "flow", "level"'),
        ({"model": "third"}, 'model: "third" is not a valid value; write one of "auto", "fopdt", "sopdt"'),
        ({"valve": "hee"}, 'valve: "hee" is not a valid value'),
        ({"solver": "lgo"}, 'solver: "lgo" is not a valid value; write one of "contour"'),
        ({"delay": "soon"}, 'delay: "soon" is not a dead time'),
        ({"delay": -1}, 'delay: "-1" is not a dead time'),
        ({"seed": 1.5}, "seed: 1.5 is not a whole number"),
        ({"evaluations": 0}, "evaluations: 0 is out of range"),
        ({"fineness_pct": 99}, "fineness_pct: 99 is not a step; give 0.5 to 50 %"),
        ({"samples": 5}, "samples: 5 is not a pair"),
        ({"samples": (1, 5)}, "samples: 1 to 5 are 5 samples, at least 30 are needed"),
        ({"samples": (1, 900)}, "samples 1 to 900 requested, but the loop has 400"),
        ({"samples": (1, 100), "window": (0, 100)}, "samples: and window both select a section"),
        ({"window": (100, 0)}, "window: the end of the window must be after its start"),
        ({"window": ("noon", "evening")}, 'window: "noon" is not a time'),
        ({"downsample": 0.5}, "downsample: 0.5 is not a ratio; give a number above 1"),
        ({"downsample": 100}, "use 3000 samples or a smaller ratio"),
        ({"downsample_like_toolbox": True}, "downsample_like_toolbox: needs downsample"),
        ({"detrend": "cubic"}, 'detrend: "cubic" is not a valid value; write one of "mean"'),
        ({"score": {"schema": 1}}, "score: "),
        ({"score": 5}, "score: 5 is not a model"),
        ({"op": np.full(400, np.nan)}, "loop: 0 usable samples, 30 with both OP and PV are needed"),
    ],
)
def test_a_fault_names_its_argument_and_the_remedy(
    short: tuple[Any, Any], change: dict[str, Any], said: str
) -> None:
    arguments: dict[str, Any] = {"op": short[0], "pv": short[1], "ts_s": 1.0, **change}
    with pytest.raises(stiction.StictionError) as caught:
        stiction.assess(**arguments)
    assert said in str(caught.value)
    assert isinstance(caught.value, ValueError)


def test_faults_of_the_gap_and_of_scenarios(short: tuple[Any, Any]) -> None:
    for arguments, said in (
        ({"without": ["gravity"]}, "without: "),
        ({"without": "backlash"}, "without: 'backlash' is a string"),
        ({"base": "quadratic"}, 'base: \'quadratic\' is not a valid value; give "refit"'),
        ({"base": {"a": 1}}, "base: "),
        ({"budget_s": -1}, "budget_s: -1.0 must be above 0"),
        ({"threads": 0}, "threads: 0 is out of range"),
    ):
        with pytest.raises(stiction.StictionError) as caught:
            stiction.diagnose(*short, 1.0, **arguments)
        assert said in str(caught.value)
    for scenario, said in (("", "scenario: "), ({"site": None}, "scenario: "), ({"run": object()}, "scenario: "),
                           ("[site]\nprefix = 1", "scenario: ")):  # fmt: skip
        with pytest.raises(stiction.StictionError) as caught:
            stiction.simulate(scenario)  # type: ignore[arg-type]
        assert said in str(caught.value)


def test_a_result_is_frozen_and_small(short: tuple[Any, Any]) -> None:
    found = stiction.assess(*short, 1.0, op_range=(0, 100))
    with pytest.raises(AttributeError):
        found.s = 1.0  # type: ignore[misc]
    assert found.to_dict()["schema"] == "stictiond.estimate.v1"
    assert "_document" not in repr(found) and found.words in str(found)
    assert stiction.assess(*short, 1.0, op_range=(0, 100)).s == found.s


def test_a_calm_loop_is_let_go_and_a_sticking_one_is_not(sticking: stiction.Simulation) -> None:
    noise = np.random.default_rng(1).normal(size=(2, 1000))
    assert stiction.screen(50 + noise[0], 20 + noise[1], 1.0)
    assert not stiction.screen(sticking.op, sticking.pv, 1.0)


def test_scenarios_with_several_loops(sticking: stiction.Simulation) -> None:
    def one(name: str) -> dict[str, Any]:
        return {
            "name": name, "operating_point": {"op": 50.0, "pv": 60.0}, "setpoint": 61.0,
            "process": {"gain": 2.0, "time_constants_s": [20.0], "dead_time_s": 6.0},
            "controller": {"kc": 0.8, "ti_s": 8.0},
        }  # fmt: skip

    run = {"start": "2026-01-05T08:00:00Z", "duration_s": 60.0, "ts_s": 1.0, "seed": 1}
    plant = {"site": {"prefix": "p"}, "run": run, "loop": [one("A"), one("B")]}
    assert list(stiction.simulate_plant(plant)) == ["A", "B"]
    with pytest.raises(stiction.StictionError, match="loop: None is not in the scenario; give one of A, B"):
        stiction.simulate(plant)
    b = stiction.simulate(plant, loop="B")
    assert b.loop == "B" and len(b.t) == len(b.op) == len(b.pv) == len(b.sp) == len(b.mv) == 60
    assert str(b.t[1]) == "2026-01-05T08:00:01.000000000" and "FIC101" in sticking.truth
