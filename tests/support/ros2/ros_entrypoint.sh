#!/bin/sh
# Set up ROS as the images of the ROS project do, and run the command.
set -e
export AMENT_PREFIX_PATH="/opt/ros/$ROS_DISTRO"
export PYTHONPATH="$AMENT_PREFIX_PATH/lib/python3.11/site-packages"
LD_LIBRARY_PATH="$AMENT_PREFIX_PATH/lib"
for libraries in "$PYTHONPATH"/ros_*.libs; do
    LD_LIBRARY_PATH="$LD_LIBRARY_PATH:$libraries"
done
export LD_LIBRARY_PATH
exec "$@"
