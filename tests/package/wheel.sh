#!/usr/bin/env bash
# The wheel and the tarball of target/debug/stictiond, or of STICTIOND_BIN: the wheel installed into a clean virtual environment
# and removed again, the tarball unpacked; the programs run from there.
# Usage: tests/package/wheel.sh
set -euo pipefail
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-target}
started=$SECONDS
binary=${STICTIOND_BIN:-$target/debug/stictiond}
[ -x "$binary" ] && [ -x "$(dirname "$binary")/stictiond-bridge" ] || cargo build --locked --quiet --features full
mkdir -p "$target/package"
work=$(mktemp -d "$target/package/wheel.XXXXXX")
trap 'rm -rf "$work"' EXIT

fail() {
    printf 'wheel test: %s\n' "$*" >&2
    exit 1
}
# What a user does first, with nothing but the folder of the programs.
tried() {
    local programs=$1
    "$programs/stictiond" demo --help | grep -q -- --no-open || fail "$programs: demo --help"
    "$programs/stictiond" analyze recordings/sticking.mcap --op-range 0,100 | grep -q 'the valve sticks' || fail "$programs: analyze"
    "$programs/stictiond-bridge" mqtt --help | grep -q -- --topic || fail "$programs: bridge"
}

strip -o "$work/stictiond" "$binary"
strip -o "$work/stictiond-bridge" "$(dirname "$binary")/stictiond-bridge"
tarball=$(packaging/static.sh --binary "$work/stictiond" --out "$work")
cmp "$tarball" "$(packaging/static.sh --binary "$work/stictiond" --out "$work/again")" || fail "the same tarball twice differs"
mkdir "$work/unpacked"
tar -C "$work/unpacked" -xzf "$tarball"
tried "$(echo "$work"/unpacked/*)/bin"

wheel=$(packaging/wheel.sh --binary "$work/stictiond" --out "$work")
cmp "$wheel" "$(packaging/wheel.sh --binary "$work/stictiond" --out "$work/again")" || fail "the same wheel twice differs"
pip=(-m pip --quiet --disable-pip-version-check)
if python3 -m venv "$work/venv" 2>/dev/null; then
    python=$work/venv/bin/python
    before=$(find "$work/venv" -type f ! -name '*.pyc' | sort)
    "$python" "${pip[@]}" install --no-index "$wheel"
    tried "$work/venv/bin"
    "$python" "${pip[@]}" check
    "$python" "${pip[@]}" uninstall --yes stictiond
    [ "$before" = "$(find "$work/venv" -type f ! -name '*.pyc' | sort)" ] || fail "files are left in the environment"
else
    # Without venv, pip can do with a folder of its own.
    python3 "${pip[@]}" install --no-index --target "$work/venv" "$wheel"
    tried "$work/venv/bin"
fi
printf 'wheel and tarball passed (%d s)\n' "$((SECONDS - started))"
