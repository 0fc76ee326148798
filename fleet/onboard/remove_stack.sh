#!/bin/sh
# Take a stack off the robot: its containers, networks and releases. Its data and its named volumes stay.
# Usage: remove_stack.sh STACK BY
set -eu
stack=$1 by=$2
cd "$HOME/.fleet/stacks/$stack"
exec 9>>"$HOME/.fleet/lock"
flock --wait 240 9
echo "$by, who runs fab remove" >"$HOME/.fleet/holder"
# No pipes: if Docker does not answer, nothing is removed.
containers=$(docker ps --all --quiet --filter "label=com.docker.compose.project=$stack")
# As long as the file gives them: a recorder that is killed leaves a bag that cannot be read.
# shellcheck disable=SC2086  # one word per container
[ -z "$containers" ] || docker stop $containers >/dev/null
# shellcheck disable=SC2086  # one word per container
[ -z "$containers" ] || docker rm --force $containers >/dev/null
networks=$(docker network ls --quiet --filter "label=com.docker.compose.project=$stack")
# shellcheck disable=SC2086  # one word per network
[ -z "$networks" ] || docker network rm $networks >/dev/null
rm -f current journal proved policies stopped
rm -rf releases dev
printf '%s\tremove\t-\t%s\tdone\n' "$(date -u +%Y-%m-%dT%H:%M:%SZ)" "$by" >>history
sync
