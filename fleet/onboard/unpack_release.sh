#!/bin/sh
# Unpack a release (a tar archive on standard input) into its directory, whole or not at all.
# Usage: unpack_release.sh DIRECTORY
# A directory that is right already stays: running containers have its files mounted, and would keep the removed ones.
set -e
part=$1.$$.part
rm -rf "$part"
mkdir -p "$part"
tar -x -f - -C "$part"
if diff -r "$1" "$part" >/dev/null 2>&1; then
    rm -rf "$part"
else
    rm -rf "$1"
    mv "$part" "$1"
fi
# Earlier runs that were cut off left theirs; one that is younger than an hour may be in use.
find "${1%/*}" -maxdepth 1 -name '*.part' -mmin +60 -exec rm -rf {} +
