#!/bin/sh
# hold a stack in dev while one desktop is connected: say what it has of that desktop's files, and how its containers are
#
# usage: dev_hold.sh STACK RELEASE BY SESSION DETACH SWAP WAIT SETTLE
#
# SESSION is a word of one `fab dev`; the same session takes over from a connection that it has lost. DETACH and SWAP are the
# scripts detach.sh and swap.sh: with them a run is prepared that brings the release back at the next boot. The input stays
# open, and until_closed.sh ends this with the connection. It prints
#   has SERVICE DIGEST PATH     what was synced earlier into containers that are still the same
#   part NAME BYTES             an upload that was cut
#   ready SINCE                 the stack is in dev; from here on:
#   said SERVICE TEXT           the last log lines of a container that has ended
#   states SERVICE,STATE,CODE,RESTARTS,HEALTH ...     whenever that changes
#   ended EVENT                 somebody has brought the stack back to a release, with the last line of its history
set -u
stack=$1 release=$2 by=$3 session=$4 detach=$5 swap=$6 wait=$7 settle=$8
fleet=$HOME/.fleet
here=$fleet/stacks/$stack
dev=$here/dev
unusable=65 broken_off=74 busy=75 # see exit_codes.py

fail() { # CODE TEXT
    echo "$2" >&2
    exit "$1"
}

# One desktop at a time. A connection that was lost holds the lock for up to 45 s more.
mkdir -p "$dev" || exit 1
exec 7>>"$dev/lock"
tries=0
until flock -n 7; do
    read -r held_by_session process holder 2>/dev/null <"$dev/holder" || held_by_session='' holder=somebody
    if [ "$held_by_session" = "$session" ] && grep -qsaF "$session" "/proc/$process/cmdline"; then
        kill "$process"
    fi
    [ "$tries" -lt 20 ] || fail "$busy" "$holder has \`fab dev\` on this robot"
    tries=$((tries + 1))
    sleep 0.2
done
echo "$session $$ $by" >"$dev/holder" || exit 1

exec 9>>"$fleet/lock"
flock -w 240 9 || fail "$busy" "$(cat "$fleet/holder" 2>/dev/null) has not ended after 240 s"
[ -e "$dev/holder" ] || fail "$broken_off" 'the release was brought back just now'
now=$(readlink "$here/current" 2>/dev/null)
now=${now##*/}
[ "$now" = "$release" ] || fail "$unusable" "release ${now:-none} is current now, not $release"

ours() {
    docker ps --all --no-trunc --filter "label=com.docker.compose.project=$stack" \
        --filter label=com.docker.compose.oneoff=False "$@"
}
ids_of() { ours --quiet --filter "label=com.docker.compose.service=$1" | sort | tr '\n' ' '; }

# --- The stack is in dev from here on, also after a power cut

[ ! -s "$here/journal" ] || fail "$unusable" "a start of a release was interrupted here: \`fab ship\` finishes it"
# Written beside, synced, renamed: after a power cut each is the old one or the new one.
put() { cat >"$1.new" && { sync "$1.new" 2>/dev/null || sync; } && mv -f "$1.new" "$1"; }
since=$(cut -d ' ' -f 1 "$dev/state" 2>/dev/null)
[ -n "$since" ] || since=$(date -u +%Y-%m-%dT%H:%M:%SZ)
back=$session.$$
FLEET_LATER=1 sh -c "$detach" detach "$back" "$swap" swap boot "$stack" "$release" '?' "$by" "$wait" "$settle" robot || exit 1
before=$(cat "$dev/back" 2>/dev/null)
echo "$since $by" | put "$dev/state" && echo "$session" | put "$dev/session" && echo "$back" | put "$dev/back" || exit 1
sync "$dev" 2>/dev/null || sync
[ -z "$before" ] || rm -rf "$fleet/runs/${before:?}"
find "$dev" -name 'work.*' -prune -exec rm -rf {} +
find "$dev" -name 'in-*' -mmin +1440 -exec rm -f {} +

for has in "$dev"/has-*; do
    [ -e "$has" ] || continue
    service=${has##*/has-}
    if [ "$(head -n 1 "$has")" = "$(ids_of "$service")" ]; then
        sed "1d; s/^/has $service /" "$has"
    else
        rm -f "$has"
    fi
done
for part in "$dev"/in-*; do
    [ ! -e "$part" ] || echo "part ${part##*/in-} $(stat -c %s "$part")"
done
exec 9>&-
echo "ready $since"

# --- How its containers are, except while dev_sync.sh restarts them

template='{{index .Config.Labels "com.docker.compose.service"}},{{.State.Status}},{{.State.ExitCode}},{{.RestartCount}},{{with .State.Health}}{{.Status}}{{else}}none{{end}} {{.ID}}'
exec 8>>"$dev/busy"
shown='' last='' ids=$(ours --quiet 7>&- 8>&-)
while [ "$(cat "$dev/back" 2>/dev/null)" = "$back" ]; do
    if flock -n -s 8; then
        # One call of Docker for each look: on a small board each costs a tenth of a second of processor time.
        # shellcheck disable=SC2086 # one word per container
        states=$([ -z "$ids" ] || docker inspect --format "$template" $ids 2>/dev/null 7>&- 8>&-) || {
            ids=$(ours --quiet 7>&- 8>&-)
            states=$(printf '%s\n' "$ids" | xargs -r docker inspect --format "$template" 2>/dev/null 7>&- 8>&-)
        }
        flock -u 8
        # One that is just being restarted by somebody has ended for a moment.
        case $states in *,exited,*) settled=$last ;; *) settled=$states ;; esac
        last=$states
        if [ "$states" = "$settled" ] && [ "$states" != "$shown" ]; then
            shown=$states
            printf '%s\n' "$states" | awk -F '[, ]' '$2 != "running" || $4 > 0 { print $1, $6 }' | while read -r service id; do
                docker logs --tail 8 "$id" 2>&1 7>&- 8>&- | tail -n 8 | cut -c 1-500 | sed "s/^/said $service /"
            done
            printf 'states %s\n' "$(printf '%s\n' "$states" | cut -d ' ' -f 1 | tr '\n' ' ')"
        fi
    fi
    sleep 1 7>&- 8>&-
done
exec 9>>"$fleet/lock"
flock -s -w 300 9 # the swap writes its line last
echo "ended $(tail -n 1 "$here/history" 2>/dev/null | tr '\t' ' ')"
