"""Stiction detection with sktime's conventions; needs `stiction[sktime]`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _arrays, _show, _tables, assess_windows
from .detector import LEAST_SAMPLES, label, probability, threshold_of

_INSTALL = ("stiction.sktime", "'stiction[sktime]'")
_Base: Any = _show.needed("sktime.detection.base", *_INSTALL).BaseDetector
_pandas: Any = _show.needed("pandas", *_INSTALL)


class StictionDetector(_Base):  # type: ignore[misc]
    """Divides a record of one loop into segments in which the valve sticks and others.

    X is a DataFrame with columns `op`, `pv` and, optionally, `sp`, `mv` (or tags such as FIC101.OP), or an array with OP,
    PV and, optionally, SP as columns. NaN is a missing value. A DatetimeIndex or PeriodIndex gives the times.

    Labels are 1 where the valve sticks, 0 where no stiction was found, -1 where there is no answer. The windows are those
    of `assess_windows`; samples that were not yet in the window before have the label of the window.

    ts_s: seconds between samples, without such an index. threshold: from this probability (`p_calibrated`) on, a valve
    sticks. name, hop_s, max_window_s, config, threads: as for `assess_windows`.

    `fit` learns nothing, and y is not used.

    Examples
    --------
    >>> import pandas as pd
    >>> from stiction.sktime import StictionDetector
    >>> still = pd.DataFrame({"op": [50.0] * 40, "pv": [60.0] * 40})
    >>> StictionDetector(ts_s=1.0).fit(still).predict(still)
         ilocs  labels
    0  [0, 40)      -1
    """

    _tags = {
        "authors": "stictiond authors",
        "maintainers": "stictiond authors",
        "task": "segmentation",
        "learning_type": "unsupervised",
        "capability:multivariate": True,
        "capability:missing_values": True,
        "fit_is_empty": True,
        "X_inner_mtype": "pd.DataFrame",
    }

    def __init__(
        self,
        ts_s: float | None = 1.0,
        *,
        threshold: float = 0.5,
        name: str = "loop",
        hop_s: float | None = None,
        max_window_s: float | None = None,
        config: str | None = None,
        threads: int | None = None,
    ) -> None:
        self.ts_s = ts_s
        self.threshold = threshold
        self.name = name
        self.hop_s = hop_s
        self.max_window_s = max_window_s
        self.config = config
        self.threads = threads
        super().__init__()

    def _predict(self, X: Any) -> Any:
        _, labels = self._judged(X)
        starts = _starts(labels)
        return _pandas.DataFrame({"ilocs": _intervals(starts, len(labels)), "labels": labels[starts]})

    def _predict_scores(self, X: Any) -> Any:
        """The mean probability of each segment of `predict`."""
        p, labels = self._judged(X)
        starts = _starts(labels)
        return _pandas.DataFrame({"scores": [float(np.mean(part)) for part in np.split(p, starts[1:])]})

    def _transform_scores(self, X: Any) -> Any:
        """The calibrated probability that the valve sticks at each sample; NaN where there is none."""
        return _pandas.DataFrame({"scores": self._judged(X)[0]}, index=X.index)

    def _judged(self, X: Any) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Probability and label of the first window that holds each sample."""
        p, labels = np.full(len(X), np.nan), np.full(len(X), -1)
        threshold = threshold_of(self.threshold)
        loop, stamps = self._loop(X)
        if len(X) < LEAST_SAMPLES:
            return p, labels
        windows = assess_windows(
            loop, ts_s=None if "t" in loop else self.ts_s, name=self.name, hop_s=self.hop_s,
            max_window_s=self.max_window_s, config=self.config, threads=self.threads,
        )  # fmt: skip
        judged = 0
        for one in windows:
            first = int(np.searchsorted(stamps, one.window[0], side="left"))
            last = int(np.searchsorted(stamps, one.window[1], side="right"))
            held = slice(max(first, judged), last)
            p[held], labels[held] = probability(one), label(one, threshold)
            judged = max(judged, last)
        return p, labels

    def _loop(self, X: Any) -> tuple[dict[str, Any], NDArray[Any]]:
        """Columns of the loop, and the times of its rows."""
        frame = _pandas.DataFrame(X)
        if not all(isinstance(column, str) for column in frame.columns):
            frame = frame.set_axis(["op", "pv", "sp"][: frame.shape[1]], axis=1) if frame.shape[1] in (2, 3) else frame
        if isinstance(frame.index, _pandas.PeriodIndex):
            frame = frame.set_axis(frame.index.to_timestamp())
        if len(frame) < LEAST_SAMPLES:
            return {}, np.array([])
        timed = _tables.index_times(frame) is not None
        try:
            _, columns = _tables.record(self.name, frame, None, None if timed else self.ts_s, None)
        except ValueError as why:
            raise _arrays.refused("X", str(why)) from None
        loop = {key: np.frombuffer(columns[key], "<f8") for key in ("op", "pv", "sp", "mv") if columns[key] is not None}
        if not timed:
            step_ns = round(1e9 * _arrays.positive("ts_s", self.ts_s))
            return loop, (np.arange(len(frame)) * step_ns).astype("datetime64[ns]")
        loop["t"] = _arrays.plain(frame.index.tz_convert("UTC") if frame.index.tz is not None else frame.index)
        return loop, loop["t"].astype("datetime64[ns]")

    @classmethod
    def get_test_params(cls, parameter_set: str = "default") -> list[dict[str, Any]]:
        """Arguments that sktime's checks try."""
        return [{}, {"ts_s": 5.0, "threshold": 0.7, "hop_s": 300.0}]


def _starts(labels: NDArray[Any]) -> NDArray[np.int64]:
    """The rows at which runs of equal labels begin."""
    return np.flatnonzero(np.diff(labels, prepend=np.nan) != 0) if len(labels) else np.array([], dtype=np.int64)


def _intervals(starts: NDArray[np.int64], rows: int) -> Any:
    return _pandas.IntervalIndex.from_arrays(starts, np.append(starts[1:], rows) if rows else starts, closed="left")
