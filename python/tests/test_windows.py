"""Windows of a long record, many windows together, repairs: as from the command line and the running daemon."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import BINARY, ROOT, Command, columns

import stiction


def estimates(text: str, loop: str) -> list[str]:
    """The documents of a loop's windows in the printed output, unchanged."""
    read = ((line, json.loads(line)) for line in text.splitlines())
    return [line for line, d in read if d["schema"] == "stictiond.estimate.v1" and d["loop"] == loop]


@pytest.mark.parametrize("name", ["sticking-FIC101", "four-loops-LIC202", "four-loops-TIC204"])
def test_windows_are_those_of_replay_to_the_byte(
    command: Command, tables: dict[str, Path], tmp_path: Path, name: str
) -> None:
    path = tables.get(name)
    assert path is not None, f"{name} is not among {list(tables)}"
    recording = tmp_path / "again.mcap"
    command("convert", path, recording)
    told = estimates(command("replay", recording, "--format", "json"), path.stem)
    found = stiction.assess_windows(**columns(path), name=path.stem)
    assert len(told) >= 3
    assert [one.to_json() for one in found] == told


def test_windows_under_a_configuration(command: Command, tables: dict[str, Path]) -> None:
    told = estimates(command("replay", ROOT / "recordings" / "sticking.mcap", "--format", "json"), "FIC101")
    config = '[site]\nprefix = "tour"\n[window]\nhop_s = 300.0\n'
    found = stiction.assess_windows(**columns(tables["sticking-FIC101"]), name="FIC101", config=config)
    assert [one.to_json() for one in found] == told and len(told) >= 6
    assert any(one.stiction for one in found) and all(one.window[0] <= one.window[1] for one in found)
    assert str(found[-1]).startswith("FIC101: ") and found[-1].s0 is not None


def test_chosen_windows_are_those_of_all(sticking: stiction.Simulation) -> None:
    record: dict[str, Any] = {"op": sticking.op, "pv": sticking.pv, "t": sticking.t, "sp": sticking.sp}
    every = stiction.assess_windows(**record, hop_s=300)
    ends = [one.window[1] for one in every]
    assert all(end.astype("datetime64[s]").astype(int) % 300 == 0 for end in ends) and ends == sorted(ends)
    told: list[tuple[int, int]] = []
    some = stiction.assess_windows(
        **record, hop_s=300, ends=(ends[1], ends[4]), threads=1, progress=lambda done, all_: told.append((done, all_))
    )
    assert [one.to_json() for one in some] == [one.to_json() for one in every[2:5]]
    assert told[-1][0] == told[-1][1] >= 3 * len(sticking.op)
    short = stiction.assess_windows(**record, hop_s=300, max_window_s=600)
    assert max(one.window[1] - one.window[0] for one in short) <= np.timedelta64(600, "s")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"hop_s": 0}, "hop_s: 0.0 must be above 0"),
        ({"hop_s": 600, "max_window_s": 60}, "max_window_s"),
        ({"config": "[window]\nhop_s = 600\n", "hop_s": 60}, "config: already contains hop_s"),
        ({"config": "[window]\nhopp_s = 600\n"}, "config: line"),
        ({"ends": ("2026-01-01",)}, "ends:"),
    ],
)
def test_what_cannot_be_used_is_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(stiction.StictionError) as caught:
        stiction.assess_windows(np.zeros(100), np.ones(100), 1.0, **wrong)
    assert said in str(caught.value)


def test_windows_together_are_refused_with_a_reason() -> None:
    for wrong, said in (({"start_ns": 1}, "is not a list"), ([{"start_ns": 1}], "number 0"), (["x"], "number 0")):
        with pytest.raises(stiction.StictionError) as caught:
            stiction.over_time(wrong)  # type: ignore[arg-type]
        assert str(caught.value).startswith("windows: ") and said in str(caught.value)
    assert stiction.over_time([])["sentences"] == ["No window has given an answer yet."]


def test_numbers_of_any_kind_are_windows_too(sticking: stiction.Simulation) -> None:
    found = stiction.assess_windows(sticking.op, sticking.pv, t=sticking.t, hop_s=300)
    plain = [
        {
            "start_ns": one.window[0].astype(np.int64), "end_ns": one.window[1].astype(np.int64), "grade": one.grade,
            "stiction": one.stiction, "p_calibrated": np.float64(one.p_calibrated or np.nan),
            "s": np.float64(one.s or np.nan), "s_interval": np.array(one.s_interval or (np.nan, np.nan)),
            "j": one.j, "j_interval": one.j_interval, "j_identifiable": one.to_dict()["j_identifiable"],
        }
        for one in found
        if one.stiction is not None
    ]  # fmt: skip
    assert stiction.over_time(plain) == stiction.over_time(found) == stiction.over_time([one.to_dict() for one in found])


