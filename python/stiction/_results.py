"""Results of the functions."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from . import _show
from ._show import DataFrame

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Interval: TypeAlias = tuple[float, float]
Verdict: TypeAlias = Literal[
    "stiction", "deadband", "disturbance", "tuning", "not_oscillating", "cause_unknown", "inconclusive"
]


def drawing() -> Any:
    """The module that draws; an ImportError says how to install matplotlib."""
    _show.needed("matplotlib", "a plot", "'stiction[plot]'")
    from . import _plots

    return _plots


class Record(NamedTuple):
    """The data that a result was computed from, as passed to the native module."""

    name: str
    columns: dict[str, Any]
    look: dict[str, Any]


def _interval(value: Any) -> Interval | None:
    return None if value is None else (value[0], value[1])


@dataclass(frozen=True)
class Process:
    """The process model fitted with the bands."""

    order: int
    """1 or 2."""
    gain: float
    """PV units per OP unit; also per second if integrating."""
    time_constants_s: tuple[float, ...]
    """Time constants, s, largest first; none for a pure integrator."""
    dead_time_s: float
    """Dead time, s."""
    integrating: bool
    """Integrating instead of self-regulating."""
    mse: float
    """Mean squared error of the free run, PV units squared."""
    fit_pct: float
    """100 (1 - rms error / standard deviation of PV)."""
    tested: bool = True
    """Whether the record tests the model; the numbers of one that is not tested mean nothing."""
    gain_interval: tuple[float, float] | None = None
    """90 % interval of the gain, where the thirds of the record tell it."""
    dead_time_interval_s: tuple[float, float] | None = None
    """90 % interval of the dead time, s, likewise."""


@dataclass(frozen=True)
class Assessment:
    """Whether a valve sticks, how much, and with what confidence. Values that do not exist are None.

    Sizes are in OP units, times in s; `docs/read-a-result.md` defines every number. `str()` gives the text of the command line,
    `to_dict()` the document. Results of `assess` and `assess_windows` keep their record for `plot()`; pickled ones do not.
    """

    loop: str
    """The loop's name."""
    window: tuple[np.datetime64, np.datetime64]
    """Start and end of the assessed record, UTC."""
    verdict: Verdict
    """`stiction`, `deadband`, `disturbance`, `tuning`, `not_oscillating`, `cause_unknown` or `inconclusive`."""
    stiction: bool | None
    """True for `stiction` and `deadband`, None for `inconclusive`."""
    p_stiction: float | None
    """Probability that the valve sticks, 0..1, where `prevalence` of such valves do; None for a screened loop too."""
    p_calibrated: float | None
    """The same where half of them do; verdict and grade follow from it."""
    prevalence: float
    """Share of such loops that is assumed to stick."""
    confidence: float | None
    """The larger of p_calibrated and 1 - p_calibrated."""
    grade: str | None
    """A (reliable, with a narrow interval) to D (no answer)."""
    s: float | None
    """Deadband plus stickband, fs + fd: travel of OP after a reversal before the stem moves."""
    j: float | None
    """Slip jump, fs - fd."""
    fs: float | None
    """Static friction band."""
    fd: float | None
    """Kinetic friction band."""
    s_interval: Interval | None
    """90 % interval of s; starts at 0 if there is no stiction."""
    j_interval: Interval | None
    """90 % interval of j."""
    fs_interval: Interval | None
    """90 % interval of fs."""
    fd_interval: Interval | None
    """90 % interval of fd."""
    s_detectable: float | None
    """Detection limit: the smallest s that would have been found here; None for a sticking valve."""
    stiction_index: float | None
    """1 - error of the best sticking model / error of the best without, 0..1."""
    severity_by_range: str | None
    """Class of the size in % of travel; None without op_range."""
    oscillating: bool
    """Whether OP and PV oscillate regularly together."""
    period_s: float | None
    """Period of the oscillation, s."""
    process: Process | None
    """Process behind the valve."""
    valve_model: str | None
    """`he` or `tracking`."""
    s0: float | None
    """Span of OP, the upper limit of fs + fd."""
    gates: tuple[str, ...]
    """Validity checks that limit the answer or prevent it."""
    reason: str | None
    """Why there is no answer, or no size."""
    words: str
    """The verdict in a sentence."""
    sureness: str
    """The confidence in a sentence."""
    size: str | None
    """The size in a sentence."""
    reasons: tuple[tuple[str, float], ...]
    """The evidence as facts, strongest first, each with its log-odds: above 0 it points to sticking."""
    unknowns: tuple[str, ...]
    """What the record does not determine."""
    proposal: str | None
    """The bump test that would settle it, a numbered step a line, or why none is proposed and what to do instead."""
    notes: tuple[str, ...]
    """Treatment of the rows: skipped, sorted."""
    _document: str = field(repr=False)
    _text: str = field(repr=False)
    _record: Record | None = field(repr=False, compare=False, default=None)

    ok = True
    """An assessment, not a `Failure`."""

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_record": None}

    def to_dict(self) -> dict[str, Any]:
        """The document as `stictiond analyze --format json` writes it, schema `stictiond.estimate.v1`."""
        found: dict[str, Any] = json.loads(self._document)
        return found

    def to_json(self) -> str:
        """The document as text."""
        return self._document

    def to_frame(self) -> DataFrame:
        """One row for pandas, with the columns of `as_columns`."""
        return Results([self]).to_frame()

    def plot(
        self, record: Any = None, *, free_run: bool = True, periods: float | None = 8.0, figure: Figure | None = None
    ) -> Figure:
        """Draw OP and PV over time with the model's free run, PV over OP, and the indicators; needs `stiction[plot]`.

        record: a table with the loop's rows, for results without a record (see `assess`). free_run: also run the fitted
        model. periods: show this many periods, the last ones of an oscillating loop; None for the whole record.
        figure: draw into this figure instead of a new one.
        """
        drawn: Figure = drawing().assessment(self, record, free_run, periods, figure)
        return drawn

    def plot_trend(
        self, record: Any = None, *, free_run: bool = True, periods: float | None = 8.0, ax: Axes | None = None
    ) -> Axes:
        """Draw PV over time, with SP and the model's free run; arguments as for `plot`."""
        drawn: Axes = drawing().trend_of(self, record, free_run, periods, ax)
        return drawn

    def plot_phase(self, record: Any = None, *, ax: Axes | None = None) -> Axes:
        """Draw PV over OP, and s as a length; arguments as for `plot`."""
        drawn: Axes = drawing().phase_of(self, record, ax)
        return drawn

    def plot_error_map(
        self, record: Any = None, *, order: Literal[1, 2] | None = None, step: float = 0.025, ax: Axes | None = None
    ) -> Axes:
        """Draw the free-run error over the bands fs and fd, each cell with its best process; takes some seconds.

        record: as for `plot`. order: of the process; None for that of the estimate. step: of a cell, a share of OP's span.
        """
        drawn: Axes = drawing().error_map(self, record, order, step, ax)
        return drawn

    def plot_indicators(self, *, ax: Axes | None = None) -> Axes:
        """Draw what each indicator adds to the log-odds of the probability."""
        drawn: Axes = drawing().indicators(self, ax)
        return drawn

    def _repr_html_(self) -> str:
        process = None if self.process is None or not self.process.tested else (
            f"order {self.process.order}, gain {_show.number(self.process.gain)}, time constants "
            f"{', '.join(_show.number(lag) for lag in self.process.time_constants_s) or 'none'} s, "
            f"dead time {_show.number(self.process.dead_time_s)} s"
        )
        return _show.card(self.loop, self.words, [
            ("window, UTC", " to ".join(_show.moment(end) for end in self.window)),
            ("probability of stiction", None if self.p_stiction is None else self._sure()),
            ("s, OP units", _show.estimate(self.s, self.s_interval) if self.stiction and self.s else None),
            ("j, OP units", _show.estimate(self.j, self.j_interval) if self.stiction and self.j is not None else None),
            ("detection limit", None if self.s_detectable is None else _show.number(self.s_detectable)),
            ("period", None if self.period_s is None else f"{_show.number(self.period_s)} s"),
            ("process", process),
            ("limits", ", ".join(self.gates)),
            ("reason", self.reason),
        ])  # fmt: skip

    def _sure(self) -> str:
        return f"{self.p_stiction:.2f} if {self.prevalence:.0%} of such loops stick, grade {self.grade or '-'}"

    def __str__(self) -> str:
        return self._text


