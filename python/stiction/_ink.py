"""Colours and axes of the pictures: those of the page (`src/web/assets/app.css`)."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

INK = {
    "text": "#1b2430", "soft": "#55606e", "faint": "#dde1e7", "paper": "#fffffe", "op": "#b45309", "pv": "#1f4fbf",
    "sp": "#6b7280", "mv": "#7c3aed", "fit": "#047857", "error": "#be123c", "other": "#a16207",
}  # fmt: skip
"""The page's colours by what they stand for."""

STYLE: Any = {
    "axes.edgecolor": INK["faint"], "axes.labelcolor": INK["soft"], "axes.titlecolor": INK["text"],
    "axes.titlelocation": "left", "axes.titlesize": 10, "axes.titleweight": "bold", "axes.labelsize": 9,
    "axes.facecolor": INK["paper"], "axes.grid": True, "axes.axisbelow": True, "axes.spines.top": False,
    "axes.spines.right": False, "figure.facecolor": INK["paper"], "figure.dpi": 110, "font.size": 9,
    "grid.color": INK["faint"], "grid.linewidth": 0.6, "legend.frameon": False, "legend.fontsize": 8,
    "savefig.facecolor": INK["paper"], "text.color": INK["text"], "xtick.color": INK["soft"], "ytick.color": INK["soft"],
    "xtick.labelsize": 8, "ytick.labelsize": 8, "xtick.major.size": 0, "ytick.major.size": 0, "lines.linewidth": 1.2,
    "figure.constrained_layout.h_pad": 0.09, "figure.constrained_layout.w_pad": 0.09,
}  # fmt: skip

_YEAR_1990 = np.datetime64("1990-01-01", "ns")
_STEPS = ((172_800.0, 86_400.0, "days"), (7_200.0, 3_600.0, "hours"), (300.0, 60.0, "minutes"), (0.0, 1.0, "seconds"))


def new_figure(figure: Figure | None, width: float, height: float) -> Figure:
    """The caller's figure, or a new one that a notebook shows once."""
    if figure is not None:
        return figure
    made = pyplot.figure(figsize=(width, height), layout="constrained")
    if "inline" in matplotlib.get_backend().lower():
        # The notebook shows the value of the cell; an open figure would be shown a second time.
        pyplot.close(made)
    return made


def new_axes(ax: Axes | None, width: float, height: float) -> Axes:
    """The caller's axes, or those of a new figure."""
    return ax if ax is not None else pyplot.subplots(figsize=(width, height), layout="constrained")[1]


def legend(ax: Axes) -> None:
    """Names of the lines, above the axes at the right, where the title leaves room."""
    handles, _ = ax.get_legend_handles_labels()
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=max(1, len(handles)), borderaxespad=0.0, handlelength=1.6)


class Clock:
    """The time axis: dates, or time since the start where the record has none."""

    def __init__(self, t: NDArray[np.datetime64]) -> None:
        self._start = t.min() if len(t) else _YEAR_1990
        self._dated = bool(self._start >= _YEAR_1990)
        span = float((t.max() - self._start) / np.timedelta64(1, "s")) if len(t) else 0.0
        self._divisor, self._unit = next((by, unit) for least, by, unit in _STEPS if span >= least)

    def x(self, t: Any) -> Any:
        """Positions on the axis."""
        return t if self._dated else (t - self._start) / np.timedelta64(1, "s") / self._divisor

    def label(self, ax: Axes) -> None:
        """Labels the axis."""
        if not self._dated:
            ax.set_xlabel(self._unit)
            return
        from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

        locator = AutoDateLocator(minticks=3, maxticks=8)  # type: ignore[no-untyped-call, unused-ignore]
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call, unused-ignore]
        ax.set_xlabel("UTC")
