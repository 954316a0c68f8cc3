#!/usr/bin/env bash
# The tests: the library and the program, the program seen from outside by Python (tests/interop), the Python package
# (python), reports and the page in a browser (tests/report, tests/page). What was skipped for want of something is said and
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
beside=$(mktemp)
trap 'rm -f "$log" "$beside"' EXIT
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

# Some tests mostly wait: for a daemon that is killed, a disk that fills, a broker that comes back, a program that runs.
# They run beside those that compute; what they print follows when both have ended.
waiting=(daemon program)
computing=()
for path in tests/*.rs tests/*/main.rs crates/*/tests/*/main.rs; do
    name=$(basename "${path%/main.rs}" .rs)
    [[ " ${waiting[*]} " == *" $name "* ]] || computing+=("$name")
done

step "tests that compute: units, ${computing[*]}; beside them those that wait: ${waiting[*]}, and those from outside"
wait "$fetching" || true
(
    # What fails here does not hide what comes behind it.
    bad=0
    cargo test --no-fail-fast --locked --features full "${waiting[@]/#/--test=}" || bad=1
    bash tests/interop/run.sh || bad=1
    exit "$bad"
) >"$beside" 2>&1 &
others=$!
failed=0
noted cargo test --no-fail-fast --locked --features full --lib --bins "${computing[@]/#/--test=}" || failed=1
noted cargo test --locked --features full --doc || failed=1
noted bash python/test.sh || failed=1
noted bash tests/report/run.sh || failed=1

step "tests that wait, and those from outside: what they said"
wait "$others" || failed=1
noted cat "$beside"

# The tests' build has every feature, and would not see that the first command of README has none to compile. The browser
# leaves the processors idle most of the time; it goes first.
step "the page in a browser, its API from outside; beside it the program as the demo builds it, without the feature full"
nice -n 19 env -u RUSTC_WORKSPACE_WRAPPER cargo check --locked --quiet -p stictiond >"$beside" 2>&1 &
plain=$!
noted bash tests/page/run.sh || failed=1
wait "$plain" || { noted cat "$beside"; failed=1; }

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
