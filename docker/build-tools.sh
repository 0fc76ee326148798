#!/bin/sh
# Usage: build-tools.sh TARGETARCH
#
# Installs CMake, catkin and the compiler that makes programs for the target; TARGETARCH is Docker's name of it. Its
# name in Debian is written to /architecture.
set -eu
case $1 in
    arm) architecture=armhf compiler=g++-arm-linux-gnueabihf ;;
    arm64) architecture=arm64 compiler=g++-aarch64-linux-gnu ;;
    amd64) architecture=amd64 compiler=g++-x86-64-linux-gnu ;;
    *)
        echo "build-tools: packages can be compiled for arm, arm64 and amd64, and not for $1" >&2
        exit 1
        ;;
esac
echo "$architecture" >/architecture
if [ "$(dpkg --print-architecture)" = "$architecture" ]; then
    compiler=g++
    if [ "${COMPILE:-cross}" = emulated ]; then echo 'build-tools: compiling under emulation, as COMPILE says'; fi
fi

apt-get -q update
# An image of the ROS project has a catkin of its own.
catkin=catkin
if [ -d /opt/ros ]; then catkin=python3-catkin-pkg; fi
if [ -z "$(apt-cache search --names-only "^$(echo "$compiler" | sed 's/+/[+]/g')\$")" ]; then
    echo "build-tools: this base has no compiler for $architecture ($compiler). Cure: the build argument COMPILE=emulated" >&2
    exit 1
fi
export DEBIAN_FRONTEND=noninteractive
apt-get -q install --yes --no-install-recommends "$catkin" "$compiler" cmake make python3-yaml
rm -rf /var/lib/apt/lists/*
