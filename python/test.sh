#!/usr/bin/env bash
# The Python package: built as a wheel, installed into a virtual environment of its own, and tried from there against
# target/debug/stictiond (or STICTIOND_BIN). Usage: python/test.sh [--fetch | ARGUMENTS OF PYTEST]. Python packages go below
# the target folder, once; --fetch does no more than that. What could not be had is said on lines that start with SKIPPED.
set -euo pipefail
cd "$(dirname "$0")/.."
target=${CARGO_TARGET_DIR:-target}
work=$target/wheel
mkdir -p "$work"
python=""
for candidate in "${PYTHON:-}" python3.11 python3; do
    if [ -n "$candidate" ] && command -v "$candidate" >/dev/null \
        && "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
        python=$candidate
        break
    fi
done
[ -n "$python" ] || { echo "SKIPPED: the wheel: its pinned packages need Python 3.11 or newer"; exit 0; }
# Whoever fetches in the background is waited for.
if command -v flock >/dev/null; then
    exec 9>"$work/lock"
    flock 9
fi
venv=$work/venv
packages=$work/packages
stamp=$work/$(sha256sum python/requirements.txt | cut -c 1-16)
if [ ! -e "$stamp" ]; then
    rm -rf "$venv" "$packages"
    # Debian keeps venv in a package of its own.
    if ! "$python" -c 'import ensurepip' 2>/dev/null && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        { apt-get update && apt-get install -y --no-install-recommends python3-venv; } >/dev/null || true
    fi
    quiet=(--quiet --disable-pip-version-check)
    if "$python" -m venv "$venv" 2>/dev/null; then
        "$venv/bin/python" -m pip install "${quiet[@]}" -r python/requirements.txt
    else
        # Without venv, pip can do with a folder of its own.
        rm -rf "$venv"
        "$python" -m pip install "${quiet[@]}" --target "$packages" -r python/requirements.txt
    fi || { echo "SKIPPED: the wheel: its Python packages could not be had"; exit 0; }
    touch "$stamp"
fi
[ "${1:-}" != --fetch ] || exit 0
if [ -x "$venv/bin/python" ]; then
    python=$venv/bin/python
    maturin=$venv/bin/maturin
else
    export PYTHONPATH=$PWD/$packages
    maturin=$packages/bin/maturin
fi

# The profile that the workspace's tests have built most of already.
rm -rf "$work/dist"
"$maturin" build --quiet --locked --profile dev --features beside-programs --manifest-path python/Cargo.toml --out "$work/dist" \
    --target-dir "$target" --compatibility linux
wheel=$(ls "$work"/dist/*.whl)
if [ -x "$venv/bin/python" ]; then
    "$python" -m pip install --quiet --disable-pip-version-check --no-deps --no-index --force-reinstall "$wheel"
else
    rm -rf "$packages"/stiction "$packages"/stiction-*
    "$python" -m pip install --quiet --disable-pip-version-check --no-deps --no-index --target "$packages" "$wheel"
fi
command=${STICTIOND_BIN:-$target/debug/stictiond}
if [ ! -x "$command" ]; then
    echo "SKIPPED: the wheel against the command line: there is no $command"
fi
"$python" -c 'import mypy' 2>/dev/null || echo "SKIPPED: the wheel's types: mypy is not installed"
export STICTIOND_BIN=$command
exec "$python" -m pytest --quiet -p no:cacheprovider python/tests "$@"
