#!/bin/sh
# Take over the releases of the first version of fleet, which kept one stack on a robot, directly in ~/.fleet.
# Usage: adopt.sh STACK
# Running containers have files of the old folders mounted: each old name stays as a link, until its release is removed.
set -e
cd "$HOME/.fleet"
exec 9>>lock
flock --wait 240 9
here=stacks/$1
mkdir -p "$here/releases"
for old in releases/*; do
    if [ -L "$old" ] || [ ! -e "$old/compose.override.yaml" ]; then continue; fi
    mv -T "$old" "$here/$old"
done
# A loop of its own: the power may have been cut between a folder and its link.
for new in "$here"/releases/*; do
    old=releases/${new##*/}
    if [ -e "$new/compose.override.yaml" ] && [ ! -e "$old" ]; then ln -sfn "../$new" "$old"; fi
done
[ ! -f history ] || [ -e "$here/history" ] || mv history "$here/history"
if [ -L current ]; then
    [ -e "$here/current" ] || ln -s "$(readlink current)" "$here/current"
    rm -f current
fi
sync
