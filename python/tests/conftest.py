"""The command line to compare with, and records to compare on."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import stiction

ROOT = Path(__file__).resolve().parents[2]
BINARY = Path(os.environ.get("STICTIOND_BIN", ROOT / "target" / "debug" / "stictiond")).absolute()
Command = Callable[..., str]


@pytest.fixture(scope="session")
def command() -> Command:
    if not BINARY.exists():
        pytest.skip(f"no command to compare with at {BINARY}; set STICTIOND_BIN")

    def run(*args: object) -> str:
        done = subprocess.run([BINARY, *map(str, args)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.fixture(scope="session")
def tables(command: Command, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every loop of the shipped recordings as a table, by its name."""
    found = {}
    for recording in ("sticking", "four-loops", "awkward"):
        folder = tmp_path_factory.mktemp(recording)
        command("convert", ROOT / "recordings" / f"{recording}.mcap", folder)
        found.update({f"{recording}-{path.stem}": path for path in sorted(folder.glob("**/*.csv"))})
    assert len(found) >= 6, found
    return found


@pytest.fixture(scope="session")
def sticking() -> stiction.Simulation:
    return stiction.simulate((ROOT / "recordings" / "scenarios" / "sticking.toml").read_text())


def columns(path: Path) -> dict[str, Any]:
    """A table's columns as a caller would read them."""
    frame = pd.read_csv(path)
    return {name: frame[name] for name in ("t", "op", "pv", "sp", "mv", "mode") if name in frame}


def same(found: stiction.Assessment, told: dict[str, Any]) -> None:
    """Checks that a result equals the command's document, bit for bit."""
    hint = f"; if only last digits differ, {BINARY} is of another build than the wheel"
    assert timeless(found.to_dict()) == timeless(told), found.loop + hint


def timeless(document: dict[str, Any]) -> str:
    """A document without its times, as text, so that numbers are compared to the last bit."""
    document["elapsed_ms"] = None
    if document.get("solver"):
        document["solver"]["elapsed_ms"] = None
    return json.dumps(document)
