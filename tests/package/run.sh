#!/usr/bin/env bash
# The Debian package of target/debug/stictiond on a clean Debian root: installed, run, upgraded, removed and purged.
# Usage: tests/package/run.sh [--fetch]. Needs root and debootstrap; says loudly when they cannot be had. The root is kept
# as target/package/*.tar, once; --fetch does no more than that.
set -euo pipefail
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-target}
started=$SECONDS

skip() {
    printf '\n!! SKIPPED: package test: %s\n\n' "$*" >&2
    exit 0
}

[ "$(id -u)" = 0 ] || skip "it takes root (chroot, mount)"
command -v dpkg-deb >/dev/null || skip "no dpkg-deb"
unshare --mount --pid --fork --net --mount-proc true 2>/dev/null || skip "no namespaces (unshare --mount --pid --net)"

# Of this machine's release, as its C library is what the program was linked to; another system gets Debian's stable.
# shellcheck disable=SC1091
suite=$(. /etc/os-release && [ "$ID" = debian ] && printf '%s' "${VERSION_CODENAME:-stable}" || echo stable)
root=$target/package/$suite-minbase.tar
if [ ! -e "$root" ]; then
    if ! command -v debootstrap >/dev/null && command -v apt-get >/dev/null; then
        { apt-get update && apt-get install -y --no-install-recommends debootstrap; } >/dev/null 2>&1 || true
    fi
    command -v debootstrap >/dev/null || skip "no debootstrap (apt-get install debootstrap)"
    mkdir -p "$target/package"
    fresh=$(mktemp -d "$target/package/root.XXXXXX")
    trap 'rm -rf "$fresh"' EXIT
    # adduser is what the package depends on beside the C library; debootstrap takes its usual mirror, or DEBIAN_MIRROR.
    debootstrap --variant=minbase --include=adduser "$suite" "$fresh" ${DEBIAN_MIRROR:+"$DEBIAN_MIRROR"} \
        >"$target/package/debootstrap.log" 2>&1 || skip "debootstrap fails (target/package/debootstrap.log)"
    rm -rf "$fresh"/var/cache/apt/archives/*.deb "$fresh"/var/lib/apt/lists/*
    tar -C "$fresh" -cf "$root.part" .
    mv "$root.part" "$root"
fi
[ "${1:-}" != --fetch ] || exit 0

[ -x "$target/debug/stictiond" ] || cargo build --locked --quiet
work=$(mktemp -d "$target/package/work.XXXXXX")
trap 'rm -rf "$work"' EXIT
# Compression is most of the time and nothing of what is tested.
export DPKG_DEB_COMPRESSOR_TYPE=none
build() {
    DEB_REVISION=$1 packaging/deb.sh --binary "$target/debug/stictiond" --out "$2"
}
first=$(build 1 "$work")
second=$(build 2 "$work")
cmp "$first" "$(build 1 "$work/again")" || { echo "the same package twice differs" >&2; exit 1; }
mkdir "$work/root"
tar -C "$work/root" -xf "$root"
# Namespaces of its own: mounts, processes and ports end with it, whatever happens.
unshare --mount --pid --fork --net --mount-proc --kill-child \
    python3 tests/package/install.py "$work/root" "$first" "$second"
if command -v systemd-analyze >/dev/null && systemd-analyze security --help | grep -q -- --offline; then
    systemd-analyze security --offline=true --threshold=12 --no-pager config/stictiond.service | tail -n 1
fi
printf 'package test passed (%d s)\n' "$((SECONDS - started))"
