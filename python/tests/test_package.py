"""The package as it is installed: types, stubs, examples, pages."""

from __future__ import annotations

import ast
import doctest
import inspect
import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from conftest import BINARY, ROOT

import stiction
from stiction import _results, _stiction

HOME = Path(stiction.__file__).parent
SAMPLE = """
import numpy as np
import stiction

found: stiction.Assessment = stiction.assess(np.zeros(100), [1.0] * 100, 1.0, model="fopdt", op_range=(0.0, 100.0))
size: float | None = found.s
interval: tuple[float, float] | None = found.s_interval
lag: tuple[float, ...] = found.process.time_constants_s if found.process is not None else ()
for result in stiction.assess_many({"op": [1.0], "pv": [1.0]}, ts_s=1.0, progress=lambda done, total: None):
    text: str = result.words if isinstance(result, stiction.Assessment) else result.error
gap: stiction.Gap = stiction.diagnose([1.0], [1.0], 1.0, base=found)
calm: bool = stiction.screen([1.0], [1.0], 1.0)
windows: list[stiction.Assessment] = stiction.assess_windows([1.0], [1.0], 1.0, hop_s=60, ends=("2026-01-01", 1.8e9))
together: stiction.OverTime = stiction.over_time(windows)
pooled: float | None = together["pooled"]["s"] if together["pooled"] is not None else None
kinds: list[str] = [change["kind"] for change in stiction.over_time([found.to_dict()])["changes"]]
bought: stiction.Repair = stiction.repair([1.0], [1.0], 1.0, seed=2)
spread: list[float] = bought["repaired"]["pv_sd"]["interval"]
from matplotlib.axes import Axes
from matplotlib.figure import Figure
figure: Figure = found.plot(periods=None)
axes: Axes = found.plot_phase(ax=figure.axes[0])
before_after: Figure = gap.plot()
history: Figure = together.plot()
documents: list[dict[str, object]] = stiction.assess_many({"op": [1.0]}).to_dict()
table: stiction.Assessment = stiction.assess({"op": [1.0], "pv": [1.0]}, ts_s=1.0)
together["pooled"]["slope"]  # type: ignore[index, typeddict-item]
detector = stiction.StictionDetector(ts_s=None, threshold=0.7).fit([{"op": [1.0], "pv": [1.0], "t": [0.0]}])
answers: np.ndarray[tuple[int, ...], np.dtype[np.int64]] = detector.predict(np.zeros((2, 100)))
stiction.Detector  # type: ignore[attr-defined]
stiction.assess([1.0], [1.0], 1.0, model="third")  # type: ignore[arg-type]
"""


def test_it_is_the_installed_one() -> None:
    assert ROOT not in HOME.parents or "target" in HOME.parts, f"{HOME} is the source"
    assert (HOME / "py.typed").exists() and (HOME / "_stiction.pyi").exists()
    about = metadata.metadata("stiction")
    assert about["Version"] == stiction.__version__ and "2" in about["Metadata-Version"]
    assert {Path(str(f)).name for f in metadata.files("stiction") or []} >= {"LICENSE-MIT", "LICENSE-APACHE", "py.typed"}
    assert set(about.get_all("Provides-Extra") or []) == {"plot", "sklearn", "sktime", "pandas"}
    # One wheel for every Python from 3.10 on.
    assert "cp310-abi3" in (metadata.distribution("stiction").read_text("WHEEL") or "")


def test_the_stub_says_what_the_native_module_has() -> None:
    stub = ast.parse((HOME / "_stiction.pyi").read_text())
    functions = {node.name: [a.arg for a in node.args.args] for node in stub.body if isinstance(node, ast.FunctionDef)}
    native = {
        name: list(inspect.signature(value).parameters)
        for name, value in vars(_stiction).items()
        if inspect.isbuiltin(value)
    }
    assert functions == native
    assert issubclass(_stiction.StictionError, ValueError)


def test_everything_public_is_described_and_typed() -> None:
    page = (ROOT / "docs" / "python.md").read_text()
    for name in stiction.__all__:
        thing = getattr(stiction, name)
        if inspect.isfunction(thing):
            assert thing.__doc__, name
            signature = inspect.signature(thing)
            assert signature.return_annotation is not inspect.Signature.empty
            for argument in signature.parameters.values():
                assert argument.annotation is not inspect.Parameter.empty, f"{name}: {argument.name}"
                assert f"`{argument.name}" in page or f" {argument.name}=" in page, f"docs/python.md lacks {argument.name}"
        assert f"`{name}" in page or name.startswith("__") or name in ("Interval", "Verdict"), f"docs/python.md lacks {name}"


def test_examples_of_the_docstrings_hold() -> None:
    for module in (stiction, _results):
        found = doctest.testmod(module)
        assert found.attempted > 0 and found.failed == 0, module


def test_examples_of_the_page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "python.md").read_text(), re.DOTALL)
    assert len(blocks) >= 5
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "docs/python.md", "exec"), names)  # noqa: S102


def test_the_example_draws_its_pictures(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    if not BINARY.exists():
        pytest.skip(f"no command that reads the recording at {BINARY}")
    where = {**os.environ, "STICTIOND_BIN": str(BINARY)}
    done = subprocess.run(
        [sys.executable, ROOT / "examples" / "assess.py", tmp_path / "pictures"],
        capture_output=True, text=True, check=False, cwd=tmp_path, env=where,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    pictures = {picture.name: picture.stat().st_size for picture in (tmp_path / "pictures").iterdir()}
    assert set(pictures) == {"op-pv.png", "phase.png", "sizes.png", "gap.png"} and min(pictures.values()) > 5_000
    assert "stiction: the valve sticks and slips" in done.stdout


def test_types_hold_strictly(tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    (tmp_path / "sample.py").write_text(SAMPLE)
    settings = ["--config-file", str(ROOT / "python" / "pyproject.toml"), "--cache-dir", "/dev/null"]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *settings, "-p", "stiction", "-m", "sample"],
        capture_output=True, text=True, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
