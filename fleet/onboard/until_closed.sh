#!/bin/sh
# Run a command until it ends, or until standard input closes or is silent for 45 s, as when the connection is lost.
# Usage: until_closed.sh COMMAND [ARGUMENT...]
# The desktop sends a heartbeat on standard input (fleet.ssh.channel.BEAT): a lost link closes nothing by itself.
exec 3<&0
"$@" &
child=$!
# Descriptor 9 is the caller's lock (start_release.sh): the watcher must not hold it after the command has ended.
{
    while [ -n "$(timeout 45 head -c 1 <&3)" ]; do :; done
    kill "$child"
} >/dev/null 2>&1 9>&- &
wait "$child"
