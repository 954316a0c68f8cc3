# Sourced by the scripts that pack programs which are built already: reads --binary and --out and sets binary, bridge, out,
# version and SOURCE_DATE_EPOCH; `given` is the path of --binary.
script=packaging/$(basename "$0")
caller=$PWD
cd "$(dirname "$0")/.."
target=${CARGO_TARGET_DIR:-target}
binary=$target/dist/stictiond
out=$target/package

fail() {
    printf '%s: %s\n' "$script" "$*" >&2
    exit 1
}
from_caller() {
    cd "$caller" && realpath -m -- "$1"
}

given=""
while [ $# -gt 0 ]; do
    case $1 in
        --binary) given=$(from_caller "${2:?--binary needs a path}"); binary=$given; shift 2 ;;
        --out) out=$(from_caller "${2:?--out needs a folder}"); shift 2 ;;
        *) fail "unknown argument $1; see the head of this script" ;;
    esac
done

# The programs, once their place is known.
take_programs() {
    bridge=$(dirname "$binary")/stictiond-bridge
    for program in "$binary" "$bridge"; do
        [ -x "$program" ] || fail "$program is missing: cargo build --profile dist --locked --features full makes both programs, or --binary PATH"
    done
    version=$("$binary" --version | sed -n 's/^stictiond \([0-9][^ ]*\).*/\1/p')
    [ -n "$version" ] || fail "$binary does not say its version"
    SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || stat -c %Y Cargo.toml)}
    export SOURCE_DATE_EPOCH
}
