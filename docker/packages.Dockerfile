# A folder of catkin packages, in C++ or Python, for linux/arm64, linux/arm/v7 and linux/amd64. No RUN happens on the
# target's platform: this computer's own processor compiles, against a sysroot of the target's development packages.
#
#   docker build --platform linux/arm64 -f docker/packages.Dockerfile -t listener .

# The folder that holds the packages, or is one. Their package.xml files say which Debian packages they need.
ARG PACKAGES=packages
# BUILD_BASE and RUN_BASE: the same Debian release, for the build platform and for the target.
ARG BUILD_BASE=debian:bookworm-slim
ARG RUN_BASE=debian:bookworm-slim
# In place of both, an image that has ROS, such as ros:noetic-ros-base: it is base and sysroot, and for the build
# platform the home of the compiler.
ARG ROS_BASE=
# cross, or emulated: everything happens on the target's platform, where the base's release has no cross compiler.
ARG COMPILE=cross


FROM --platform=$BUILDPLATFORM ${ROS_BASE:-$BUILD_BASE} AS build-cross


FROM ${ROS_BASE:-$RUN_BASE} AS run-base


FROM run-base AS build-emulated


# hadolint ignore=DL3006
FROM build-${COMPILE} AS tools
ARG COMPILE
ARG TARGETARCH
COPY docker/build-tools.sh /
RUN /build-tools.sh "$TARGETARCH"
COPY docker/catkin_packages.py docker/cross-install.sh docker/rosdep.yaml docker/toolchain.cmake /


# What the packages need. An edit of their code leaves these two files as they are, and so the stages that read them.
FROM tools AS needs
ARG PACKAGES
COPY ${PACKAGES} /src
RUN python3 /catkin_packages.py needs /src /needs


FROM tools AS sysroot
COPY --from=run-base / /sysroot
COPY --from=needs /needs/build /needs/
# libc6-dev: not every package names something that needs it, and catkin looks for librt in each of them.
RUN /cross-install.sh --development --keys /needs/build "$(cat /architecture)" /sysroot /sysroot libc6-dev


# The cache holds what was compiled before: only packages that changed are compiled again. Another name of CACHE begins
# with an empty one. Times and modes are fixed, so that the same source gives the same layer in every checkout.
FROM sysroot AS packages
ARG PACKAGES
ARG CACHE=packages
COPY ${PACKAGES} /src
RUN --mount=type=cache,target=/cache python3 /catkin_packages.py build /src /target
COPY docker/entrypoint.sh docker/roslaunch.py docker/python_logging.yaml fleet/ros/tcpros.py /add/
RUN install -D --mode 755 /add/entrypoint.sh /target/usr/local/bin/entrypoint \
 && install -D --mode 755 /add/roslaunch.py /target/usr/local/bin/roslaunch \
 && install -D --mode 644 /add/python_logging.yaml /target/opt/packages/etc/ros/python_logging.yaml \
 && install -D --mode 644 /add/tcpros.py /target/usr/local/lib/fleet/tcpros.py \
 && find /target -name '*.pyc' -delete \
 && python3 -m compileall -q --invalidation-mode checked-hash -s /target -p / /target/opt/packages/lib \
 && chmod -R u=rwX,go=rX /target \
 && find /target -exec touch --no-dereference --date=@0 {} +


FROM tools AS ros-files
COPY --from=run-base /etc/os-release /base/etc/os-release
COPY --from=run-base /etc/apt /base/etc/apt
COPY --from=run-base /var/lib/dpkg/status /base/var/lib/dpkg/status
COPY --from=needs /needs/run /needs/
COPY --from=packages /libraries /needs/
# hadolint ignore=SC2046
RUN /cross-install.sh --keys /needs/run "$(cat /architecture)" /base /target $(cat /needs/libraries)


# An account for the nodes, as in docker/Dockerfile.
FROM tools AS account
COPY --from=run-base /etc/passwd /etc/group /target/etc/
# hadolint ignore=DL3003
RUN mkdir -p /target/home/ros/.ros \
 && chown -R 1000:1000 /target/home/ros \
 && cd /target/etc \
 && { grep -q '^[^:]*:[^:]*:1000:' group || echo 'ros:x:1000:' >> group; } \
 && { grep -q '^[^:]*:[^:]*:1000:' passwd || echo 'ros:x:1000:1000::/home/ros:/bin/bash' >> passwd; } \
 && find /target -exec touch --date=@0 {} +


FROM run-base
COPY --from=ros-files /target/ /
COPY --from=account /target/ /
USER 1000:1000
# Without line buffering, Docker gets what a node in C++ prints minutes later, in blocks of 4 kB.
ENV LANG=C.UTF-8 \
    HOME=/home/ros \
    OVERLAY=/opt/packages \
    PYTHONUNBUFFERED=1 \
    PYTHONPATH=/opt/packages/lib/python3/dist-packages \
    LD_LIBRARY_PATH=/opt/packages/lib \
    CMAKE_PREFIX_PATH=/opt/packages:/usr \
    ROS_PACKAGE_PATH=/opt/packages/share:/usr/share \
    ROS_HOME=/home/ros/.ros \
    ROS_LOG_DIR=/home/ros/.ros/log \
    ROS_PYTHON_LOG_CONFIG_FILE=/opt/packages/etc/ros/python_logging.yaml \
    ROSOUT_DISABLE_FILE_LOGGING=1 \
    ROSCONSOLE_STDOUT_LINE_BUFFERED=1 \
    ROSCONSOLE_FORMAT="[\${severity}] \${message}"
ENTRYPOINT ["/usr/local/bin/entrypoint"]
# Last, because it changes with every edit and is the smallest.
COPY --from=packages /target/ /
