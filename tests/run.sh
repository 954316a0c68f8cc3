#!/usr/bin/env bash
# Every test: the pure half alone, the whole program, the program seen from outside by Python (tests/interop), and its
# reports in a browser (tests/report).
set -euo pipefail
cd "$(dirname "$0")/.."
started=$SECONDS

step() {
    printf '\n== %s (%d s)\n' "$*" "$((SECONDS - started))"
}

step "tests of the pure half"
cargo test --locked --no-default-features --quiet

step "tests of everything"
cargo build --locked --quiet
cargo test --locked --quiet

step "tests from outside"
bash tests/interop/run.sh

step "reports in a browser"
bash tests/report/run.sh

printf '\nall tests passed (%d s)\n' "$((SECONDS - started))"
