"""Says of each promise of docs/robustness.md how its tests ended: promises.py LOG, with the output of the test binaries."""

import re
import sys
from pathlib import Path

PAGE = Path(__file__).parent.parent / "docs" / "robustness.md"
RESULT = re.compile(r"^test (?:\S+::)?(\w+)(?: - should panic)? \.\.\. (ok|FAILED|ignored)")


def promises(page: str) -> list[tuple[str, list[str]]]:
    """Each promise with the names of its tests."""
    rows = [line.strip("|").split(" | ") for line in page.splitlines() if line.startswith("| ")]
    named = [(row[0].strip(), re.findall(r"\.rs::(\w+)", row[1])) for row in rows if len(row) == 3]
    return [(promise, tests) for promise, tests in named if tests]


def main() -> None:
    lines = Path(sys.argv[1]).read_text(errors="replace").splitlines()
    results = dict(match.groups() for line in lines if (match := RESULT.match(line)))
    told = promises(PAGE.read_text())
    kept = 0
    for promise, tests in told:
        ends = [results.get(test, "not run") for test in tests]
        if all(end == "ok" for end in ends):
            kept += 1
            print(f"kept     {promise}")
        else:
            named = ", ".join(f"{test} {end}" for test, end in zip(tests, ends) if end != "ok")
            print(f"{'BROKEN' if 'FAILED' in ends else 'not run':<8} {promise} ({named})")
    print(f"{kept} of {len(told)} promises tested and kept")


main()
