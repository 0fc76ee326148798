#!/bin/sh
# Run a command that uses apt, and run it again while another program holds apt's locks.
#
# Arguments: LOCK_TIMEOUT LIMIT PAUSE (seconds) COMMAND...
# apt itself waits only for the two locks of dpkg; the lock of the package lists makes it fail, so the command is run again.
# `tail --pid`, not a pipe, shows the output: a process that the command leaves running would hold a pipe open.
# Without Use-Pty, dpkg ends together with apt.

lock_timeout=$1 limit=$2 pause=$3
shift 3
umask 022

work=$(mktemp -d) && trap 'rm -rf "$work"' EXIT
echo "DPkg::Lock::Timeout \"$lock_timeout\"; DPkg::Use-Pty \"0\";" >"$work/apt.conf"
end=$(($(date +%s) + lock_timeout))
while : >"$work/output"; do
    APT_CONFIG=$work/apt.conf timeout --kill-after=5 "$limit" "$@" >>"$work/output" 2>&1 &
    tail -n +1 -f -s 0.2 --pid=$! "$work/output"
    wait $!
    code=$?
    [ "$code" -ne 0 ] || exit 0
    grep -qE "^E: Could not get lock|^dpkg: error: .* lock was locked" "$work/output" || break
    [ "$(date +%s)" -lt "$end" ] || break
    echo "another program uses apt; trying again in $pause s"
    sleep "$pause"
done
[ "$code" -ne 124 ] && [ "$code" -ne 137 ] || {
    echo "the command did not end within $limit s, and was stopped"
    exit 1
}
exit "$code"
