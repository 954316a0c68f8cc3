"""The shipped Grafana board, checked with Grafana's schema from its foundation SDK."""

import enum
import json
import types
import typing

from daemon import ROOT

BOARD = ROOT / "config" / "grafana.json"


def leaves(given, read, where="board"):
    """Places where reading changed the input, as they are not in the schema."""
    if isinstance(given, dict) and isinstance(read, dict):
        for name, value in given.items():
            if name in read:
                yield from leaves(value, read[name], f"{where}.{name}")
            else:
                yield f"{where}.{name}"
    elif isinstance(given, list) and isinstance(read, list) and len(given) == len(read):
        for at, pair in enumerate(zip(given, read)):
            yield from leaves(*pair, f"{where}[{at}]")
    elif given != read:
        yield where


def fits(value, hint):
    """Whether a value is of a type of the schema. The SDK does not convert words of enumerations and some objects."""
    if hint is typing.Any or isinstance(hint, typing.TypeVar):
        return True
    kind, parts = typing.get_origin(hint), typing.get_args(hint)
    if kind in (typing.Union, types.UnionType):
        return any(fits(value, one) for one in parts)
    if kind is typing.Literal:
        return value in parts
    if kind is list:
        return isinstance(value, list) and all(fits(one, parts[0]) for one in value)
    if kind is dict:
        return isinstance(value, dict) and all(fits(one, parts[1]) for one in value.values())
    if issubclass(hint, enum.Enum):
        return value in list(hint) or value in [one.value for one in hint]
    if isinstance(value, dict) and hasattr(hint, "from_json"):
        return not list(misfits(hint.from_json(value)))
    return isinstance(value, (int, float) if hint is float else hint) and not (isinstance(value, bool) and hint is not bool)


def misfits(thing, where="board"):
    """Attributes whose value is not of the schema's type."""
    if isinstance(thing, list):
        for at, one in enumerate(thing):
            yield from misfits(one, f"{where}[{at}]")
    elif type(thing).__module__.startswith("grafana_foundation_sdk.models") and not isinstance(thing, enum.Enum):
        hints = typing.get_type_hints(type(thing))
        for name, value in vars(thing).items():
            if not fits(value, hints[name]):
                yield f"{where}.{name}: {value!r} is not {hints[name]}"
            yield from misfits(value, f"{where}.{name}")


def faults(board):
    """Parts that Grafana's schema does not allow or does not contain."""
    from grafana_foundation_sdk.cog.encoder import JSONEncoder
    from grafana_foundation_sdk.models.dashboard import Dashboard

    read = Dashboard.from_json(board)
    return [*leaves(board, json.loads(JSONEncoder().encode(read))), *misfits(read)]


def test_the_board_fits_grafanas_schema(_):
    try:
        from grafana_foundation_sdk.cog.plugins import register_default_plugins
    except ImportError:
        print("\nSKIPPED: grafana-foundation-sdk cannot be had: the board was not checked by Grafana's schema\n", flush=True)
        return
    register_default_plugins()
    assert not faults(json.loads(BOARD.read_text())), faults(json.loads(BOARD.read_text()))

    def broken(change):
        board = json.loads(BOARD.read_text())
        change(board)
        return faults(board)

    series = next(at for at, panel in enumerate(json.loads(BOARD.read_text())["panels"]) if panel["type"] == "timeseries")
    # A field unknown to Grafana, a word instead of a number, a word from a different enumeration.
    assert broken(lambda board: board["panels"][series].update(legnd={})) == [f"board.panels[{series}].legnd"]
    assert broken(lambda board: board["panels"][0]["gridPos"].update(h="four"))
    assert broken(lambda board: board["templating"]["list"][0].update(type="anything"))
