#!/bin/sh
# Start a release with the given command; if that succeeds, make it the current release.
# Usage: start_release.sh SECONDS UNTIL_CLOSED RELEASE COMMAND [ARGUMENT...]
# One at a time: two `docker compose up` at once collide, and both fail. SECONDS is how long to wait for another one to
# end. UNTIL_CLOSED is the text of until_closed.sh, which ends the command when the connection is lost.
seconds=$1 until_closed=$2 release=$3
shift 3
exec 9>>.fleet/lock
flock --wait "$seconds" 9 || {
    echo "another ship to this robot is still starting its release" >&2
    exit 1
}
sh -c "$until_closed" until_closed "$@" || exit
ln -sfn "releases/$release" .fleet/current.new && mv -fT .fleet/current.new .fleet/current
