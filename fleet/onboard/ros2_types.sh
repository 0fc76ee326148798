#!/bin/sh
# Print the definition of a ROS 2 message type, and of each type that it uses. Runs in a container.
#
# Argument: TYPE (std_msgs/String). Before each definition there is a line `=== TYPE`. The code is 0 if TYPE was found.
# A package has its definitions in PREFIX/share/PACKAGE/msg. The prefixes are those that a program of the container was
# started with, those of ROS, and for any other installation the first folder of that package. The search for that folder
# takes at most 20 seconds.

prefixes=$(
    cat /proc/[0-9]*/environ 2>/dev/null | tr '\0' '\n' | sed -n 's/^AMENT_PREFIX_PATH=//p' | tr ':' '\n' | sort -u
    ls -d /opt/ros/* 2>/dev/null
)

look_for() {
    package=${1%%/*}
    for prefix in $prefixes; do
        file=$prefix/share/$package/msg/${1##*/}.msg
        [ ! -f "$file" ] || return 0
    done
    file=$(timeout 20 find / -xdev -path "*/share/$package/msg/${1##*/}.msg" 2>/dev/null | head -n 1)
    prefixes="$prefixes ${file%/share/*}"
    [ -n "$file" ]
}

todo=$1
seen=' '
while [ -n "$todo" ]; do
    next=
    for type in $todo; do
        case $seen in *" $type "*) continue ;; esac
        seen="$seen$type "
        look_for "$type" || exit 1
        echo "=== $type"
        cat "$file"
        echo
        words=$(sed -n 's/^[[:space:]]*\([A-Za-z][A-Za-z0-9_/]*\)[^A-Za-z0-9_/].*/\1/p' "$file")
        for used in $words; do
            case $used in
                bool | byte | char | float32 | float64 | int8 | uint8 | int16 | uint16) ;;
                int32 | uint32 | int64 | uint64 | string | wstring) ;;
                */*) next="$next ${used%%/*}/${used##*/}" ;;
                *) next="$next $package/$used" ;;
            esac
        done
    done
    todo=$next
done
