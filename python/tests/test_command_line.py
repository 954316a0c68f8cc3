"""The same numbers as the command line, bit for bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from conftest import ROOT, Command, columns, same

import stiction

def table(tables: dict[str, Path], name: str) -> Path:
    assert name in tables, f"{name} is not among {list(tables)}"
    return tables[name]


def test_every_loop_of_the_shipped_recordings(command: Command, tables: dict[str, Path]) -> None:
    for name, path in tables.items():
        told = json.loads(command("analyze", path, "--format", "json"))
        found = stiction.assess(**columns(path), name=path.stem)
        same(found, told)
        assert found.p_stiction == told["p_stiction"] and found.verdict == told["verdict"]


@pytest.mark.parametrize(
    ("flags", "arguments"),
    [
        (["--samples", "50,900"], {"samples": (50, 900)}),
        (["--model", "sopdt", "--delay", "12s", "--seed", "7"], {"model": "sopdt", "delay": "12s", "seed": 7}),
        (["--model", "fopdt", "--delay", "3", "--downsample", "2.5"], {"model": "fopdt", "delay": 3, "downsample": 2.5}),
        (["--valve", "tracking", "--op-range", "0,100"], {"valve": "tracking", "op_range": (0, 100)}),
        (["--detrend", "linear", "--fineness", "10"], {"detrend": "linear", "fineness_pct": 10}),
        (
            ["--downsample", "2", "--downsample-like-toolbox", "--samples", "100,1100"],
            {"downsample": 2, "downsample_like_toolbox": True, "samples": [100, 1100]},
        ),
        (["--solver", "random", "--evaluations", "300"], {"solver": "random", "evaluations": 300}),
        (
            ["--window", "2026-01-05T08:05:00Z,2026-01-05T08:20:00Z"],
            {"window": (np.datetime64("2026-01-05T08:05:00"), "2026-01-05T08:20:00Z")},
        ),
    ],
)
def test_every_option(
    command: Command, tables: dict[str, Path], flags: list[str], arguments: dict[str, Any]
) -> None:
    path = table(tables, "sticking-FIC101")
    told = json.loads(command("analyze", path, *flags, "--format", "json"))
    found = stiction.assess(**columns(path), name=path.stem, **arguments)
    same(found, told)


def test_the_page_of_text(command: Command, tables: dict[str, Path]) -> None:
    path = table(tables, "sticking-FIC101")

    def timed(text: str) -> list[str]:
        return [line for line in text.strip().splitlines() if "run time" not in line]

    assert timed(str(stiction.assess(**columns(path), name=path.stem))) == timed(command("analyze", path))


def test_a_model_from_elsewhere(command: Command, tables: dict[str, Path], tmp_path: Path) -> None:
    path, model = table(tables, "sticking-FIC101"), tmp_path / "may.json"
    first = stiction.assess(**columns(path), name=path.stem, samples=(1, 1000))
    model.write_text(first.to_json())
    told = json.loads(command("analyze", path, "--score", model, "--format", "json"))
    for given in (first, first.to_dict()):
        scored = stiction.assess(**columns(path), name=path.stem, score=given).to_dict()["scored"]
        assert {**scored, "model": str(model)} == told["scored"]


@pytest.mark.parametrize(
    ("name", "flags", "arguments"),
    [
        ("sticking-FIC101", ["--base", "linear", "--samples", "1,500"], {"base": "linear", "samples": (1, 500)}),
        ("sticking-FIC101", ["--samples", "50,900", "--without", "backlash"], {"samples": (50, 900), "without": ["backlash"]}),
    ],
)
def test_the_gap(
    command: Command, tables: dict[str, Path], tmp_path: Path, name: str, flags: list[str], arguments: dict[str, Any]
) -> None:
    path, rows = table(tables, name), tmp_path / "rows.csv"
    told = json.loads(command("gap", path, *flags, "--predictions", rows, "--format", "json"))
    found = stiction.diagnose(**columns(path), name=path.stem, **arguments)
    assert json.dumps(found.to_dict()) == json.dumps(told)
    assert (found.cause, found.probability) == (told["cause"]["id"], told["cause"]["probability"])
    written, run = pd.read_csv(rows, float_precision="round_trip"), found.predictions
    for column, values in (("pv", run.pv), ("pv_base", run.base), ("pv_after", run.after)):
        np.testing.assert_array_equal(written[column].to_numpy(), values)
    np.testing.assert_array_equal(written["held_out"].to_numpy() > 0, run.held_out)


def test_windows_that_are_judged_together(command: Command, tables: dict[str, Path]) -> None:
    path = table(tables, "sticking-FIC101")
    given = columns(path)
    ends = [str(given["t"][at]) for at in (0, 449, 450, 899)]
    windows = [(ends[0], ends[1]), (ends[2], ends[3])]
    flags = [flag for window in windows for flag in ("--window", ",".join(window))]
    told = json.loads(command("gap", path, "--base", "linear", "--pool", *flags, "--format", "json"))
    found = stiction.diagnose(**given, name=path.stem, base="linear", windows=windows).to_dict()
    assert [window.pop("source") for window in found["pooled"]] == ["window 1", "window 2"]
    assert all(window.pop("source").endswith(f"window {at}") for at, window in enumerate(told["pooled"], 1))
    assert json.dumps(found) == json.dumps(told)
    with pytest.raises(stiction.StictionError, match="one pair of times; give two or more, or window"):
        stiction.diagnose(**given, windows=windows[:1])
    with pytest.raises(stiction.StictionError, match="the same data as window 1"):
        stiction.diagnose(**given, base="linear", windows=windows[:1] * 2)


def test_the_gap_is_the_same_on_any_number_of_threads(sticking: stiction.Simulation) -> None:
    found = [
        stiction.diagnose(sticking.op[:300], sticking.pv[:300], 1.0, base="linear", threads=threads).to_json()
        for threads in (1, 3)
    ]
    assert found[0] == found[1]


def test_a_simulated_plant(command: Command, tmp_path: Path, sticking: stiction.Simulation) -> None:
    scenario, recording = ROOT / "recordings" / "scenarios" / "sticking.toml", tmp_path / "plant.mcap"
    command("simulate", scenario, "--raw", "--out", recording)
    path = tmp_path / "FIC101.csv"
    command("convert", recording, path)
    frame = pd.read_csv(path)
    for name in ("op", "pv", "sp"):
        np.testing.assert_array_equal(frame[name].to_numpy(float), getattr(sticking, name))
    np.testing.assert_array_equal(frame["t"].to_numpy() * 10**9, sticking.t.view("int64"))
    told = json.loads(command("analyze", path, "--format", "json"))
    found = stiction.assess(sticking.op, sticking.pv, t=sticking.t, sp=sticking.sp, name="FIC101")
    same(found, told)


def test_missing_values_and_fractions_of_a_second(
    command: Command, tmp_path: Path, sticking: stiction.Simulation
) -> None:
    pv, sp, t = sticking.pv.copy(), sticking.sp.copy(), 1767600000 + np.arange(len(sticking.pv)) * 0.1
    pv[[7, 8, 300, 1500]] = np.nan
    sp[1:] = np.nan
    path = tmp_path / "FIC7.csv"
    pd.DataFrame({"t": t, "op": sticking.op, "pv": pv, "sp": sp}).to_csv(path, index=False)
    told = json.loads(command("analyze", path, "--format", "json"))
    found = stiction.assess(sticking.op, pv, t=t, sp=sp, name="FIC7")
    same(found, told)
    # OP and PV in separate rows, and newest first.
    path = tmp_path / "FIC8.csv"
    rows = pd.DataFrame({"t": t, "op": sticking.op, "pv": sticking.pv})
    apart = pd.concat([rows.assign(pv=np.nan), rows.assign(op=np.nan)]).sort_values("t", kind="stable", ascending=False)
    apart.to_csv(path, index=False)
    told = json.loads(command("analyze", path, "--format", "json"))
    found = stiction.assess(apart["op"], apart["pv"], t=apart["t"], name="FIC8")
    same(found, told)
    assert any("separate rows" in note for note in found.notes)
    assert any("newest first" in note for note in found.notes)
