"""Reads loops from exports and recordings."""

from __future__ import annotations

import os
import warnings
from typing import Any

import numpy as np

from . import _show, _stiction
from ._results import doubles_of, times_of
from ._show import DataFrame

OPTIONAL = ("sp", "mv", "mode")


def read(
    *paths: str | os.PathLike[str],
    map: str | None = None,
    tz: str | None = None,
    time_format: str | None = None,
    decimal: str | None = None,
    delimiter: str | None = None,
    encoding: str | None = None,
    sheet: str | None = None,
    quality: str | None = None,
    missing: str | None = None,
) -> DataFrame:
    """Read exports and recordings into one table for `assess`, `assess_many` and `assess_plant`; needs pandas.

    paths: files, folders or patterns such as "exports/*.csv": every format of `stictiond analyze`.
    The other arguments are the options of the command line for what a file does not show, such as tz="Europe/Berlin".

    The table has a row per time of a loop: `loop`, `t` (UTC), `op`, `pv`, and `sp`, `mv` and `mode` if present. Warnings of
    the program become Python warnings. Raises StictionError if nothing can be read.
    """
    options = {
        "map": map, "tz": tz, "time_format": time_format, "decimal": decimal,
        "delimiter": delimiter, "encoding": encoding, "sheet": sheet, "quality": quality, "missing": missing,
    }  # fmt: skip
    loops, said = _stiction.read([os.fspath(path) for path in paths], options)
    for words in said:
        warnings.warn(words, stacklevel=2)
    parts: dict[str, list[Any]] = {name: [] for name in ("loop", "t", "op", "pv", *OPTIONAL)}
    for name, times, numbers, modes in loops:
        clock = times_of(times)
        parts["loop"].append(np.full(len(clock), name, dtype=object))
        parts["t"].append(clock)
        for signal, column in zip(("op", "pv", "sp", "mv"), numbers):
            parts[signal].append(doubles_of(column))
        parts["mode"].append(np.array(modes, dtype=object))
    table = _show.frame({name: np.concatenate(columns) for name, columns in parts.items()}, {})
    table["t"] = table["t"].dt.tz_localize("UTC")
    return table.drop(columns=[name for name in OPTIONAL if table[name].isna().all()])
