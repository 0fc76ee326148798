#!/bin/sh
# Check within seconds that one of this system's package servers answers; without a network apt itself needs minutes.
# Usage: apt_reach.sh SECONDS
# Each server is asked for one list, all at the same time, with apt's own program: a server may accept connections and then
# send nothing for SECONDS. One server that answers is enough, with an error too; those that do not answer are named. With a
# proxy nothing is checked: only the proxy knows what it can reach.

seconds=$1 helper=/usr/lib/apt/apt-helper
[ -x "$helper" ] || exit 0
apt-config dump | grep -qE "^Acquire::https?::.*Proxy.* \".+\"" && exit 0
lists=$(apt-get --print-uris update 2>/dev/null |
    sed -nE "s,^'(https?://([^][/:@]+(:[0-9]+)?)/[^']*)' .*,\2 \1,p" | sort -u -k1,1)
[ -n "$lists" ] || exit 0
work=$(mktemp -d) && trap 'rm -rf "$work"' EXIT

ask() { # SITE URL
    host=${1%:*}
    timeout 10 getent ahosts "$host" >/dev/null || {
        echo "Could not resolve host: $host"
        return
    }
    # apt 2.6 waits twice its time limit for an answer over HTTP.
    timeout $((2 * seconds + 2)) "$helper" -o Acquire::Retries=0 -o "Acquire::http::Timeout=$seconds" \
        -o "Acquire::https::Timeout=$seconds" download-file "$2" "$work/$1.list" >"$work/$1.said" 2>&1
    code=$?
    if [ "$code" = 0 ] || [ -s "$work/$1.list" ]; then
        return
    elif grep -qE 'Could not connect|Unable to connect|Cannot initiate' "$work/$1.said"; then
        echo "Could not connect to $host"
    elif [ "$code" = 124 ] || grep -qE 'Could not wait|Connection (failed|timed out)' "$work/$1.said"; then
        echo "package server $1 does not answer within $seconds s"
    fi
}

while read -r site url; do
    ask "$site" "$url" >"$work/$site.problem" &
done <<EOF
$lists
EOF
wait
problems=$(cat "$work"/*.problem)
[ -n "$problems" ] || exit 0
for file in "$work"/*.problem; do
    [ -s "$file" ] || {
        printf '%s\n' "$problems" | sed 's/^/note: /; s/$/; other package servers answer/'
        exit 0
    }
done
printf '%s\n' "$problems" >&2
exit 1
