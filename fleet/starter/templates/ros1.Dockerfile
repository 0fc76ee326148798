# ROS packages for a robot, built with catkin_make. The programs that build run on the robot's platform: this computer
# emulates it. An edit of the code builds only the packages again, not their dependencies.
ARG ROS_IMAGE=ros:@DISTRO@-ros-base

FROM scratch AS sources
@COPY@

# The manifests alone decide which dependencies are installed.
FROM ${ROS_IMAGE} AS manifests
COPY --from=sources /ws/src /ws/src
RUN find /ws/src '(' ! -type d ! -name package.xml -o -type d -empty ')' -delete

FROM ${ROS_IMAGE} AS dependencies
ARG DEBIAN_FRONTEND=noninteractive
COPY --from=manifests /ws/src /ws/src
RUN apt-get update \
 && rosdep update --include-eol-distros --rosdistro "$ROS_DISTRO" \
 && rosdep install --from-paths /ws/src --ignore-src --rosdistro "$ROS_DISTRO" --default-yes \
 && rm -rf /var/lib/apt/lists/* /root/.ros /ws

FROM dependencies AS build
COPY --from=sources /ws/src /ws/src
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
RUN source "/opt/ros/$ROS_DISTRO/setup.bash" \
 && catkin_make -C /ws -DCMAKE_BUILD_TYPE=Release

# The devel space is used, not the install space: packages without install rules work, too.
FROM dependencies
ENTRYPOINT ["/bin/bash", "-c", "source /ws/devel/setup.bash && exec \"$@\"", "--"]
COPY --from=build /ws/src /ws/src
COPY --from=build /ws/devel /ws/devel
