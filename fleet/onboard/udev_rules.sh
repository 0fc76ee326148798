#!/bin/sh
# Write fleet's udev rules from standard input, and give the devices that are plugged in their names; as root.
# Usage: udev_rules.sh PATH [SHA256 REPLACE]   (REPLACE is replace_file.sh; without both, the file is removed)
# If udev does not take the rules, the earlier file is back: with the new one, the next attempt would find nothing to do.
set -eu
path=$1 digest=${2-} replace=${3-}
folder=$(dirname "$path")
before=$path.before
durable() { sync "$@" 2>/dev/null || sync; }

trap 'rm -f "$before"' EXIT
[ ! -e "$path" ] || cp -p "$path" "$before"
if [ -n "$digest" ]; then
    sh -c "$replace" replace_file "$path" "$digest"
else
    rm -f "$path"
    durable "$folder"
fi
if ! command -v udevadm >/dev/null || [ ! -S /run/udev/control ]; then
    echo 'note: udev does not run on this robot: the names come when it starts'
    exit 0
fi
if ! problem=$({
    udevadm control --reload &&
        udevadm trigger --action=change --subsystem-match=tty --subsystem-match=video4linux --subsystem-match=input
} 2>&1); then
    if [ -e "$before" ]; then mv "$before" "$path"; else rm -f "$path"; fi
    durable "$folder"
    echo "udev did not take the rules: ${problem:-it gave no reason}" >&2
    exit 1
fi
udevadm settle --timeout=10 || echo 'note: udev is still at work: the names come in a moment'
