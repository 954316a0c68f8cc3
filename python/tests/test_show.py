"""Results as dicts, frames, tables of a notebook and pictures."""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
import types
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT

import stiction
from stiction import _show

pd = pytest.importorskip("pandas")
matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

from stiction import _plots  # noqa: E402
from stiction._ink import INK, Clock  # noqa: E402

HOUR = 3_600_000_000_000
NASTY = "FIC<script>1&\"'</script>"
QUICK: dict[str, Any] = {"model": "fopdt", "valve": "tracking", "delay": 6}


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    pyplot.close("all")


@pytest.fixture(scope="module")
def found(sticking: stiction.Simulation) -> stiction.Assessment:
    return stiction.assess(sticking.op, sticking.pv, t=sticking.t, sp=sticking.sp, name="FIC101")


@pytest.fixture(scope="module")
def gap(sticking: stiction.Simulation) -> stiction.Gap:
    return stiction.diagnose(sticking.op[:600], sticking.pv[:600], 1.0, base="linear", name=NASTY)


@pytest.fixture(scope="module")
def together() -> stiction.OverTime:
    start = 490_000 * HOUR
    sizes = [4.0, 4.1, 3.9] * 4 + [8.0, 8.2, 7.8] * 4
    seen = [
        {"start_ns": start + k * HOUR, "end_ns": start + (k + 1) * HOUR, "stiction": True, "p_stiction": 0.9, "grade": "A",
         "s": s, "s_interval": [0.9 * s, 1.1 * s]}
        for k, s in enumerate(sizes)
    ]  # fmt: skip
    seen[5] |= {"s": 30.0, "s_interval": [29.0, 31.0]}
    return stiction.over_time(reversed(seen))


@pytest.fixture(scope="module")
def many(sticking: stiction.Simulation) -> stiction.Results[stiction.Assessment | stiction.Failure]:
    table = {
        "loop": np.repeat([NASTY, "calm", "empty"], 600), "op": np.tile(sticking.op[:600], 3),
        "pv": np.concatenate([sticking.pv[:600], np.random.default_rng(1).normal(size=600), np.full(600, np.nan)]),
    }  # fmt: skip
    return stiction.assess_many(table, ts_s=1.0, model="fopdt", valve="tracking", delay=6)


def lines(axes: Any) -> dict[str, Any]:
    return {str(line.get_label()): line for line in axes.get_lines()}


def test_frames_have_numbers_times_and_missing_values(
    found: stiction.Assessment, many: stiction.Results[Any], gap: stiction.Gap, together: stiction.OverTime
) -> None:
    one = found.to_frame().iloc[0]
    assert (one["loop"], one["s"], one["s_low"], one["start"]) == ("FIC101", found.s, found.s_interval[0], pd.Timestamp(found.window[0]))  # type: ignore[index]
    frame = many.to_frame()
    assert list(frame["loop"]) == [NASTY, "calm", "empty"] and frame["error"].notna().tolist() == [False, False, True]
    assert frame["s"].dtype == "float64" and frame["stiction"].dtype == "boolean" and str(frame["end"].dtype) == "datetime64[ns]"
    # A column keeps its type even if no loop has a value.
    assert stiction.Results([many[2]]).to_frame()["s"].dtype == "float64" and np.isnat(stiction.Results([many[2]]).to_frame()["end"][0].to_numpy())
    effects, samples = gap.to_frame(), gap.predictions.to_frame()
    assert effects.index[0] == gap.effects[0].id and effects["closed_low"].dtype == "float64"
    assert samples.index[0] == pd.Timestamp(0) and list(samples) == ["pv", "base", "after", "held_out"] and len(samples) == 600
    history = together.to_frame()
    assert history.index.is_monotonic_increasing and len(history) == 24
    assert history["contradicts"].sum() == len(together["contradicting"]) >= 1
    assert history["s"].iloc[5] == 30.0 and history["contradicts"].iloc[5]


def test_documents_are_plain_dicts(many: stiction.Results[Any], together: stiction.OverTime, sticking: stiction.Simulation) -> None:
    documents = many.to_dict()
    assert documents[0]["schema"] == "stictiond.estimate.v1" and documents[2] == {"loop": "empty", "error": many[2].error}
    assert type(together.to_dict()) is dict and together.to_dict() == together
    assert sticking.to_frame().shape == (2000, 4) and set(sticking.to_dict()) == {"t", "op", "pv", "sp", "mv"}
    again = pickle.loads(pickle.dumps(together))
    assert again == together and again.to_frame().equals(together.to_frame())


