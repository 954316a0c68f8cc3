#!/usr/bin/env bash
# Reports in a real browser: target/debug/stictiond writes them, Debian's Chromium shows them at desktop and phone width,
# light and dark. Usage: tests/report/run.sh [--fetch | FOLDER FOR SCREENSHOTS]. Says loudly when no browser can be had;
# --fetch only gets what is needed.
set -euo pipefail
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-target}

skip() {
    printf '\n!! SKIPPED: reports were not looked at in a browser: %s\n\n' "$*" >&2
    exit 0
}

browser=${CHROMIUM:-$(command -v chromium || command -v chromium-browser || command -v google-chrome || true)}
if [ -z "$browser" ] && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    { apt-get update && apt-get install -y --no-install-recommends chromium fonts-dejavu-core; } >/dev/null 2>&1 || true
    browser=$(command -v chromium || true)
fi
[ -n "$browser" ] || skip "no chromium (apt-get install chromium, or set CHROMIUM)"

venv=$target/report/venv
stamp=$venv/$(sha256sum tests/report/requirements.txt | cut -c 1-16)
if [ ! -e "$stamp" ]; then
    rm -rf "$venv"
    python3 -m venv "$venv" 2>/dev/null || skip "python3 -m venv fails (apt-get install python3-venv)"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r tests/report/requirements.txt \
        || skip "playwright cannot be had from PyPI"
    touch "$stamp"
fi
[ "${1:-}" != --fetch ] || exit 0
[ -x "$target/debug/stictiond" ] || cargo build --locked --quiet --features full
exec "$venv/bin/python" tests/report/look.py "$target/debug/stictiond" "$browser" "$@"
