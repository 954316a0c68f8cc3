"""The detector by the rules of scikit-learn."""

from __future__ import annotations

import pickle
import sys
import warnings
from typing import Any

import numpy as np
import pytest

import stiction

sklearn = pytest.importorskip("sklearn")
from sklearn.base import clone  # noqa: E402
from sklearn.model_selection import GridSearchCV, cross_val_score  # noqa: E402
from sklearn.utils.estimator_checks import check_estimator  # noqa: E402

from stiction.detector import StictionDetector  # noqa: E402

QUICK: dict[str, Any] = {"model": "fopdt", "valve": "tracking", "delay": 6}


@pytest.fixture(scope="module")
def loops(sticking: stiction.Simulation) -> tuple[Any, Any]:
    """Two sticking records, one calm one, one that never moves; as rows OP, PV."""
    noise = np.random.default_rng(1).normal(size=(2, 400))
    rows = [
        np.concatenate([sticking.op[:400], sticking.pv[:400]]),
        np.concatenate([sticking.op[400:800], sticking.pv[400:800]]),
        np.concatenate([50 + noise[0], 20 + noise[1]]),
        np.zeros(800),
    ]
    return np.stack(rows), np.array([1, 1, 0, 0])


def test_the_checks_of_scikit_learn_hold() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        done = check_estimator(StictionDetector(), on_fail=None)
    other = {one["check_name"]: one["exception"] for one in done if one["status"] != "passed"}
    # This check needs another array library; the detector takes anything that numpy can read.
    other.pop("check_array_api_input", None)
    assert len(done) > 35 and not other, other


def test_it_predicts_what_assess_says(loops: tuple[Any, Any]) -> None:
    rows, truth = loops
    detector = StictionDetector(**QUICK).fit(rows, truth)
    assert detector.predict(rows).tolist() == [1, 1, 0, -1]
    p = detector.predict_proba(rows)
    one = stiction.assess(rows[0, :400], rows[0, 400:], 1.0, name="loop 0", **QUICK)
    assert p[0, 1] == one.p_calibrated and p[0].sum() == 1 and np.isnan(p[3]).all()
    assert detector.score(rows, truth) == 0.75 and detector.score(rows[:3], truth[:3] > 0) == 1.0
    assert detector.score(rows, truth, sample_weight=[1, 1, 1, 0]) == 1.0
    # Rows depend neither on each other nor on their order.
    assert np.array_equal(detector.predict_proba(rows[::-1])[::-1], p, equal_nan=True)
    assert np.array_equal(np.concatenate([detector.predict_proba(rows[at : at + 1]) for at in range(4)]), p, equal_nan=True)


def test_rows_cubes_and_tables_are_the_same(loops: tuple[Any, Any]) -> None:
    rows, _ = loops
    expected = StictionDetector(**QUICK).fit(rows).predict_proba(rows)
    cube = rows.reshape(4, 2, 400)
    assert np.array_equal(StictionDetector(**QUICK).fit(cube).predict_proba(cube), expected, equal_nan=True)
    tables = [{"t": np.arange(400), "op": one[0], "pv": one[1]} for one in cube]
    timed = StictionDetector(ts_s=None, **QUICK).fit(tables)
    assert np.array_equal(timed.predict_proba(tables), expected, equal_nan=True)
    # Rows of different length are filled at their end.
    padded = np.pad(cube, ((0, 0), (0, 0), (0, 50)), constant_values=np.nan)
    assert np.array_equal(StictionDetector(**QUICK).fit(padded).predict_proba(padded), expected, equal_nan=True)
    results = timed.assess([*tables, {"t": [0], "op": [1.0], "pv": [2.0]}])
    assert [one.ok for one in results] == [True, True, True, True, False]
    assert results[4].to_dict()["error"] == "1 samples, 30 are needed"


def test_it_goes_through_searches_and_pickles(loops: tuple[Any, Any]) -> None:
    rows, truth = loops
    search = GridSearchCV(StictionDetector(**QUICK), {"threshold": [0.5, 1.0]}, cv=2).fit(rows[:3], truth[:3])
    assert search.best_params_ == {"threshold": 0.5} and search.best_score_ == 1.0
    assert cross_val_score(StictionDetector(**QUICK), rows[:3], truth[:3], cv=3).tolist() == [1.0, 1.0, 1.0]
    detector = clone(StictionDetector(threshold=0.7)).set_params(ts_s=2.0)
    assert detector.get_params()["threshold"] == 0.7 and detector.get_params()["ts_s"] == 2.0
    again = pickle.loads(pickle.dumps(StictionDetector(**QUICK).fit(rows)))
    assert again.predict(rows[2:3]).tolist() == [0]


@pytest.mark.parametrize(
    ("X", "more", "said"),
    [
        (np.zeros((2, 61)), {}, "X: 61 columns; give the samples of OP, then as many of PV"),
        (np.zeros((2, 4, 60)), {}, "X: 4 channels; give OP and PV"),
        (np.zeros((1, 2, 2, 60)), {}, "X: 4 dimensions"),
        ([{"op": [1.0]}], {}, "X: table 0: pv: the table has no pv column"),
        ([{"op": [1.0], "pv": [1.0], "t": [np.nan]}], {"ts_s": None}, "X: table 0: a row has no time"),
        (np.zeros((2, 100)), {"threshold": 1.5}, "threshold: 1.5 is not a probability"),
    ],
)
def test_a_fault_names_its_field(X: Any, more: dict[str, Any], said: str) -> None:
    with pytest.raises(stiction.StictionError) as caught:
        StictionDetector(**more).fit(X)
    assert str(caught.value).startswith(said)


def test_the_package_needs_no_scikit_learn(monkeypatch: pytest.MonkeyPatch) -> None:
    assert stiction.StictionDetector is StictionDetector
    monkeypatch.delitem(sys.modules, "stiction.detector")
    monkeypatch.setitem(sys.modules, "sklearn.base", None)
    with pytest.raises(ImportError, match=r"StictionDetector needs sklearn; install it: pip install 'stiction\[sklearn\]'"):
        stiction.StictionDetector  # noqa: B018
    with pytest.raises(AttributeError, match="has no attribute 'Detector'"):
        stiction.Detector  # type: ignore[attr-defined]
