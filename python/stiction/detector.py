"""Stiction detection with scikit-learn's conventions; needs `stiction[sklearn]`.

>>> import numpy as np
>>> detector = StictionDetector(ts_s=1.0).fit(np.zeros((2, 100)))
>>> detector.predict(np.zeros((2, 100)))
array([-1, -1])
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import Assessment, Detrend, Failure, Interval, Kind, Model, Results, Valve, _arrays, _show, _tables, assess_many

_Base: Any = _show.needed("sklearn.base", "StictionDetector", "'stiction[sklearn]'").BaseEstimator
_validation: Any = _show.needed("sklearn.utils.validation", "StictionDetector", "'stiction[sklearn]'")

Loops: TypeAlias = ArrayLike | Sequence[Any]
"""An array, or a list of tables."""
LEAST_SAMPLES = 30
"""Samples that an estimate needs."""


class StictionDetector(_Base):  # type: ignore[misc]
    """Tells sticking valves from others, one loop per row.

    X is one of:
    an array (loops, 2 n): a loop's n samples of OP, then its n samples of PV;
    an array (loops, channels, n), as in sktime and aeon: OP, PV and, if there is a third channel, SP;
    a list of tables, one per loop, with columns `op`, `pv` and, optionally, `sp`; times from `t` or a DatetimeIndex.
    NaN is a missing value; rows of different length are filled with NaN at their end.

    ts_s: seconds between samples; None for tables with times. threshold: from this probability on, a valve sticks.
    Probabilities are `p_calibrated`: those of a set in which half of the valves stick.
    threads: as for `assess_many`, like the other arguments, which apply to every loop.

    `fit` only notes the shape of X: the classifier is that of the package, and y is not used.
    """

    def __init__(
        self,
        ts_s: float | None = 1.0,
        *,
        threshold: float = 0.5,
        op_range: Interval | None = None,
        kind: Kind | None = None,
        model: Model = "auto",
        delay: str | float = "auto",
        valve: Valve = "auto",
        downsample: float | None = None,
        detrend: Detrend | None = None,
        seed: int = 1,
        threads: int | None = None,
    ) -> None:
        self.ts_s = ts_s
        self.threshold = threshold
        self.op_range = op_range
        self.kind = kind
        self.model = model
        self.delay = delay
        self.valve = valve
        self.downsample = downsample
        self.detrend = detrend
        self.seed = seed
        self.threads = threads

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = True
        tags.input_tags.three_d_array = True
        return tags

    def fit(self, X: Loops, y: ArrayLike | None = None) -> StictionDetector:
        """Note the shape of X; y is not used."""
        self._loops(X, reset=True)
        threshold_of(self.threshold)
        self.classes_ = np.array([0, 1])
        return self

    def assess(self, X: Loops) -> Results[Assessment | Failure]:
        """Every loop's `Assessment`, or `Failure`, in the order of X."""
        _validation.check_is_fitted(self)
        loops = self._loops(X, reset=False)
        found: list[Assessment | Failure] = [
            Failure(f"loop {at}", f"{len(loop['op'])} samples, {LEAST_SAMPLES} are needed") for at, loop in enumerate(loops)
        ]
        long = [(at, loop) for at, loop in enumerate(loops) if len(loop["op"]) >= LEAST_SAMPLES]
        if long:
            table = _stacked(long)
            ts_s = None if "t" in table else self.ts_s
            answers = assess_many(
                table, ts_s=ts_s, op_range=self.op_range, kind=self.kind, model=self.model, delay=self.delay,
                valve=self.valve, downsample=self.downsample, detrend=self.detrend, seed=self.seed,
                threads=self.threads,
            )  # fmt: skip
            for (at, _), answer in zip(long, answers):
                found[at] = answer
        return Results(found)

    def predict_proba(self, X: Loops) -> NDArray[np.float64]:
        """Probabilities that the valve does not stick and that it does, a row per loop; NaN where there is no answer."""
        return self._probabilities(self.assess(X))

    def predict(self, X: Loops) -> NDArray[np.int64]:
        """1 where the valve sticks, 0 where no stiction was found, -1 where the record allows no answer."""
        threshold = threshold_of(self.threshold)
        return np.array([label(one, threshold) for one in self.assess(X)], dtype=np.int64)

    def fit_predict(self, X: Loops, y: ArrayLike | None = None) -> NDArray[np.int64]:
        """`fit`, then `predict`."""
        return self.fit(X, y).predict(X)

    def score(self, X: Loops, y: ArrayLike, sample_weight: ArrayLike | None = None) -> float:
        """Share of loops whose prediction is y (1 or True: sticks); no answer counts as wrong."""
        found = self.predict(X)
        truth = np.asarray(y).astype(np.int64)
        _validation.check_consistent_length(found, truth, sample_weight)
        weights = None if sample_weight is None else np.asarray(sample_weight, dtype=np.float64)
        return float(np.average(found == truth, weights=weights))

    @staticmethod
    def _probabilities(results: Results[Assessment | Failure]) -> NDArray[np.float64]:
        p = np.array([probability(one) for one in results], dtype=np.float64)
        return np.stack([1.0 - p, p], axis=1)

    def _loops(self, X: Any, reset: bool) -> list[dict[str, Any]]:
        """Columns of every loop."""
        if isinstance(X, (list, tuple)) and X and _tables.is_table(X[0]):
            return [self._of_table(at, one) for at, one in enumerate(X)]
        array = _validation.validate_data(
            self, X, reset=reset, dtype=np.float64, ensure_all_finite="allow-nan", allow_nd=True, ensure_min_samples=1
        )
        if array.ndim == 3:
            if array.shape[1] not in (2, 3):
                raise _arrays.refused("X", f"{array.shape[1]} channels; give OP and PV, or OP, PV and SP")
            return [_trimmed(dict(zip(("op", "pv", "sp"), loop))) for loop in array]
        if array.ndim != 2:
            raise _arrays.refused("X", f"{array.ndim} dimensions; give (loops, 2 n) or (loops, channels, n)")
        # Too narrow for an estimate, so there is no answer however the columns are split.
        half, odd = divmod(array.shape[1], 2)
        if odd and half >= LEAST_SAMPLES:
            raise _arrays.refused("X", f"{array.shape[1]} columns; give the samples of OP, then as many of PV")
        return [_trimmed({"op": loop[:half], "pv": loop[half : 2 * half]}) for loop in array]

    def _of_table(self, at: int, table: Any) -> dict[str, Any]:
        try:
            _, columns = _tables.record("loop", table, None, self.ts_s, None)
        except ValueError as why:
            raise _arrays.refused("X", f"table {at}: {why}") from None
        unit, stamps = columns["t"]
        loop = {name: np.frombuffer(columns[name], "<f8") for name in ("op", "pv", "sp") if columns[name] is not None}
        if self.ts_s is None:
            ns = np.frombuffer(stamps, "<i8") if unit == "ns" else np.rint(np.frombuffer(stamps, "<f8") * 1e9)
            if not np.isfinite(ns).all():
                raise _arrays.refused("X", f"table {at}: a row has no time; drop the row")
            loop["t"] = ns.astype(np.int64).view("datetime64[ns]")
        return loop


