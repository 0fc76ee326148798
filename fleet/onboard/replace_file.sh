#!/bin/sh
# Replace a file by standard input, whole or not at all. Owner and mode stay.
# Usage: replace_file.sh PATH SHA256 [keep]   (keep: what fleet found there the first time stays as PATH.before-fleet)
#    or: replace_file.sh PATH SHA256 secret   (only its owner may read it, from its first byte on)
# If the connection is lost, the input just ends. So the digest says whether it is whole; otherwise the exit code is 74.
set -eu
path=$1 digest=$2 keep=${3-}
folder=$(dirname "$path")
new=$path.new kept=$path.before-fleet
durable() { sync "$@" 2>/dev/null || sync; }

mkdir -p "$folder"
trap 'rm -f "$new" "$kept.new"' EXIT
[ ! -e "$path" ] || cp -p "$path" "$new"
if [ "$keep" = secret ]; then
    : >"$new"
    chmod 600 "$new"
fi
cat >"$new"
if [ "$(sha256sum <"$new" | cut -c1-64)" != "$digest" ]; then
    echo "the bytes for $path did not arrive whole, so it stays as it was" >&2
    exit 74
fi
if [ "$keep" = keep ] && [ -e "$path" ] && [ ! -e "$kept" ]; then
    cp -p "$path" "$kept.new"
    durable "$kept.new"
    mv "$kept.new" "$kept"
    durable "$folder" # before the original goes: after a power cut one of both must be there
fi
durable "$new" # after a power cut it is the old file or the new one, and not empty
mv "$new" "$path"
durable "$folder"