def assessment_of(document: str, said: str, record: Record | None = None) -> Assessment:
    """Converts the answer of the native module."""
    d, words = json.loads(document), json.loads(said)
    process = d["process"]
    if process is not None:
        process = Process(**{
            **process,
            "time_constants_s": tuple(process["time_constants_s"]),
            **{name: _interval(process[name]) for name in ("gain_interval", "dead_time_interval_s")},
        })  # fmt: skip
    plain = ("verdict", "stiction", "p_stiction", "p_calibrated", "prevalence", "confidence", "grade", "s", "j", "fs", "fd")
    more = ("s_detectable", "stiction_index", "severity_by_range", "valve_model", "reason")
    intervals = ("s_interval", "j_interval", "fs_interval", "fd_interval")
    same: dict[str, Any] = {name: d[name] for name in plain + more}
    same.update({name: _interval(d[name]) for name in intervals})
    return Assessment(
        loop=d["loop"],
        window=(time_of(d["window"]["start_ns"]), time_of(d["window"]["end_ns"])),
        **same,
        s0=words["s0"],
        oscillating=d["oscillation"]["oscillating"],
        period_s=d["oscillation"]["period_s"],
        process=process,
        gates=tuple(d["gates"]),
        words=words["words"],
        sureness=words["sureness"],
        size=words["size"],
        reasons=tuple((text, logit) for text, logit in words["reasons"]),
        unknowns=tuple(words["unknowns"]),
        proposal=words["proposal"],
        notes=tuple(words["notes"]),
        _document=document,
        _text=words["text"],
        _record=record,
    )


