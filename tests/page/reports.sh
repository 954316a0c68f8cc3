#!/usr/bin/env bash
# Reports in a real browser: target/debug/stictiond writes them, Chromium shows them at desktop and phone width, light and
# dark. Usage: tests/page/reports.sh [FOLDER FOR SCREENSHOTS].
set -euo pipefail
cd "$(dirname "$0")/../.."
what="reports in a browser"
source tests/tools.sh
use_browser
use_python
[ -x "$target/debug/stictiond" ] || cargo build --locked --quiet --features full
exec "$python" tests/page/reports.py "$target/debug/stictiond" "$browser" "$@"
