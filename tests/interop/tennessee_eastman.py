"""The Tennessee Eastman plant with an added sticking valve, judged by `stictiond analyze --plant`.

The plant and its controllers are those of the PyPI package tep-studio: Downs and Vogel's process as revised by
Bathelt, Ricker and Jelali, under Ricker's decentralized control (J. Proc. Cont. 6, 1996). In half of the plants one of
nine valves follows He's law; the others have a calm day, a random disturbance, a production target that moves in a
wave, or a reactor temperature controller that is tuned too tightly.

    python3 -m venv target/plants
    target/plants/bin/pip install tep-studio==0.2.0
    target/plants/bin/python tests/interop/tennessee_eastman.py target/release/stictiond --cases 40 --seed 300
"""

import argparse
import dataclasses
import json
import math
import random
import subprocess
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tep_studio import TEP_SCHEMA, RickerMultiLoopController, TennesseeEastmanProcess
from tep_studio.control import RICKER_MODE1
from tep_studio.control.tuning import apply_tuning

HOURS = 12.0
STEP_HOURS = 0.0005
# Time for the plant to settle; nothing is recorded until then.
SETTLED_HOURS = 1.0
# Fewest reversals of a stem in the record for its limit cycle to show, as in the daemon's windows.
SHOWN_REVERSALS = 16
# Random disturbances (IDV) whose plant stays within its limits for the day.
RANDOM_DISTURBANCES = [8, 9, 10, 11, 12, 16, 17, 18]

FLOWS = {loop.mv.removesuffix("_valve"): loop for loop in RICKER_MODE1.feed_loops}
TEMPERATURES = {
    "reactor_temperature": RICKER_MODE1.reactor_temperature,
    "separator_temperature": RICKER_MODE1.separator_temperature,
}
# Outer loops of cascades: their output is the set point of a loop listed above, so they have no valve.
OUTER = {
    "reactor_level": RICKER_MODE1.reactor_level,
    "separator_level": RICKER_MODE1.separator_level,
    "stripper_level": RICKER_MODE1.stripper_level,
    "reactor_pressure": RICKER_MODE1.reactor_pressure,
}


class Valve:
    """He's law: the stem rests until OP is farther than fs away, and then moves to within fd of it."""

    def __init__(self, fs, fd):
        self.fs, self.fd, self.stem = fs, fd, None
        self.direction, self.reversals = 0, 0

    def follow(self, op):
        if self.stem is None:
            self.stem = op
        push = op - self.stem
        if abs(push) > self.fs:
            direction = math.copysign(1, push)
            self.reversals += direction == -self.direction
            self.direction = direction
            self.stem = op - direction * self.fd
        return self.stem


@dataclasses.dataclass
class Case:
    """The case drawn from a seed."""

    seed: int
    # The loop with the sticking valve, and its bands in per cent of the stroke.
    sticking: str | None = None
    s: float = 0.0
    j: float = 0.0
    disturbance: int | None = None
    wave_hours: float | None = None
    tightly: float | None = None

    @staticmethod
    def draw(seed):
        rng = random.Random(seed)
        case = Case(seed)
        kind = rng.choice(["calm", "disturbance", "wave", "tight"])
        if rng.random() < 0.5:
            case.sticking = rng.choice(sorted([*FLOWS, *TEMPERATURES]))
            case.s = 0.5 * 10.0 ** rng.uniform(0.0, 1.0)
            case.j = case.s * rng.uniform(0.0, 0.9)
        elif kind == "disturbance":
            case.disturbance = rng.choice(RANDOM_DISTURBANCES)
        elif kind == "wave":
            case.wave_hours = rng.uniform(0.5, 2.0)
        elif kind == "tight":
            case.tightly = rng.uniform(2.0, 5.0)
        return case

    def text(self):
        if self.sticking:
            return f"{self.sticking} sticks, s {self.s:.2f}, j {self.j:.2f}"
        if self.disturbance:
            return f"IDV({self.disturbance})"
        if self.wave_hours:
            return f"production wave of {self.wave_hours:.2f} h"
        return f"reactor temperature {self.tightly:.1f} times as tight" if self.tightly else "calm"