@dataclass(frozen=True)
class Failure:
    """A loop of many that could not be assessed."""

    loop: str
    """The loop's name."""
    error: str
    """Why, and the remedy."""

    ok = False
    """Not an assessment."""

    def to_dict(self) -> dict[str, str]:
        """Loop and error."""
        return {"loop": self.loop, "error": self.error}


def as_columns(results: Iterable[Assessment | Failure]) -> dict[str, list[Any]]:
    """Results as columns, one row per loop: `pandas.DataFrame(as_columns(results))`.

    >>> as_columns([Failure("FIC1", "3 usable samples")])["error"]
    ['3 usable samples']
    """
    names = (
        "loop", "verdict", "stiction", "p_stiction", "p_calibrated", "prevalence", "confidence", "grade", "s", "j", "fs", "fd",
        "s_detectable", "stiction_index", "severity_by_range", "oscillating", "period_s", "valve_model", "reason", "words", "error",
    )  # fmt: skip
    rows = list(results)
    columns: dict[str, list[Any]] = {name: [getattr(row, name, None) for row in rows] for name in names}
    for end, name in ((0, "start"), (1, "end")):
        columns[name] = [row.window[end] if isinstance(row, Assessment) else None for row in rows]
    for end, side in ((0, "low"), (1, "high")):
        intervals = [row.s_interval if isinstance(row, Assessment) else None for row in rows]
        columns[f"s_{side}"] = [None if pair is None else pair[end] for pair in intervals]
    return columns


_NUMBERS = (
    "p_stiction", "p_calibrated", "prevalence", "confidence", "s", "j", "fs", "fd", "s_detectable", "stiction_index",
    "period_s", "s_low", "s_high",
)  # fmt: skip
One = TypeVar("One", bound="Assessment | Failure")


