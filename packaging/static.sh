#!/usr/bin/env bash
# Makes a tarball of static programs, which run on any Linux of their processor: both programs, man pages, completions, the
# unit and the example configurations.
# Usage: packaging/static.sh [--binary PATH] [--out FOLDER]. Without --binary it builds for musl, which needs
# `rustup target add x86_64-unknown-linux-musl` and musl-tools (a C compiler for ring and zstd); without --out the tarball is in
# target/package. Prints its path. The same programs and SOURCE_DATE_EPOCH (default: the last commit) give the same bytes.
set -euo pipefail
. "$(dirname "$0")/programs.sh"
if [ -z "$given" ]; then
    platform=$(uname -m)-unknown-linux-musl
    cargo build --profile dist --locked --features full --target "$platform" >&2
    binary=$target/$platform/dist/stictiond
    if readelf -d "$binary" | grep -q '(NEEDED)'; then
        fail "$binary is linked to libraries"
    fi
fi
take_programs

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
umask 022
name=stictiond-$version-linux-$(uname -m)
stage=$work/$name
mkdir -p "$stage"/{bin,man/man1,completions,config}
install -m 755 "$binary" "$bridge" "$stage/bin/"
strip --strip-all "$stage"/bin/*
"$binary" manual --out "$stage/man/man1" >/dev/null
"$bridge" manual --force --out "$stage/man/man1" >/dev/null
for program in "$stage"/bin/*; do
    for shell in bash zsh fish; do
        "$program" completions "$shell" >"$stage/completions/$(basename "$program").$shell"
    done
done
cp README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE "$stage/"
cp config/monitor.toml config/demo.toml config/stictiond.service "$stage/config/"
mkdir -p "$out"
tar -C "$work" --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$SOURCE_DATE_EPOCH" -cf - "$name" | gzip -9n >"$out/$name.tar.gz"
printf '%s\n' "$out/$name.tar.gz"
