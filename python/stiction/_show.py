"""Results as frames of pandas and as small HTML tables for notebooks."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any, TypeAlias

DataFrame: TypeAlias = Any
"""A pandas DataFrame; pandas is imported when one is made."""

MOST_ROWS = 60
"""Rows of an HTML table; more are counted."""


def needed(module: str, what: str, install: str) -> Any:
    """An optional package, or an ImportError with the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as why:
        package = module.partition(".")[0]
        raise ImportError(f"{what} needs {package}; install it: pip install {install}", name=module) from why


def meter(progress: Any) -> Any:
    """The callback for (done, most); True gives a tqdm bar."""
    if progress is not True:
        return progress or None
    bar = needed("tqdm.auto", "progress=True", "tqdm").tqdm()

    def moved(done: int, most: int) -> None:
        bar.total = most
        bar.update(done - bar.n)
        if done >= most:
            bar.close()

    return moved


def frame(columns: Mapping[str, Any], kinds: Mapping[str, str], index: str | None = None) -> DataFrame:
    """Columns as a DataFrame; `kinds` gives the dtype of columns that may contain None."""
    pandas = needed("pandas", "to_frame()", "pandas")
    made = pandas.DataFrame(dict(columns)).astype({name: kind for name, kind in kinds.items() if name in columns})
    return made if index is None else made.set_index(index)


def number(value: float | None) -> str:
    """A number with three significant digits, as the page writes it."""
    if value is None:
        return "-"
    size = abs(value)
    return f"{value:.0f}" if 1000 <= size < 1e7 else f"{value:.3g}"


def estimate(value: float | None, interval: Sequence[float] | None, unit: str = "") -> str:
    """A size with its interval."""
    if value is None:
        return "-"
    between = "" if interval is None else f" ({number(interval[0])} to {number(interval[1])})"
    return f"{number(value)}{between}{' ' if unit else ''}{unit}"


def moment(stamp: Any) -> str:
    """A time to the second, UTC."""
    return str(stamp)[:19].replace("T", " ")


def card(caption: str, lead: str, rows: Iterable[tuple[str, str | None]]) -> str:
    """A table of names and values under a caption; rows without a value are left out."""
    cells = (
        f'<tr><th style="text-align:left">{escape(name)}</th><td style="text-align:left">{escape(value)}</td></tr>'
        for name, value in rows
        if value
    )
    return f"<table>{_caption(caption, lead)}<tbody>{''.join(cells)}</tbody></table>"


def grid(caption: str, lead: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table with a heading per column, of at most MOST_ROWS rows."""
    top = "".join(f'<th style="text-align:left">{escape(head)}</th>' for head in heads)
    shown = ("".join(f'<td style="text-align:left">{escape(cell)}</td>' for cell in row) for row in rows[:MOST_ROWS])
    body = "".join(f"<tr>{cells}</tr>" for cells in shown)
    more = len(rows) - MOST_ROWS
    rest = f'<tr><td colspan="{len(heads)}">and {more} more</td></tr>' if more > 0 else ""
    return f"<table>{_caption(caption, lead)}<thead><tr>{top}</tr></thead><tbody>{body}{rest}</tbody></table>"


def _caption(caption: str, lead: str) -> str:
    return f'<caption style="text-align:left"><b>{escape(caption)}</b>{": " if lead else ""}{escape(lead)}</caption>'
