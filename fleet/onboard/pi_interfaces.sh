#!/bin/sh
# Switch on interfaces of a Raspberry Pi, from its next boot on; as root. Only what is not on yet is named.
# Usage: pi_interfaces.sh FOLDER NAME=LINE...   (FOLDER has config.txt; NAME: i2c, spi, serial, camera; LINE for config.txt)
# raspi-config does what it can, if it is installed. Other lines get into config.txt between two marks.
# What fleet found there the first time is kept as config.txt.before-fleet and cmdline.txt.before-fleet.
set -eu
PATH=$PATH:/usr/sbin:/sbin
config=$1/config.txt
cmdline=$1/cmdline.txt
[ ! -e "$1/current/cmdline.txt" ] || cmdline=$1/current/cmdline.txt # Ubuntu since 25.10
shift
first='# fleet: what "interfaces:" of the inventory says'
last='# fleet: end'

durable() { sync "$@" 2>/dev/null || sync; }
# FILE.new takes the place of FILE, unless it is empty. On FAT, owner and mode are the same for all files.
replace() {
    [ -s "$1.new" ]
    durable "$1.new"
    mv "$1.new" "$1"
    durable "$(dirname "$1")"
}
keep() {
    [ ! -e "$1" ] || [ -e "$1.before-fleet" ] || {
        cp "$1" "$1.before-fleet.new"
        replace "$1.before-fleet"
    }
}

keep "$config"
keep "$cmdline"
if [ "$(grep -cxF "$first" "$config")" != "$(grep -cxF "$last" "$config")" ]; then
    echo "$config has one of the lines '$first' and '$last' without the other: remove it" >&2
    exit 1
fi
# Noted first: if this is interrupted, an interface may be on without anybody knowing that it waits for a reboot.
for pair in "$@"; do printf ' %s' "${pair%%=*}"; done >>/run/fleet-reboot # in memory: the next boot removes it
echo >>/run/fleet-reboot
names='' own=''
for pair in "$@"; do
    name=${pair%%=*}
    names="$names $name"
    if command -v raspi-config >/dev/null; then
        case $name in
            i2c) raspi-config nonint do_i2c 0 && continue ;;
            spi) raspi-config nonint do_spi 0 && continue ;;
            serial) raspi-config nonint do_serial_hw 0 && raspi-config nonint do_serial_cons 1 && continue ;;
        esac
    fi
    own="$own${pair#*=}
"
    case $name in
        i2c)
            echo i2c-dev >/etc/modules-load.d/fleet-i2c.conf.new
            replace /etc/modules-load.d/fleet-i2c.conf
            ;;
        serial) # no login and no messages of the kernel on the port
            if [ -e "$cmdline" ]; then
                sed -E 's/console=(serial0|ttyAMA0|ttyS0)[^ ]* ?//g' "$cmdline" >"$cmdline.new"
                replace "$cmdline"
            fi
            ;;
    esac
done
if [ -n "$own" ]; then
    FIRST=$first LAST=$last OWN=$own awk '
        $0 == ENVIRON["FIRST"] { inside = 1; next }
        $0 == ENVIRON["LAST"] { inside = 0; next }
        inside { if ($0 != "[all]") kept = kept $0 "\n"; next }
        { print }
        END { printf "%s\n[all]\n%s%s%s\n", ENVIRON["FIRST"], kept, ENVIRON["OWN"], ENVIRON["LAST"] }
    ' "$config" >"$config.new"
    replace "$config"
fi
sync
echo "note: reboot the robot to switch on:$names"
