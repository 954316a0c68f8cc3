"""Many windows of one valve, and the benefit of a repair: input and result documents.

`docs/plant.md` defines every number. Sizes are in OP units, intervals are 90 % `[low, high]`, times in ns since 1970.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, overload

from . import _arrays, _show
from ._results import Assessment, drawing, time_of
from ._show import DataFrame

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Picture

Window: TypeAlias = "Assessment | Mapping[str, Any]"
"""A result, or its document as a dict."""

_FIELDS = ("stiction", "p_stiction", "p_calibrated", "grade", "s", "s_interval", "j", "j_interval", "j_identifiable", "gates")


class Pooled(TypedDict):
    """A size that many windows agree on."""

    s: float
    s_interval: list[float]
    j: float | None
    j_interval: list[float] | None
    j_identifiable: bool
    windows: int
    independent_windows: float
    between_windows_pct: float


class Change(TypedDict):
    """A change of the valve, with an interval for its date."""

    at_ns: int
    from_ns: int
    to_ns: int
    kind: Literal["repaired", "better", "worse"]
    s_before: float | None
    s_after: float | None
    p: float


class Contradicting(TypedDict):
    """A window that contradicts the others of its segment."""

    end_ns: int
    s: float | None
    s_interval: list[float] | None
    why: str


class Trend(TypedDict):
    """Steady growth of s."""

    s_per_month: float
    s_per_month_interval: list[float]
    pct_per_month: float
    since_ns: int


class OverTime(dict[str, Any]):
    """The combined result of many windows of one valve: a dict, and the windows that it was computed from."""

    def __init__(self, document: Mapping[str, Any], windows: list[dict[str, Any]]) -> None:
        super().__init__(document)
        self._windows = sorted(windows, key=lambda window: int(window["end_ns"]))

    def __reduce__(self) -> tuple[Any, ...]:
        return OverTime, (dict(self), self._windows)

    @overload
    def __getitem__(self, key: Literal["windows"]) -> int: ...
    @overload
    def __getitem__(self, key: Literal["pooled"]) -> Pooled | None: ...
    @overload
    def __getitem__(self, key: Literal["since_ns"]) -> int | None: ...
    @overload
    def __getitem__(self, key: Literal["changes"]) -> list[Change]: ...
    @overload
    def __getitem__(self, key: Literal["contradicting"]) -> list[Contradicting]: ...
    @overload
    def __getitem__(self, key: Literal["trend"]) -> Trend | None: ...
    @overload
    def __getitem__(self, key: Literal["sentences"]) -> list[str]: ...
    @overload
    def __getitem__(self, key: str) -> Any: ...
    def __getitem__(self, key: str) -> Any:
        return super().__getitem__(key)

    def to_dict(self) -> dict[str, Any]:
        """The document as a plain dict."""
        return dict(self)

    def to_frame(self) -> DataFrame:
        """A row per window for pandas, by its end (UTC), with s and its interval."""
        odd = {one["end_ns"] for one in self["contradicting"]}
        rows = self._windows
        columns: dict[str, Any] = {
            "end": [time_of(row["end_ns"]) for row in rows],
            "start": [time_of(row["start_ns"]) for row in rows],
            **{name: [row[name] for row in rows] for name in ("stiction", "p_stiction", "grade", "s")},
        }
        for end, side in ((0, "low"), (1, "high")):
            columns[f"s_{side}"] = [row["s_interval"][end] if row["s_interval"] else None for row in rows]
        columns["contradicts"] = [row["end_ns"] in odd for row in rows]
        kinds = {"stiction": "boolean", **dict.fromkeys(("p_stiction", "s", "s_low", "s_high"), "float64")}
        return _show.frame(columns, {**kinds, **dict.fromkeys(("start", "end"), "datetime64[ns]")}, "end")

    def plot(self, *, figure: Picture | None = None) -> Picture:
        """Draw s of every window with its interval, changes with the interval of their date, and p; needs `stiction[plot]`.

        Windows that contradict the others are ringed. figure: draw into this figure instead of a new one.
        """
        drawn: Picture = drawing().history(self, self._windows, figure)
        return drawn

    def _repr_html_(self) -> str:
        pooled = self["pooled"]
        changes = [
            f"{_show.moment(time_of(one['at_ns']))}: {one['kind']}, s {_show.number(one['s_before'])} to "
            f"{_show.number(one['s_after'])}, p {one['p']:.2f}"
            for one in self["changes"]
        ]
        return _show.card(f"{self['windows']} windows", "", [
            ("s, pooled, OP units", None if pooled is None else _show.estimate(pooled["s"], pooled["s_interval"])),
            ("since", None if self["since_ns"] is None else _show.moment(time_of(self["since_ns"]))),
            *(("change", text) for text in changes),
            ("contradicting windows", str(len(self["contradicting"])) if self["contradicting"] else None),
            ("in words", " ".join(self["sentences"])),
        ])  # fmt: skip


class Figure(TypedDict):
    """A number with its interval."""

    value: float
    interval: list[float]


class Case(TypedDict):
    """Behaviour of a loop; PV units, OP units per day, reversals per day."""

    pv_sd: Figure
    pv_sd_ratio: Figure
    pv_mean_abs_error: Figure
    travel_per_day: Figure
    op_travel_per_day: Figure
    reversals_per_day: Figure
    oscillates: bool | None


class Repair(dict[str, Any]):
    """Benefit of a repair: the loop as it is, without stiction, and with half the controller gain; a dict."""

    @overload
    def __getitem__(self, key: Literal["now", "repaired", "half_gain"]) -> Case: ...
    @overload
    def __getitem__(self, key: Literal["recorded_pv_sd", "turn_op"]) -> float: ...
    @overload
    def __getitem__(self, key: Literal["sentences", "assumptions"]) -> list[str]: ...
    @overload
    def __getitem__(self, key: str) -> Any: ...
    def __getitem__(self, key: str) -> Any:
        return super().__getitem__(key)

    def to_dict(self) -> dict[str, Any]:
        """The document as a plain dict."""
        return dict(self)

    def to_frame(self) -> DataFrame:
        """A row per case for pandas, with value, `_low` and `_high` of every figure."""
        rows: list[dict[str, Any]] = []
        for name in CASES:
            row: dict[str, Any] = {"case": name}
            for figure, told in self[name].items():
                if isinstance(told, Mapping):
                    low, high = told["interval"]
                    row |= {figure: told["value"], f"{figure}_low": low, f"{figure}_high": high}
                else:
                    row[figure] = told
            rows.append(row)
        columns = {name: [row[name] for row in rows] for name in rows[0]}
        return _show.frame(columns, {"oscillates": "boolean"}, "case")

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the standard deviation of PV in each case with its interval; needs `stiction[plot]`."""
        drawn: Axes = drawing().benefit(self, ax)
        return drawn

    def _repr_html_(self) -> str:
        def cells(name: str) -> list[str]:
            case = self[name]
            figures = (case["pv_sd"], case["travel_per_day"], case["reversals_per_day"])
            return [CASES[name], *(_show.estimate(one["value"], one["interval"]) for one in figures)]

        heads = ("case", "standard deviation of PV", "valve travel per day", "reversals per day")
        return _show.grid("Repair", " ".join(self["sentences"]), heads, [cells(name) for name in CASES])