def simulate(case):
    """Each loop's rows (OP, PV, SP), and the reversals of the sticking stem; None if the plant shuts down."""
    registry = RICKER_MODE1
    if case.tightly:
        registry = apply_tuning(registry, {"reactor_temperature.kc": case.tightly * registry.reactor_temperature.kc})
    plant, controller = TennesseeEastmanProcess(), RickerMultiLoopController(registry=registry)
    measured, _ = plant.reset(seed=1.0 + case.seed)
    controller.reset(measured, time=plant.time)
    target = controller.setpoints
    disturbances = [float(number + 1 == case.disturbance) for number in range(28)]
    measurement = {name: TEP_SCHEMA.index("measurements", name) for name in TEP_SCHEMA.names("measurements")}
    output = {
        name: TEP_SCHEMA.index("manipulated_variables", loop.mv if name in FLOWS else loop.drives)
        for name, loop in {**FLOWS, **TEMPERATURES}.items()
    }
    valve = Valve(0.5 * (case.s + case.j), 0.5 * (case.s - case.j))
    rows = {name: [] for name in [*FLOWS, *TEMPERATURES, *OUTER]}
    while plant.time < SETTLED_HOURS + HOURS:
        if case.wave_hours:
            wave = 1.0 + 0.05 * math.sin(2.0 * math.pi * plant.time / case.wave_hours)
            controller.setpoints = dataclasses.replace(target, production_rate=wave * target.production_rate)
        action, seen = controller.compute_action(measured, time=plant.time)
        if plant.time >= SETTLED_HOURS:
            for name, loop in FLOWS.items():
                sp = seen.ratios[loop.ratio_key] * seen.fp
                rows[name].append((action[output[name]], measured[measurement[loop.pv]], sp))
            for name, loop in TEMPERATURES.items():
                rows[name].append((action[output[name]], measured[measurement[loop.pv]], seen.setpoints[name]))
            for name, loop in OUTER.items():
                ratio = seen.ratios.get(loop.drives)
                op = seen.setpoints["separator_temperature"] if ratio is None else 100.0 * ratio
                rows[name].append((op, measured[measurement[loop.pv]], seen.setpoints[name]))
        else:
            valve.reversals = 0
        if case.sticking:
            at = output[case.sticking]
            action[at] = valve.follow(action[at])
        result = plant.advance(action, control_interval=STEP_HOURS, disturbances=disturbances)
        if result.shutdown_status["terminated"]:
            return None
        measured = result.measurements
    return rows, valve.reversals


def judge(program, rows, folder):
    """The program's estimates by loop, and its groups."""
    for name, samples in rows.items():
        step_s = 3600.0 * STEP_HOURS
        lines = [f"{step_s * k:.1f},{op},{pv},{sp}" for k, (op, pv, sp) in enumerate(samples)]
        (folder / f"{name}.csv").write_text("\n".join(["t,op,pv,sp", *lines]) + "\n")
    command = [program, "analyze", str(folder), "--plant", "--format", "json"]
    out = subprocess.run(command, capture_output=True, text=True)
    if out.returncode:
        raise SystemExit(f"{' '.join(command)}: {out.stderr}")
    documents = [json.loads(line) for line in out.stdout.splitlines()]
    estimates = {d["loop"]: d for d in documents if d["schema"] == "stictiond.estimate.v1"}
    return estimates, [d for d in documents if d["schema"] == "stictiond.group.v1"]


def run(seed, program, keep):
    """A seed's case as it was run, and the program's answers. If the plant shuts down, the bands are halved."""
    case, tried = Case.draw(seed), 0
    while (ran := simulate(case)) is None:
        if not case.sticking or tried == 4:
            return None
        case.s, case.j, tried = 0.5 * case.s, 0.5 * case.j, tried + 1
    rows, reversals = ran
    with tempfile.TemporaryDirectory() as own:
        folder = Path(keep) / str(seed) if keep else Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        estimates, groups = judge(program, rows, folder)
    return case, reversals, estimates, groups


