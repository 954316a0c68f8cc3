"""Reads loops from tables (wide, or long by loop or by tag) and times from an index."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _arrays
from ._arrays import Table

SIGNALS = ("op", "pv", "sp", "mv", "mode")
ENDINGS = {
    "OP": "op", "OUT": "op", "CO": "op", "OUTPUT": "op", "LMN": "op", "MV": "op",
    "PV": "pv", "ACTUAL": "pv", "MEAS": "pv", "MEASUREMENT": "pv",
    "SP": "sp", "SETPOINT": "sp", "SV": "sp",
    "MODE": "mode", "MD": "mode",
    "ZT": "mv", "ZI": "mv", "POS": "mv", "POSITION": "mv", "FBK": "mv", "FB": "mv",
}  # fmt: skip
"""Endings of tags, the strongest of each signal first: the short ones of `docs/formats.md`."""
TIMES = ("t", "ts", "time", "timestamp", "date", "datetime", "zeit", "zeitstempel", "horodatage", "fecha")
TAGS = ("tag", "tagname", "tag name", "point", "name")
VALUES = ("value", "val", "wert")

_UNIT = re.compile(r"\s*[(\[{][^)\]}]*[)\]}]$")
_TAG = re.compile(r"(.+)[._/|:\\ -]([A-Za-z]+)", re.DOTALL)


def _bare(name: str) -> str:
    """A heading without its unit in brackets."""
    return _UNIT.sub("", name.strip())


def role(tag: str) -> tuple[str, str, int] | None:
    """Loop, signal and rank of a tag, such as `FIC101.OP [%]`; None if its ending is unknown."""
    found = _TAG.fullmatch(_bare(tag))
    if found is None or (end := found[2].upper()) not in ENDINGS:
        return None
    return found[1], ENDINGS[end], list(ENDINGS).index(end)


def index_times(values: Any) -> Any:
    """The DatetimeIndex of a pandas Series or DataFrame, or None."""
    index = getattr(values, "index", None)
    if index is None or callable(index) or not hasattr(index, "to_numpy"):
        return None
    kind = getattr(getattr(index, "dtype", None), "kind", "")
    return index if kind == "M" else None


def _flat(table: Table) -> Table:
    """Joins two levels of column names with a point, and makes columns of named levels of the index."""
    columns = getattr(table, "columns", None)
    if columns is not None and getattr(columns, "nlevels", 1) > 1:
        table = table.copy(deep=False)
        table.columns = [".".join(str(level) for level in name) for name in columns]
    if getattr(getattr(table, "index", None), "nlevels", 1) > 1:
        table = table.reset_index()
    return table


def _wide(names: list[str]) -> dict[str, dict[str, str]]:
    """Columns of a wide table by loop and signal; only loops with OP and PV."""
    loops: dict[str, dict[str, str]] = {}
    ranks: dict[tuple[str, str], int] = {}
    for name in names:
        if (found := role(name)) is None:
            continue
        loop, signal, rank = found
        best = ranks.setdefault((loop, signal), rank)
        columns = loops.setdefault(loop, {})
        if signal in columns and rank == best:
            raise _arrays.refused("table", f"{columns[signal]!r} and {name!r} are both {signal} of {loop}; drop one")
        if rank <= best:
            ranks[loop, signal] = rank
            columns[signal] = name
    return {loop: columns for loop, columns in loops.items() if {"op", "pv"} <= columns.keys()}


def _one_of(names: list[str], known: tuple[str, ...]) -> str | None:
    return next((name for name in names if _bare(name).lower() in known), None)


def _times(table: Table, names: list[str]) -> Any:
    found = ["t"] if "t" in names else [name for name in names if _bare(name).lower() in TIMES]
    if len(found) > 1:
        raise _arrays.refused("t", f"the table has the columns {' and '.join(found)}; give t=, or name one of them t")
    return table[found[0]] if found else index_times(table)


def _nothing(signal: str, rows: int) -> Any:
    return np.full(rows, None, dtype=object) if signal == "mode" else np.full(rows, np.nan)


def _stacked(parts: Mapping[str, Mapping[str, Any]], times: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of several loops as one long table."""
    rows = {loop: len(columns["op"]) for loop, columns in parts.items()}
    long: dict[str, Any] = {"loop": np.repeat(np.array(list(parts), dtype=object), list(rows.values()))}
    for signal in SIGNALS:
        if any(signal in columns for columns in parts.values()):
            found = [columns.get(signal, _nothing(signal, rows[loop])) for loop, columns in parts.items()]
            long[signal] = np.concatenate(found)
    if times:
        long["t"] = np.concatenate([times[loop] for loop in parts])
    return long


def _column(signal: str, values: Any) -> NDArray[Any]:
    if signal == "mode":
        return np.array(_arrays.words(values), dtype=object)
    return _arrays.numbers(signal, values)


