#!/usr/bin/env bash
# The Python package: built as a wheel, installed into the tests' virtual environment, and tried from there against
# target/debug/stictiond (or STICTIOND_BIN). Usage: python/test.sh [ARGUMENTS OF PYTEST].
set -euo pipefail
cd "$(dirname "$0")/.."
what="the Python package"
source tests/tools.sh
use_python

# The profile that the workspace's tests have built most of already.
wheels=$target/wheels
rm -rf "$wheels"
"$bin/maturin" build --quiet --locked --profile dev --features beside-programs --manifest-path python/Cargo.toml --out "$wheels" \
    --target-dir "$target" --compatibility linux
place=()
if [ -n "${PYTHONPATH:-}" ]; then
    place=(--target "$target/python" --upgrade)
fi
"$python" -m pip install --quiet --disable-pip-version-check --no-deps --no-index --force-reinstall "${place[@]}" "$wheels"/*.whl
export STICTIOND_BIN=${STICTIOND_BIN:-$target/debug/stictiond}
[ -x "$STICTIOND_BIN" ] || echo "SKIPPED: the wheel against the command line: there is no $STICTIOND_BIN"
exec "$python" -m pytest --quiet -p no:cacheprovider python/tests "$@"
