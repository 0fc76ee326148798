#!/bin/sh
# Print what Docker's daemon wrote at the end of its journal, unless Docker runs.
# systemd adds lines of its own at each attempt to start Docker. They say only that it failed, and would push the reason out
# of sight: they are shown if there are no others.
systemctl is-active --quiet docker && exit 0
lines=$(journalctl --quiet --unit docker --boot --lines 60 --no-pager --output cat 2>/dev/null)
own=$(printf '%s\n' "$lines" | grep -vE '^docker\.(service|socket): |^(Start|Stopp)(ing|ed) |^Failed to start |^Dependency ')
printf '%s\n' "${own:-$lines}" | tail -n 8
