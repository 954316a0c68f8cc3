#!/usr/bin/env bash
# The program seen from outside: Python's Zenoh and MCAP libraries against target/debug/stictiond.
# Usage: tests/interop/run.sh [--fetch | NAME OF A TEST]. Python packages and tools go below the target folder, once;
# --fetch does no more than that.
set -euo pipefail
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-target}
python=""
for candidate in "${PYTHON:-}" python3.11 python3; do
    if [ -n "$candidate" ] && command -v "$candidate" >/dev/null \
        && "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
        python=$candidate
        break
    fi
done
[ -n "$python" ] || { echo "Python 3.11 or newer is needed" >&2; exit 1; }
venv=$target/interop/venv
stamp=$venv/$(sha256sum tests/interop/requirements.txt | cut -c 1-16)
if [ ! -e "$stamp" ]; then
    rm -rf "$venv"
    # Debian keeps venv in a package of its own.
    if ! "$python" -c 'import ensurepip' 2>/dev/null && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        { apt-get update && apt-get install -y --no-install-recommends python3-venv; } >/dev/null || true
    fi
    if ! "$python" -m venv "$venv" 2>/dev/null; then
        # Without venv, pip can do with a folder of its own.
        rm -rf "$venv"
        mkdir -p "$venv"
        "$python" -m pip install --quiet --disable-pip-version-check --target "$venv/packages" \
            -r tests/interop/requirements.txt
    else
        "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r tests/interop/requirements.txt
    fi
    touch "$stamp"
fi
if [ -x "$venv/bin/python" ]; then
    python=$venv/bin/python
else
    export PYTHONPATH=$venv/packages
fi
[ "${1:-}" != --fetch ] || exec "$python" tests/interop/receivers.py
[ -x "$target/debug/stictiond" ] || cargo build --locked --quiet --features full
exec "$python" tests/interop/test_interop.py "$@"
