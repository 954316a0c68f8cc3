"""Simulated loops of a scenario."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from . import _arrays, _stiction
from ._results import Simulation, doubles_of, times_of


def simulate_plant(scenario: str | Mapping[str, Any]) -> dict[str, Simulation]:
    """Simulate every loop of a scenario, by name; see `simulate`."""
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
    """Simulate one loop of a plant: valve with friction, process, controller, noise, disturbances.

    scenario: text of a scenario file (not its path; see `recordings/scenarios`), or the same as a dict.
    loop: name of the loop, if the scenario has several. Values are rounded as in the scenario's recording; no sample is
    lost or late. The same scenario gives the same numbers.
    """
    loops = simulate_plant(scenario)
    if loop is None and len(loops) == 1:
        return next(iter(loops.values()))
    if loop not in loops:
        raise _arrays.refused("loop", f"{loop!r} is not in the scenario; give one of {', '.join(loops)}")
    return loops[loop]
