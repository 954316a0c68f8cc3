"""Converts the caller's arrays and tables to the bytes that the native module takes."""

from __future__ import annotations

import datetime as dt
import math
import operator
from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ._stiction import StictionError

Table: TypeAlias = Any
"""A pandas or polars DataFrame, a mapping of arrays, a structured array, or an Arrow table."""

_EPOCH = np.datetime64(0, "ns")


def refused(argument: str, why: str) -> StictionError:
    """An error that names the argument and the remedy."""
    return StictionError(f"{argument}: {why}")


def plain(values: Any) -> NDArray[Any]:
    """An array of whatever numpy, pandas, polars or Arrow hold; missing values become NaN where possible."""
    if isinstance(values, np.ma.MaskedArray):
        return np.asarray(np.ma.filled(values.astype(float), np.nan))
    if hasattr(values, "to_numpy"):
        # Each library names this differently.
        kind = getattr(values, "dtype", None)
        if getattr(kind, "tz", None) is not None:
            return np.asarray(values.to_numpy(dtype="datetime64[ns]"))
        if getattr(kind, "na_value", None) is not None and getattr(kind, "kind", "O") in "iuf":
            return np.asarray(values.to_numpy(dtype=float, na_value=np.nan))
        try:
            return np.asarray(values.to_numpy(zero_copy_only=False))
        except TypeError:
            return np.asarray(values.to_numpy())
    return np.asarray(values)


def numbers(argument: str, values: Any) -> NDArray[np.float64]:
    """A contiguous column of doubles."""
    try:
        array = plain(values)
        if array.dtype.kind in "biuf" or (array.dtype.kind == "O" and not any(isinstance(v, str) for v in array.flat)):
            found = np.ascontiguousarray(array, dtype=np.float64)
        else:
            raise TypeError(f"values of type {array.dtype}")
    except (TypeError, ValueError) as why:
        raise refused(argument, f"is not a column of numbers ({why}); give a one-dimensional array of numbers") from None
    if array.ndim != 1:
        raise refused(argument, f"has {array.ndim} dimensions; give one column, such as x.ravel()")
    return found


def _bytes(array: NDArray[Any], kind: str) -> bytes:
    return array.astype(kind, copy=False).tobytes()


def _of_datetimes(values: Iterable[Any]) -> NDArray[np.int64]:
    """Python's datetime; UTC if without a zone, as in numpy."""

    def naive(stamp: Any) -> Any:
        if isinstance(stamp, dt.datetime) and stamp.tzinfo is not None:
            return stamp.astimezone(dt.timezone.utc).replace(tzinfo=None)
        return stamp

    stamps = np.array([naive(stamp) for stamp in values], dtype="datetime64[ns]")
    return np.asarray((stamps - _EPOCH).astype(np.int64))


def stamps(t: Any) -> tuple[str, bytes]:
    """Timestamps with their unit: `ns` as integers or `s` as doubles."""
    array = plain(t)
    if array.ndim != 1:
        raise refused("t", f"has {array.ndim} dimensions; give one column")
    if array.dtype.kind == "O" and len(array) and isinstance(array[0], dt.datetime):
        return "ns", _bytes(_of_datetimes(array), "<i8")
    if array.dtype.kind == "M":
        if np.isnat(array).any():
            row = int(np.flatnonzero(np.isnat(array))[0])
            raise refused("t", f"row {row} has no time (NaT); drop the row")
        # Outside the range of ns, numpy would wrap silently.
        coarse = array.astype("datetime64[s]").astype(np.int64)
        if len(array) and np.abs(coarse).max() > 9_200_000_000:
            raise refused("t", "is outside the years 1678 to 2261, the range of nanoseconds in 64 bits")
        return "ns", _bytes((array.astype("datetime64[ns]") - _EPOCH).astype(np.int64), "<i8")
    try:
        return "s", _bytes(numbers("t", array), "<f8")
    except StictionError:
        raise refused("t", "is not a column of times; give seconds since 1970 or datetime64 (pandas.to_datetime)") from None


def words(mode: Any) -> list[str | None]:
    """Controller modes as words; missing values become None."""
    array = np.asarray(mode if not hasattr(mode, "to_numpy") else plain(mode), dtype=object)

    def word(value: Any) -> str | None:
        missing = value is None or value == "" or (isinstance(value, float) and math.isnan(value))
        return None if missing or type(value).__name__ == "NAType" else str(value)

    return [word(value) for value in array.flat]


