"""Native functions; use the package `stiction`."""

from collections.abc import Callable
from typing import Any

__version__: str

class StictionError(ValueError):
    """The input cannot be used; the message states the remedy."""

def assess(
    name: str,
    columns: dict[str, Any],
    look: dict[str, Any],
    fit: dict[str, Any],
    score: str | None,
) -> tuple[str, str]: ...
def assess_many(asked: dict[str, Any]) -> list[tuple[tuple[str, str] | None, str | None]]: ...
def assess_plant(asked: dict[str, Any]) -> tuple[list[tuple[tuple[str, str] | None, str | None]], list[str]]: ...
def screen(name: str, columns: dict[str, Any], look: dict[str, Any]) -> bool: ...
def diagnose(
    name: str,
    columns: dict[str, Any],
    look: dict[str, Any],
    asked: dict[str, Any],
    progress: Callable[[int, int], object] | None,
) -> tuple[str, str, list[bytes]]: ...
def error_map(
    name: str, columns: dict[str, Any], look: dict[str, Any], document: str, order: int, step: float
) -> str: ...
def read(
    paths: list[str], format: dict[str, str | None]
) -> tuple[list[tuple[str, bytes, list[bytes], list[str | None]]], list[str]]: ...
def simulate(scenario: str, json: bool) -> list[tuple[str, str, float, list[bytes]]]: ...
def assess_windows(
    name: str,
    columns: dict[str, Any],
    watched: dict[str, Any],
    progress: Callable[[int, int], object] | None,
) -> list[tuple[str, str]]: ...
def over_time(windows: str) -> str: ...
def repair(name: str, columns: dict[str, Any], look: dict[str, Any], fit: dict[str, Any]) -> str: ...
