#!/bin/sh
# Listen to a topic in the first running container that can. Standard input: open as long as somebody listens.
#
# Arguments: PROGRAM ARGUMENT... PROGRAM is Python source, for the container's Python: fleet/ros/ros2_check.py or tcpros.py.
# The line `== CONTAINER` comes before what the program prints. The code is the program's, or 3 if no container has ROS.
# Shared memory is switched off for Fast DDS: the program shall hear containers that do not share theirs with its own.

program=$1
shift
for container in $(docker ps --quiet); do
    docker exec "$container" python3 -c 'import sys' </dev/null >/dev/null 2>&1 || continue
    docker inspect --format '== {{slice .Name 1}}' "$container"
    docker exec --interactive --env FASTDDS_BUILTIN_TRANSPORTS=UDPv4 "$container" python3 -c "$program" "$@"
    code=$?
    [ "$code" = 3 ] || exit "$code"
done
exit 3
