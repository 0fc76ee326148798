#!/bin/sh
# Replace a file of the system by standard input, whole or not at all; as root. Owner and mode stay.
# Usage: replace_file.sh PATH
# What fleet found there the first time is kept as PATH.before-fleet.
set -eu
folder=$(dirname "$1")
mkdir -p "$folder"
if [ -e "$1" ]; then
    if [ ! -e "$1.before-fleet" ]; then
        cp -p "$1" "$1.before-fleet.new"
        mv "$1.before-fleet.new" "$1.before-fleet"
    fi
    cp -p "$1" "$1.new"
fi
cat >"$1.new"
sync "$1.new" 2>/dev/null || sync # after a power cut it is the old file or the new one, and not empty
mv "$1.new" "$1"
sync "$folder" 2>/dev/null || sync
