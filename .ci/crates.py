"""Licences, banned crates and sources of everything in Cargo.lock, by the lists of .ci/deny.toml.

Needs Python 3.11 and cargo alone. Says each crate that breaks a rule, and exits with 1.
"""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

RULES = tomllib.loads((Path(__file__).parent / "deny.toml").read_text())
ALLOWED = set(RULES["licenses"]["allow"])
BANNED = {ban["name"] for ban in RULES["bans"]["deny"]}


def allowed(expression):
    """Whether an SPDX expression can be met by allowed licences: AND binds before OR, older crates write / for OR."""
    tokens = re.findall(r"[()]|[^\s()]+", expression.replace("/", " OR "))
    at = 0

    def take():
        nonlocal at
        at += 1
        return tokens[at - 1] if at <= len(tokens) else None

    def peek():
        return tokens[at] if at < len(tokens) else None

    def one():
        if (token := take()) == "(":
            met = either()
            if take() != ")":
                raise ValueError(expression)
            return met
        if token in (None, ")", "AND", "OR", "WITH"):
            raise ValueError(expression)
        if peek() == "WITH":
            take()
            token = f"{token} WITH {take()}"
        return token in ALLOWED

    def both():
        met = one()
        while peek() == "AND":
            take()
            met = one() and met
        return met

    def either():
        met = both()
        while peek() == "OR":
            take()
            met = both() or met
        return met

    met = either()
    if peek() is not None:
        raise ValueError(expression)
    return met


def faults(packages):
    registries = {p["source"] for p in packages if (p["source"] or "").startswith("registry+")}
    if len(registries) > 1:
        yield f"crates come from {len(registries)} registries: {', '.join(sorted(registries))}"
    for package in packages:
        name = f"{package['name']} {package['version']}"
        if package["name"] in BANNED:
            yield f"{name}: banned by .ci/deny.toml"
        if package["source"] is not None and not package["source"].startswith("registry+"):
            yield f"{name}: comes from {package['source']}, not from a registry"
        try:
            if not allowed(package["license"] or ""):
                yield f"{name}: {package['license']} is not among the licences of .ci/deny.toml"
        except ValueError:
            yield f"{name}: its licence {package['license']!r} is no SPDX expression"
        for dependency in package["dependencies"] if package["source"] is None else []:
            if dependency["req"] == "*" and dependency.get("path") is None:
                yield f"{name}: any version of {dependency['name']} will do, say which"


for text, met in [("MIT", True), ("GPL-3.0 OR MIT", True), ("GPL-3.0 AND MIT", False), ("(MIT OR X) AND X", False),
                  ("MIT/X", True), ("Apache-2.0 WITH LLVM-exception", True), ("X OR MIT AND X", False)]:
    assert allowed(text) is met, text

command = ["cargo", "metadata", "--locked", "--format-version", "1", "--all-features"]
packages = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)["packages"]
found = list(faults(packages))
print("\n".join(found) or f"{len(packages)} crates: licences, bans and sources are as .ci/deny.toml says")
sys.exit(bool(found))