def _of_wide(table: Table, names: list[str], loops: Mapping[str, Mapping[str, str]], timed: bool) -> dict[str, Any]:
    parts = {
        loop: {signal: _column(signal, table[name]) for signal, name in columns.items()} for loop, columns in loops.items()
    }
    times: dict[str, Any] = {}
    if timed:
        if (own := _times(table, names)) is None:
            raise _arrays.refused("t", "the table has no column of times; give t=, ts_s= or a DatetimeIndex")
        clock = _arrays.plain(own)
        times = {loop: clock for loop in parts}
    return _stacked(parts, times)


def _of_tags(table: Table, tag: str, value: str, own: Any) -> dict[str, Any]:
    """A table with one row per value: rows of one loop at one time become one row."""
    labels = [str(label) for label in _arrays.plain(table[tag])]
    loops = _wide(list(dict.fromkeys(labels)))
    if not loops:
        raise _arrays.refused("table", f"no tag in {tag!r} ends like OP and PV of one loop, such as FIC101.OP and FIC101.PV")
    codes, clock, values = np.array(labels, dtype=object), _arrays.plain(own), _arrays.plain(table[value])
    parts: dict[str, dict[str, Any]] = {}
    times: dict[str, Any] = {}
    for loop, tags in loops.items():
        times[loop] = np.unique(clock[np.isin(codes, list(tags.values()))])
        parts[loop] = {}
        for signal, name in tags.items():
            column = _nothing(signal, len(times[loop]))
            chosen = codes == name
            column[np.searchsorted(times[loop], clock[chosen])] = _column(signal, values[chosen])
            parts[loop][signal] = column
    return _stacked(parts, times)


def long_form(table: Table, named: Mapping[str, str], timed: bool) -> tuple[Table, list[str]]:
    """A table with one row per loop and time, from any of the forms; `named` are the names that the caller wants.

    timed: whether times are wanted. Names that differ from the default are taken as they are.
    """
    opened, names = _arrays.open_table(_flat(table))
    if named["op"] in names and named["pv"] in names:
        if timed and named["t"] not in names and (own := _times(opened, names)) is not None:
            kept = {name: opened[name] for name in named.values() if name in names}
            return {**kept, named["t"]: own}, [*kept, named["t"]]
        return opened, names
    if any(named[signal] != signal for signal in ("op", "pv")):
        return opened, names
    if loops := _wide(names):
        long = _of_wide(opened, names, loops, timed)
        return long, list(long)
    tag, value, own = _one_of(names, TAGS), _one_of(names, VALUES), _times(opened, names)
    if tag is not None and value is not None and own is not None:
        long = _of_tags(opened, tag, value, own)
        return long, list(long)
    return opened, names


def is_table(values: Any) -> bool:
    """Whether this has named columns."""
    return bool(_arrays.names_of(values))


def _one_loop(table: Table, name: str, timed: bool) -> tuple[str, dict[str, Any]]:
    """The columns of one loop of a table, and its name."""
    long, names = long_form(table, {signal: signal for signal in ("t", *SIGNALS)}, timed)
    for signal in ("op", "pv"):
        if signal not in names:
            why = f"the table has no {signal} column among {', '.join(names)}"
            raise _arrays.refused(signal, f"{why}; name columns op and pv, or FIC101.OP and FIC101.PV")
    columns = {signal: long[signal] for signal in ("t", *SIGNALS) if signal in names}
    if "loop" not in names:
        return name, columns
    labels = np.array([str(label) for label in _arrays.plain(long["loop"])], dtype=object)
    loops = list(dict.fromkeys(labels))
    if len(loops) == 1:
        return (loops[0] if name == "loop" else name), columns
    if name not in loops:
        raise _arrays.refused("name", f"the table has the loops {', '.join(loops)}; give one of them, or call assess_many")
    chosen = labels == name
    return name, {signal: _arrays.plain(column)[chosen] for signal, column in columns.items()}


def _index_of(**series: Any) -> Any:
    """The DatetimeIndex that the columns share, or None."""
    index = index_times(series["op"])
    for name, values in series.items():
        own = index_times(values)
        if index is not None and own is not None and not index.equals(own):
            why = "has other times than op; give pandas.concat([op, pv], axis=1, keys=['op', 'pv']), or t= or ts_s="
            raise _arrays.refused(name, why)
    return index


def record(
    name: str, op: Any, pv: Any, ts_s: float | None, t: Any, sp: Any = None, mv: Any = None, mode: Any = None
) -> tuple[str, dict[str, Any]]:
    """A loop's name and its columns for the native module, from arrays, Series or one table."""
    name = str(name)
    if pv is None and is_table(op):
        name, found = _one_loop(op, name, ts_s is None and t is None)
        given = {"t": t, "sp": sp, "mv": mv, "mode": mode}
        found.update({signal: values for signal, values in given.items() if values is not None})
        if ts_s is not None and t is None:
            found.pop("t", None)
        op, pv, t, sp, mv, mode = (found.get(signal) for signal in ("op", "pv", "t", "sp", "mv", "mode"))
    elif ts_s is None and t is None:
        t = _index_of(op=op, pv=pv, sp=sp, mv=mv, mode=mode)
    return name, _arrays.columns(op, pv, ts_s, t, sp, mv, mode)
