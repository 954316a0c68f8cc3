#!/usr/bin/env bash
# The Debian package of target/debug/stictiond, or of STICTIOND_BIN, on a clean Debian root: installed, run, upgraded, removed
# and purged. Before it the wheel and the tarball (tests/package/wheel.sh).
# Usage: tests/package/run.sh [--fetch | --boot]. Needs root and debootstrap; says loudly when they cannot be had. The root is
# kept as target/package/*.tar, once; --fetch does no more than that. --boot is for the hand: it boots a root with systemd in
# systemd-nspawn and tries the unit itself there.
set -euo pipefail
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-target}
started=$SECONDS

skip() {
    printf '\n!! SKIPPED: package test: %s\n\n' "$*" >&2
    exit 0
}

# What needs no root comes first.
[ -n "${1:-}" ] || bash tests/package/wheel.sh

[ "$(id -u)" = 0 ] || skip "it takes root (chroot, mount)"
command -v dpkg-deb >/dev/null || skip "no dpkg-deb"
unshare --mount --pid --fork --net --mount-proc true 2>/dev/null || skip "no namespaces (unshare --mount --pid --net)"

# Of this machine's release, as its C library is what the program was linked to; another system gets Debian's stable.
# shellcheck disable=SC1091
suite=$(. /etc/os-release && [ "$ID" = debian ] && printf '%s' "${VERSION_CODENAME:-stable}" || echo stable)
# adduser is what the package depends on beside the C library.
packages=adduser
if [ "${1:-}" = --boot ]; then
    command -v systemd-nspawn >/dev/null || skip "no systemd-nspawn (apt-get install systemd-container)"
    packages=adduser,systemd,systemd-sysv,dbus
fi
root=$target/package/$suite-$packages.tar
mkdir -p "$target/package"
# Whoever comes while it is being fetched waits.
exec 9>"$target/package/lock"
flock 9
if [ ! -e "$root" ]; then
    if ! command -v debootstrap >/dev/null && command -v apt-get >/dev/null; then
        { apt-get update && apt-get install -y --no-install-recommends debootstrap; } >/dev/null 2>&1 || true
    fi
    command -v debootstrap >/dev/null || skip "no debootstrap (apt-get install debootstrap)"
    fresh=$(mktemp -d "$target/package/root.XXXXXX")
    trap 'rm -rf "$fresh"' EXIT
    # What is the root's / must be open to its users, as mktemp's folders are not.
    chmod 755 "$fresh"
    # debootstrap takes its usual mirror, or DEBIAN_MIRROR.
    debootstrap --variant=minbase --include="$packages" "$suite" "$fresh" ${DEBIAN_MIRROR:+"$DEBIAN_MIRROR"} \
        >"$target/package/debootstrap.log" 2>&1 || skip "debootstrap fails (target/package/debootstrap.log)"
    rm -rf "$fresh"/var/cache/apt/archives/*.deb "$fresh"/var/lib/apt/lists/*
    tar -C "$fresh" -cf "$root.part" .
    mv "$root.part" "$root"
    rm -rf "$fresh"
fi
exec 9>&-
[ "${1:-}" != --fetch ] || exit 0

binary=${STICTIOND_BIN:-$target/debug/stictiond}
[ -x "$binary" ] && [ -x "$(dirname "$binary")/stictiond-bridge" ] || cargo build --locked --quiet --features full
work=$(mktemp -d "$target/package/work.XXXXXX")
trap 'rm -rf "$work"' EXIT
# Compression is most of the time and nothing of what is tested.
export DPKG_DEB_COMPRESSOR_TYPE=none
strip -o "$work/stictiond" "$binary"
strip -o "$work/stictiond-bridge" "$(dirname "$binary")/stictiond-bridge"
build() {
    DEB_REVISION=$1 packaging/deb.sh --binary "$work/stictiond" --out "$2"
}
first=$(build 1 "$work")
second=$(build 2 "$work")
cmp "$first" "$(build 1 "$work/again")" || { echo "the same package twice differs" >&2; exit 1; }
mkdir "$work/root"
tar -C "$work/root" -xf "$root"
if [ "${1:-}" = --boot ]; then
    cp "$first" "$work/root/first.deb"
    cp "$second" "$work/root/second.deb"
    cp tests/package/boot.sh "$work/root/boot.sh"
    printf '[Unit]\nAfter=multi-user.target\n[Service]\nType=oneshot\nExecStart=/bin/bash /boot.sh\n' \
        >"$work/root/etc/systemd/system/boot-test.service"
    mkdir -p "$work/root/etc/systemd/system/default.target.wants"
    ln -s ../boot-test.service "$work/root/etc/systemd/system/default.target.wants/"
    timeout 300 systemd-nspawn --quiet --register=no --keep-unit --private-network --boot --directory "$work/root" \
        </dev/null >"$work/console" 2>&1 || true
    [ -e "$work/root/log" ] || { cat "$work/console"; exit 1; }
    cat "$work/root/log"
    [ -e "$work/root/passed" ] || exit 1
    printf 'package test under systemd passed (%d s)\n' "$((SECONDS - started))"
    exit 0
fi
# Namespaces of its own: mounts, processes and ports end with it, whatever happens.
unshare --mount --pid --fork --net --mount-proc --kill-child \
    python3 tests/package/install.py "$work/root" "$first" "$second"
# 1.2 by systemd 252; later ones may look at more.
if command -v systemd-analyze >/dev/null && systemd-analyze security --help | grep -q -- --offline; then
    systemd-analyze security --offline=true --threshold=20 --no-pager config/stictiond.service | tail -n 1
fi
printf 'package test passed (%d s)\n' "$((SECONDS - started))"
