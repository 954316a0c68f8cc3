#!/usr/bin/env bash
# Makes a Python wheel of programs that are built already, so that `pip install stictiond-*.whl` installs them. It holds no
# Python code and fits every Python 3; needs binutils, openssl and Python.
# Usage: packaging/wheel.sh [--binary PATH] [--out FOLDER]; without them target/dist/stictiond and target/package. The
# program stictiond-bridge is taken from beside it. Prints the wheel's path. The same programs and SOURCE_DATE_EPOCH (default:
# the last commit) give the same bytes.
set -euo pipefail
. "$(dirname "$0")/programs.sh"
for tool in strip readelf python3 openssl; do
    command -v "$tool" >/dev/null || fail "$tool is missing (apt-get install binutils python3 openssl)"
done
take_programs

# pip takes a wheel only where the C library is as new as the programs need it. A static program runs with any.
machine=$(uname -m)
glibc=$(readelf -VW "$binary" "$bridge" | grep -o 'GLIBC_[0-9.]*' | cut -c 7- | sort -V | tail -n 1)
platform=manylinux_${glibc/./_}_$machine
[ -n "$glibc" ] || platform=manylinux_2_17_$machine.musllinux_1_1_$machine

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
umask 022
about=stictiond-$version.dist-info
mkdir -p "$work/stictiond-$version.data/scripts" "$work/$about/licenses"
for program in "$binary" "$bridge"; do
    install -m 755 "$program" "$work/stictiond-$version.data/scripts/"
done
strip --strip-all "$work/stictiond-$version.data/scripts/"*
cp LICENSE-MIT LICENSE-APACHE "$work/$about/licenses/"
{
    printf 'Metadata-Version: 2.4\nName: stictiond\nVersion: %s\n' "$version"
    printf 'Summary: Watches control loops for sticking valves: a daemon and its command line\n'
    printf 'License-Expression: MIT OR Apache-2.0\nLicense-File: LICENSE-MIT\nLicense-File: LICENSE-APACHE\n'
    printf 'Requires-Python: >=3\nDescription-Content-Type: text/markdown\n\n'
    cat README.md
} >"$work/$about/METADATA"
{
    printf 'Wheel-Version: 1.0\nGenerator: packaging/wheel.sh\nRoot-Is-Purelib: false\n'
    for each in ${platform//./ }; do printf 'Tag: py3-none-%s\n' "$each"; done
} >"$work/$about/WHEEL"
(
    cd "$work"
    find . -type f ! -path ./record -printf '%P\n' | LC_ALL=C sort | while read -r path; do
        sum=$(openssl dgst -sha256 -binary "$path" | base64 | tr '+/' '-_' | tr -d =)
        printf '%s,sha256=%s,%s\n' "$path" "$sum" "$(stat -c %s "$path")"
    done >record
    printf '%s/RECORD,,\n' "$about" >>record
    mv record "$about/RECORD"
    find . -exec touch --no-dereference --date "@$SOURCE_DATE_EPOCH" {} +
)
mkdir -p "$out"
wheel=$out/stictiond-$version-py3-none-$platform.whl
rm -f "$wheel"
(cd "$work" && TZ=UTC python3 -m zipfile -c "$wheel" "stictiond-$version.data" "$about")
printf '%s\n' "$wheel"
