#!/bin/sh
# Listen to a topic in a running container that can. Standard input: open as long as somebody listens.
#
# Arguments: VARIABLE PROGRAM ARGUMENT... Containers with VARIABLE (ROS_MASTER_URI=http://localhost:11311) and the host's network
# come first: they see what the inventory means. PROGRAM is Python source, for the container's Python: fleet/ros/ros2_check.py or tcpros.py.
# `== CONTAINER` comes before what the program prints. If it ends with 3 (it cannot listen there) or 4 (nobody publishes the
# topic there), the next container is tried, but for those that see the same as one with 4. Any other code is the end.
# At the end, the code is 4 or 3, and a last `== CONTAINER` says whose reason counts: the first with 4, or else with 3.
# Shared memory is switched off for Fast DDS: the program shall hear containers that do not share theirs with its own.

variable=$1 program=$2
shift 2

# Print what decides which topics a container sees: its network and its variables of ROS.
sight() {
    docker inspect --format '{{if eq .HostConfig.NetworkMode "host"}}network=host{{else}}network={{.Id}}{{end}}{{range .Config.Env}}
{{.}}{{end}}' "$1" | grep -E '^(network=|ROS_|RMW_)'
}

first='' others=''
for container in $(docker ps --quiet); do
    if sight "$container" | grep -cxF -e "network=host" -e "$variable" | grep -qx 2; then
        first="$first $container"
    else
        others="$others $container"
    fi
done
[ -n "$first$others" ] || echo 'none is running'
cannot='' unpublished='' seen=''
for container in $first $others; do
    docker exec "$container" python3 -c 'import sys' </dev/null >/dev/null 2>&1 || continue
    here=$(sight "$container" | cksum)
    case $seen in *"|$here|"*) continue ;; esac
    docker inspect --format '== {{slice .Name 1}}' "$container"
    docker exec --interactive --env FASTDDS_BUILTIN_TRANSPORTS=UDPv4 "$container" python3 -c "$program" "$@"
    code=$?
    case $code in
        3) cannot=${cannot:-$container} ;;
        4) unpublished=${unpublished:-$container} seen="$seen|$here|" ;;
        *) exit "$code" ;;
    esac
done
for container in ${unpublished:-$cannot}; do docker inspect --format '== {{slice .Name 1}}' "$container"; done
[ -z "$unpublished" ] || exit 4
exit 3
