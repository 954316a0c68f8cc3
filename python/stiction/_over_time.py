"""Many windows of one valve, and the benefit of a repair: input and result documents.

`docs/over-time.md` defines every number. Sizes are in OP units, intervals are 90 % `[low, high]`, times in ns since 1970.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any, Literal, TypeAlias, TypedDict

from . import _arrays
from ._results import Assessment

Window: TypeAlias = "Assessment | Mapping[str, Any]"
"""A result, or its document as a dict."""

_FIELDS = ("stiction", "p_stiction", "grade", "s", "s_interval", "j", "j_interval", "j_identifiable", "gates")


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
    """A window that contradicts its stretch."""

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


class OverTime(TypedDict):
    """The combined result of many windows of one valve."""

    windows: int
    pooled: Pooled | None
    since_ns: int | None
    changes: list[Change]
    contradicting: list[Contradicting]
    trend: Trend | None
    sentences: list[str]


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


class Repair(TypedDict):
    """Benefit of a repair: the loop as it is, without stiction, and with half the controller gain."""

    now: Case
    repaired: Case
    half_gain: Case
    recorded_pv_sd: float
    turn_op: float
    sentences: list[str]
    assumptions: list[str]


def _plain(value: Any) -> Any:
    """A value for JSON: numpy numbers become Python numbers, missing values None."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def windows_text(windows: Iterable[Window]) -> str:
    """The fields of each window, for the native module."""

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
        return json.dumps([read(at, window) for at, window in enumerate(windows)])
    except TypeError as why:
        raise _arrays.refused("windows", f"cannot be read ({why}); give results, or documents as dicts") from None
