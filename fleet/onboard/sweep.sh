#!/bin/sh
# Remove what interrupted commands have left in ~/.fleet and in Docker, unless a command is at work now.
# Usage: sweep.sh NAME...   (paths in ~/.fleet, and images of fleet/incoming, as probe.sh lists them)
set -u
cd "$HOME/.fleet" || exit 1
exec 9>>lock
flock -n 9 || exit 0
mkdir -p spool && exec 8>>spool/lock
flock -n 8 || exit 0
for name in "$@"; do
    case $name in
        *..*) ;;
        fleet/incoming:*) docker image rm "$name" >/dev/null ;;
        pulled/references) # names by which Docker pulled: what they name stays if it has another one
            grep '@sha256:' "$name" | while read -r image; do docker image rm "$image" >/dev/null 2>&1 </dev/null; done
            rm -f "$name"
            ;;
        spool/* | receipts/* | pulled/*.new) rm -f "$name" ;;
        stacks/*/releases/*.part) rm -rf "$name" ;;
    esac
done
