"""Pictures of results, with matplotlib. The words and colours are those of the page."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import wraps
from textwrap import fill
from typing import Any, ParamSpec, TypeVar

import matplotlib
import matplotlib.colors
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from . import _arrays, _show, _stiction, _tables
from ._ink import INK, STYLE, Clock, legend, new_axes, new_figure
from ._over_time import CASES, OverTime, Repair
from ._results import Assessment, Failure, Gap, Record, Simulation, Verdict, doubles_of, time_of, times_of

MOST_LOOPS = 60
MOST_EFFECTS = 10
SHORT: dict[Verdict, str] = {
    "stiction": "sticks", "deadband": "dead band", "disturbance": "disturbed", "tuning": "tuning",
    "cause_unknown": "oscillates", "not_oscillating": "steady", "inconclusive": "no answer",
}  # fmt: skip
"""Verdicts as the page's tables have them."""
SAME_ERROR = 0.1
"""Relative difference between two mean squared errors of one model."""
P = ParamSpec("P")
R = TypeVar("R")


def _styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Draws with the page's style and leaves the caller's style unchanged."""

    @wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> R:
        with matplotlib.rc_context(STYLE):
            return draw(*args, **kwargs)

    return styled


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of a loop in order of time; signals that the record lacks are None."""

    t: NDArray[np.datetime64]
    signals: dict[str, NDArray[np.float64]]

    def between(self, start: np.datetime64, end: np.datetime64) -> _Rows:
        inside = (self.t >= start) & (self.t <= end)
        return _Rows(self.t[inside], {name: column[inside] for name, column in self.signals.items()})

    def measured(self, name: str) -> tuple[NDArray[np.datetime64], NDArray[np.float64]]:
        """Rows that have this signal."""
        finite = np.isfinite(self.signals[name])
        return self.t[finite], self.signals[name][finite]


def _rows(columns: Mapping[str, Any]) -> _Rows:
    unit, stamps = columns["t"]
    t = times_of(stamps)
    if unit == "s":
        t = np.rint(doubles_of(stamps) * 1e9).astype(np.int64).view("datetime64[ns]")
    order = np.argsort(t, kind="stable")
    found = {name: doubles_of(columns[name])[order] for name in ("op", "pv", "sp", "mv") if columns.get(name) is not None}
    return _Rows(t[order], {name: column for name, column in found.items() if np.isfinite(column).any()})


def _record_of(found: Assessment, table: Any) -> Record:
    if table is not None:
        name, columns = _tables.record(found.loop, table, None, None, None)
        return Record(name, columns, _arrays.look(None, None, None, False, None))
    if found._record is None:
        why = "this result has none; give the loop's rows, such as plot(frame) with columns t, op and pv"
        raise _arrays.refused("record", why)
    return found._record


def _last(found: Assessment, periods: float | None) -> np.datetime64:
    """Start of the displayed range."""
    start, end = found.window
    if periods is None or found.period_s is None or not found.oscillating:
        return start
    shown = np.timedelta64(int(_arrays.positive("periods", periods) * found.period_s * 1e9), "ns")
    return max(start, end - shown)


def _free_run(found: Assessment, record: Record) -> tuple[NDArray[np.datetime64], NDArray[np.float64]] | None:
    """PV simulated by the fitted model from OP alone; None without a model.

    `diagnose` refits the model, so its run is used only if its error equals that of the estimate.
    """
    if found.process is None:
        return None
    window = tuple(f"{int(end.astype(np.int64))}ns" for end in found.window)
    look = {**record.look, "samples": None, "window": window}
    asked = {
        "base": found.to_json(), "neighbours": [], "without": [], "pairs": False,
        "budget_s": 1e-3, "seed": 1, "threads": 1, "windows": [],
    }  # fmt: skip
    try:
        *_, columns = _stiction.diagnose(record.name, record.columns, look, asked, None)
    except _stiction.StictionError:
        return None
    t, pv, run = times_of(columns[0]), doubles_of(columns[1]), doubles_of(columns[2])
    known = np.isfinite(pv) & np.isfinite(run)
    mse = float(np.mean((pv[known] - run[known]) ** 2)) if known.any() else np.inf
    return (t, run) if abs(mse / found.process.mse - 1.0) <= SAME_ERROR else None


