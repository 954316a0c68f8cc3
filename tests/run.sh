#!/usr/bin/env bash
# Every test: the pure half alone, what only the whole program has, the program seen from outside by Python
# (tests/interop), and its reports in a browser (tests/report).
set -euo pipefail
cd "$(dirname "$0")/.."
started=$SECONDS

step() {
    printf '\n== %s (%d s)\n' "$*" "$((SECONDS - started))"
}

step "tests of the pure half"
cargo test --no-fail-fast --locked --no-default-features --quiet

# The pure rooms and their tests were built and run above; here run the shell's rooms and the tests that need it.
step "tests of the shell"
cargo build --locked --quiet
shell=$(sed -n 's/^#\[cfg(feature = "daemon")\]$/shell/; /^shell$/{n;s/^pub mod \([a-z]*\);$/\1::/p}' src/lib.rs)
cargo test --no-fail-fast --locked --quiet --lib --bins -- $shell
named=$(grep -l 'feature = "daemon"' tests/*.rs | sed 's#tests/\(.*\)\.rs#--test \1#')
cargo test --no-fail-fast --locked --quiet --examples $named
cargo test --no-fail-fast --locked --quiet --doc

step "tests from outside"
bash tests/interop/run.sh

step "reports in a browser"
bash tests/report/run.sh

printf '\nall tests passed (%d s)\n' "$((SECONDS - started))"
