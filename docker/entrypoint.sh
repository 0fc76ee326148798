#!/bin/sh
# Debian's ROS needs nothing but the image's environment. A ROS base image brings a setup file instead: read it, then
# put the talker in front again. exec, so that roslaunch is process 1 and `docker stop` reaches it.
set -e
for setup in /opt/ros/*/setup.sh; do
    if [ -f "$setup" ]; then
        # shellcheck source=/dev/null
        . "$setup"
        export ROS_PACKAGE_PATH="/opt/talker/share:$ROS_PACKAGE_PATH"
        export CMAKE_PREFIX_PATH="/opt/talker:$CMAKE_PREFIX_PATH"
        export PYTHONPATH="/opt/talker/lib/python3/dist-packages:$PYTHONPATH"
    fi
done
exec "$@"
