#!/usr/bin/env bash
# The tests: the library and the program, the program seen from outside by Python (tests/interop), the Python package
# (python), reports and the page in a browser (tests/page). What was skipped for want of something is said and
# counted at the end.
#
# Python packages come from PyPI. STICTIOND_INSTALL=1 lets root install what Debian has of the rest (chromium, npm, python3-venv).
# --all adds what takes long: the tests that cargo calls ignored, all loops of the statistical tests (the usual run takes a
# third), thirty simulated days by three seeds, five times the damaged inputs, the soak (ten minutes), every view of the page
# by axe, the packages on a clean root (tests/package), and the lints of the plain build, whose dependencies then compile once
# more.
set -euo pipefail
cd "$(dirname "$0")/.."
started=$SECONDS
log=$(mktemp)
beside=$(mktemp -d)
trap 'rm -rf "$log" "$beside"' EXIT
all=${1:-}
[ -z "$all" ] || [ "$all" = --all ] || { echo "usage: tests/run.sh [--all]" >&2; exit 2; }
if [ -n "$all" ]; then
    export STICTIOND_FUZZ_TIMES=${STICTIOND_FUZZ_TIMES:-5} STICTIOND_SIM_DAYS=${STICTIOND_SIM_DAYS:-30}
    export STICTIOND_SEEDS=${STICTIOND_SEEDS:-3} STICTIOND_SOAK_S=${STICTIOND_SOAK_S:-600} STICTIOND_LONG=1
fi

step() {
    printf '\n== %s (%d s)\n' "$*" "$((SECONDS - started))"
}

# Both channels go on to where they went; the log is for counting.
noted() {
    "$@" > >(tee -a "$log") 2> >(tee -a "$log" >&2)
}

# Browser, broker and Python packages are fetched while the compiler works. What fails here is said where it is needed.
{ bash tests/interop/run.sh --fetch && bash tests/page/run.sh --fetch; } >/dev/null 2>&1 &
fetching=$!

if [ -n "$all" ]; then
    step "the plain build, without the feature full"
    cargo clippy --locked --quiet -- -D warnings
fi

step "building the tests"
cargo test --no-run --locked --quiet --features full --all-targets

# Tests of the daemon and of the page mostly wait: for a kill, a full disk, a browser. They run beside those that compute, which
# take what the others leave of the processors: all of it at the priority that the daemon gives to its gap diagnoses, which a
# higher one would starve. What ran beside is printed once it has ended.
beside_them=(daemon program)
computing=()
for path in tests/*.rs tests/*/main.rs crates/*/tests/*/main.rs; do
    name=$(basename "${path%/main.rs}" .rs)
    [[ " ${beside_them[*]} " == *" $name "* ]] || computing+=("$name")
done

# What fails in one of these does not hide what comes behind it. The tests' build has every feature, and would not see that
# the first command of README has none to compile: that is checked here.
of_the_program() {
    local bad=0
    nice -n 19 cargo test --no-fail-fast --locked --features full --test=program || bad=1
    nice -n 19 bash tests/interop/run.sh || bad=1
    nice -n 19 bash python/test.sh || bad=1
    return "$bad"
}
that_wait() {
    local bad=0
    cargo test --no-fail-fast --locked --features full --test=daemon -- --test-threads=4 || bad=1
    bash tests/page/run.sh || bad=1
    bash tests/page/reports.sh || bad=1
    nice -n 19 env -u RUSTC_WORKSPACE_WRAPPER cargo check --locked --quiet -p stictiond || bad=1
    return "$bad"
}

step "tests that compute: units, ${computing[*]}; beside them: ${beside_them[*]}, interop, python, page, report"
wait "$fetching" || true
failed=0
of_the_program >"$beside/program" 2>&1 &
program=$!
that_wait >"$beside/wait" 2>&1 &
others=$!
noted nice -n 19 cargo test --no-fail-fast --locked --features full --lib --bins "${computing[@]/#/--test=}" || failed=1
noted nice -n 19 cargo test --locked --features full --doc || failed=1

step "the program, from outside and by Python: what was said"
wait "$program" || failed=1
noted cat "$beside/program"

step "the daemon, pages and reports in a browser, the program as the demo builds it: what was said"
wait "$others" || failed=1
noted cat "$beside/wait"

if [ -n "$all" ]; then
    step "tests that take long"
    noted cargo test --no-fail-fast --locked --features full -- --ignored || failed=1
    step "the package on a clean Debian root"
    noted bash tests/package/run.sh || failed=1
fi

skipped=$(grep -c '^\(!! \)\?SKIPPED: ' "$log" || true)
if [ "$skipped" -gt 0 ]; then
    printf '\n== %d SKIPPED, not passed:\n' "$skipped"
    grep '^\(!! \)\?SKIPPED: ' "$log"
fi
[ "$failed" = 0 ] || { printf '\nsome tests failed (%d s)\n' "$((SECONDS - started))"; exit 1; }
printf '\nall tests that were run passed (%d s)\n' "$((SECONDS - started))"