def _line(ax: Axes, clock: Clock, rows: _Rows, name: str, label: str, ink: str, **more: Any) -> None:
    if name in rows.signals:
        t, values = rows.measured(name)
        ax.plot(clock.x(t), values, color=INK[ink], label=label, **more)


def _pv_axes(ax: Axes, clock: Clock, rows: _Rows, behind: bool = False) -> None:
    _line(ax, clock, rows, "sp", "SP", "sp", drawstyle="steps-post", ls=(0, (5, 4)), lw=1.0)
    # A good model would cover PV, so draw PV wider.
    _line(ax, clock, rows, "pv", "PV", "pv", **({"lw": 3.2, "alpha": 0.45} if behind else {"lw": 1.4}))
    ax.set_ylabel("PV")


def _op_axes(ax: Axes, clock: Clock, rows: _Rows) -> None:
    _line(ax, clock, rows, "op", "OP", "op", drawstyle="steps-post")
    _line(ax, clock, rows, "mv", "valve measured", "mv", lw=1.0)
    ax.set_ylabel("OP")


def _shown(found: Assessment, periods: float | None) -> str:
    start = _last(found, periods)
    if start == found.window[0] or found.period_s is None:
        return ""
    whole = float((found.window[1] - found.window[0]) / np.timedelta64(1, "s")) / found.period_s
    return f"last {periods:g} of {whole:.0f} periods"


def _trend(ax: Axes, found: Assessment, record: Record, free_run: bool, periods: float | None) -> tuple[Clock, _Rows]:
    rows = _rows(record.columns).between(_last(found, periods), found.window[1])
    clock = Clock(rows.t)
    run = _free_run(found, record) if free_run else None
    _pv_axes(ax, clock, rows, behind=run is not None)
    if run is not None:
        inside = (run[0] >= _last(found, periods)) & (run[0] <= found.window[1])
        ax.plot(clock.x(run[0][inside]), run[1][inside], color=INK["fit"], lw=1.1, label="free run of the model")
    legend(ax)
    return clock, rows


def _phase(ax: Axes, rows: _Rows, found: Assessment | None) -> None:
    """PV over OP within the window, and s as a length."""
    if "op" not in rows.signals or "pv" not in rows.signals:
        return
    # OP holds between its samples, so rows with PV alone take the last OP.
    known = np.maximum.accumulate(np.where(np.isfinite(rows.signals["op"]), np.arange(len(rows.t)), -1))
    both = np.isfinite(rows.signals["pv"]) & (known >= 0)
    if found is not None:
        both &= (rows.t >= found.window[0]) & (rows.t <= found.window[1])
    op, pv = rows.signals["op"][known[both]], rows.signals["pv"][both]
    ax.plot(op, pv, color=INK["pv"], lw=0.6, alpha=0.6)
    ax.set(xlabel="OP", ylabel="PV", title="PV over OP")
    if found is not None and found.stiction and found.s and len(op):
        low, high = np.quantile(pv, (0.0, 1.0))
        left, level = (np.min(op) + np.max(op) - found.s) / 2, low - 0.1 * (high - low)
        ax.plot([left, left + found.s], [level, level], "|-", color=INK["error"], ms=9, mew=1.6, lw=1.6)
        words = f"s = {_show.number(found.s)}"
        ax.annotate(words, (left + found.s / 2, level), (0, 4), textcoords="offset points", color=INK["error"], ha="center")


def _bars(ax: Axes, rows: Iterable[tuple[str, float, str]]) -> None:
    labels, values, inks = zip(*rows)
    ax.barh(labels, values, color=inks, height=0.62)
    ax.invert_yaxis()
    ax.grid(axis="y", visible=False)
    ax.axvline(0, color=INK["soft"], lw=0.8)


def _say(ax: Axes, words: str) -> None:
    """A text instead of a picture."""
    ax.set(xticks=[], yticks=[], xlabel="")
    ax.text(0.5, 0.5, words, transform=ax.transAxes, ha="center", color=INK["soft"])


