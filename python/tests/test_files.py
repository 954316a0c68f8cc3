"""Loops from exports and recordings, as the command line reads them."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Command, same

import stiction

pytest.importorskip("pandas")
RECORDINGS = ROOT / "recordings"
FAST = ("--model", "fopdt", "--valve", "tracking", "--delay", "6", "--format", "json")


def test_an_export_gives_what_the_command_says(command: Command) -> None:
    export = RECORDINGS / "fic201-export.csv"
    table = stiction.read(export, tz="Europe/Berlin")
    assert list(table.columns)[:4] == ["loop", "t", "op", "pv"] and str(table["t"].dt.tz) == "UTC"
    found = stiction.assess(table, model="fopdt", valve="tracking", delay=6)
    # A table cannot keep the unit from its heading.
    told = json.loads(command("analyze", export, "--tz", "Europe/Berlin", *FAST))
    same(found, {**told, "op_unit": found.to_dict()["op_unit"]})


def test_a_loop_of_a_recording_gives_what_the_command_says(command: Command) -> None:
    recording = RECORDINGS / "four-loops.mcap"
    table = stiction.read(recording)
    assert list(dict.fromkeys(table["loop"])) == ["FIC201", "LIC202", "PIC203", "TIC204"]
    assert "sp" in table.columns and "mode" not in table.columns
    found = stiction.assess(table, name="LIC202", model="fopdt", valve="tracking", delay=6)
    # The command uses the recording's configuration, which here changes only the hash.
    told = json.loads(command("analyze", recording, "--loop", "LIC202", *FAST))
    same(found, {**told, "config_hash": found.to_dict()["config_hash"]})


def test_several_files_come_into_one_table(tmp_path: Path) -> None:
    for name in ("A", "B"):
        (tmp_path / f"{name}.csv").write_text("t,op,pv\n" + "".join(f"{k},{k % 7},{k % 5}\n" for k in range(40)))
    table = stiction.read(tmp_path / "*.csv")
    assert list(table.columns) == ["loop", "t", "op", "pv"]
    assert table.groupby("loop").size().to_dict() == {"A": 40, "B": 40}
    assert np.array_equal(table["op"], [k % 7 for k in range(40)] * 2)
    (tmp_path / "C.csv").write_text("hello")
    with pytest.warns(UserWarning, match=r"C\.csv"):
        assert len(stiction.read(tmp_path)) == 80
    (tmp_path / "A.csv").write_text("t,op,pv,mode\n0,1,2,auto\n1,2,3,manual\n2,3,4,\n")
    assert list(stiction.read(tmp_path / "A.csv")["mode"].fillna("none")) == ["auto", "manual", "none"]


def test_faults_name_the_file_or_the_argument(tmp_path: Path) -> None:
    with pytest.raises(stiction.StictionError, match=r"none\.csv"):
        stiction.read(tmp_path / "none.csv")
    with pytest.raises(stiction.StictionError, match=r"^tz: .*Mars"):
        stiction.read(RECORDINGS / "fic201-export.csv", tz="Mars")
    with pytest.raises(stiction.StictionError, match="^decimal: "):
        stiction.read(RECORDINGS / "fic201-export.csv", decimal="dot")


def test_a_cut_recording_is_read_with_a_warning(tmp_path: Path) -> None:
    whole = (RECORDINGS / "sticking.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    with pytest.warns(UserWarning, match="the recording is cut"):
        assert 0 < len(stiction.read(cut))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(stiction.read(RECORDINGS / "sticking.mcap")) > 1000
