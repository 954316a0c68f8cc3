#!/usr/bin/env bash
# The program seen from outside: Python's Zenoh and MCAP libraries against target/debug/stictiond.
# Usage: tests/interop/run.sh [--fetch | NAME OF A TEST]. --fetch only gets what is needed.
set -euo pipefail
cd "$(dirname "$0")/../.."
what="the program seen from outside"
source tests/tools.sh
use_python
[ "${1:-}" != --fetch ] || exec "$python" tests/interop/receivers.py
[ -x "$target/debug/stictiond" ] || cargo build --locked --quiet --features full
exec "$python" tests/interop/test_interop.py "$@"
