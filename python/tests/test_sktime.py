"""The detector by the rules of sktime."""

from __future__ import annotations

import sys
import warnings
from typing import Any

import numpy as np
import pandas as pd
import pytest

import stiction

pytest.importorskip("sktime")
from sktime.utils.estimator_checks import check_estimator  # noqa: E402

from stiction.sktime import StictionDetector  # noqa: E402


@pytest.fixture(scope="module")
def table(sticking: stiction.Simulation) -> pd.DataFrame:
    """A sticking valve, then a calm loop without friction."""
    noise = np.random.default_rng(1).normal(size=(2, 2000))
    op, pv = (np.concatenate([x, x.mean() + n]) for x, n in zip((sticking.op, sticking.pv), noise))
    return pd.DataFrame({"op": op, "pv": pv}, index=pd.date_range("2026-01-05T08:00:00", periods=4000, freq="s"))


def test_the_checks_of_sktime_hold() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        done = check_estimator(StictionDetector, verbose=False)
    other = {name: result for name, result in done.items() if result != "PASSED"}
    assert len(done) > 80 and not other, other
    assert sum("Detectors" in name or "detector" in name or "predict_segments" in name for name in done) >= 3


def test_segments_are_those_of_the_windows(table: pd.DataFrame) -> None:
    detector = StictionDetector(hop_s=300, max_window_s=900).fit(table)
    windows = stiction.assess_windows(table, hop_s=300, max_window_s=900)
    labels = detector.transform(table)["labels"].to_numpy()
    stamps = table.index.to_numpy()
    for one in windows[1:]:
        last = labels[np.searchsorted(stamps, one.window[1])]
        assert last == (-1 if one.stiction is None else int((one.p_calibrated or 0.0) >= 0.5)), one
    segments = detector.predict(table)
    assert segments["ilocs"].iloc[0].left == 0 and segments["ilocs"].iloc[-1].right == len(table)
    assert {0, 1} <= set(segments["labels"]) and (np.diff(segments["labels"]) != 0).all()
    for segment, label in zip(segments["ilocs"], segments["labels"]):
        assert (labels[segment.left : segment.right] == label).all()
    # The valve sticks in the first half only; a window that still contains part of it may find stiction.
    assert (labels[400:1800] == 1).all() and (labels[3000:3600] == 0).all()


def test_scores_are_the_probabilities(table: pd.DataFrame) -> None:
    detector = StictionDetector(hop_s=300, threshold=0.9).fit(table)
    p, segments = detector.transform_scores(table)["scores"], detector.predict(table)
    assert p.index.equals(table.index) and (p.dropna() > 0.9).any()
    means = [p.iloc[one.left : one.right].mean() for one in segments["ilocs"]]
    assert np.allclose(detector.predict_scores(table)["scores"], means, equal_nan=True)
    assert np.array_equal(segments["labels"] == 1, np.array(means) >= 0.9)


def test_times_come_from_the_index_or_from_ts_s(table: pd.DataFrame) -> None:
    part = table.iloc[:1400]
    expected = StictionDetector(hop_s=300).fit(part).predict(part)
    assert 1 in set(expected["labels"])
    zoned = part.set_axis(part.index.tz_localize("UTC").tz_convert("Europe/Berlin"))
    periods = part.set_axis(part.index.to_period("s"))
    for same in (zoned, periods, part.reset_index(drop=True), part.to_numpy()):
        found = StictionDetector(hop_s=300).fit(same).predict(same)
        assert found.equals(expected), type(same)


@pytest.mark.parametrize(
    ("X", "more", "said"),
    [
        (pd.DataFrame({"op": np.arange(40.0)}), {}, "X: .*pv"),
        (pd.Series(np.arange(40.0)), {}, "X: "),
        (np.ones((40, 2)), {"ts_s": None}, "X: ts_s: give either"),
        (np.ones((40, 2)), {"ts_s": -1.0}, "X: ts_s: "),
        (np.ones((40, 2)), {"threshold": 1.5}, "threshold: 1.5 is not a probability"),
    ],
)
def test_a_fault_names_its_field(X: Any, more: dict[str, Any], said: str) -> None:
    with pytest.raises(stiction.StictionError, match=said):
        StictionDetector(**more).fit(X).predict(X)


def test_the_package_needs_no_sktime(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "stiction.sktime")
    monkeypatch.setitem(sys.modules, "sktime.detection.base", None)
    with pytest.raises(ImportError, match=r"needs sktime; install it: pip install 'stiction\[sktime\]'"):
        import stiction.sktime  # noqa: F401, PLC0415
