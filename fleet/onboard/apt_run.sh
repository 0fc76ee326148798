#!/bin/sh
# Run a command that uses apt, and run it again while another program holds apt's locks.
#
# Arguments: LOCK_TIMEOUT LIMIT PAUSE SILENCE ANSWER (seconds) COMMAND...
# apt itself waits only for the two locks of dpkg; the lock of the package lists makes it fail, so the command is run again.
# `tail --pid`, not a pipe, shows the output: a process that the command leaves running would hold a pipe open.
# Without Use-Pty, dpkg ends together with apt.
# A server may accept connections and then send nothing. For that, apt 2.6 waits twice its time limit, at each attempt to get
# a list or a package, and curl waits for ever. So both wait for ANSWER seconds, a line tells every 15 s how far the command
# is, and the command is stopped when nothing has arrived for SILENCE seconds.

lock_timeout=$1 limit=$2 pause=$3 silence=$4 answer=$5
shift 5
every=${FLEET_TELL:-15}
umask 022

work=$(mktemp -d) && trap 'rm -rf "$work"' EXIT
cat >"$work/apt.conf" <<EOF
DPkg::Lock::Timeout "$lock_timeout";
DPkg::Use-Pty "0";
Acquire::Retries "1";
Acquire::http::Timeout "$answer";
Acquire::https::Timeout "$answer";
EOF
{
    cat "${CURL_HOME:-$HOME}/.curlrc" 2>/dev/null
    printf '\nconnect-timeout = %s\nspeed-limit = 1\nspeed-time = %s\n' "$answer" $((2 * answer))
} >"$work/.curlrc"

# The programs of the command: `timeout` gives them a process group of their own.
programs() { cat /proc/[0-9]*/stat 2>/dev/null | awk -v group="$1" '$5 == group { gsub(/[()]/, "", $2); print $2 }'; }
arrived() { du -sk /var/lib/apt/lists /var/cache/apt/archives 2>/dev/null | awk '{ sum += $1 } END { print sum + 0 }'; }
# The servers that downloads are connected to, by the names that apt's sources or the output have for them. apt keeps a
# connection for some time after its last download, so there may be several.
servers() {
    names=
    # shellcheck disable=SC2013 # there are no blanks in sites
    for peer in $(ss -Htnp 2>/dev/null | sed -nE 's/.* \[?([^] ]+)\]?:[0-9]+ +users:\(\("(https?|curl|wget)".*/\1/p' | sort -u); do
        for site in $(grep -rhoE 'https?://[^]/: "[]+' /etc/apt/sources.list /etc/apt/sources.list.d "$work/output" 2>/dev/null | sort -u); do
            site=${site#*://}
            timeout 5 getent ahosts "$site" 2>/dev/null | grep -qF "$peer " && peer=$site && break
        done
        names=$names${names:+ or }$peer
    done
    echo "$names"
}
tell() { # PID
    seconds=0 quiet=0 first=$(arrived) last='' found='' from='(unknown)'
    while sleep "$every" >/dev/null 2>&1 && kill -0 "$1" 2>/dev/null; do
        seconds=$((seconds + every)) now=$(arrived) running=$(programs "$1")
        if [ "$now" != "${last:-$first}" ] || ! printf '%s\n' "$running" | grep -qxE 'https?|curl|wget'; then
            quiet=0
        else
            quiet=$((quiet + every))
        fi
        last=$now
        [ "$quiet" -eq 0 ] || found=$(servers)
        from=${found:-$from}
        if [ "$quiet" -ge "$silence" ]; then
            echo "package server $from sends nothing for $quiet s" | tee "$work/silent"
            kill "$1"
        elif [ "$quiet" -gt 0 ]; then
            echo "now: waiting for package server $from: nothing has arrived for $quiet s"
        elif printf '%s\n' "$running" | grep -qxE 'dpkg.*'; then
            echo "now: installing packages, $seconds s so far"
        elif [ "$now" -gt "$first" ]; then
            echo "now: downloading, $(((now - first) / 1000)) MB in $seconds s"
        else
            echo "now: working, $seconds s so far"
        fi
    done
}

end=$(($(date +%s) + lock_timeout))
while : >"$work/output"; do
    APT_CONFIG=$work/apt.conf CURL_HOME=$work timeout --kill-after=5 "$limit" "$@" >>"$work/output" 2>&1 &
    child=$!
    tell "$child" &
    teller=$!
    tail -n +1 -f -s 0.2 --pid="$child" "$work/output"
    wait "$child"
    code=$?
    kill "$teller" 2>/dev/null
    [ "$code" -ne 0 ] || exit 0
    [ ! -s "$work/silent" ] || exit 1
    grep -qE "^E: Could not get lock|^dpkg: error: .* lock was locked" "$work/output" || break
    [ "$(date +%s)" -lt "$end" ] || break
    echo "now: another program uses apt; trying again in $pause s"
    sleep "$pause"
done
[ "$code" -ne 124 ] && [ "$code" -ne 137 ] || {
    echo "the command did not end within $limit s, and was stopped"
    exit 1
}
exit "$code"