def free_port() -> int:
    with socket.socket() as some:
        some.bind(("127.0.0.1", 0))
        return int(some.getsockname()[1])


PREFIX = "wheel"
# The page simulates a repair from the samples held at the time. Without lateness, and with samples only up to the end of a
# window, these are the window.
ROWS = 1801
SETTINGS = '[window]\nhop_s = 300.0\nlateness_s = 0.0\n[gap]\nenabled = false\n[[loop]]\nname = "FIC101"\nop_range = [0, 100]\n'


@pytest.fixture(scope="module")
def daemon(tables: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of the API of a daemon that has received a whole loop."""
    folder, bus, web = tmp_path_factory.mktemp("daemon"), f"tcp/127.0.0.1:{free_port()}", f"127.0.0.1:{free_port()}"
    config = folder / "monitor.toml"
    config.write_text(
        f'[site]\nprefix = "{PREFIX}"\n[zenoh]\nlisten = ["{bus}"]\nmulticast = false\n'
        f'[recording]\ndir = "{folder}/recordings"\n[web]\nlisten = "{web}"\n{SETTINGS}'
    )
    table = folder / "FIC101.csv"
    table.write_text("".join(tables["sticking-FIC101"].read_text().splitlines(keepends=True)[: ROWS + 1]))
    environment = {**os.environ, "RUST_LOG": "error"}
    with subprocess.Popen([BINARY, "run", "--config", config], env=environment, stderr=subprocess.DEVNULL) as process:
        try:
            api = f"http://{web}/api/v1"
            eventually(lambda: ask(f"{api}/loops"))
            subprocess.run(
                [BINARY, "play", table, "--connect", bus, "--prefix", PREFIX, "--speed", "max"],
                check=True, capture_output=True, timeout=60,
            )  # fmt: skip
            eventually(lambda: len(ask(f"{api}/loops/FIC101/history?{WHEN}")["windows"]) >= 7)
            yield f"{api}/loops/FIC101"
        finally:
            process.terminate()
            process.wait(timeout=30)


WHEN = f"from_ms={1767600000_000 - 86_400_000}&to_ms={1767600000_000 + 86_400_000}"


def ask(url: str) -> Any:
    with urllib.request.urlopen(url, timeout=30) as answer:  # noqa: S310
        return json.loads(answer.read())


def eventually(check: Any, within: float = 60.0) -> None:
    until = time.monotonic() + within
    while True:
        try:
            if check():
                return
        except OSError:
            pass
        assert time.monotonic() < until, f"not within {within} s"
        time.sleep(0.1)


def test_many_windows_and_a_repair_are_what_the_page_shows(daemon: str, tables: dict[str, Path]) -> None:
    record = {name: column[:ROWS] for name, column in columns(tables["sticking-FIC101"]).items()}
    config = f'[site]\nprefix = "{PREFIX}"\n{SETTINGS}'
    found = stiction.assess_windows(**record, name="FIC101", config=config)
    told = ask(f"{daemon}/over-time?{WHEN}")
    together = stiction.over_time(found)
    assert told["complete"] and together["pooled"] is not None
    for name in ("windows", "pooled", "trend", "sentences"):
        assert json.dumps(together[name]) == json.dumps(told[name]), name  # type: ignore[literal-required]
    assert [change["at_ns"] / 1e6 for change in together["changes"]] == [change["at_ms"] for change in told["changes"]]
    bought = stiction.repair(**record, name="FIC101", op_range=(0, 100), window=found[-1].window)
    assert json.dumps(bought) == json.dumps(ask(f"{daemon}/repair"))
    assert bought["repaired"]["pv_sd"]["value"] < bought["now"]["pv_sd"]["value"]


def test_a_repair_that_cannot_be_told_says_why(sticking: stiction.Simulation) -> None:
    noise = np.random.default_rng(1).normal(size=(2, 600))
    cases = ((50 + noise[0], 20 + noise[1], "loop: "), (np.zeros(600), sticking.pv[:600], "choose another window"))
    for op, pv, said in cases:
        with pytest.raises(stiction.StictionError) as caught:
            stiction.repair(op, pv, 1.0)
        assert said in str(caught.value)
    again = [stiction.repair(sticking.op, sticking.pv, 1.0, sp=sticking.sp, seed=seed) for seed in (1, 1, 2)]
    assert again[0] == again[1] != again[2]