def columns(
    op: Any, pv: Any, ts_s: float | None, t: Any, sp: Any, mv: Any, mode: Any
) -> dict[str, Any]:
    """The columns of a record, checked for equal length."""
    arrays: dict[str, NDArray[np.float64] | None] = {
        name: None if values is None else numbers(name, values)
        for name, values in (("op", op), ("pv", pv), ("sp", sp), ("mv", mv))
    }
    if arrays["op"] is None or arrays["pv"] is None:
        missing = "op" if arrays["op"] is None else "pv"
        raise refused(missing, "is None; give a column of numbers")
    n = len(arrays["op"])
    if (ts_s is None) == (t is None):
        why = "give either ts_s, the seconds between samples, or t, their times"
        raise refused("ts_s", why if t is not None else f"{why}; a pandas DatetimeIndex will do")
    if t is not None:
        times = stamps(t)
    else:
        step_ns = positive("ts_s", ts_s) * 1e9
        if step_ns * max(n, 1) > 9.2e18:
            raise refused("ts_s", f"{ts_s} s for {n} samples are more than 292 years; ts_s is in seconds")
        times = "ns", _bytes(np.rint(np.arange(n) * step_ns), "<i8")
    texts = None if mode is None else words(mode)
    lengths = {name: len(array) for name, array in arrays.items() if array is not None}
    lengths["t"] = len(times[1]) // 8
    if texts is not None:
        lengths["mode"] = len(texts)
    for name, length in lengths.items():
        if length != n:
            raise refused(name, f"{length} values, op has {n}; give columns of one length, with NaN for missing values")
    found = {name: None if array is None else _bytes(array, "<f8") for name, array in arrays.items()}
    return {**found, "t": times, "mode": texts}


def positive(argument: str, value: Any) -> float:
    """A number above 0."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise refused(argument, f"{value!r} is not a number") from None
    if not (math.isfinite(number) and number > 0):
        raise refused(argument, f"{number} must be above 0")
    return number


def whole(argument: str, value: Any, least: int = 0) -> int:
    """An integer."""
    try:
        number = operator.index(value)
    except TypeError:
        raise refused(argument, f"{value!r} is not a whole number") from None
    if not least <= number < 2**64:
        raise refused(argument, f"{number} is out of range; give {least} or more")
    return number


def _time_text(value: Any) -> str:
    """A time as the command line reads it."""
    if isinstance(value, str):
        return value
    if isinstance(value, (dt.datetime, np.datetime64)):
        return f"{int(_of_datetimes([value])[0])}ns"
    return repr(float(value))


def _pair(argument: str, value: Any) -> tuple[Any, Any] | None:
    if value is None:
        return None
    try:
        first, second = value
    except (TypeError, ValueError):
        raise refused(argument, f"{value!r} is not a pair; give (from, to)") from None
    return first, second


def times(argument: str, value: Any) -> tuple[str, str] | None:
    """Two times as the command line reads them."""
    between = _pair(argument, value)
    try:
        return None if between is None else (_time_text(between[0]), _time_text(between[1]))
    except (TypeError, ValueError):
        raise refused(argument, f"{value!r} does not give two times; use seconds since 1970, text or datetime64") from None


def look(
    samples: Any, window: Any, downsample: Any, downsample_like_toolbox: bool, detrend: str | None
) -> dict[str, Any]:
    """Section and downsampling, for the native module."""
    chosen = _pair("samples", samples)
    return {
        "samples": None if chosen is None else tuple(whole("samples", v) for v in chosen),
        "window": times("window", window),
        "downsample": None if downsample is None else positive("downsample", downsample),
        "downsample_like_toolbox": bool(downsample_like_toolbox),
        "detrend": None if detrend is None else str(detrend),
    }


def names_of(table: Table) -> list[str]:
    """Names of a table's columns; none if it has no named columns."""
    if isinstance(table, Mapping):
        return [str(name) for name in table]
    if isinstance(table, np.ndarray):
        return list(table.dtype.names or ())
    for attribute in ("column_names", "columns"):
        found = getattr(table, attribute, None)
        if found is not None and not callable(found):
            return [str(name) for name in found]
    return list(getattr(getattr(table, "schema", None), "names", []))


def open_table(table: Table) -> tuple[Table, list[str]]:
    """A table with access to columns by name, and the names."""
    names = names_of(table)
    if not names and hasattr(table, "__arrow_c_stream__"):
        try:
            import pyarrow  # type: ignore[import-untyped,unused-ignore]
        except ImportError:
            raise refused("table", "is an Arrow stream, which needs pyarrow; install pyarrow") from None
        table = pyarrow.table(table)
        names = names_of(table)
    if not names:
        raise refused("table", f"{type(table).__name__} has no named columns; give a DataFrame, a dict or an Arrow table")
    return table, names


def grouped(labels: Any) -> tuple[list[str], NDArray[np.int64], list[int]]:
    """Loops in order of first appearance, the rows in that order, and the end of each loop."""
    codes: dict[Any, int] = {}
    if hasattr(labels, "to_pylist"):
        labels = labels.to_pylist()
    column = np.fromiter((codes.setdefault(label, len(codes)) for label in labels), dtype=np.int64)
    rows = np.argsort(column, kind="stable")
    ends = np.cumsum(np.bincount(column, minlength=len(codes)))
    return [str(label) for label in codes], rows, [int(end) for end in ends]


def reordered(found: dict[str, Any], rows: NDArray[np.int64]) -> dict[str, Any]:
    """Columns with reordered rows."""

    def moved(column: Any) -> Any:
        if isinstance(column, bytes):
            return np.frombuffer(column, dtype="<i8")[rows].tobytes()
        if isinstance(column, tuple):
            return column[0], moved(column[1])
        return None if column is None else [column[row] for row in rows]

    return {name: moved(column) for name, column in found.items()}
