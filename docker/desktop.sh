#!/bin/sh
# What this computer needs for building images and for the lab, on Debian, Ubuntu and their kin.
#
# Says what is missing, installs exactly that with apt, and is quiet when there is nothing to do. A Docker that works is
# not touched. Runs as root, or as a user with sudo; sudo is only used when something has to be changed. With the word
# `test`, what the tests need is there afterwards, too.
set -eu
for_tests="${1:-}"
PATH="$PATH:/usr/sbin:/sbin" # where dockerd and update-binfmts are; a user's PATH may lack it

say() { echo "desktop: $*"; }
fail() {
    say "$*" >&2
    exit 1
}
quietly() { "$@" >>"$log" 2>&1; }
have() { command -v "$1" >/dev/null 2>&1; }

as_root() {
    if [ "$(id -u)" = 0 ]; then
        "$@"
    elif have sudo; then
        sudo "$@"
    else
        fail "this needs root, and there is no sudo: $*"
    fi
}

# --- What is there?

docker_works() { have docker && docker info >/dev/null 2>&1; }

# By its own file, not by name: engines inside containers show up as processes, too.
engine_runs() { grep -qsx dockerd "/proc/$(cat /var/run/docker.pid 2>/dev/null)/comm"; }

# Every client on PATH is asked, as an old and a new one often live side by side: from version 23 on a client builds with
# BuildKit if it has the buildx plugin, before that by itself.
docker_builds() (
    IFS=:
    for folder in $PATH; do
        client="$folder/docker"
        [ -x "$client" ] || continue
        if "$client" buildx version >/dev/null 2>&1; then return 0; fi
        major="$("$client" --version | sed -n 's/^Docker version \([0-9]*\)\..*/\1/p')"
        if [ -n "$major" ] && [ "$major" -ge 19 ] && [ "$major" -lt 23 ]; then return 0; fi
    done
    return 1
)

# A handler works inside containers only with flag F, which keeps the emulator open.
emulates() {
    handler="/proc/sys/fs/binfmt_misc/qemu-$1"
    [ -r "$handler" ] && grep -q '^enabled' "$handler" && grep -q '^flags:.*F' "$handler"
}

arm_runs() {
    case "$(uname -m)" in
        aarch64 | arm64) return 0 ;;
        *) emulates aarch64 && emulates arm ;;
    esac
}

python_makes_environments() { python3 -c 'import ensurepip, venv' >/dev/null 2>&1; }

# Debian's certificates of its archive have to be there for mmdebstrap; Ubuntu does not bring them.
debian_keys() { [ -e /usr/share/keyrings/debian-archive-keyring.gpg ] || [ -e /usr/share/keyrings/debian-archive-keyring.pgp ]; }

static_busybox() { have busybox && ! head -c 4096 "$(command -v busybox)" | grep -q ld-linux; }

# --- What is missing?

known_to_apt() { [ -n "$(apt-cache search --names-only "^$1\$" 2>/dev/null)" ]; }

engine_missing() { ! have dockerd && ! docker_works; }

why_docker_does_not_work() {
    answer="$(docker info 2>&1 || true)"
    case "$answer" in
        *"permission denied"*)
            fail "Docker runs, and this login may not use it. Cure: sudo usermod -aG docker $(id -un), then log in again"
            ;;
    esac
    if [ -n "${DOCKER_HOST:-}" ]; then
        fail "DOCKER_HOST=$DOCKER_HOST does not answer. Cure: start that Docker Engine, or unset DOCKER_HOST"
    fi
}

missing() {
    if engine_missing; then
        echo docker.io
        # Newer Debian releases have the client and its build plugin in packages of their own.
        for package in docker-cli docker-buildx; do ! known_to_apt "$package" || echo "$package"; done
        [ "$(id -u)" = 0 ] || echo acl
    elif ! docker_builds; then
        for package in docker-buildx docker-buildx-plugin; do
            if known_to_apt "$package"; then
                echo "$package"
                break
            fi
        done
    fi
    have mmdebstrap || echo mmdebstrap
    have arch-test || echo arch-test
    debian_keys || echo debian-archive-keyring
    [ "$(id -u)" = 0 ] || have newuidmap || echo uidmap
    arm_runs || have qemu-aarch64-static || echo qemu-user-static
    arm_runs || have update-binfmts || echo binfmt-support
    have ssh || echo openssh-client
    have python3 || echo python3
    python_makes_environments || echo python3-venv
    ! sshd_missing || echo openssh-server
    [ -z "$for_tests" ] || have zstd || echo zstd
    [ -z "$for_tests" ] || have ip || echo iproute2
    # A USB stick in a file; not every distribution has the second.
    [ -z "$for_tests" ] || have mkfs.vfat || echo dosfstools
    [ -z "$for_tests" ] || have fusefat || ! known_to_apt fusefat || echo fusefat
    # The one program of the tests' images: they have no libraries.
    [ -z "$for_tests" ] || static_busybox || echo busybox-static
    [ -z "$for_tests" ] || have openssl || echo openssl
}

