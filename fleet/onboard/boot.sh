#!/bin/sh
# start the current releases that systemd owns, after network and clock, and start again what ends of them
#
# fleet-boot.service runs it (`boot: systemd` in the inventory). A release that has a file `boot` is systemd's: Docker's own
# restart policies are off in it. All others are Docker's, and left alone. What is current is looked up each time, so a
# rollback, a stop or a removal needs no change here.
set -u
export LC_ALL=C
cd "$HOME/.fleet" || exit 1
exec 9>>lock
clock=${FLEET_CLOCK:-60}               # seconds to wait for the clock: a robot without a network must start too
every=${FLEET_EVERY:-5}                # seconds between two looks
passes=${FLEET_PASSES:-}               # of the loop; without end if it is empty
started=${RUNTIME_DIRECTORY:?}/started # gone at power-on, there when only this was restarted
stopped=$RUNTIME_DIRECTORY/stopped     # ends of containers that a person has stopped: `ID TIME`
retries=$RUNTIME_DIRECTORY/retries     # what was started again and may not be for ever: an ID for each time

owned() { # STACK-FOLDER
    [ -e "$1/current/boot" ] && [ ! -e "$1/stopped" ]
}
any() { for here in stacks/*/; do ! owned "${here%/}" || return 0; done && return 1; }
synchronized() { [ "$(timedatectl show --property=NTPSynchronized --value 2>/dev/null)" = yes ]; }
# Whoever swaps containers holds the lock, and knows better what shall run.
alone() {
    flock -n 9 || return 1
    echo "fleet-boot.service since $(date +%H:%M:%S)" >holder
}

# Docker leaves alone what a person has stopped, and says so only by an event. It keeps the last 256 events, so this must be
# asked soon, and noted.
by_hand() { # ID TIME-OF-ITS-END
    if grep -qsxF "$1 $2" "$stopped"; then return; fi
    last=$(docker events --since 1 --until "$(date +%s.%N)" --filter "container=$1" --filter event=start --filter event=stop \
        --format '{{.Action}}' 2>/dev/null | tail -n 1)
    [ "$last" = stop ] || return 1
    echo "$1 $2" >>"$stopped"
    echo "somebody has stopped $1: it stays stopped until the next power-on, or until it is started"
}

# Containers that should run, of the current release, and have ended by themselves; `some` after those whose number of
# retries is limited.
ended() { # STACK-FOLDER
    release=$(readlink "$1/current")
    docker ps --all --quiet --no-trunc --filter "label=com.docker.compose.project=${1##*/}" \
        --filter label=com.docker.compose.oneoff=False --filter status=exited 2>/dev/null |
        xargs -r docker inspect --format \
            '{{.ID}} {{index .Config.Labels "com.docker.compose.service"}} {{.State.ExitCode}} {{index .Config.Labels "fleet.release"}} {{.State.FinishedAt}}' 2>/dev/null |
        tried=$(cat "$retries" 2>/dev/null) awk -v release="${release##*/}" -v services="$(tr '\n' ' ' <"$1/current/services")" '
            BEGIN {
                n = split(services, pairs, " ")
                for (i = 1; i <= n; i++) { split(pairs[i], pair, /[=:]/); policy[pair[1]] = pair[2]; most[pair[1]] = pair[3] }
                n = split(ENVIRON["tried"], ids, "\n")
                for (i = 1; i <= n; i++) count[ids[i]]++
            }
            $4 != release { next }
            policy[$2] == "always" { print $1, $5 }
            policy[$2] == "on-failure" && $3 != 0 && !most[$2] { print $1, $5 }
            policy[$2] == "on-failure" && $3 != 0 && count[$1] < most[$2] { print $1, $5, "some" }' |
        while read -r id at some; do by_hand "$id" "$at" >&2 || echo "$id $some"; done
}

until docker version >/dev/null 2>&1; do sleep 1; done
if [ ! -e "$started" ] && any; then
    waited=0
    until synchronized; do
        [ "$waited" -lt "$clock" ] || {
            echo "the clock is not synchronized after $clock s: starting anyway"
            break
        }
        sleep 1
        waited=$((waited + 1))
    done
    until alone; do sleep 1; done
    for here in stacks/*/; do
        here=${here%/}
        owned "$here" || continue
        echo "start $(readlink "$here/current") of ${here##*/}"
        (
            cd -P "$here/current" && unset COMPOSE_FILE COMPOSE_PROFILES &&
                exec timeout -k 10 600 docker compose --project-name "${here##*/}" --file compose.yaml up --detach --no-build --pull never 9>&-
        ) || echo "it did not start"
    done
    flock -u 9
fi
: >"$started"

while [ "$passes" != 0 ]; do
    for here in stacks/*/; do
        here=${here%/}
        if ! owned "$here" || [ -z "$(ended "$here")" ] || ! alone; then continue; fi
        # Asked again: it may have been stopped, or replaced, before the lock was free.
        if owned "$here"; then
            ended "$here" | while read -r id some; do
                [ -z "$some" ] || echo "$id" >>"$retries"
                docker start "$id" 9>&- </dev/null
            done
        fi
        flock -u 9
    done
    passes=${passes:+$((passes - 1))}
    sleep "$every" 9>&-
done
