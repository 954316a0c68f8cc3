"""Detect and measure valve stiction in routine data of a control loop.

OP is the controller output (the signal to the valve, usually in %), PV the process variable. Sizes are in OP units,
times in seconds. The numbers are identical to those of the command `stictiond`.

>>> import stiction
>>> loop = stiction.simulate({
...     "site": {"prefix": "demo"},
...     "run": {"start": "2026-01-05T08:00:00Z", "duration_s": 1200.0, "ts_s": 1.0, "seed": 1, "warmup_s": 1800.0},
...     "loop": [{
...         "name": "FIC101", "operating_point": {"op": 50.0, "pv": 60.0}, "setpoint": 61.0,
...         "process": {"gain": 2.0, "time_constants_s": [20.0], "dead_time_s": 6.0},
...         "controller": {"kc": 0.8, "ti_s": 8.0}, "valve": {"law": "he", "fs": 5.0, "fd": 3.0},
...         "noise": {"pv_sd": 0.05},
...     }],
... })
>>> found = stiction.assess(loop.op, loop.pv, loop.ts_s, sp=loop.sp, name="FIC101")
>>> found.verdict, found.words
('stiction', 'the valve sticks and slips')
>>> bool(abs(found.s - 8.0) < 0.5)
True
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _show, _stiction, _tables
from ._arrays import Table
from ._files import read
from ._over_time import (
    Case,
    Change,
    Contradicting,
    Figure,
    OverTime,
    Pooled,
    Repair,
    Trend,
    Window,
    windows_read,
    windows_text,
)
from ._results import (
    Assessment,
    Effect,
    Failure,
    Gap,
    Interval,
    Predictions,
    Process,
    Record,
    Results,
    Simulation,
    Verdict,
    as_columns,
    assessment_of,
    gap_of,
)
from ._simulate import simulate, simulate_plant
from ._stiction import StictionError, __version__

if TYPE_CHECKING:
    from ._show import DataFrame
    from .detector import StictionDetector as StictionDetector
else:

    def __getattr__(name: str) -> Any:
        if name != "StictionDetector":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from .detector import StictionDetector

        return StictionDetector


__all__ = [
    "Assessment",
    "Case",
    "Change",
    "Contradicting",
    "Effect",
    "Failure",
    "Figure",
    "Gap",
    "Interval",
    "OverTime",
    "Plant",
    "Pooled",
    "Predictions",
    "Process",
    "Repair",
    "Results",
    "Simulation",
    "StictionError",
    "Trend",
    "Verdict",
    "__version__",
    "as_columns",
    "assess",
    "assess_many",
    "assess_plant",
    "assess_windows",
    "diagnose",
    "over_time",
    "read",
    "repair",
    "screen",
    "simulate",
    "simulate_plant",
]

Progress: TypeAlias = Callable[[int, int], object] | bool
Kind: TypeAlias = Literal["flow", "level", "pressure", "temperature", "analysis", "other"]
Model: TypeAlias = Literal["auto", "fopdt", "sopdt"]
Valve: TypeAlias = Literal["auto", "he", "tracking"]
Solver: TypeAlias = Literal["contour", "multistart", "random", "branch-bound"]
Detrend: TypeAlias = Literal["mean", "median", "linear"]
Given: TypeAlias = "Assessment | Gap | Mapping[str, Any]"


def _fit(
    op_range: Interval | None,
    prevalence: float,
    kind: Kind | None,
    model: Model,
    delay: str | float,
    valve: Valve,
    solver: Solver | None,
    fineness_pct: float,
    evaluations: int,
    seed: int,
) -> dict[str, Any]:
    try:
        ends = None if op_range is None else (float(op_range[0]), float(op_range[1]))
    except (TypeError, ValueError, IndexError):
        raise _arrays.refused("op_range", f"{op_range!r} is not a pair of numbers; give (low, high)") from None
    return {
        "op_range": ends,
        "prevalence": _arrays.positive("prevalence", prevalence),
        "kind": None if kind is None else str(kind),
        "model": str(model),
        "delay": str(delay),
        "valve": str(valve),
        "solver": None if solver is None else str(solver),
        "fineness_pct": _arrays.positive("fineness_pct", fineness_pct),
        "evaluations": _arrays.whole("evaluations", evaluations, 1),
        "seed": _arrays.whole("seed", seed),
    }


def _model(argument: str, given: Given | None) -> str | None:
    if given is None:
        return None
    if isinstance(given, (Assessment, Gap)):
        return given.to_json()
    if not isinstance(given, Mapping):
        raise _arrays.refused(argument, f"{given!r} is not a model; give a result, or a document as a dict")
    try:
        return json.dumps(given)
    except (TypeError, ValueError) as why:
        raise _arrays.refused(argument, f"is not a document ({why}); give the result of to_dict()") from None


def assess(
    op: ArrayLike | Mapping[str, Any],
    pv: ArrayLike | None = None,
    ts_s: float | None = None,
    *,
    t: ArrayLike | None = None,
    sp: ArrayLike | None = None,
    mv: ArrayLike | None = None,
    mode: ArrayLike | None = None,
    name: str = "loop",
    op_range: Interval | None = None,
    prevalence: float = 0.3,
    kind: Kind | None = None,
    model: Model = "auto",
    delay: str | float = "auto",
    valve: Valve = "auto",
    solver: Solver | None = None,
    fineness_pct: float = 5.0,
    evaluations: int = 10_000,
    seed: int = 1,
    samples: tuple[int, int] | None = None,
    window: tuple[Any, Any] | None = None,
    downsample: float | None = None,
    downsample_like_toolbox: bool = False,
    detrend: Detrend | None = None,
    score: Given | None = None,
) -> Assessment:
    """Assess whether the valve of a loop sticks, and how much, as `stictiond analyze` does.

    op, pv: controller output and process variable, one number per sample; NaN if missing. Or op alone: a table with columns
    t, op, pv (sp, mv, mode), or with tags such as FIC101.OP and FIC101.PV; `name` chooses one of several loops.
    ts_s: seconds between samples; or t: their times, seconds since 1970 or datetime64 (UTC if without a zone); or neither,
    where pandas Series or DataFrames have a DatetimeIndex.
    sp, mv, mode: set point (PV units), measured valve position, controller mode (`auto`, `manual`, `cascade`).
    name: the loop's tag. FIC101 implies a flow loop, unless `kind` is given.
    op_range: the full range of OP, such as (0, 100); needed for `severity_by_range`.
    prevalence: share of such loops that stick, 0.001 to 0.999; `p_stiction` assumes it, the verdict does not depend on it.
    model: order of the process, `fopdt` or `sopdt`. delay: dead time, samples (3) or seconds ("12s").
    valve: valve model. solver: also run this solver on the error surface (`solver` in `to_dict()`), with at most
    `evaluations` models and a grid of `fineness_pct` % of OP's span. seed: for all random choices.
    samples: range to use, such as (50, 500), counted from 1, both ends included. window: two times to use between.
    downsample: samples per point. detrend: trend to remove from PV and SP first.
    score: another model to run over the record (`scored` in `to_dict()`).

    Raises StictionError for unusable input, such as fewer than 30 samples.

    >>> import numpy as np
    >>> assess(np.arange(900) % 90, (np.arange(900) + 30) % 90, 1.0).loop
    'loop'
    """
    name, columns = _tables.record(name, op, pv, ts_s, t, sp, mv, mode)
    look = _arrays.look(samples, window, downsample, downsample_like_toolbox, detrend)
    fit = _fit(op_range, prevalence, kind, model, delay, valve, solver, fineness_pct, evaluations, seed)
    document, said = _stiction.assess(name, columns, look, fit, _model("score", score))
    return assessment_of(document, said, Record(name, columns, look))


def _many(
    table: Table,
    named: Mapping[str, str],
    ts_s: float | None,
    threads: int | None,
    progress: Progress | None,
    look: dict[str, Any],
    fit: dict[str, Any],
) -> dict[str, Any]:
    """The loops of a table as the native module takes them."""
    opened, names = _tables.long_form(table, named, ts_s is None)
    for argument in ("op", "pv", *(("t",) if ts_s is None else ())):
        if (wanted := named[argument]) not in names:
            why = f'the table has no column {wanted!r}; name one of {", ".join(names)} with {argument}="..."'
            raise _arrays.refused(argument, why)

    def column(argument: str) -> Any:
        return opened[named[argument]] if named[argument] in names else None

    one = ["loop"], None, [len(column("op"))]
    loops, order, ends = _arrays.grouped(column("loop")) if named["loop"] in names else one
    if ts_s is None:
        times = column("t")
    else:
        # Each loop's own clock starts at 0.
        starts = [0, *ends[:-1]]
        place = np.concatenate([np.arange(end - start) for start, end in zip(starts, ends)] or [np.arange(0)])
        step_ns = _arrays.positive("ts_s", ts_s) * 1e9
        clock = np.rint(place * step_ns).astype(np.int64).view("datetime64[ns]")
        times = clock
        if order is not None:
            times = np.empty_like(clock)
            times[order] = clock
    columns = _arrays.columns(column("op"), column("pv"), None, times, column("sp"), column("mv"), column("mode"))
    if order is not None:
        columns = _arrays.reordered(columns, order)
    return {
        "names": loops,
        "ends": ends,
        "columns": columns,
        "look": look,
        "fit": fit,
        "threads": None if threads is None else _arrays.whole("threads", threads, 1),
        "progress": _show.meter(progress),
    }


def _replies(
    names: Iterable[str], answers: Iterable[tuple[tuple[str, str] | None, str | None]]
) -> Results[Assessment | Failure]:
    return Results(
        Failure(name, error or "") if told is None else assessment_of(*told) for name, (told, error) in zip(names, answers)
    )


def assess_many(
    table: Table,
    *,
    loop: str = "loop",
    t: str = "t",
    op: str = "op",
    pv: str = "pv",
    sp: str = "sp",
    mv: str = "mv",
    mode: str = "mode",
    ts_s: float | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    op_range: Interval | None = None,
    prevalence: float = 0.3,
    kind: Kind | None = None,
    model: Model = "auto",
    delay: str | float = "auto",
    valve: Valve = "auto",
    solver: Solver | None = None,
    fineness_pct: float = 5.0,
    evaluations: int = 10_000,
    seed: int = 1,
    samples: tuple[int, int] | None = None,
    window: tuple[Any, Any] | None = None,
    downsample: float | None = None,
    downsample_like_toolbox: bool = False,
    detrend: Detrend | None = None,
) -> Results[Assessment | Failure]:
    """Assess every loop of a long table on all cores. Results are in order of first appearance.

    table: a DataFrame (pandas, polars), a dict of arrays, a structured array or an Arrow table with one row per sample;
    or wide, with tags such as FIC101.OP as columns; or with one row per value and columns tag, time, value.
    loop, t, op, pv, sp, mv, mode: names of its columns. The last three are optional, and `t` if ts_s is given (seconds
    between a loop's samples). threads: number of threads [one per core]; the results do not depend on it.
    progress: called with (loops done, loops) in the calling thread; an exception in it stops the work. True: a bar of tqdm.
    The other arguments apply to every loop, see `assess`.

    A loop that cannot be assessed gives a `Failure`, not an exception. Ctrl-C stops the work.

    >>> import numpy as np
    >>> n = np.arange(600)
    >>> table = {"loop": np.repeat(["A", "B"], 300), "t": n % 300, "op": n % 60, "pv": np.where(n < 300, n % 50, np.nan)}
    >>> [result.ok for result in assess_many(table)]
    [True, False]
    """
    named = {"loop": loop, "t": t, "op": op, "pv": pv, "sp": sp, "mv": mv, "mode": mode}
    look = _arrays.look(samples, window, downsample, downsample_like_toolbox, detrend)
    fit = _fit(op_range, prevalence, kind, model, delay, valve, solver, fineness_pct, evaluations, seed)
    asked = _many(table, named, ts_s, threads, progress, look, fit)
    return _replies(asked["names"], _stiction.assess_many(asked))


class Plant(NamedTuple):
    """The loops of one plant, judged together."""

    loops: Results[Assessment | Failure]
    """Every loop, by first appearance; `to_dict()["group"]` is a member's part in its group."""
    groups: list[dict[str, Any]]
    """Loops that share one oscillation, largest group first: documents `stictiond.group.v1`."""

    def to_dict(self) -> dict[str, Any]:
        """The documents of loops and groups."""
        return {"loops": self.loops.to_dict(), "groups": self.groups}

    def to_frame(self) -> DataFrame:
        """A row per loop for pandas."""
        return self.loops.to_frame()

    def _repr_html_(self) -> str:
        return self.loops._repr_html_()


def assess_plant(
    table: Table,
    *,
    loop: str = "loop",
    t: str = "t",
    op: str = "op",
    pv: str = "pv",
    sp: str = "sp",
    mv: str = "mv",
    mode: str = "mode",
    threads: int | None = None,
    progress: Progress | None = None,
    seed: int = 1,
    window: tuple[Any, Any] | None = None,
) -> Plant:
    """Assess the loops of one plant together, as `stictiond analyze --plant` does.

    Arguments as for `assess_many`. Finds loops that share one oscillation, and which of them causes it. A follower's
    estimate has the group's probability; `to_dict()["group"]` also has the separate one.

    Raises StictionError for unusable input.

    >>> import numpy as np
    >>> n = np.arange(600)
    >>> table = {"loop": np.repeat(["A", "B"], 300), "t": n % 300, "op": n % 60, "pv": n % 50}
    >>> len(assess_plant(table).loops)
    2
    """
    named = {"loop": loop, "t": t, "op": op, "pv": pv, "sp": sp, "mv": mv, "mode": mode}
    look = _arrays.look(None, window, None, False, None)
    fit = _fit(None, 0.3, None, "auto", "auto", "auto", None, 5.0, 10_000, seed)
    asked = _many(table, named, None, threads, progress, look, fit)
    answers, groups = _stiction.assess_plant(asked)
    return Plant(_replies(asked["names"], answers), [json.loads(group) for group in groups])


def assess_windows(
    op: ArrayLike | Mapping[str, Any],
    pv: ArrayLike | None = None,
    ts_s: float | None = None,
    *,
    t: ArrayLike | None = None,
    sp: ArrayLike | None = None,
    mv: ArrayLike | None = None,
    mode: ArrayLike | None = None,
    name: str = "loop",
    hop_s: float | None = None,
    max_window_s: float | None = None,
    config: str | None = None,
    ends: tuple[Any, Any] | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Results[Assessment]:
    """Assess every window of a long record, oldest first, cut as the daemon does.

    Arguments as for `assess`, and:
    hop_s: windows end at multiples of it since 1970, s [600]. max_window_s: longest window, s [a week].
    config: text of a daemon configuration (as `config/monitor.toml`) instead of these two; its `[window]` and the
    loop's `[[loop]]` are used.
    ends: (after, until), only windows that end after the first time and not after the second; others are not judged.
    threads: number of threads [one per core]; the results do not depend on it.
    progress: called with (samples taken, samples) in the calling thread; an exception in it stops the work.

    A window is due once a sample arrives that is later than its end by the allowed lateness (5 s); a record that ends
    earlier does not have that window. The documents are byte-identical to those of `stictiond replay`.

    >>> import numpy as np
    >>> found = assess_windows(np.arange(900) % 90, (np.arange(900) + 30) % 90, 1.0, hop_s=300)
    >>> [str(one.window[1])[11:19] for one in found]
    ['00:00:00', '00:05:00', '00:10:00']
    """
    name, columns = _tables.record(name, op, pv, ts_s, t, sp, mv, mode)
    if config is not None and (hop_s, max_window_s) != (None, None):
        raise _arrays.refused("config", "already contains hop_s and max_window_s; set them there")
    watched = {
        "config": None if config is None else str(config),
        "hop_s": None if hop_s is None else _arrays.positive("hop_s", hop_s),
        "max_window_s": None if max_window_s is None else _arrays.positive("max_window_s", max_window_s),
        "ends": _arrays.times("ends", ends),
        "threads": None if threads is None else _arrays.whole("threads", threads, 1),
    }
    record = Record(name, columns, _arrays.look(None, None, None, False, None))
    answers = _stiction.assess_windows(name, columns, watched, _show.meter(progress))
    return Results(assessment_of(*told, record) for told in answers)


def over_time(windows: Iterable[Window]) -> OverTime:
    """Combine many windows of one valve: size since its last change, the date of that change, windows that disagree.

    windows: results of `assess_windows`, or documents of estimates as dicts (from a recording or a table), in any order.

    Returns a dict, see `OverTime`; `sentences` has the same in words.

    >>> hour = 3_600_000_000_000
    >>> seen = [{"start_ns": k * hour, "end_ns": (k + 1) * hour, "stiction": True, "s": s, "s_interval": [0.9 * s, 1.1 * s]}
    ...         for k, s in enumerate([4.0] * 12 + [8.0] * 12)]
    >>> [change["kind"] for change in over_time(seen)["changes"]]
    ['worse']
    """
    read = windows_read(windows)
    return OverTime(json.loads(_stiction.over_time(windows_text(read))), read)


def repair(
    op: ArrayLike | Mapping[str, Any],
    pv: ArrayLike | None = None,
    ts_s: float | None = None,
    *,
    t: ArrayLike | None = None,
    sp: ArrayLike | None = None,
    mv: ArrayLike | None = None,
    mode: ArrayLike | None = None,
    name: str = "loop",
    op_range: Interval | None = None,
    kind: Kind | None = None,
    seed: int = 1,
    samples: tuple[int, int] | None = None,
    window: tuple[Any, Any] | None = None,
) -> Repair:
    """Estimate the benefit of a valve repair: simulate the closed loop as it is, without stiction, with half the gain.

    Arguments as for `assess`; op_range also limits OP in the simulation. The loop is identified from the record, so choose a
    representative window.

    Returns a dict, see `Repair`; `sentences` has the same in words, `assumptions` lists the assumptions.
    Raises StictionError if the loop cannot be simulated or the simulation is not reliable; the message says why.
    """
    name, columns = _tables.record(name, op, pv, ts_s, t, sp, mv, mode)
    look = _arrays.look(samples, window, None, False, None)
    fit = _fit(op_range, 0.3, kind, "auto", "auto", "auto", None, 5.0, 10_000, seed)
    return Repair(json.loads(_stiction.repair(name, columns, look, fit)))


def screen(
    op: ArrayLike | Mapping[str, Any],
    pv: ArrayLike | None = None,
    ts_s: float | None = None,
    *,
    t: ArrayLike | None = None,
    sp: ArrayLike | None = None,
    mode: ArrayLike | None = None,
    name: str = "loop",
    samples: tuple[int, int] | None = None,
    window: tuple[Any, Any] | None = None,
) -> bool:
    """Return True if the loop is so calm that the daemon skips it without a fit. Takes less than a millisecond.

    False only means that the loop needs a fit. Arguments as for `assess`.

    >>> import numpy as np
    >>> noise = np.random.default_rng(1).normal(size=(2, 1000))
    >>> screen(50 + noise[0], 20 + noise[1], 1.0)
    True
    """
    name, columns = _tables.record(name, op, pv, ts_s, t, sp, None, mode)
    return _stiction.screen(name, columns, _arrays.look(samples, window, None, False, None))


def diagnose(
    op: ArrayLike | Mapping[str, Any],
    pv: ArrayLike | None = None,
    ts_s: float | None = None,
    *,
    t: ArrayLike | None = None,
    sp: ArrayLike | None = None,
    mv: ArrayLike | None = None,
    mode: ArrayLike | None = None,
    name: str = "loop",
    base: Literal["refit", "linear"] | Given = "refit",
    neighbours: Mapping[str, Mapping[str, Any]] | None = None,
    without: Iterable[str] = (),
    pairs: bool = False,
    budget_s: float | None = None,
    seed: int = 1,
    threads: int | None = None,
    progress: Progress | None = None,
    samples: tuple[int, int] | None = None,
    window: tuple[Any, Any] | None = None,
    windows: Iterable[tuple[Any, Any]] = (),
    downsample: float | None = None,
    downsample_like_toolbox: bool = False,
    detrend: Detrend | None = None,
) -> Gap:
    """Find what a loop's model does not explain and which effect causes it, as `stictiond gap` does.

    Arguments as for `assess`, and:
    base: the base model: `refit` (a sticking valve and a first-order process), `linear` (no friction), or a given one:
    a result of `assess` or `diagnose`, or its document.
    neighbours: other loops that may drive this one, by name: each a mapping with `op`, `pv` and `ts_s` or `t`, on the same
    clock.
    without: effects to exclude. pairs: also search pairs of effects when one explains the record. budget_s: time for the
    search, s [about 5 on two cores]; a search that runs out of time is not repeatable. progress: called with (models
    tried, most models) in the calling thread; an exception in it, or Ctrl-C, stops the search. windows: two or more
    pairs (from, to) of times; each window is diagnosed separately, and the cause is decided from all, as with `--pool`.
    """
    name, columns = _tables.record(name, op, pv, ts_s, t, sp, mv, mode)
    look = _arrays.look(samples, window, downsample, downsample_like_toolbox, detrend)
    if isinstance(base, str) and base not in ("refit", "linear"):
        raise _arrays.refused("base", f'{base!r} is not a valid value; give "refit", "linear", a result or a document')
    if isinstance(without, str):
        raise _arrays.refused("without", f"{without!r} is a string; give a list of effects, such as [{without!r}]")
    asked = {
        "base": base if isinstance(base, str) else _model("base", base),
        "without": [str(effect) for effect in without],
        "pairs": bool(pairs),
        "budget_s": None if budget_s is None else _arrays.positive("budget_s", budget_s),
        "seed": _arrays.whole("seed", seed),
        "threads": None if threads is None else _arrays.whole("threads", threads, 1),
        "neighbours": [(str(other), _neighbour(other, given)) for other, given in (neighbours or {}).items()],
        "windows": [_arrays.times("windows", pair) for pair in windows],
    }
    return gap_of(*_stiction.diagnose(name, columns, look, asked, _show.meter(progress)))


def _neighbour(name: str, given: Mapping[str, Any]) -> Any:
    missing = [key for key in ("op", "pv") if key not in given]
    if missing:
        raise _arrays.refused("neighbours", f"{name!r} lacks {missing[0]!r}; give op, pv and ts_s or t")
    return _arrays.columns(given["op"], given["pv"], given.get("ts_s"), given.get("t"), None, None, None)
