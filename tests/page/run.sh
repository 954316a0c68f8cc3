#!/usr/bin/env bash
# The page in a real browser and its API from outside: target/debug/stictiond serves it, Debian's Chromium looks at it.
# Usage: tests/page/run.sh [--fetch | ARGUMENTS FOR pytest, such as -k overview]. Says loudly what cannot be had; --fetch
# only gets what is needed.
set -euo pipefail
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-target}
axe_version=4.14.1

skip() {
    printf '\n!! SKIPPED: the page was not looked at in a browser: %s\n\n' "$*" >&2
    exit 0
}

browser=${CHROMIUM:-$(command -v chromium || command -v chromium-browser || command -v google-chrome || true)}
if [ -z "$browser" ] && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    { apt-get update && apt-get install -y --no-install-recommends chromium fonts-dejavu-core; } >/dev/null 2>&1 || true
    browser=$(command -v chromium || true)
fi
[ -n "$browser" ] || skip "no chromium (apt-get install chromium, or set CHROMIUM)"

venv=$target/page/venv
stamp=$venv/$(sha256sum tests/page/requirements.txt | cut -c 1-16)
if [ ! -e "$stamp" ]; then
    rm -rf "$venv"
    python3 -m venv "$venv" 2>/dev/null || skip "python3 -m venv fails (apt-get install python3-venv)"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r tests/page/requirements.txt \
        || skip "playwright and the like cannot be had from PyPI"
    touch "$stamp"
fi

# What axe-core finds is for those who cannot see the page; it is not kept here.
axe=$target/page/axe-$axe_version
if [ ! -e "$axe/node_modules/axe-core/axe.min.js" ]; then
    if ! command -v npm >/dev/null && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        { apt-get update && apt-get install -y --no-install-recommends npm; } >/dev/null 2>&1 || true
    fi
    mkdir -p "$axe"
    npm install --silent --no-audit --no-fund --ignore-scripts --prefix "$axe" "axe-core@$axe_version" >/dev/null 2>&1 \
        || rm -rf "$axe"
fi
[ "${1:-}" != --fetch ] || exit 0
[ -x "$target/debug/stictiond" ] || cargo build --locked --quiet --features full
export CHROMIUM="$browser" AXE="$axe/node_modules/axe-core/axe.min.js" PYTHONDONTWRITEBYTECODE=1
exec "$venv/bin/python" -m pytest -c tests/page/pytest.ini tests/page "$@"