CASES = {"now": "as it is", "repaired": "without stiction", "half_gain": "with half the gain"}
"""The cases of a `Repair` in words."""


def _plain(value: Any) -> Any:
    """A value for JSON: numpy numbers become Python numbers, missing values None."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def windows_read(windows: Iterable[Window]) -> list[dict[str, Any]]:
    """The fields of each window that the native module needs."""

    def read(at: int, window: Window) -> dict[str, Any]:
        document = window.to_dict() if isinstance(window, Assessment) else window
        try:
            between = document.get("window", document)
            told = {name: int(between[name]) for name in ("start_ns", "end_ns")}
        except (AttributeError, KeyError, TypeError, ValueError):
            why = "has no start_ns and end_ns; give results of assess_windows, or documents of estimates as dicts"
            raise _arrays.refused("windows", f"number {at} {why}") from None
        plain = {name: _plain(document.get(name)) for name in _FIELDS}
        return {**told, **plain, "gates": plain["gates"] or []}

    if isinstance(windows, (str, bytes, Mapping)):
        raise _arrays.refused("windows", "is not a list; give several results, or documents of estimates as dicts")
    try:
        return [read(at, window) for at, window in enumerate(windows)]
    except TypeError as why:
        raise _arrays.refused("windows", f"cannot be read ({why}); give results, or documents as dicts") from None


def windows_text(read: list[dict[str, Any]]) -> str:
    """Windows as JSON, for the native module."""
    try:
        return json.dumps(read)
    except TypeError as why:
        raise _arrays.refused("windows", f"cannot be read ({why}); give results, or documents as dicts") from None
