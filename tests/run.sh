#!/usr/bin/env bash
# Every test: the pure half alone, the whole program, and the program seen from outside by Python (tests/interop).
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

printf '\nall tests passed (%d s)\n' "$((SECONDS - started))"
