#!/bin/sh
# Receive the missing uploads into ~/.fleet/spool, load them into Docker, verify the images and name them.
#
# Arguments: TOKEN (of the run) BY (who ships) SKELETON (its SHA-256) INCOMING (the private repository) STALE (seconds), then
# in any number and order
#   "upload SHA256 SIZE"                  what the desktop can send
#   "layer SHA256 SIZE cat"               a layer that is uploaded as the file of that name
#   "layer SHA256 SIZE COMMAND..."        a layer that this command of root's writes to its standard output
#   "image INCOMING_NAME FINGERPRINT NAME ID ID OFFSET LENGTH"   an image, and where the skeleton holds its manifest
# It asks for bytes with "need SHA256 OFFSET" on standard output, and ends asking with "enough".
# shellcheck disable=SC2317,SC2329 # `each` calls functions by a name that it is given
set -eu

unusable=65 broken_off=74 busy=75 # see exit_codes.py
block=512                         # bytes: what tar pads its members to

token=$1 by=$2 skeleton=$3 incoming=$4 stale=$5
shift 5
mkdir -p .fleet/spool .fleet/receipts
cd .fleet/spool
read -r _ _ _ _ group _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ began _ <"/proc/$$/stat"

# Call function $2 with the words of each line whose first word is $1.
each() {
    kind=$1 call=$2
    shift 2
    for line in "$@"; do
        case $line in
            "$kind "*)
                set -f
                # shellcheck disable=SC2086 # the words of a line are the arguments
                "$call" $line
                ;;
        esac
    done
}

# One transfer at a time. A transfer whose connection dropped still holds the lock: the same run ends it at once, any other
# run when it is stale. A transfer that lost its connection while it waited here does not know that, and must not end the
# one that came after it: hence the comparison of starting times.
note() { printf '%s %s %s %s %s\n' "$group" "$began" "$token" "$1" "$by" >holder; }
is_stale() { [ "$holder_state" = receive ] && [ -z "$(find . -type f ! -name lock -mmin -1)" ]; }
is_ours() { [ "$holder_token" = "$token" ] && [ "$holder_began" -le "$began" ]; }
exec 9>>lock
waited=0
until flock -n 9; do
    read -r holder_group holder_began holder_token holder_state holder_by 2>/dev/null <holder || {
        holder_group='' holder_began=0 holder_token='' holder_state='' holder_by=somebody
    }
    if is_ours || is_stale; then
        [ -z "$holder_group" ] || kill -- "-$holder_group" 2>/dev/null || true
    fi
    [ "$waited" -lt "$stale" ] || {
        echo "$holder_by is shipping to this robot" >&2
        exit "$busy"
    }
    [ "$waited" != 2 ] || echo "wait for $holder_by"
    sleep 1
    waited=$((waited + 1))
done
note begin

# Images that another transfer has brought in the meantime, or this one before its connection dropped, are not sent again.
missing=
check_image() {
    id=$(docker image inspect --format '{{.Id}}' "$4" 2>/dev/null) || id=
    [ "$id" = "$5" ] || [ "$id" = "$6" ] || missing=yes
}
empty_spool() { find . -type f ! -name lock -exec rm -f {} +; }
each image check_image "$@"
[ "$missing" ] || {
    empty_spool
    exit 0
}

# A folder in the place of an upload has a size, and a pipe is waited for.
is_file() { [ -f "$1" ] && [ ! -L "$1" ]; }
size_of() { stat -c %s "$1" 2>/dev/null || echo 0; }
receive() {
    while :; do
        note receive
        is_file "$2" || rm -rf "$2"
        have=$(size_of "$2")
        [ "$have" -le "$3" ] || {
            rm -f "$2"
            have=0
        }
        echo "need $2 $have"
        [ "$have" = "$3" ] || head -c $(($3 - have)) >>"$2"
        [ "$(size_of "$2")" = "$3" ] || exit "$broken_off" # the next attempt resumes here
        note verify
        [ "$(sha256sum <"$2")" != "$2  -" ] || return 0
        rm -f "$2"
        [ "$have" != 0 ] || {
            echo "upload $2 arrived damaged" >&2
            exit "$unusable"
        }
    done
}
each upload receive "$@"
echo enough

# A layer that is rebuilt here is rebuilt twice: the first time only to check it, so that it never takes disk space as a file.
as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@"; fi; }
check_layer() {
    [ "$4" = cat ] || {
        shift 3
        as_root "$@" --check || exit "$unusable"
    }
}
each layer check_layer "$@"

# The archive is put together as it flows into Docker: for each layer its header from the skeleton, the layer, and padding up
# to a whole block; then the rest of the skeleton.
count=0
member() {
    size=$3
    dd if="$skeleton" bs="$block" skip="$count" count=1 status=none
    count=$((count + 1))
    if [ "$4" = cat ]; then
        cat "$2"
    else
        shift 3
        as_root "$@"
    fi || exit 1
    head -c $(((-size % block + block) % block)) /dev/zero
}
archive() {
    each layer member "$@"
    tail -c +$((count * block + 1)) "$skeleton"
    head -c $((2 * block)) /dev/zero
}
load() { # a containerd store prints an error and still exits with 0
    output=$(archive "$@" | docker load --quiet 2>&1) && case $output in *'Error unpacking'*) return 1 ;; esac
}
forget() { # the private names, and the container of an attempt that was interrupted
    docker ps -aq --filter "label=$incoming" | xargs -r docker rm --volumes >/dev/null
    docker image ls --format '{{.Repository}}:{{.Tag}}' "$incoming" | xargs -r docker image rm >/dev/null
}
note load
# The private names of an earlier attempt stay until this one has ended: its layers may be among those that are not sent.
if ! load "$@"; then
    case $output in *'no space left'*)
        echo "$output" >&2
        exit 1
        ;;
    esac
    # Docker may be restarting: wait for it.
    for _ in $(seq 30); do
        ! docker version >/dev/null 2>&1 || break
        sleep 2
    done
    load "$@" || {
        echo "$output" >&2
        exit "$unusable"
    }
fi

# The output of `docker load` proves nothing: the image must have the expected ID, and Docker must be able to make a container of it.
name_image() {
    id=$(docker image inspect --format '{{.Id}}' "$2") || exit "$unusable"
    [ "$id" = "$5" ] || [ "$id" = "$6" ] || {
        echo "$4 arrived as $id" >&2
        exit "$unusable"
    }
    container=$(docker create --label "$incoming" "$2" true) || exit "$unusable"
    docker rm --volumes "$container" >/dev/null
    tail -c +"$(($7 + 1))" "$skeleton" | head -c "$8" >../receipts/new
    { sync ../receipts/new 2>/dev/null || sync; } && mv ../receipts/new "../receipts/$3"
    docker tag "$2" "$4" # the private name stays for now: one image may be needed under two names
}
sync # after a power cut the card has the layers, and not only their names
each image name_image "$@"
forget
empty_spool
