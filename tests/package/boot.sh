#!/usr/bin/env bash
# The package under systemd itself. Run by tests/package/run.sh --boot as a service of a system that it boots, whose root
# has first.deb and second.deb; leaves `passed` there.
set -euo pipefail
exec >/log 2>&1
trap 'sync; systemctl poweroff --force' EXIT

fail() {
    printf 'failed: %s\n' "$*"
    journalctl -u stictiond --no-pager -o cat | tail -n 20
    exit 1
}
property() {
    systemctl show --property "$1" --value stictiond
}
healthy() {
    local answer
    exec 3<>/dev/tcp/127.0.0.1/8080
    printf 'GET /healthz HTTP/1.0\r\n\r\n' >&3
    read -r answer <&3
    exec 3>&-
    [[ $answer == *" 200 "* ]]
}

dpkg -i /first.deb
! systemctl --quiet is-active stictiond || fail "it runs unasked"
systemctl enable --now stictiond || fail "it does not start"
healthy || fail "no answer"
systemctl reload stictiond || fail "no reload"
# The watchdog's 30 s and some more.
sleep 40
[ "$(property ActiveState) $(property NRestarts)" = "active 0" ] || fail "it did not stay"
systemd-analyze security --no-pager stictiond | tail -n 1

pid=$(property MainPID)
dpkg -i /second.deb
[ "$(property MainPID)" != "$pid" ] && healthy || fail "not restarted by an upgrade"

pid=$(property MainPID)
echo 'nonsense = 1' >>/etc/stictiond/monitor.toml
dpkg -i /first.deb
[ "$(property MainPID)" = "$pid" ] && healthy || fail "stopped for a configuration that the new program refuses"
sed -i '/^nonsense/d' /etc/stictiond/monitor.toml
systemctl restart stictiond

kill -KILL "$(property MainPID)"
sleep 4
[ "$(property ActiveState) $(property NRestarts)" = "active 1" ] && healthy || fail "not started again after a crash"

started=$(date +%s%N)
systemctl stop stictiond
echo "stopped in $((($(date +%s%N) - started) / 1000000)) ms"
[ "$(property Result)" = success ] || fail "stopped with $(property Result)"
systemctl start stictiond
dpkg -r stictiond
! systemctl --quiet is-active stictiond || fail "it runs on after its removal"
ls /var/lib/stictiond/recordings/*.mcap >/dev/null || fail "no recordings after the removal"
dpkg -P stictiond
[ ! -e /var/lib/stictiond ] && [ ! -e /etc/stictiond ] && ! getent passwd stictiond || fail "something is left"
[ -z "$(find /etc/systemd -name 'stictiond*')" ] || fail "something is left in /etc/systemd"
touch /passed
