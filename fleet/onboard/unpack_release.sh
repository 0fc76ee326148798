#!/bin/sh
# Unpack a release (a tar archive on standard input) into its folder, whole or not at all, and safe from a power cut.
# Usage: unpack_release.sh FOLDER
# A folder that is right already stays: running containers have its files mounted, and would keep the removed ones.
# A folder that is not right is moved aside and never written into: what is in it may be somebody's.
set -e
umask 022
part=$1.$$.part
trap 'rm -rf "$part"' EXIT # a disk that is full gets its room back
mkdir -p "$part"
# Secrets are in it. Containers reach what is mounted; other logins do not come in.
chmod 700 "$part"
# Whoever removes old releases leaves this one alone until it is started, or for an hour (remove_releases.sh).
: >"${1%/*}/.shipping-${1##*/}"
tar -x -p -f - -C "$part"
chmod 700 "$part" # an archive may have a mode for the folder itself
# The last file of the archive: tar is content with an archive that was cut between two files.
[ -e "$part/services" ]
# Another desktop may write the same release just now.
exec 9>>"${1%/*}/.unpacking"
flock 9
if diff -r "$1" "$part" >/dev/null 2>&1; then
    rm -rf "$part"
    chmod 700 "$1"
else
    find "$part" -exec sync {} + 2>/dev/null || sync
    if [ -e "$1" ]; then mv -T "$1" "$1.replaced.$$.part"; fi
    mv -T "$part" "$1"
fi
sync "${1%/*}" 2>/dev/null || sync