def _head(figure: Figure, words: str) -> None:
    """The title of a figure, wrapped to its width."""
    figure.suptitle(fill(words, 96), x=0.01, ha="left", fontsize=11, fontweight="bold")


@_styled
def indicators(found: Assessment, ax: Axes | None) -> Axes:
    """Contributions of the indicators, with the base and the sum, in log-odds."""
    document = found.to_dict()
    known = [one for one in document["indicators"] if one["score"] is not None]
    ax = new_axes(ax, 5.6, 1.2 + 0.24 * (len(known) + 2))
    rows = [(one["name"], one["contribution"], INK["error" if one["contribution"] > 0 else "fit"]) for one in known]
    if (explained := document["explanation"]) is not None:
        rows = [("base", explained["base"], INK["sp"]), *rows, ("together", explained["logit"], INK["text"])]
    ax.set(title="Indicators", xlabel="log-odds: right points to sticking, left away from it")
    if rows:
        _bars(ax, rows)
    else:
        _say(ax, "none: the record was not fitted")
    return ax


@_styled
def trend_of(found: Assessment, table: Any, free_run: bool, periods: float | None, ax: Axes | None) -> Axes:
    """PV over time."""
    record = _record_of(found, table)
    ax = new_axes(ax, 8.0, 2.8)
    clock, _ = _trend(ax, found, record, free_run, periods)
    ax.set_title(f"{found.loop}  {_shown(found, periods)}")
    clock.label(ax)
    return ax


@_styled
def phase_of(found: Assessment, table: Any, ax: Axes | None) -> Axes:
    """PV over OP."""
    record = _record_of(found, table)
    ax = new_axes(ax, 4.6, 4.2)
    _phase(ax, _rows(record.columns), found)
    return ax


REGIONS = (
    (0.052, 0.013, "none"), (0.43, 0.385, "deadband"), (0.52, 0.27, "deadband with stick and slip"),
    (0.79, 0.028, "stick-slip"), (0.135, 0.058, "weak"), (0.33, 0.12, "moderate"), (0.72, 0.13, "strong"),
)  # fmt: skip
"""Words of the regions, at shares of OP's span."""
BOUNDS = (((0.1, 0.0), (0.1, 0.1)), ((0.1, 0.015), (1.0, 0.15)), ((0.1, 0.085), (1.0, 0.85)),
          ((0.2, 0.0), (0.2, 0.2)), ((0.6, 0.0), (0.6, 0.6)))  # fmt: skip
"""Lines between the regions, as (s, j) at shares of OP's span."""


def _bands(s: float, j: float) -> tuple[float, float]:
    return 0.5 * (s + j), 0.5 * (s - j)


def _ring(low: tuple[float, float], high: tuple[float, float]) -> list[tuple[float, float]]:
    return [low, (high[0], low[1]), high, (low[0], high[1]), low]


def _map_of(found: Assessment, table: Any, order: int | None, step: float) -> dict[str, Any]:
    if found.process is None:
        raise _arrays.refused("record", "this result has no model: nothing was fitted")
    chosen = found.process.order if order is None else _arrays.whole("order", order, 1)
    if chosen > 2 or not 0.005 <= _arrays.positive("step", step) <= 0.25:
        raise _arrays.refused(*(("order", "give 1 or 2") if chosen > 2 else ("step", "give a share from 0.005 to 0.25")))
    record = _record_of(found, table)
    window = tuple(f"{int(end.astype(np.int64))}ns" for end in found.window)
    look = {**record.look, "samples": None, "window": window}
    told: dict[str, Any] = json.loads(
        _stiction.error_map(record.name, record.columns, look, found.to_json(), chosen, step)
    )
    return told


