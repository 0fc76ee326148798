#!/bin/sh
# Debian's ROS needs nothing but the image's environment. A ROS base image brings a setup file instead: read it, then
# put our own packages in front again. exec, so that roslaunch is process 1 and `docker stop` reaches it.
set -e
overlay=${OVERLAY:-/opt/talker}
for setup in /opt/ros/*/setup.sh; do
    if [ -f "$setup" ]; then
        # shellcheck source=/dev/null
        . "$setup"
        export ROS_PACKAGE_PATH="$overlay/share:$ROS_PACKAGE_PATH"
        export CMAKE_PREFIX_PATH="$overlay:$CMAKE_PREFIX_PATH"
        export PYTHONPATH="$overlay/lib/python3/dist-packages:$PYTHONPATH"
        export LD_LIBRARY_PATH="$overlay/lib:$LD_LIBRARY_PATH"
    fi
done
exec "$@"