class Cells(HTMLParser):
    """Tags and texts."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.texts: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.tags.append(tag)

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def test_tables_of_a_notebook_are_escaped(
    found: stiction.Assessment, many: stiction.Results[Any], gap: stiction.Gap, together: stiction.OverTime
) -> None:
    for one in (many, many[0], gap, together, found):
        page = Cells(one._repr_html_())
        assert set(page.tags) <= {"table", "caption", "thead", "tbody", "tr", "th", "td", "b"}, page.tags
    assert NASTY in Cells(many._repr_html_()).texts and NASTY in Cells(gap._repr_html_()).texts
    texts = Cells(found._repr_html_()).texts
    assert found.s is not None and found.s_interval is not None and found.words in " ".join(texts)
    assert _show.estimate(found.s, found.s_interval) in texts and f"{found.p_stiction:.2f} if 30% of such loops stick, grade {found.grade}" in texts
    many_rows = Cells(stiction.Results([many[0]] * 75)._repr_html_())
    assert many_rows.tags.count("tr") == 1 + 60 + 1 and "and 15 more" in many_rows.texts


def test_the_picture_of_an_assessment(found: stiction.Assessment, sticking: stiction.Simulation) -> None:
    figure = found.plot()
    pv, op, phase, why = figure.axes
    assert found.words in figure._suptitle.get_text()  # type: ignore[attr-defined]
    assert found.period_s is not None
    drawn = lines(pv)
    assert {"SP", "PV", "free run of the model"} <= set(drawn)
    shown = drawn["PV"].get_ydata()
    assert abs(len(shown) - 8 * found.period_s) < 3 and np.array_equal(shown, sticking.pv[-len(shown) :])
    # The free run is that of the model: it follows PV as well as the fit states.
    whole = lines(found.plot_trend(periods=None))
    run, pv_all = whole["free run of the model"], whole["PV"]
    assert np.array_equal(pv_all.get_ydata(), sticking.pv)
    assert np.array_equal(run.get_xdata(), pv_all.get_xdata())
    known = np.isfinite(run.get_ydata())
    error = (run.get_ydata() - sticking.pv)[known]
    assert found.process is not None and np.isclose(np.mean(error**2), found.process.mse, rtol=0.1)
    assert np.mean(known) > 0.9
    # The run of a different model is not drawn instead.
    other = stiction.assess(sticking.op, sticking.pv, 1.0, **QUICK)
    assert other.process is not None and other.process.mse > 10 * found.process.mse
    assert "free run of the model" not in lines(other.plot_trend())
    assert pv.get_ylabel() == "PV" and op.get_ylabel() == "OP" and op.get_xlabel() == "UTC" and phase.get_xlabel() == "OP"
    size = [line for line in phase.get_lines() if len(line.get_xdata()) == 2][0].get_xdata()
    assert np.isclose(size[1] - size[0], found.s)
    bars = [bar.get_width() for bar in why.patches]
    explained = found.to_dict()["explanation"]
    assert np.isclose(sum(bars[:-1]), bars[-1], atol=1e-6) and np.isclose(bars[-1], explained["logit"])


def test_the_error_map_is_least_near_the_truth(found: stiction.Assessment) -> None:
    axes = found.plot_error_map(step=0.05)
    drawn = lines(axes)
    assert {"suggested region", "answer", "least error", "90 % interval"} <= set(drawn)
    cells = axes.collections[0]
    z, corners = cells.get_array(), cells.get_coordinates()
    row, column = np.unravel_index(np.nanargmin(np.ma.filled(z, np.nan)), z.shape)
    middle = corners[row : row + 2, column : column + 2].mean(axis=(0, 1))
    least = np.concatenate(drawn["least error"].get_data())
    assert np.allclose(middle, least)
    region = np.array(drawn["suggested region"].get_data())
    inside = (region.min(axis=1) <= least) & (least <= region.max(axis=1))
    # The valve has fs 5 and fd 3; a cell is a twentieth of OP's span.
    assert inside.all() and (np.abs(least - [5.0, 3.0]) < 0.1 * found.s0).all()
    assert np.allclose(np.concatenate(drawn["answer"].get_data()), [found.fs, found.fd])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("fs, OP units", "fd, OP units")
    assert "answer" not in lines(found.plot_error_map(order=3 - found.process.order, step=0.1))
    for wrong, said in (({"order": 3}, "order: give 1 or 2"), ({"step": 0.5}, "step: give a share")):
        with pytest.raises(stiction.StictionError, match=said):
            found.plot_error_map(**wrong)


def test_axes_and_figures_of_the_caller_are_used(found: stiction.Assessment) -> None:
    before = dict(matplotlib.rcParams)
    figure, axes = pyplot.subplots(1, 3)
    assert found.plot_trend(ax=axes[0], free_run=False) is axes[0] and "free run of the model" not in lines(axes[0])
    assert found.plot_phase(ax=axes[1]) is axes[1] and found.plot_indicators(ax=axes[2]) is axes[2]
    mine = pyplot.figure()
    assert found.plot(figure=mine) is mine and len(mine.axes) == 4
    assert dict(matplotlib.rcParams) == before


def test_a_result_without_its_record_takes_one(found: stiction.Assessment, many: Any, sticking: stiction.Simulation) -> None:
    again = pickle.loads(pickle.dumps(found))
    assert again == found and again._record is None
    for one in (again, many[0]):
        with pytest.raises(stiction.StictionError, match=r"^record: this result has none; give the loop's rows"):
            one.plot()
    drawn = again.plot_trend(sticking.to_frame(), periods=None)
    assert np.array_equal(lines(drawn)["PV"].get_ydata(), sticking.pv)
    with pytest.raises(stiction.StictionError, match=r"^periods: -1.0 must be above 0"):
        found.plot(periods=-1)


def test_the_picture_of_a_window_shows_that_window(sticking: stiction.Simulation) -> None:
    windows = stiction.assess_windows(sticking.op, sticking.pv, 1.0, hop_s=600)
    one = windows[-1]
    axes = one.plot_trend(periods=None)
    span = np.ptp(lines(axes)["PV"].get_xdata()) * 60
    assert axes.get_xlabel() == "minutes"
    assert np.isclose(span, (one.window[1] - one.window[0]) / np.timedelta64(1, "s"), atol=1.0)


def test_rows_of_either_signal_are_drawn(sticking: stiction.Simulation) -> None:
    t = np.concatenate([sticking.t[:600], sticking.t[:600] + np.timedelta64(400, "ms")])
    nothing = np.full(600, np.nan)
    apart = stiction.assess(
        np.concatenate([sticking.op[:600], nothing]), np.concatenate([nothing, sticking.pv[:600]]), t=t, **QUICK
    )
    line = apart.plot_phase().get_lines()[0]
    assert np.array_equal(line.get_xdata(), sticking.op[:600]) and np.array_equal(line.get_ydata(), sticking.pv[:600])


def test_the_picture_of_a_gap(gap: stiction.Gap) -> None:
    upper, middle, lower = gap.plot().axes
    drawn, errors = lines(upper), lines(middle)
    assert {"PV", "before: base model", f"after: with {gap.cause}"} <= set(drawn)
    held_out = gap.predictions.held_out
    before, after = (np.nanmean(errors[name].get_ydata()[held_out] ** 2) for name in ("before: base model", f"after: with {gap.cause}"))
    assert after < before
    assert [text.get_text() for text in lower.get_yticklabels()][0] == gap.effects[0].id


def test_the_picture_of_many_windows(together: stiction.OverTime) -> None:
    upper, lower = together.plot().axes
    drawn = lines(upper)
    assert drawn["s and its interval"].get_ydata().tolist() == together.to_frame()["s"].tolist()
    assert sorted(drawn["contradicts the others"].get_ydata()) == sorted(one["s"] for one in together["contradicting"])
    assert [text.get_text() for text in upper.texts] == ["worse since"] and len(upper.patches) == 1
    assert lower.get_ylabel() == "p of stiction"


def test_the_pictures_of_loops_and_of_a_repair(many: Any, sticking: stiction.Simulation) -> None:
    axes = many.plot()
    assert [label.get_text() for label in axes.get_yticklabels()] == [NASTY, "calm", "empty"]
    words = [text.get_text().strip() for text in axes.texts]
    assert words == [_plots.SHORT[many[1].verdict], "could not be assessed"]
    benefit = stiction.repair(sticking.op, sticking.pv, t=sticking.t, sp=sticking.sp, op_range=(0, 100), samples=(1, 900))
    points = [line.get_xdata()[0] for line in benefit.plot().get_lines() if line.get_marker() == "o"]
    frame = benefit.to_frame()
    assert points == frame["pv_sd"].tolist() and list(frame.index) == ["now", "repaired", "half_gain"]
    assert Cells(benefit._repr_html_()).tags.count("tr") == 4
    assert len(sticking.plot().axes) == 3


def test_colours_are_those_of_the_page() -> None:
    light = (ROOT / "src" / "web" / "assets" / "app.css").read_text().split("@media")[0]
    page = dict(re.findall(r"--([a-z]+):(#[0-9a-f]{6});", light))
    assert {name: page.get(name) for name in INK} == INK


def test_short_verdicts_are_those_of_the_page() -> None:
    page = (ROOT / "src" / "web" / "assets" / "verdicts.js").read_text()
    assert dict(re.findall(r'(\w+): \{ short: "([a-z ]+)"', page)) == _plots.SHORT


def test_axes_of_time() -> None:
    for seconds, unit in ((100, "seconds"), (1000, "minutes"), (10_000, "hours"), (1_000_000, "days")):
        _, axes = pyplot.subplots()
        clock = Clock(np.array([0, seconds * 10**9]).view("datetime64[ns]"))
        clock.label(axes)
        assert axes.get_xlabel() == unit
    assert clock.x(np.array([0, 10**15]).view("datetime64[ns]")).tolist() == [0.0, 1_000_000 / 86_400]


@pytest.mark.parametrize(
    ("hidden", "call", "said"),
    [
        ("pandas", "to_frame", r"to_frame\(\) needs pandas; install it: pip install pandas"),
        ("matplotlib", "plot", r"a plot needs matplotlib; install it: pip install 'stiction\[plot\]'"),
    ],
)
def test_what_is_not_installed_is_named(
    found: stiction.Assessment, monkeypatch: pytest.MonkeyPatch, hidden: str, call: str, said: str
) -> None:
    monkeypatch.setitem(sys.modules, hidden, None)
    with pytest.raises(ImportError, match=said):
        getattr(found, call)()


def test_progress_by_tqdm(sticking: stiction.Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    class Bar:
        made: list[Any] = []

        def __init__(self) -> None:
            self.n, self.total, self.open = 0, 0, True
            self.made.append(self)

        def update(self, by: int) -> None:
            self.n += by

        def close(self) -> None:
            self.open = False

    monkeypatch.setitem(sys.modules, "tqdm.auto", types.SimpleNamespace(tqdm=Bar))
    table = {"loop": np.repeat(["A", "B"], 400), "op": np.tile(sticking.op[:400], 2), "pv": np.full(800, np.nan)}
    stiction.assess_many(table, ts_s=1.0, progress=True)
    assert [(bar.n, bar.total, bar.open) for bar in Bar.made] == [(2, 2, False)]
    stiction.assess_many(table, ts_s=1.0, progress=False)
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    with pytest.raises(ImportError, match="progress=True needs tqdm; install it: pip install tqdm"):
        stiction.assess_many(table, ts_s=1.0, progress=True)


def test_a_plant_has_the_frame_of_its_loops(sticking: stiction.Simulation) -> None:
    table = {"loop": np.repeat(["A", "B"], 400), "t": np.tile(np.arange(400), 2), "op": np.tile(sticking.op[:400], 2),
             "pv": np.full(800, np.nan)}  # fmt: skip
    plant = stiction.assess_plant(table)
    assert list(plant.to_frame()["loop"]) == ["A", "B"] and plant.to_dict() == {"loops": plant.loops.to_dict(), "groups": []}
    assert plant._repr_html_() == plant.loops._repr_html_()


def test_the_package_imports_none_of_them() -> None:
    names = "{'pandas', 'matplotlib', 'sklearn', 'pyarrow', 'tqdm'}"
    program = f"import sys, stiction; assert not {names} & set(sys.modules), {names} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)


def test_the_notebook_runs(tmp_path: Path) -> None:
    pytest.importorskip("sklearn")
    done = subprocess.run(
        [sys.executable, ROOT / "examples" / "notebook.py", tmp_path / "pictures"],
        capture_output=True, text=True, check=False, cwd=tmp_path, env={**os.environ, "MPLBACKEND": "Agg"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    pictures = {picture.name: picture.stat().st_size for picture in (tmp_path / "pictures").iterdir()}
    assert set(pictures) == {"assessment.png", "gap.png", "history.png", "repair.png", "loops.png"}
    assert min(pictures.values()) > 8_000
    # The simulated valve has s = 5.5, as the tutorial says.
    assert "41FIC201" in done.stdout and "the valve sticks and slips" in done.stdout and "[1 1]" in done.stdout
    assert "Warning" not in done.stderr, done.stderr
