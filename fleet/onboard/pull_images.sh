#!/bin/sh
# Pull images by digest from a registry, verify them and name them, as receive.sh does with images that are uploaded.
#
# Arguments: TOKEN (of the run) BY (who ships) LABEL (of the container that proves an image) STALE (seconds) PLATFORM ("" for
# the robot's own), then for each image: PATH (in the registry) DIGEST (of its manifest) FINGERPRINT NAME IDENTITY
# Standard input: a line with the address of the registry; a line with a login as Docker's config.json, or an empty one; a
# line with the manifest of each image; then a byte every ten seconds (fleet.ssh.channel.BEAT). After 45 s without one the
# connection is lost: the pull ends, and the next one begins when it has.
# shellcheck disable=SC2329 # functions are called by traps, and by a name that is given to `each`
set -u

broken_off=74 busy=75 # see exit_codes.py
token=$1 by=$2 label=$3 stale=$4 platform=$5
shift 5
mkdir -p .fleet/spool .fleet/receipts .fleet/pulled
cd .fleet || exit
read -r _ _ _ _ group _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ began _ <"/proc/$$/stat"
IFS= read -r address && IFS= read -r login || exit "$broken_off"

# One transfer at a time: see receive.sh.
exec 9>>spool/lock
waited=0
until flock -n 9; do
    read -r holder_group holder_began holder_token holder_state holder_by 2>/dev/null <spool/holder || {
        holder_group='' holder_began=0 holder_token='' holder_state='' holder_by=somebody
    }
    if { [ "$holder_token" = "$token" ] && [ "$holder_began" -le "$began" ]; } ||
        { [ "$holder_state" = receive ] && [ -z "$(find spool -type f ! -name lock -mmin -1)" ]; }; then
        [ -z "$holder_group" ] || kill -- "-$holder_group" 2>/dev/null
    fi
    [ "$waited" -lt "$stale" ] || {
        echo "$holder_by is shipping to this robot" >&2
        exit "$busy"
    }
    sleep 1
    waited=$((waited + 1))
done
printf '%s %s %s %s %s\n' "$group" "$began" "$token" pull "$by" >spool/holder

child='' watcher=''
ended() {
    [ -z "$watcher" ] || kill "$watcher" 2>/dev/null
    [ -z "${DOCKER_CONFIG-}" ] || [ -z "$login" ] || rm -rf "$DOCKER_CONFIG"
}
trap ended EXIT
trap '[ -z "$child" ] || kill "$child" 2>/dev/null; exit "$broken_off"' HUP INT TERM

# The login is written only to memory, for the login user alone, and for the time of the pull.
if [ "$login" ]; then
    for memory in "${XDG_RUNTIME_DIR:-/nowhere}" /dev/shm ''; do
        if [ -d "$memory" ] && [ -w "$memory" ]; then break; fi
    done
    [ "$memory" ] || {
        echo "there is no folder in memory for the registry's login: neither XDG_RUNTIME_DIR nor /dev/shm" >&2
        exit 1
    }
    rm -rf "$memory"/fleet-login.* 2>/dev/null # of an attempt that was killed
    engine=$(docker context inspect --format '{{.Endpoints.docker.Host}}' 2>/dev/null)
    export DOCKER_HOST="${DOCKER_HOST:-$engine}"
    DOCKER_CONFIG=$(mktemp -d "$memory/fleet-login.XXXXXX") || exit
    export DOCKER_CONFIG
    (umask 077 && printf '%s\n' "$login" >"$DOCKER_CONFIG/config.json") || exit
fi

# Docker knows the blobs of a manifest that it has pulled: the next pull asks only for the others.
keep_manifest() { # PATH DIGEST FINGERPRINT ...
    IFS= read -r manifest && printf '%s' "$manifest" >"pulled/$3.new"
}
each() { # FUNCTION IMAGE...
    call=$1
    shift
    while [ "$#" -ge 5 ]; do
        "$call" "$1" "$2" "$3" "$4" "$5" || exit
        shift 5
    done
}
each keep_manifest "$@"

exec 3<&0
{
    while [ -n "$(timeout 45 head -c 1 <&3)" ]; do :; done
    kill "$$"
} >/dev/null 2>&1 9>&- &
watcher=$!

pull() { # PATH DIGEST FINGERPRINT NAME IDENTITY
    id=$(docker image inspect --format '{{.Id}}' "$4" 2>/dev/null)
    [ "$id" != "$2" ] && [ "$id" != "$5" ] || return 0
    reference=$address/$1@$2
    printf '%s\n' "$reference" >>pulled/references
    # In the background: a shell notices a signal only between two commands, or while it waits.
    docker pull --quiet ${platform:+"--platform=$platform"} "$reference" </dev/null >/dev/null 9>&- &
    child=$!
    wait "$child" || return
    child=''
    id=$(docker image inspect --format '{{.Id}}' "$reference") || return
    if [ "$id" != "$2" ] && [ "$id" != "$5" ]; then
        echo "$4 arrived as another image: $id" >&2
        return 1
    fi
    container=$(docker create --label "$label" "$reference" true) || return
    docker rm --volumes "$container" >/dev/null
    sync # after a power cut the card has the layers, and not only their names
    cp "pulled/$3.new" "receipts/$3.new" && sync && mv "receipts/$3.new" "receipts/$3" && mv "pulled/$3.new" "pulled/$3" || return
    docker tag "$reference" "$4"
}
each pull "$@"

# The names by which Docker pulled are not needed any more. Those of an earlier attempt stay until here: their layers may be
# among those that were not pulled again.
if [ -e pulled/references ]; then
    while read -r reference; do docker image rm "$reference" >/dev/null 2>&1; done <pulled/references
fi
rm -f pulled/references pulled/*.new
exit 0
