#!/bin/sh
# Write a unit of systemd from standard input, and enable it; as root.
# Usage: systemd_unit.sh NAME SHA256 REPLACE [restart]   (REPLACE is replace_file.sh; restart: also start it anew now)
set -eu
unit=$1 digest=$2 replace=$3 restart=${4-}
sh -c "$replace" replace_file "/etc/systemd/system/$unit.service" "$digest"
systemctl daemon-reload
systemctl enable --quiet "$unit"
[ -z "$restart" ] || systemctl restart "$unit"
