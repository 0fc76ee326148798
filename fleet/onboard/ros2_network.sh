#!/bin/sh
# Print how the ROS 2 programs of a robot use its network. It only looks.
#
# No arguments. Sections begin with `== NAME`: the address that the desktop reached, the UDP ports in use, the multicast
# groups, and the running containers: a line with their name and network, and lines with their variables about ROS.

echo '== ssh'
echo "$SSH_CONNECTION"
echo '== udp'
cat /proc/net/udp
echo '== igmp'
cat /proc/net/igmp
echo '== containers'
docker ps --quiet 2>/dev/null | while read -r container; do
    docker inspect --format '{{.Name}} {{.HostConfig.NetworkMode}}{{range .Config.Env}}{{println}} {{.}}{{end}}' "$container"
done | grep -E '^/|^ (ROS|RMW|FASTDDS|FASTRTPS|CYCLONEDDS|ZENOH)_'
echo '== end'
