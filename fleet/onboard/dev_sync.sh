#!/bin/sh
# bring one upload of changed files into the containers of a stack, and restart services
#
# usage: dev_sync.sh STACK SESSION NAME SIZE OFFSET SERVICE...
#
# The input is the upload from byte OFFSET on: a tar archive, packed with gzip, of SIZE bytes; NAME is its SHA-256. In it are
#   plan                   lines `put SERVICE DIGEST PATH`, `gone SERVICE - PATH`, `mark SERVICE DIGEST NAME`
#   files/SERVICE/PATH     the files, as the container has them
# The services are restarted. Docker itself unpacks the files (`docker cp`), so a container needs no shell and no tar. To
# remove one it needs `rm`. dev/has-SERVICE says what its containers have: their IDs, then lines `DIGEST PATH`.
set -u
stack=$1 session=$2 name=$3 size=$4 offset=$5
shift 5
fleet=$HOME/.fleet
dev=$fleet/stacks/$stack/dev
part=$dev/in-$name
broken_off=74 busy=75 # see exit_codes.py

fail() { # CODE TEXT
    echo "$2" >&2
    exit "$1"
}
mine() { [ "$(cat "$dev/session" 2>/dev/null)" = "$session" ] || fail "$broken_off" 'this robot was brought back to a release'; }

# --- The upload, whole before a container is touched

mine
work=$dev/work.$$
trap 'rm -rf "$work"' EXIT
[ "$offset" != 0 ] || : >"$part" || exit 1
[ "$(stat -c %s "$part" 2>/dev/null)" = "$offset" ] || fail "$broken_off" 'another upload came in between'
problem=$(cat 2>&1 >>"$part") || {
    rm -f "$part"
    fail 1 "the files cannot be written: $(printf '%s\n' "$problem" | head -n 1)"
}
[ "$(stat -c %s "$part")" = "$size" ] || fail "$broken_off" 'the upload was cut'
[ "$(sha256sum <"$part" | cut -c 1-64)" = "$name" ] || {
    rm -f "$part"
    fail "$broken_off" 'the upload was damaged'
}
problem=$({ mkdir "$work" && tar -xzf "$part" -C "$work"; } 2>&1) || {
    rm -f "$part"
    fail 1 "the files cannot be written: $(printf '%s\n' "$problem" | head -n 1)"
}
rm -f "$part"

# --- Into the containers

exec 9>>"$fleet/lock" 8>>"$dev/busy"
flock -n 9 || echo "now: waits for $(cat "$fleet/holder" 2>/dev/null)"
flock -w 240 9 || fail "$busy" "$(cat "$fleet/holder" 2>/dev/null) has not ended after 240 s"
echo "a sync of fab dev since $(date +%H:%M:%S)" >"$fleet/holder"
mine
flock -w 20 8

ids_of() {
    docker ps --all --no-trunc --quiet --filter "label=com.docker.compose.project=$stack" \
        --filter label=com.docker.compose.oneoff=False --filter "label=com.docker.compose.service=$1" | sort | tr '\n' ' '
}

# What is about to be changed is not known until that has succeeded.
forget() { # SERVICE IDS
    {
        echo "$2"
        awk -v service="$1" '
            NR == FNR { if ($2 == service) { sub(/^[^ ]+ [^ ]+ [^ ]+ /, ""); changed[$0] } ; next }
            FNR > 1 { path = $0; sub(/^[^ ]+ /, "", path); if (!(path in changed)) print }
        ' "$work/plan" "$has"
    } >"$has.new" && mv -f "$has.new" "$has"
}
remember() { # SERVICE
    awk -v service="$1" '$2 == service { sub(/^[^ ]+ [^ ]+ /, ""); print }' "$work/plan" >>"$dev/has-$1"
}

put() { # SERVICE ID
    [ -d "$work/files/$1" ] || return 0
    # Without the folders: those of the container keep their owner and their mode.
    (
        cd "$work/files/$1" || exit 1
        find . ! -type d -print0 | tar --null --no-recursion --owner=0 --group=0 --numeric-owner -cf - -T -
    ) | docker cp - "$2:/" >"$work/said" 2>&1 || fail 1 "$1: docker cp: $(tail -n 1 "$work/said")"
}
remove() { # SERVICE ID
    awk -v service="$1" '$1 == "gone" && $2 == service { sub(/^[^ ]+ [^ ]+ [^ ]+ /, ""); print }' "$work/plan" >"$work/gone"
    [ -s "$work/gone" ] || return 0
    tr '\n' '\0' <"$work/gone" | xargs -0 docker exec --user 0 "$2" rm -f -- >"$work/said" 2>&1 && return
    if grep -qE 'executable file not found|no such file' "$work/said"; then
        echo "note: $1: $(wc -l <"$work/gone") files stay in the container, because its image has no \`rm\`: \`fab build\` and \`fab ship\` remove them"
    elif grep -qE 'is not running|is restarting' "$work/said"; then
        : >"$work/later" # what has come may be its repair: it is started first
    else
        fail 1 "$1: cannot remove files: $(tail -n 1 "$work/said")"
    fi
}
remove_all() {
    while IFS= read -r service <&3; do
        for id in $(ids_of "$service"); do remove "$service" "$id"; done
    done 3<"$work/services"
}

cut -d ' ' -f 2 "$work/plan" | sort -u >"$work/services"
while IFS= read -r service <&3; do
    ids=$(ids_of "$service")
    has=$dev/has-$service
    [ -n "$ids" ] || fail 1 "$service has no container"
    if [ ! -e "$has" ]; then
        echo "$ids" >"$has" || exit 1
    elif [ "$(head -n 1 "$has")" != "$ids" ]; then
        fail "$broken_off" 'its containers were replaced'
    fi
    forget "$service" "$ids" || exit 1
    for id in $ids; do put "$service" "$id"; done
done 3<"$work/services"
remove_all

all=
for service in "$@"; do all="$all $(ids_of "$service")"; done
# shellcheck disable=SC2086 # one word per container
[ -z "${all# }" ] || problem=$(docker restart $all 2>&1 >/dev/null) || fail 1 "the restart failed: $problem"
if [ -e "$work/later" ]; then
    rm -f "$work/later"
    remove_all
    [ ! -e "$work/later" ] || fail 1 'a container does not run, so files cannot be removed from it yet'
fi

# Docker's files too: after a power cut, what is remembered must be in the containers.
sync
while IFS= read -r service <&3; do remember "$service" || exit 1; done 3<"$work/services"