class Results(list[One]):
    """A list of results; a slice is a plain list.

    >>> Results([Failure("FIC1", "3 usable samples")]).to_dict()
    [{'loop': 'FIC1', 'error': '3 usable samples'}]
    """

    def to_dict(self) -> list[dict[str, Any]]:
        """The documents; a `Failure` gives its loop and error."""
        return [one.to_dict() for one in self]

    def to_frame(self) -> DataFrame:
        """One row per result for pandas, with the columns of `as_columns`; `start` and `end` are UTC."""
        kinds = {**dict.fromkeys(_NUMBERS, "float64"), "stiction": "boolean", "oscillating": "boolean"}
        stamps = dict.fromkeys(("start", "end"), "datetime64[ns]")
        return _show.frame(as_columns(self), {**kinds, **stamps})

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw s of every loop with its interval, or where there is none, that no sign or no answer was found."""
        drawn: Axes = drawing().sizes(self, ax)
        return drawn

    def _repr_html_(self) -> str:
        def cells(one: Assessment | Failure) -> list[str]:
            if isinstance(one, Failure):
                return [one.loop, "", "", "", "", one.error]
            p = "-" if one.p_stiction is None else f"{one.p_stiction:.2f}"
            size = _show.estimate(one.s, one.s_interval) if one.stiction else "-"
            return [one.loop, _show.moment(one.window[1]), p, one.grade or "-", size, one.words]

        heads = ("loop", "end, UTC", "p of stiction", "grade", "s, OP units", "verdict")
        return _show.grid(f"{len(self)} results", "", heads, [cells(one) for one in self])


@dataclass(frozen=True)
class Effect:
    """An effect added to the loop's model."""

    id: str
    """Its name, one of the table in `docs/gap.md`."""
    gap_before: float
    """Gap without it, PV units (rms)."""
    gap_after: float
    """Gap with it."""
    closed_pct: float | None
    """Share of the gap that it closes, %."""
    closed_interval: Interval | None
    """90 % interval of that share."""


@dataclass(frozen=True, eq=False)
class Predictions:
    """Measured and simulated PV, row by row; NaN where a free run is not valid."""

    t: NDArray[np.datetime64]
    """Times, UTC."""
    pv: NDArray[np.float64]
    """PV as measured."""
    base: NDArray[np.float64]
    """Free run of the base."""
    after: NDArray[np.float64]
    """Free run of the base with the cause."""
    held_out: NDArray[np.bool_]
    """True for rows that no model was fitted to."""

    def to_dict(self) -> dict[str, NDArray[Any]]:
        """The columns by name."""
        return {name: getattr(self, name) for name in ("t", "pv", "base", "after", "held_out")}

    def to_frame(self) -> DataFrame:
        """A row per sample for pandas, by time (UTC)."""
        return _show.frame(self.to_dict(), {}, "t")


@dataclass(frozen=True, eq=False)
class Gap:
    """What a loop's model does not explain, and its cause.

    `docs/gap.md` defines every number. `str()` gives the text of the command line, `to_dict()` the document.
    """

    loop: str
    """The loop's name."""
    cause: str
    """The effect that causes the gap, `none` or `unknown`."""
    probability: float
    """Probability of the cause, 0..1."""
    confirmed: bool
    """Whether held-out data confirm it."""
    rmse: float
    """Gap of the base, PV units (rms of the free run on held-out data)."""
    noise_floor: float
    """The gap that noise alone would leave, PV units."""
    effects: tuple[Effect, ...]
    """All effects tried, best first."""
    alternatives: tuple[tuple[str, float], ...]
    """Other causes with their probabilities."""
    second_cause: tuple[str, float] | None
    """A second cause with its probability, if one of the two is an artefact of the historian."""
    next_test: dict[str, Any] | None
    """The experiment that distinguishes the likeliest causes."""
    stopped_early: bool
    """Whether the search ran out of time."""
    words: str
    """The answer in a few words."""
    paragraph: str
    """The answer in a paragraph."""
    notes: tuple[str, ...]
    """Treatment of the rows."""
    predictions: Predictions
    """Measured and simulated PV."""
    _document: str = field(repr=False)
    _text: str = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """The document as `stictiond gap --format json` writes it, schema `stictiond.gap.v1`."""
        found: dict[str, Any] = json.loads(self._document)
        return found

    def to_json(self) -> str:
        """The document as text."""
        return self._document

    def to_frame(self) -> DataFrame:
        """A row per effect tried for pandas, best first; `predictions.to_frame()` has the samples."""
        names = ("id", "gap_before", "gap_after", "closed_pct")
        columns: dict[str, Any] = {name: [getattr(effect, name) for effect in self.effects] for name in names}
        for end, side in ((0, "low"), (1, "high")):
            columns[f"closed_{side}"] = [e.closed_interval[end] if e.closed_interval else None for e in self.effects]
        return _show.frame(columns, dict.fromkeys([name for name in columns if name != "id"], "float64"), "id")

    def plot(self, *, figure: Figure | None = None) -> Figure:
        """Draw PV with the free run before and after the cause is added, both errors, and what each effect closes.

        Needs `stiction[plot]`. figure: draw into this figure instead of a new one.
        """
        drawn: Figure = drawing().gap(self, figure)
        return drawn

    def _repr_html_(self) -> str:
        best = self.effects[0] if self.effects else None
        closed = "" if best is None else f"{best.id}: {_show.estimate(best.closed_pct, best.closed_interval, '%')}"
        return _show.card(self.loop, self.words, [
            ("cause", f"{self.cause}, probability {self.probability:.2f}"),
            ("confirmed on held-out data", "yes" if self.confirmed else "no"),
            ("gap, PV units", f"{_show.number(self.rmse)}, of which noise {_show.number(self.noise_floor)}"),
            ("best effect closes", closed),
            ("other causes", ", ".join(f"{name} {p:.2f}" for name, p in self.alternatives)),
        ])  # fmt: skip

    def __str__(self) -> str:
        return self._text