def probability(result: Assessment | Failure) -> float:
    """The calibrated probability that the valve sticks; NaN where there is none."""
    if isinstance(result, Failure) or result.stiction is None or result.p_calibrated is None:
        return np.nan
    return result.p_calibrated


def label(result: Assessment | Failure, threshold: float) -> int:
    """1 where the valve sticks, 0 where no stiction was found, -1 where there is no answer."""
    if isinstance(result, Failure) or result.stiction is None:
        return -1
    # A screened loop has no probability.
    return int(result.p_calibrated is not None and result.p_calibrated >= threshold)


def threshold_of(value: Any) -> float:
    number = _arrays.positive("threshold", value)
    if number > 1.0:
        raise _arrays.refused("threshold", f"{number} is not a probability; give a number above 0, at most 1")
    return number


def _trimmed(loop: dict[str, NDArray[np.float64]]) -> dict[str, Any]:
    """A loop without the missing values at its end."""
    known = np.flatnonzero(np.isfinite(loop["op"]) | np.isfinite(loop["pv"]))
    end = int(known[-1]) + 1 if len(known) else 0
    return {name: column[:end] for name, column in loop.items()}


def _stacked(loops: list[tuple[int, dict[str, Any]]]) -> dict[str, Any]:
    """Loops as the long table of `assess_many`."""
    rows = [len(loop["op"]) for _, loop in loops]
    table: dict[str, Any] = {"loop": np.repeat([f"loop {at}" for at, _ in loops], rows)}
    for name in ("op", "pv", "sp", "t"):
        if any(name in loop for _, loop in loops):
            missing = [loop.get(name, np.full(n, np.nan)) for n, (_, loop) in zip(rows, loops)]
            table[name] = np.concatenate(missing)
    return table