class Table:
    """Fractions, one per row."""

    def __init__(self):
        self.rows = {}

    def count(self, row, right):
        hits, all_ = self.rows.get(row, (0, 0))
        self.rows[row] = (hits + bool(right), all_ + 1)

    def print(self, rows):
        for row in rows:
            hits, all_ = self.rows.get(row, (0, 0))
            share = f"{hits / all_:.3f}" if all_ else "-"
            print(f"{row:<58}{f'{hits}/{all_}':>10} {share:>6}")


def is_called(estimate, least):
    return estimate["stiction"] is True and estimate["p_calibrated"] >= least


def score(table, case, reversals, estimates, groups):
    for least in (0.5, 0.7):
        for name, estimate in estimates.items():
            kind = "healthy valve"
            if name == case.sticking:
                kind = "sticking, many reversals" if reversals >= SHOWN_REVERSALS else "sticking, few reversals"
            elif name in OUTER:
                kind = "outer loop"
            table.count(f"{kind}: called at p >= {least}", is_called(estimate, least))
    for group in groups:
        kind, named = group["source"]["kind"], group["source"]["loop"]
        if not case.sticking:
            table.count("no valve sticks: a loop named", kind == "loop")
        elif case.sticking in group["members"]:
            table.count("sticking: named as the source", named == case.sticking)
            table.count("sticking: another loop named", kind == "loop" and named != case.sticking)
        else:
            table.count("group without it: a loop named", kind == "loop")


def describe(case, reversals, estimates, groups):
    print(f"\n{case.seed}: {case.text()}" + (f", {reversals} reversals" if case.sticking else ""))
    for name, e in estimates.items():
        p = e["p_calibrated"] or 0.0
        if p >= 0.5 or name == case.sticking:
            print(f"  {name:<24} {e['verdict']:<14} p {p:.3f}")
    for group in groups:
        source = group["source"]
        named = f"{source['kind']} {source['loop'] or ''} p {source['probability']:.2f}"
        print(f"  group {' '.join(group['members'])}: {named}")


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("program", help="stictiond")
    arguments.add_argument("--cases", type=int, default=40, help="plants (40)")
    arguments.add_argument("--seed", type=int, default=1, help="seed of the first plant (1)")
    arguments.add_argument("--jobs", type=int, default=2, help="plants at a time (2)")
    arguments.add_argument("--keep", help="folder for the loops' CSV files")
    arguments.add_argument("--verbose", action="store_true", help="print every plant")
    args = arguments.parse_args()
    table, ended = Table(), 0
    seeds = range(args.seed, args.seed + args.cases)
    with ProcessPoolExecutor(args.jobs) as pool:
        for made in pool.map(run, seeds, [args.program] * args.cases, [args.keep] * args.cases):
            if made is None:
                ended += 1
                continue
            if args.verbose:
                describe(*made)
            score(table, *made)
    recorded = f"{HOURS:.0f} h every {3600 * STEP_HOURS:.1f} s"
    print(f"{args.cases} plants from seed {args.seed}, {recorded}; {ended} shut down, not scored")
    table.print(
        [
            "sticking, many reversals: called at p >= 0.5",
            "sticking, many reversals: called at p >= 0.7",
            "sticking, few reversals: called at p >= 0.5",
            "sticking, few reversals: called at p >= 0.7",
            "sticking: named as the source",
            "sticking: another loop named",
            "group without it: a loop named",
            "no valve sticks: a loop named",
            "healthy valve: called at p >= 0.5",
            "healthy valve: called at p >= 0.7",
            "outer loop: called at p >= 0.5",
            "outer loop: called at p >= 0.7",
        ]
    )


if __name__ == "__main__":
    main()
