#!/bin/sh
# The lab's stand-in for Docker's convenience script (https://get.docker.com), which real robots get.
#
# The lab must work wherever Debian's archive can be reached, and install the same thing every time, so this one installs
# Debian's own packages. It is called like the real one, runs as root or with sudo, and shows its commands the same way.
#
#   sh get-docker.sh [--version VERSION] [--channel NAME] [--mirror NAME] [--setup-repo] [--dry-run]
set -e

VERSION=
DRY_RUN=
while [ $# -gt 0 ]; do
    case "$1" in
        --version)
            VERSION="${2#v}"
            shift
            ;;
        --channel | --mirror) shift ;;
        --setup-repo) ;;
        --dry-run) DRY_RUN=1 ;;
        --*) echo "Illegal option $1" ;;
    esac
    shift $(($# > 0 ? 1 : 0))
done

echo "# Executing docker install script (the lab's: Debian's packages)"

if command -v docker >/dev/null 2>&1; then
    echo 'Warning: the "docker" command appears to already exist on this system.' >&2
    echo 'You may press Ctrl+C now to abort this script.' >&2
    (
        set -x
        sleep 20
    )
fi

if [ "$(id -un)" = root ]; then
    as_root='sh -c'
elif command -v sudo >/dev/null 2>&1; then
    as_root='sudo -E sh -c'
elif [ -z "$DRY_RUN" ]; then
    echo 'Error: this installer needs the ability to run commands as root.' >&2
    echo 'We are unable to find either "sudo" or "su" available to make this happen.' >&2
    exit 1
fi

run() {
    if [ -n "$DRY_RUN" ]; then
        echo "$1"
    else
        (
            set -x
            $as_root "$1"
        )
    fi
}

run 'apt-get -qq update >/dev/null'

pin=
if [ -n "$VERSION" ] && [ -z "$DRY_RUN" ]; then
    # A pin is a pattern, as in the real script; the newest package that matches is taken.
    found="$(apt-cache madison docker.io | awk '{print $3}' | grep -m1 -F "$VERSION" || true)"
    if [ -z "$found" ]; then
        echo >&2
        echo "ERROR: '$VERSION' not found amongst apt-cache madison results" >&2
        echo >&2
        exit 1
    fi
    pin="=$found"
fi

run "DEBIAN_FRONTEND=noninteractive apt-get -y -qq install --no-install-recommends docker.io$pin docker-cli$pin docker-compose >/dev/null"

if [ -z "$DRY_RUN" ]; then
    run 'docker version'
    echo
    echo 'To run Docker as a non-privileged user, add it to the docker group.'
fi