@_styled
def error_map(found: Assessment, table: Any, order: int | None, step: float, ax: Axes | None) -> Axes:
    """The error over the (fs, fd) plane, with the suggested region and the estimate."""
    told = _map_of(found, table, order, step)
    ax = new_axes(ax, 6.4, 4.4)
    span, side = told["span"], told["step"]
    fs, fd, rms = np.array(told["cells"], dtype=float).T
    at, above = np.rint(fs / side).astype(int), np.rint(fd / side).astype(int)
    z = np.full((above.max() + 1, at.max() + 1), np.nan)
    z[above, at] = 100.0 * rms / told["pv_sd"]
    low, high = np.nanmin(z), np.nanmax(z)
    scale = matplotlib.colors.LogNorm(low, high) if low > 0 and high > 3 * low else matplotlib.colors.Normalize(low, high)
    ax.fill([0, 0.5 * span, span], [0, 0.5 * span, 0], color="#808690", lw=0)
    edges = [side * (np.arange(n + 1) - 0.5) for n in z.shape[::-1]]
    cells = ax.pcolormesh(*edges, z, norm=scale, cmap="viridis")
    bar = ax.get_figure(root=True).colorbar(cells, ax=ax, label="rms error, % of PV's std")  # type: ignore[union-attr]
    shown = np.geomspace(low, high, 6) if isinstance(scale, matplotlib.colors.LogNorm) else np.linspace(low, high, 6)
    bar.set_ticks(shown.tolist(), labels=[_show.number(value) for value in shown])
    bar.minorticks_off()
    for ends in BOUNDS:
        ax.plot(*zip(*(_bands(s * span, j * span) for s, j in ends)), color=INK["paper"], lw=0.8, ls=(0, (4, 3)))
    for x, y, word in REGIONS:
        ax.text(x * span, y * span, word, color=INK["paper"], fontsize=8, ha="center", va="center")
    left, right = ((max(least - side / 2, 0.0), most + side / 2) for least, most in told["region"])
    ax.plot(*zip(*_ring((left[0], right[0]), (left[1], right[1]))), color=INK["paper"], lw=1.6, label="suggested region")
    if found.process is not None and found.process.order == told["order"]:
        if found.s_interval is not None and found.j_interval is not None:
            corners = _ring(*zip(found.s_interval, found.j_interval))
            ring = [_bands(min(s, span), min(max(j, 0.0), s, span)) for s, j in corners]
            ax.plot(*zip(*ring), color=INK["op"], lw=1.6, label="90 % interval")
        if found.fs is not None and found.fd is not None:
            ax.plot(found.fs, found.fd, "o", mfc="none", mec=INK["op"], mew=1.8, ms=8, label="answer")
    ax.plot(*told["best"], "o", color=INK["error"], ms=5, label="least error")
    ax.set(xlim=(0, 1.02 * span), ylim=(0, 0.54 * span), xlabel="fs, OP units", ylabel="fd, OP units")
    ax.set_title(f"{found.loop}: error map, order {told['order']}", pad=22)
    ax.grid(visible=False)
    legend(ax)
    ax.get_legend().get_lines()[0].set_color(INK["soft"])  # type: ignore[union-attr]
    return ax


@_styled
def assessment(
    found: Assessment, table: Any, free_run: bool, periods: float | None, figure: Figure | None
) -> Figure:
    """Everything of one assessment."""
    record = _record_of(found, table)
    figure = new_figure(figure, 9.0, 7.0)
    axes = figure.subplot_mosaic([["pv", "pv"], ["op", "op"], ["phase", "why"]], height_ratios=[1, 0.8, 1.3])
    axes["op"].sharex(axes["pv"])
    clock, rows = _trend(axes["pv"], found, record, free_run, periods)
    axes["pv"].tick_params(labelbottom=False)
    axes["pv"].set_title(_shown(found, periods), fontweight="normal", fontsize=8, color=INK["soft"])
    _op_axes(axes["op"], clock, rows)
    legend(axes["op"])
    clock.label(axes["op"])
    _phase(axes["phase"], _rows(record.columns), found)
    indicators(found, axes["why"])
    sure = "" if found.p_stiction is None else f"; p of stiction {found.p_stiction:.2f}"
    if sure and found.grade and "grade" not in found.words:
        sure += f", grade {found.grade}"
    figure.align_ylabels([axes["pv"], axes["op"]])
    _head(figure, f"{found.loop}: {found.words}{sure}")
    return figure


