"""Valve stiction from routine data of a control loop.

OP is the controller output, the signal sent to the valve, in any unit, mostly %; PV the process variable. Sizes come out
in OP's units, times in seconds. The numbers are those of the command `stictiond`, to the bit.

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
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _stiction
from ._arrays import Table
from ._over_time import Case, Change, Contradicting, Figure, OverTime, Pooled, Repair, Trend, Window, windows_text
from ._results import (
    Assessment,
    Effect,
    Failure,
    Gap,
    Interval,
    Predictions,
    Process,
    Simulation,
    Verdict,
    as_columns,
    assessment_of,
    doubles_of,
    gap_of,
    times_of,
)
from ._stiction import StictionError, __version__

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
    "Pooled",
    "Predictions",
    "Process",
    "Repair",
    "Simulation",
    "StictionError",
    "Trend",
    "Verdict",
    "__version__",
    "as_columns",
    "assess",
    "assess_many",
    "assess_windows",
    "diagnose",
    "over_time",
    "repair",
    "screen",
    "simulate",
    "simulate_plant",
]

Progress: TypeAlias = Callable[[int, int], object]
Kind: TypeAlias = Literal["flow", "level", "pressure", "temperature", "analysis", "other"]
Model: TypeAlias = Literal["auto", "fopdt", "sopdt"]
Valve: TypeAlias = Literal["auto", "he", "tracking"]
Solver: TypeAlias = Literal["contour", "multistart", "random", "branch-bound"]
Detrend: TypeAlias = Literal["mean", "median", "linear"]
Given: TypeAlias = "Assessment | Gap | Mapping[str, Any]"


def _fit(
    op_range: Interval | None,
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
        raise _arrays.refused("op_range", f"{op_range!r} is no pair of numbers; give (low, high)") from None
    return {
        "op_range": ends,
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
        raise _arrays.refused(argument, f"{given!r} is no model; give a result, or a document as a dict")
    try:
        return json.dumps(given)
    except (TypeError, ValueError) as why:
        raise _arrays.refused(argument, f"is no document ({why}); give what to_dict() gave") from None


def assess(
    op: ArrayLike,
    pv: ArrayLike,
    ts_s: float | None = None,
    *,
    t: ArrayLike | None = None,
    sp: ArrayLike | None = None,
    mv: ArrayLike | None = None,
    mode: ArrayLike | None = None,
    name: str = "loop",
    op_range: Interval | None = None,
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
    """Whether the valve of a loop sticks, and how much; as `stictiond analyze`.

    op, pv: controller output and process variable, one number a sample; NaN where there is none.
    ts_s: seconds between samples; or t: their times, seconds since 1970 or datetime64 (UTC unless a zone says else).
    sp, mv, mode: set point (PV units), measured valve position, controller mode (`auto`, `manual`, `cascade`).
    name: the loop's tag; FIC101 tells a flow loop, unless `kind` does.
    op_range: OP's whole range, such as (0, 100), so that `severity_by_range` is told.
    model: order of the process, `fopdt` or `sopdt`. delay: dead time, samples (3) or seconds ("12s").
    valve: law of friction. solver: also set this one on the error surface (`solver` in `to_dict()`), with
    `evaluations` models, a grid of `fineness_pct` % of OP's span. seed: of every random choice.
    samples: only these, (50, 500) counts from 1, ends included. window: only between two times.
    downsample: one point for every so many samples. detrend: take this away from PV and SP first.
    score: a model from elsewhere, to be run over the record (`scored` in `to_dict()`).

    Raises StictionError where something cannot be used, such as under 30 samples.

    >>> import numpy as np
    >>> assess(np.arange(900) % 90, (np.arange(900) + 30) % 90, 1.0).loop
    'loop'
    """
    columns = _arrays.columns(op, pv, ts_s, t, sp, mv, mode)
    look = _arrays.look(samples, window, downsample, downsample_like_toolbox, detrend)
    fit = _fit(op_range, kind, model, delay, valve, solver, fineness_pct, evaluations, seed)
    document, said = _stiction.assess(str(name), columns, look, fit, _model("score", score))
    return assessment_of(document, said)


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
) -> list[Assessment | Failure]:
    """Every loop of a long table, on all cores; results in the order in which loops first appear.

    table: a DataFrame (pandas, polars), a dict of arrays, a structured array or an Arrow table with a row a sample.
    loop, t, op, pv, sp, mv, mode: names of its columns; the last three may be absent, `t` too where ts_s is given
    (seconds between a loop's samples). threads: how many, else as many as cores; no number depends on it.
    progress: called with (loops done, loops) by the thread that called; what it raises ends the work.
    The rest is told every loop, see `assess`.

    A loop that cannot be assessed gives a `Failure`, not an exception. Ctrl-C ends it.

    >>> import numpy as np
    >>> n = np.arange(600)
    >>> table = {"loop": np.repeat(["A", "B"], 300), "t": n % 300, "op": n % 60, "pv": np.where(n < 300, n % 50, np.nan)}
    >>> [result.ok for result in assess_many(table)]
    [True, False]
    """
    opened, names = _arrays.open_table(table)
    for argument, wanted in (("op", op), ("pv", pv)) + ((("t", t),) if ts_s is None else ()):
        if wanted not in names:
            why = f'the table has no column {wanted!r}, but {", ".join(names)}; name it by {argument}="..."'
            raise _arrays.refused(argument, why)

    def column(wanted: str) -> Any:
        return opened[wanted] if wanted in names else None

    order = None
    if loop in names:
        loops, order, ends = _arrays.grouped(opened[loop])
    else:
        loops, ends = ["loop"], [len(opened[op])]
    if ts_s is None:
        times, step = column(t), None
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
        step = None
    columns = _arrays.columns(column(op), column(pv), step, times, column(sp), column(mv), column(mode))
    if order is not None:
        columns = _arrays.reordered(columns, order)
    look = _arrays.look(samples, window, downsample, downsample_like_toolbox, detrend)
    fit = _fit(op_range, kind, model, delay, valve, solver, fineness_pct, evaluations, seed)
    team = None if threads is None else _arrays.whole("threads", threads, 1)
    answers = _stiction.assess_many(loops, ends, columns, look, fit, team, progress)
    return [
        Failure(name, error or "") if told is None else assessment_of(*told)
        for name, (told, error) in zip(loops, answers)
    ]


def assess_windows(
    op: ArrayLike,
    pv: ArrayLike,
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
) -> list[Assessment]:
    """Every window of a long record, oldest first, as the daemon beside the plant would have cut and judged it.

    Arguments as for `assess`, and:
    hop_s: windows end at whole multiples of it since 1970 (600 s). max_window_s: the longest window (a week).
    config: text of a daemon's configuration (`config/monitor.toml`) instead of these two, of which `[window]` and the
    loop's own `[[loop]]` count.
    ends: (after, until), only windows that end behind the first and not behind the second; those before are not judged.
    threads: how many, else as many as cores; no number depends on it.
    progress: called with (samples taken, samples) by the thread that called; what it raises ends the work.

    A window is due once a sample has come that lies behind its end by the lateness allowed (5 s); a record that ends
    before has no such window. Documents are, to the byte, those that `stictiond replay` makes of the same samples.

    >>> import numpy as np
    >>> found = assess_windows(np.arange(900) % 90, (np.arange(900) + 30) % 90, 1.0, hop_s=300)
    >>> [str(one.window[1])[11:19] for one in found]
    ['00:00:00', '00:05:00', '00:10:00']
    """
    columns = _arrays.columns(op, pv, ts_s, t, sp, mv, mode)
    if config is not None and (hop_s, max_window_s) != (None, None):
        raise _arrays.refused("config", "holds hop_s and max_window_s itself; write them into it")
    watched = {
        "config": None if config is None else str(config),
        "hop_s": None if hop_s is None else _arrays.positive("hop_s", hop_s),
        "max_window_s": None if max_window_s is None else _arrays.positive("max_window_s", max_window_s),
        "ends": _arrays.times("ends", ends),
        "threads": None if threads is None else _arrays.whole("threads", threads, 1),
    }
    return [assessment_of(*told) for told in _stiction.assess_windows(str(name), columns, watched, progress)]


def over_time(windows: Iterable[Window]) -> OverTime:
    """Many windows of one valve together: size since it last changed, when that was, which windows disagree.

    windows: results of `assess_windows`, or documents of estimates as dicts (from a recording or a table), in any order.

    Returns a dict, see `OverTime`; `sentences` say the same in words.

    >>> hour = 3_600_000_000_000
    >>> seen = [{"start_ns": k * hour, "end_ns": (k + 1) * hour, "stiction": True, "s": s, "s_interval": [0.9 * s, 1.1 * s]}
    ...         for k, s in enumerate([4.0] * 12 + [8.0] * 12)]
    >>> [change["kind"] for change in over_time(seen)["changes"]]
    ['worse']
    """
    found: OverTime = json.loads(_stiction.over_time(windows_text(windows)))
    return found


def repair(
    op: ArrayLike,
    pv: ArrayLike,
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
    """What a repair of the valve buys: the closed loop simulated as it is, without stiction, with half the gain.

    Arguments as for `assess`; op_range also bounds OP in the simulation. The loop is what one record tells, so give a
    window of it.

    Returns a dict, see `Repair`; `sentences` say the same in words, `assumptions` what was taken for granted.
    Raises StictionError where the loop cannot be simulated, or the simulation not be trusted; the message says why.
    """
    columns = _arrays.columns(op, pv, ts_s, t, sp, mv, mode)
    look = _arrays.look(samples, window, None, False, None)
    fit = _fit(op_range, kind, "auto", "auto", "auto", None, 5.0, 10_000, seed)
    found: Repair = json.loads(_stiction.repair(str(name), columns, look, fit))
    return found


def screen(
    op: ArrayLike,
    pv: ArrayLike,
    ts_s: float | None = None,
    *,
    t: ArrayLike | None = None,
    sp: ArrayLike | None = None,
    mode: ArrayLike | None = None,
    name: str = "loop",
    samples: tuple[int, int] | None = None,
    window: tuple[Any, Any] | None = None,
) -> bool:
    """Whether the loop is so calm that the daemon lets it go at once, without a fit: under a millisecond.

    False says only that a look is worth it. Arguments as for `assess`.

    >>> import numpy as np
    >>> noise = np.random.default_rng(1).normal(size=(2, 1000))
    >>> screen(50 + noise[0], 20 + noise[1], 1.0)
    True
    """
    columns = _arrays.columns(op, pv, ts_s, t, sp, None, mode)
    return _stiction.screen(str(name), columns, _arrays.look(samples, window, None, False, None))


def diagnose(
    op: ArrayLike,
    pv: ArrayLike,
    ts_s: float | None = None,
    *,
    t: ArrayLike | None = None,
    sp: ArrayLike | None = None,
    mv: ArrayLike | None = None,
    mode: ArrayLike | None = None,
    name: str = "loop",
    base: Literal["refit", "linear"] | Given = "refit",
    without: Iterable[str] = (),
    pairs: bool = False,
    budget_s: float | None = None,
    seed: int = 1,
    threads: int | None = None,
    progress: Progress | None = None,
    samples: tuple[int, int] | None = None,
    window: tuple[Any, Any] | None = None,
    downsample: float | None = None,
    downsample_like_toolbox: bool = False,
    detrend: Detrend | None = None,
) -> Gap:
    """What a loop's model leaves unexplained, and which effect causes it; as `stictiond gap`.

    Arguments as for `assess`, and:
    base: the model that the gap is measured from: `refit` (a sticking valve and a first-order process), `linear`
    (without friction), or one from elsewhere: a result of `assess` or `diagnose`, or its document.
    without: effects that are not tried. pairs: try two at once also where one alone explains the record. budget_s:
    seconds for the search, else some 5 on two cores at most; a search that its time ends is not repeatable. progress:
    called with (models tried, models at most) by the thread that called; what it raises ends the search, and so does
    Ctrl-C.
    """
    columns = _arrays.columns(op, pv, ts_s, t, sp, mv, mode)
    look = _arrays.look(samples, window, downsample, downsample_like_toolbox, detrend)
    if isinstance(base, str) and base not in ("refit", "linear"):
        raise _arrays.refused("base", f'{base!r} is not known; give "refit", "linear", a result or a document')
    if isinstance(without, str):
        raise _arrays.refused("without", f"{without!r} is one text; give a list of effects, such as [{without!r}]")
    asked = {
        "base": base if isinstance(base, str) else _model("base", base),
        "without": [str(effect) for effect in without],
        "pairs": bool(pairs),
        "budget_s": None if budget_s is None else _arrays.positive("budget_s", budget_s),
        "seed": _arrays.whole("seed", seed),
        "threads": None if threads is None else _arrays.whole("threads", threads, 1),
    }
    return gap_of(*_stiction.diagnose(str(name), columns, look, asked, progress))


def simulate_plant(scenario: str | Mapping[str, Any]) -> dict[str, Simulation]:
    """Every loop of a scenario, by its name; see `simulate`."""
    if isinstance(scenario, str):
        text, is_json = scenario, False
    else:
        try:
            text, is_json = json.dumps(scenario, allow_nan=False), True
        except (TypeError, ValueError) as why:
            raise _arrays.refused("scenario", f"{why}; give TOML, or a dict of plain values") from None

    def loop(name: str, truth: str, ts_s: float, columns: list[bytes]) -> Simulation:
        op, pv, sp, mv = (doubles_of(column) for column in columns[1:])
        return Simulation(name, truth, ts_s, times_of(columns[0]), op, pv, sp, mv)

    loops = (loop(*told) for told in _stiction.simulate(text, is_json))
    return {one.loop: one for one in loops}


def simulate(scenario: str | Mapping[str, Any], loop: str | None = None) -> Simulation:
    """A loop of a simulated plant: valve with friction, process, controller, noise, disturbances.

    scenario: text of a scenario file, such as those in `recordings/scenarios` (not its path), or the same as a dict.
    loop: which one, where the scenario has several. Values are rounded as the scenario records them, nothing is lost or
    late. The same scenario gives the same numbers.
    """
    loops = simulate_plant(scenario)
    if loop is None and len(loops) == 1:
        return next(iter(loops.values()))
    if loop not in loops:
        raise _arrays.refused("loop", f"{loop!r} is not in the scenario; give one of {', '.join(loops)}")
    return loops[loop]