def gap_of(document: str, said: str, columns: list[bytes]) -> Gap:
    """Converts the answer of the native module."""
    d, words = json.loads(document), json.loads(said)
    t = times_of(columns[0])
    pv, base, after, held_out = (doubles_of(column) for column in columns[1:])

    def effect(e: dict[str, Any]) -> Effect:
        interval = _interval(e["closed_interval"])
        return Effect(e["id"], e["gap_before"], e["gap_after"], e["closed_pct"], interval)

    return Gap(
        loop=d["loop"],
        cause=d["cause"]["id"],
        probability=d["cause"]["probability"],
        confirmed=d["cause"]["confirmed"],
        rmse=d["gap"]["rmse"],
        noise_floor=d["gap"]["noise_floor"],
        effects=tuple(effect(e) for e in d["effects"]),
        alternatives=tuple((a["id"], a["probability"]) for a in d["alternatives"]),
        second_cause=(d["second_cause"]["id"], d["second_cause"]["probability"]) if d["second_cause"] else None,
        next_test=d["next_test"],
        stopped_early=d["stopped_early"],
        words=words["words"],
        paragraph=words["paragraph"],
        notes=tuple(words["notes"]),
        predictions=Predictions(t, pv, base, after, held_out > 0),
        _document=document,
        _text=words["text"],
    )


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated loop: arrays of one length."""

    loop: str
    """Its name."""
    truth: str
    """The simulated truth in words."""
    ts_s: float
    """Time between samples, s."""
    t: NDArray[np.datetime64]
    """Times, UTC."""
    op: NDArray[np.float64]
    """Controller output, %."""
    pv: NDArray[np.float64]
    """Process variable."""
    sp: NDArray[np.float64]
    """Set point, PV units."""
    mv: NDArray[np.float64]
    """Valve position, %."""

    def to_dict(self) -> dict[str, NDArray[Any]]:
        """The columns by name."""
        return {name: getattr(self, name) for name in ("t", "op", "pv", "sp", "mv")}

    def to_frame(self) -> DataFrame:
        """A row per sample for pandas, by time (UTC); `assess` reads it."""
        return _show.frame(self.to_dict(), {}, "t")

    def plot(self, *, figure: Figure | None = None) -> Figure:
        """Draw OP, PV, SP and valve position over time, and PV over OP; needs `stiction[plot]`."""
        drawn: Figure = drawing().simulation(self, figure)
        return drawn


def doubles_of(column: bytes) -> NDArray[np.float64]:
    """A column from the native module."""
    return np.frombuffer(column, dtype="<f8").astype(np.float64)


def times_of(column: bytes) -> NDArray[np.datetime64]:
    """A column of timestamps from the native module."""
    return np.frombuffer(column, dtype="<i8").astype(np.int64).view("datetime64[ns]")


def time_of(stamp_ns: int) -> np.datetime64:
    """A timestamp from the native module."""
    return np.datetime64(stamp_ns, "ns")