@_styled
def simulation(loop: Simulation, figure: Figure | None) -> Figure:
    """A simulated loop."""
    rows = _Rows(loop.t, {name: getattr(loop, name) for name in ("op", "pv", "sp", "mv")})
    figure = new_figure(figure, 9.0, 4.4)
    axes = figure.subplot_mosaic([["pv", "phase"], ["op", "phase"]], width_ratios=[1.7, 1])
    axes["op"].sharex(axes["pv"])
    clock = Clock(rows.t)
    _pv_axes(axes["pv"], clock, rows)
    _op_axes(axes["op"], clock, rows)
    axes["pv"].tick_params(labelbottom=False)
    clock.label(axes["op"])
    for name in ("pv", "op"):
        legend(axes[name])
    _phase(axes["phase"], rows, None)
    _head(figure, f"{loop.loop}, simulated")
    return figure


def _effects(ax: Axes, found: Gap) -> None:
    best = [effect for effect in found.effects if effect.closed_pct is not None][:MOST_EFFECTS]
    ax.set_xlabel("% of the gap that an effect closes, on held-out data; line: 90 % interval")
    if not best:
        _say(ax, "no effect was tried")
        return
    _bars(ax, ((e.id, max(e.closed_pct or 0.0, 0.0), INK["fit" if e.id == found.cause else "sp"]) for e in best))
    for at, effect in enumerate(best):
        if effect.closed_interval is not None:
            ax.plot(np.clip(effect.closed_interval, 0, 100), [at, at], color=INK["text"], lw=1)
    ax.set_xlim(0, 100)


@_styled
def gap(found: Gap, figure: Figure | None) -> Figure:
    """Before and after the cause is added."""
    figure = new_figure(figure, 9.0, 6.6)
    upper, middle, lower = figure.subplots(3, 1, height_ratios=[1.3, 0.8, 1.2])
    middle.sharex(upper)
    run = found.predictions
    clock = Clock(run.t)
    x, known = clock.x(run.t), np.isfinite(run.base)
    has_cause = found.cause not in ("none", "unknown")
    upper.plot(x, run.pv, color=INK["pv"], lw=3.2, alpha=0.45, label="PV")
    for axes, subtract in ((upper, 0.0), (middle, run.pv)):
        axes.plot(x, np.where(known, run.base - subtract, np.nan), color=INK["other"], lw=1.1, label="before: base model")
        if has_cause:
            axes.plot(x, run.after - subtract, color=INK["fit"], lw=1.1, label=f"after: with {found.cause}")
        low, high = axes.get_ylim()
        where = run.held_out.tolist()
        axes.fill_between(x, low, high, where=where, color=INK["faint"], alpha=0.5, lw=0, label="held out", zorder=0)
        axes.set_ylim(low, high)
    upper.set_ylabel("PV")
    upper.tick_params(labelbottom=False)
    legend(upper)
    middle.set_ylabel("model - PV")
    middle.axhline(0, color=INK["soft"], lw=0.8)
    clock.label(middle)
    _effects(lower, found)
    others = [] if has_cause else [f"{name} {p:.2f}" for name, p in found.alternatives[:2]]
    possible = f"; possible: {', '.join(others)}" if others else ""
    figure.align_ylabels([upper, middle])
    _head(figure, f"{found.loop}: {found.words}, probability {found.probability:.2f}{possible}")
    return figure


@_styled
def sizes(results: Iterable[Assessment | Failure], ax: Axes | None) -> Axes:
    """s of every loop with its interval."""
    loops = list(results)
    shown = loops[:MOST_LOOPS]
    ax = new_axes(ax, 7.0, 1.2 + 0.26 * max(len(shown), 1))
    for at, one in enumerate(shown):
        if isinstance(one, Failure):
            words = "could not be assessed"
        elif one.s is not None and one.stiction:
            if one.s_interval is not None:
                ax.plot(one.s_interval, [at, at], color=INK["error"], lw=4, alpha=0.35, solid_capstyle="butt")
            ax.plot([one.s], [at], "o", color=INK["error"], ms=5)
            continue
        else:
            words = SHORT[one.verdict]
        ax.text(0, at, f" {words}", va="center", color=INK["soft"], fontsize=8).set_in_layout(False)
    # Windows of one loop differ by their ends.
    same = len({one.loop for one in shown}) == 1 and len(shown) > 1
    names = [_show.moment(one.window[1]) if same and isinstance(one, Assessment) else one.loop for one in shown]
    ax.set_yticks(range(len(shown)), names)
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.set_xlim(left=0)
    ax.grid(axis="y", visible=False)
    rest = f"; {len(shown)} of {len(loops)} shown" if len(shown) < len(loops) else ""
    ax.set(xlabel="s, OP units; bar: 90 % interval", title=f"Stiction{f' of {shown[0].loop}' if same else ''}{rest}")
    return ax