# Tests start SSH servers of their own, as programs; nobody's computer begins to let people in because of that.
sshd_missing() { [ -n "$for_tests" ] && ! have sshd; }

without_starting_services() {
    refuse=/usr/sbin/policy-rc.d
    if ! sshd_missing || [ -e "$refuse" ]; then
        "$@"
        return
    fi
    as_root sh -c "printf '#!/bin/sh\nexit 101\n' > $refuse && chmod 755 $refuse" || return
    result=0
    "$@" || result=$?
    as_root rm -f "$refuse"
    if [ -d /run/systemd/system ]; then as_root systemctl disable --quiet ssh.service ssh.socket 2>/dev/null || true; fi
    return "$result"
}

# --- Put it there

install_missing() {
    [ -n "$(missing)" ] || return 0
    have apt-get || fail "missing: $(missing | tr '\n' ' ')- and no apt-get here. Cure: install them your system's way"
    say "renewing apt's package lists"
    log="$(mktemp -t fleet-desktop.XXXXXX)" # what apt-get says; an error names it
    quietly as_root apt-get -qq -o DPkg::Lock::Timeout=300 update || say "that failed; continuing with the old ones"
    packages="$(missing | sort -u | tr '\n' ' ')"
    say "installing with apt-get: $packages"
    # One word per package.
    # shellcheck disable=SC2086
    quietly without_starting_services as_root env DEBIAN_FRONTEND=noninteractive apt-get -qq -y -o DPkg::Lock::Timeout=300 \
        install --no-install-recommends $packages || fail "apt-get failed: $(grep '^E:' "$log" | tail -n 1). Its whole output: $log"
    rm -f "$log"
}

start_engine() {
    if engine_runs; then
        wait_for_docker 30 && return 0
        why_docker_does_not_work
        fail "a Docker Engine runs, and does not answer. Cure: see docker info"
    fi
    if [ -d /run/systemd/system ]; then
        say "starting Docker Engine with systemctl"
        as_root systemctl enable --quiet --now docker
    else
        # Without an init system, nobody has mounted what containers are limited with.
        if ! grep -q ' /sys/fs/cgroup' /proc/mounts; then
            say "mounting control groups on /sys/fs/cgroup"
            as_root mount -t cgroup2 cgroup2 /sys/fs/cgroup
        fi
        say "starting Docker Engine"
        if ! as_root service docker start >/dev/null 2>&1 || { ! wait_for_docker 10 && ! engine_runs; }; then
            say "starting dockerd directly, as there is no init system; its log: /var/log/dockerd.log"
            as_root sh -c 'nohup setsid dockerd > /var/log/dockerd.log 2>&1 < /dev/null &'
        fi
    fi
    wait_for_docker 60 || {
        why_docker_does_not_work
        fail "Docker Engine does not start. Cure: see journalctl -u docker or /var/log/dockerd.log"
    }
}

wait_for_docker() {
    tries="$1"
    while [ "$tries" -gt 0 ]; do
        if docker_works || may_not_use_docker; then return 0; fi
        tries=$((tries - 1))
        sleep 1
    done
    return 1
}

may_not_use_docker() {
    case "$(docker info 2>&1 || true)" in *"permission denied"*) return 0 ;; *) return 1 ;; esac
}

# Only after this script installed Docker: a login that already had one decides itself who may use it.
let_this_login_use_docker() {
    [ "$(id -u)" != 0 ] || return 0
    say "letting $(id -un) use Docker (group docker, from the next login on; until then by an access list)"
    as_root usermod -aG docker "$(id -un)"
    as_root setfacl -m "u:$(id -un):rw" /var/run/docker.sock
}

set_up_emulation() {
    say "setting up ARM emulation"
    if [ ! -e /proc/sys/fs/binfmt_misc/register ]; then
        as_root mount -t binfmt_misc binfmt_misc /proc/sys/fs/binfmt_misc || true
    fi
    for name in qemu-aarch64 qemu-arm; do
        as_root update-binfmts --enable "$name" >/dev/null 2>&1 || true
    done
    arm_runs || say "ARM programs cannot be emulated here; the lab will use this computer's own architecture"
}

docker_was_missing=
if engine_missing; then
    if have docker; then why_docker_does_not_work; fi
    docker_was_missing=yes
fi
install_missing
docker_works || start_engine
if [ -n "$docker_was_missing" ]; then let_this_login_use_docker; fi
docker_works || why_docker_does_not_work
docker_works || fail "Docker does not answer. Cure: see docker info"
docker_builds || fail "no docker client here can build with BuildKit. Cure: install Docker's buildx plugin (package docker-buildx)"
arm_runs || set_up_emulation
