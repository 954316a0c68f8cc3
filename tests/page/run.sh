#!/usr/bin/env bash
# The page in a real browser and its API from outside: target/debug/stictiond serves it, Chromium looks at it.
# Usage: tests/page/run.sh [--fetch | ARGUMENTS FOR pytest, such as -k overview]. --fetch only gets what is needed.
set -euo pipefail
cd "$(dirname "$0")/../.."
what="the page in a browser"
source tests/tools.sh
use_browser
use_python

# What axe-core finds is for those who cannot see the page; it is not kept here.
axe=$target/axe-4.14.1
if [ ! -e "$axe/node_modules/axe-core/axe.min.js" ]; then
    command -v npm >/dev/null || install npm
    mkdir -p "$axe"
    npm install --silent --no-audit --no-fund --ignore-scripts --prefix "$axe" "axe-core@${axe##*-}" >/dev/null 2>&1 || rm -rf "$axe"
fi
[ "${1:-}" != --fetch ] || exit 0
[ -x "$target/debug/stictiond" ] || cargo build --locked --quiet --features full
export CHROMIUM="$browser" AXE="$axe/node_modules/axe-core/axe.min.js" PYTHONDONTWRITEBYTECODE=1
exec "$python" -m pytest -c tests/page/pytest.ini tests/page "$@"