@_styled
def history(found: OverTime, windows: list[dict[str, Any]], figure: Figure | None) -> Figure:
    """s of every window, changes and p."""
    figure = new_figure(figure, 9.0, 5.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    t = np.array([window["end_ns"] for window in windows], dtype=np.int64).view("datetime64[ns]")
    clock = Clock(t)

    def column(name: str, end: int | None = None) -> NDArray[np.float64]:
        values = [window[name] if end is None or window[name] is None else window[name][end] for window in windows]
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)

    x, s = clock.x(t), column("s")
    upper.fill_between(x, column("s_interval", 0), column("s_interval", 1), color=INK["error"], alpha=0.15, lw=0)
    upper.plot(x, s, color=INK["error"], marker="o" if len(t) < 60 else None, ms=3, label="s and its interval")
    words = {"repaired": "no longer detected", "better": "better since", "worse": "worse since"}
    for change in found["changes"]:
        ink = INK["error" if change["kind"] == "worse" else "fit"]
        for axes in (upper, lower):
            axes.axvspan(clock.x(time_of(change["from_ns"])), clock.x(time_of(change["to_ns"])), color=ink, alpha=0.12, lw=0)
            axes.axvline(clock.x(time_of(change["at_ns"])), color=ink, lw=1)
        where = (clock.x(time_of(change["at_ns"])), 1.0)
        upper.annotate(words[change["kind"]], where, (3, -9), xycoords=("data", "axes fraction"),
                       textcoords="offset points", color=ink, fontsize=8)  # fmt: skip
    odd = {one["end_ns"] for one in found["contradicting"]}
    rings = [at for at, window in enumerate(windows) if window["end_ns"] in odd and np.isfinite(s[at])]
    if rings:
        upper.plot(x[rings], s[rings], "o", ms=9, mfc="none", mec=INK["error"], label="contradicts the others")
    upper.set_ylabel("s, OP units")
    upper.set_ylim(bottom=0)
    legend(upper)
    lower.plot(x, column("p_stiction"), color=INK["pv"], marker="o" if len(t) < 60 else None, ms=3)
    lower.set(ylabel="p of stiction", ylim=(0, 1.02))
    clock.label(lower)
    if (pooled := found["pooled"]) is not None:
        _head(figure, f"s {_show.estimate(pooled['s'], pooled['s_interval'])}, pooled over {pooled['windows']} windows")
    return figure


@_styled
def benefit(found: Repair, ax: Axes | None) -> Axes:
    """Standard deviation of PV in each case."""
    ax = new_axes(ax, 6.4, 2.2)
    for at, name in enumerate(CASES):
        figure, ink = found[name]["pv_sd"], INK["fit" if name == "repaired" else "pv"]
        ax.plot(figure["interval"], [at, at], color=ink, lw=5, alpha=0.35, solid_capstyle="butt")
        ax.plot([figure["value"]], [at], "o", color=ink, clip_on=False)
    ax.axvline(found["recorded_pv_sd"], color=INK["soft"], lw=1, ls="--", label="as recorded")
    ax.set_yticks(range(len(CASES)), list(CASES.values()))
    ax.set_ylim(len(CASES) - 0.5, -0.5)
    ax.set_xlim(left=0)
    ax.grid(axis="y", visible=False)
    legend(ax)
    ax.set(xlabel="standard deviation of PV; bar: 90 % interval", title="What a repair would bring")
    return ax
