#!/bin/sh
# Write fleet's udev rules from standard input, and give the devices that are plugged in their names; as root.
# Usage: udev_rules.sh PATH   (without input the file is removed)
set -eu
mkdir -p "$(dirname "$1")"
cat >"$1.new"
if [ -s "$1.new" ]; then
    sync "$1.new" 2>/dev/null || sync
    mv "$1.new" "$1"
else
    rm -f "$1.new" "$1"
fi
sync "$(dirname "$1")" 2>/dev/null || sync
if ! command -v udevadm >/dev/null; then
    echo 'note: there is no udev on this robot: the names come with it'
    exit 0
fi
udevadm control --reload
udevadm trigger --action=change --subsystem-match=tty --subsystem-match=video4linux --subsystem-match=input
udevadm settle --timeout=10 || echo 'note: udev is still at work: the names come in a moment'
