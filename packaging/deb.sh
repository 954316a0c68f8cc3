#!/usr/bin/env bash
# Makes the Debian package from programs that are built already, with dpkg-deb and binutils alone.
# Usage: packaging/deb.sh [--binary PATH] [--out FOLDER]; without them target/dist/stictiond and target/package. The
# program stictiond-bridge is taken from beside it.
# Prints the package's path. The same program, sources and SOURCE_DATE_EPOCH (default: the last commit) give the same bytes.
# DEBFULLNAME and DEBEMAIL name who answers for the package, DEB_REVISION counts packages of one version.
set -euo pipefail
. "$(dirname "$0")/programs.sh"
for tool in dpkg-deb strip readelf gzip; do
    command -v "$tool" >/dev/null || fail "$tool is missing (apt-get install dpkg binutils gzip)"
done
take_programs
# A pre-release sorts before its release in Debian's order only behind a tilde.
version=${version/-/\~}-${DEB_REVISION:-1}
maintainer="${DEBFULLNAME:-The stictiond authors} <${DEBEMAIL:-stictiond@packages.example}>"
architecture=$(dpkg --print-architecture)

# What the programs are linked to, named as Debian names it. A static program needs nothing.
depends=adduser
for library in $(readelf -d "$binary" "$bridge" | sed -n 's/.*(NEEDED).*\[\(.*\)\]/\1/p'); do
    case $library in
        libc.so.6 | libm.so.6 | libdl.so.2 | libpthread.so.0 | librt.so.1 | ld-linux*)
            glibc=$(readelf -VW "$binary" "$bridge" | grep -o 'GLIBC_[0-9.]*' | cut -c 7- | sort -V | tail -n 1)
            needed="libc6 (>= $glibc)" ;;
        libgcc_s.so.1) needed="libgcc-s1 (>= 4.2)" ;;
        *) fail "$binary is linked to $library, which no Debian package is known for here" ;;
    esac
    case $depends in *"$needed"*) ;; *) depends="$depends, $needed" ;; esac
done

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# Whatever the caller's umask: a package's files are readable by all.
umask 022
stage=$work/stictiond
mkdir "$stage"
doc=$stage/usr/share/doc/stictiond
put() {
    install -D -m "$1" "$2" "$3"
}

put 755 "$binary" "$stage/usr/bin/stictiond"
put 755 "$bridge" "$stage/usr/bin/stictiond-bridge"
strip --strip-all "$stage"/usr/bin/*
put 644 config/stictiond.service "$stage/usr/lib/systemd/system/stictiond.service"
put 644 packaging/monitor.toml "$stage/etc/stictiond/monitor.toml"
put 644 packaging/debian/lintian-overrides "$stage/usr/share/lintian/overrides/stictiond"

# The program writes these itself, so they cannot depart from it.
"$binary" manual --out "$stage/usr/share/man/man1" >/dev/null
# Its own pages, in place of the one for the command that calls it.
"$bridge" manual --force --out "$stage/usr/share/man/man1" >/dev/null
gzip -9n "$stage"/usr/share/man/man1/*
mkdir -p "$stage"/usr/share/{bash-completion/completions,zsh/vendor-completions,fish/vendor_completions.d}
for program in "$stage"/usr/bin/*; do
    name=$(basename "$program")
    "$program" completions bash >"$stage/usr/share/bash-completion/completions/$name"
    "$program" completions zsh >"$stage/usr/share/zsh/vendor-completions/_$name"
    "$program" completions fish >"$stage/usr/share/fish/vendor_completions.d/$name.fish"
done

for page in README.md SECURITY.md docs/*.md docs/dev/*.md docs/results/*.txt; do
    put 644 "$page" "$doc/$page"
done
for example in monitor.toml hardened.toml hardened-daemon.json5 hardened-router.json5 alerts.yml recording.yml alerts.test.yml \
    grafana.json; do
    put 644 "config/$example" "$doc/examples/$example"
done
{
    printf 'Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/\nUpstream-Name: stictiond\n\n'
    printf 'Files: *\nCopyright: %s\nLicense: MIT or Apache-2.0\n' "$(sed -n 's/^Copyright (c) //p' LICENSE-MIT)"
    printf '\nLicense: MIT\n'
    sed '1,/^Copyright/d; /./!d; s/^/ /' LICENSE-MIT
    printf '\nLicense: Apache-2.0\n On Debian systems the text is in /usr/share/common-licenses/Apache-2.0.\n'
} >"$doc/copyright"
gzip -9nc CHANGELOG.md >"$doc/changelog.gz"
{
    printf 'stictiond (%s) stable; urgency=medium\n\n  * See changelog.gz for what is new in %s.\n\n -- %s  %s\n' \
        "$version" "${version%-*}" "$maintainer" "$(LC_ALL=C date -u -R -d "@$SOURCE_DATE_EPOCH")"
} | gzip -9nc >"$doc/changelog.Debian.gz"

mkdir "$stage/DEBIAN"
for script in postinst prerm postrm; do
    put 755 "packaging/debian/$script" "$stage/DEBIAN/$script"
done
echo /etc/stictiond/monitor.toml >"$stage/DEBIAN/conffiles"
(cd "$stage" && find etc usr -type f -print0 | LC_ALL=C sort -z | xargs -0 md5sum) >"$stage/DEBIAN/md5sums"
cat >"$stage/DEBIAN/control" <<CONTROL
Package: stictiond
Version: $version
Architecture: $architecture
Maintainer: $maintainer
Section: science
Priority: optional
Installed-Size: $(du -k -s --apparent-size "$stage" | cut -f 1)
Depends: $depends
Description: watches control loops for sticking valves
 A daemon that reads the signals of control loops from a Zenoh bus, says which
 valves stick, by how much and how sure that is, raises alarms after ISA-18.2
 and records everything, so that each result can be repeated bit for bit.
 .
 It never writes to the plant. The service is installed switched off: it needs
 the plant's keys first, in /etc/stictiond/monitor.toml.
CONTROL
find "$stage" -exec touch --no-dereference --date "@$SOURCE_DATE_EPOCH" {} +

mkdir -p "$out"
package=$out/stictiond_${version}_$architecture.deb
dpkg-deb --build --root-owner-group "$stage" "$package" >/dev/null
printf '%s\n' "$package"
