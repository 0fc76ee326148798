#!/bin/sh
# Print what this robot has, in sections; read only, change nothing.
# Usage: probe.sh [images]
# `images` adds the sections about layers and transfers, which take longer. fleet/robot/probe.py reads the answer.
section() { printf '\n%s %s\n' '=fleet=' "$1"; }

identity() { # first and alone: a robot that says nothing for seconds counts as silent
    section identity
    cat /etc/machine-id /proc/sys/kernel/random/boot_id 2>/dev/null
}
machine() {
    section machine
    uname -m
    section userland
    dpkg --print-architecture 2>/dev/null || getconf LONG_BIT 2>/dev/null
    section os
    # shellcheck source=/dev/null
    [ ! -r /etc/os-release ] || . /etc/os-release 2>/dev/null
    printf '%s\n' "${PRETTY_NAME:-unknown}"
    section login
    id -un
    printf '%s\n' "$HOME"
    id -Gn
    section home
    if [ ! -d "$HOME" ]; then
        echo missing
    elif [ ! -e "$HOME/.fleet" ] && [ ! -w "$HOME" ] && [ "$(stat -c %u "$HOME" 2>/dev/null)" != "$(id -u)" ]; then
        echo foreign
    fi
    section missing
    for name in awk cat cp cut date diff grep head id mkdir mv readlink rm sed setsid sha256sum sleep sort stat sync \
        tail tar tr xargs; do
        command -v "$name" >/dev/null || echo "$name"
    done
    # Busybox has these too, without the options that the scripts use.
    env -C / true 2>/dev/null || echo env
    flock --version >/dev/null 2>&1 || echo flock
    find / -maxdepth 0 -printf '' 2>/dev/null || echo find
    section sudo
    if [ "$(id -u)" = 0 ]; then
        echo root
    elif ! command -v sudo >/dev/null; then
        echo none
    elif sudo -n true 2>/dev/null; then
        echo free
    else
        echo password
    fi
    section clock
    date +%s
    section memory
    sed -n 's/^MemTotal: *\([0-9]*\) kB$/\1/p' /proc/meminfo

    section model
    cat /proc/device-tree/model /sys/firmware/devicetree/base/model 2>/dev/null | tr '\000' '\n' | head -n 1
    section l4t
    # shellcheck disable=SC2016  # the braces are dpkg-query's
    head -n 1 /etc/nv_tegra_release 2>/dev/null || dpkg-query -W -f '${Version}' nvidia-l4t-core 2>/dev/null
    section raw
    # Docker 28 and newer need the iptables table `raw`, unless iptables works over nf_tables (which Jetsons' kernels have only
    # in part), or a setting of 28.0.2 says to do without (moby #49557).
    PATH=$PATH:/usr/sbin:/sbin
    kernel=$(uname -r)
    if grep -rqs '^[^#]*DOCKER_INSECURE_NO_IPTABLES_RAW=1' /etc/systemd/system/docker.service.d /etc/default/docker; then
        echo unused
    elif [ ! -e /etc/nv_tegra_release ] && iptables --version 2>/dev/null | grep -q nf_tables; then
        echo unused
    elif [ -e /sys/module/iptable_raw ] || modprobe -n -q iptable_raw 2>/dev/null; then
        echo yes
    else
        case $({ zcat /proc/config.gz || cat "/boot/config-$kernel"; } 2>/dev/null | grep CONFIG_IP_NF_RAW) in
            *=y) echo yes ;;
            ?*) echo no ;;
            *) [ ! -e "/lib/modules/$kernel" ] || ! command -v modprobe >/dev/null || echo no ;;
        esac
    fi
    section toolkit
    command -v nvidia-ctk
    section cdi
    for file in /etc/cdi/* /var/run/cdi/*; do
        case $file in
            *.json | *.yaml | *.yml)
                echo spec
                tr ',{}' '[\n*]' <"$file" | head -c 1000000 |
                    sed -nE "s/^[[:space:]-]*[\"']?(kind|name)[\"']?[[:space:]]*:[[:space:]]*[\"']?([A-Za-z0-9_.:\/-]+).*/\1 \2/p"
                ;;
        esac
    done 2>/dev/null | head -n 300
    section devices
    rules=/etc/udev/rules.d/99-fleet.rules
    if [ "$wanted" = images ]; then # a release may want any
        find /dev -maxdepth 4 ! -type f ! -type s ! -path '/dev/shm/*' 2>/dev/null | head -n 5000
    else
        {
            sed -n 's,.* SYMLINK+="\([^"]*\)"$,/dev/\1,p' "$rules"
            ls -d /dev/serial/by-id/* /dev/serial[0-9] /dev/ttyUSB* /dev/ttyACM* /dev/ttyAMA* /dev/ttyTHS* /dev/v4l/by-id/* \
                /dev/video* /dev/i2c-* /dev/spidev* /dev/gpiochip* /dev/input/by-id/*
        } 2>/dev/null | while read -r device; do [ ! -e "$device" ] || echo "$device"; done | head -n 300
    fi
    section udev
    head -c 10000 "$rules" 2>/dev/null
    section pi
    for folder in /boot/firmware /boot; do
        [ -f "$folder/config.txt" ] || continue
        cmdline=$folder/cmdline.txt
        [ ! -e "$folder/current/cmdline.txt" ] || cmdline=$folder/current/cmdline.txt # Ubuntu since 25.10
        printf '%s\n' "$folder" "$(command -v raspi-config)" "$(head -n 1 "$cmdline" 2>/dev/null | cut -c1-2000)"
        tr -d '\r' <"$folder/config.txt" | grep -E '^(device_tree_param|dtparam|enable_uart|camera_auto_detect|start_x)=' |
            cut -c1-200 | head -n 40
        break
    done
    section reboot
    head -n 20 /run/fleet-reboot 2>/dev/null
    section groups
    getent group | cut -d: -f1 | head -n 500

    section temperature
    cat /sys/class/thermal/thermal_zone0/temp 2>/dev/null
    section emulates
    grep -l '^enabled' /proc/sys/fs/binfmt_misc/qemu-* 2>/dev/null
    section boot
    systemctl is-enabled docker 2>/dev/null
    section finish
    if command -v systemctl >/dev/null; then
        systemctl is-enabled fleet-finish 2>/dev/null
        sha256sum /etc/systemd/system/fleet-finish.service 2>/dev/null | cut -c1-64
    else
        echo 'no systemd'
    fi
    section 'boot unit'
    if command -v systemctl >/dev/null; then
        systemctl is-enabled fleet-boot 2>/dev/null
        cat /etc/systemd/system/fleet-boot.service "$HOME/.fleet/boot.sh" 2>/dev/null | sha256sum | cut -c1-64
    else
        echo 'no systemd'
    fi
    section daemon
    cat /etc/docker/daemon.json 2>/dev/null || sudo -n cat /etc/docker/daemon.json 2>/dev/null
    section certs
    [ ! -d /etc/docker/certs.d ] || { [ "$(id -u)" = 0 ] && sha256sum /etc/docker/certs.d/*/*; } 2>/dev/null ||
        sudo -n sh -c 'sha256sum /etc/docker/certs.d/*/*' 2>/dev/null
    section packages
    # shellcheck disable=SC2016  # the braces are dpkg-query's
    dpkg-query -W -f '${db:Status-Abbrev}${Package}\n' docker-ce docker.io docker-buildx \
        docker-compose docker-compose-v2 podman-docker zstd 2>/dev/null | sed -n 's/^ii *//p'
    section interrupted
    ls /var/lib/dpkg/updates 2>/dev/null
    grep -E '^Status: .* (half-configured|half-installed|unpacked)$' /var/lib/dpkg/status 2>/dev/null
    section source
    ls /etc/apt/sources.list.d/docker.list 2>/dev/null
    section group
    getent group docker
}
engine() {
    info=
    if command -v docker >/dev/null; then
        # shellcheck disable=SC2016  # $name is the template's
        info=$(docker info --format '{{.DockerRootDir}} {{.Driver}}{{range .DriverStatus}} {{index . 1}}{{end}}
{{range .SecurityOptions}}{{println .}}{{end}}{{range $name, $_ := .Runtimes}}runtime {{println $name}}{{end}}default {{println .DefaultRuntime}}{{range .ClientInfo.Plugins}}{{if eq .Name "compose"}}compose {{println .Version}}{{end}}{{end}}' 2>/dev/null)
    fi
    root=${info%% *}
    case $info in *io.containerd.snapshotter*) root=/var/lib/containerd ;; esac
    section disk
    df -Pk "${root:-/var/lib/docker}" 2>/dev/null || df -Pk /var/lib
    section 'home disk'
    df -Pk "$HOME/.fleet" 2>/dev/null || df -Pk "$HOME"
    section store
    printf '%s\n' "$info" | head -n 1
    # Which engine `docker` leads to: snap's, one that runs without root, podman's. And its runtimes.
    section engine
    printf '%s\n' "$info" | tail -n +2
    program=$(command -v docker) && readlink -f "$program"
    for file in /snap/docker/current "$HOME/.config/systemd/user/docker.service"; do
        [ ! -e "$file" ] || echo "there is $file"
    done
    section compose
    # `docker info` has asked its plugins already. Without the engine it tells nothing.
    printf '%s\n' "$info" | sed -n 's/^compose //p' | grep . || docker compose version --short 2>/dev/null
}
stacks() {
    section stacks
    for here in "$HOME"/.fleet/stacks/*/; do
        [ -d "$here" ] || continue
        here=${here%/}
        printf 'stack %s\ncurrent %s\n' "${here##*/}" "$(readlink "$here/current" 2>/dev/null)"
        (
            cd "$here/current" 2>/dev/null || exit
            printf 'checksum '
            find . -type f -print | LC_ALL=C sort | tr '\n' '\0' | xargs -0 -r sha256sum | sha256sum | cut -c1-64
            sed 's/^/service /' services 2>/dev/null
            sed 's/^/boot /' boot 2>/dev/null
        )
        [ ! -e "$here/stopped" ] || echo stopped
        for release in "$here"/releases/*/; do
            [ ! -d "$release" ] || { release=${release%/} && printf 'release %s\n' "${release##*/}"; }
        done
        printf 'data '
        timeout 2 du -sk "$here/data" 2>/dev/null | cut -f1 | grep . || if [ -d "$here/data" ]; then echo unknown; else echo 0; fi
        [ ! -s "$here/journal" ] || printf 'journal %s\n' "$(head -n 1 "$here/journal" | cut -c1-200)"
        [ ! -s "$here/dev/state" ] || printf 'dev %s\n' "$(head -n 1 "$here/dev/state" | cut -c1-200)"
        sed 's/^/proved /' "$here/proved" 2>/dev/null
        tail -n 200 "$here/history" 2>/dev/null | tr -d '\000' | cut -c1-1000 | sed 's/^/event /'
    done
    section legacy
    # While adopt.sh works, the release may be in its new place already.
    old=$(readlink "$HOME/.fleet/current" 2>/dev/null)
    [ -z "$old" ] || sed -n 's/^  "name": "\(.*\)",$/\1/p' "$HOME/.fleet/$old/compose.override.yaml" \
        "$HOME"/.fleet/stacks/*/"$old"/compose.override.yaml 2>/dev/null | head -n 1
}
versions() {
    section docker
    docker version --format '{{.Server.Version}}{{range .Server.Components}} {{.Name}}{{end}}' 2>&1
    section specs
    # Before Docker 25 there is no such field. It is empty if CDI is off.
    [ ! -e /etc/cdi ] && [ ! -e /var/run/cdi ] || docker info --format '{{range .CDISpecDirs}}{{println .}}{{end}}' 2>/dev/null
    section client
    docker --version 2>/dev/null
}
containers() {
    listing=$(docker ps --all --no-trunc \
        --format '{{.ID}}|{{.Label "fleet.release"}}|{{.Names}}|{{.Label "com.docker.compose.project"}}|{{.Ports}}' 2>/dev/null)
    section containers
    # With `.Id` Docker takes another way, on which a missing Health is an error.
    printf '%s\n' "$listing" | awk -F '|' '$2 { print $1 }' | xargs -r docker inspect --format \
        '{"id":{{json .ID}},"name":{{json .Name}},"state":{{json .State.Status}},"code":{{.State.ExitCode}},"restarts":{{.RestartCount}},"health":{{with .State.Health}}{{json .Status}}{{else}}""{{end}},"policy":{{json .HostConfig.RestartPolicy.Name}},"started":{{json .State.StartedAt}},"ended":{{json .State.FinishedAt}},"service":{{json (index .Config.Labels "com.docker.compose.service")}},"release":{{json (index .Config.Labels "fleet.release")}},"stack":{{json (index .Config.Labels "fleet.stack")}},"robot":{{json (index .Config.Labels "fleet.robot")}}}' 2>/dev/null
    section claims
    printf '%s\n' "$listing" | cut -d '|' -f 3-
}
images() {
    listing=$(docker image ls --all --no-trunc --format '{{.Repository}}:{{.Tag}} {{.ID}} {{.Size}}' 2>/dev/null)
    section images
    # Name, ID, the configuration that its receipt names, and the digest of the receipt.
    printf '%s\n' "$listing" | grep '^[^ ]*:fleet-' | while read -r name id _; do
        receipt=$HOME/.fleet/receipts/${name##*:fleet-}
        if [ -f "$receipt" ]; then
            printf '%s %s %s %s\n' "$name" "$id" "$(sed -n 's/.*"config": *{[^}]*"digest": *"\([^"]*\)".*/\1/p' "$receipt")" "$(sha256sum <"$receipt" | cut -c1-64)"
        else
            printf '%s %s\n' "$name" "$id"
        fi
    done
    [ "$wanted" = images ] || return 0
    section layers
    printf '%s\n' "$listing" | awk '$2 { print $2 }' | sort -u |
        xargs -r docker image inspect --format '{{.Id}} {{json .RootFS.Layers}}' 2>/dev/null
    section sizes
    printf '%s\n' "$listing" | awk '$1 ~ /:fleet-/ { print $1, $3 }'
    # What interrupted commands have left. Whoever is at work has touched his files within the hour; a piece of an upload,
    # or a pull, waits a day for the next attempt. What was moved aside (*.replaced.*) may be somebody's.
    section leftovers
    (
        cd "$HOME/.fleet" 2>/dev/null || exit
        find stacks/*/releases -mindepth 1 -maxdepth 1 -name '*.part' ! -name '*.replaced.*' -mmin +60
        find receipts -mindepth 1 -mmin +60 \( -size 0 -o -name '*.new' -o -name new \)
        find spool -mindepth 1 -type f ! -name lock ! -name holder -mmin +1440
        find pulled -mindepth 1 -type f \( -name references -o -name '*.new' \) -mmin +1440
        [ ! -e spool/lock ] || ! flock -n spool/lock true || printf '%s\n' "$listing" | sed -n 's,^\(fleet/incoming:[^ ]*\) .*,\1,p'
    ) 2>/dev/null
}
transfers() {
    section receipts
    for file in "$HOME"/.fleet/receipts/*; do
        [ -f "$file" ] && printf '%s ' "$(sha256sum <"$file" | cut -c1-64)" && tr -d '\n' <"$file" && echo
    done
    section pulled
    for file in "$HOME"/.fleet/pulled/*; do
        case $file in *.new | */references) ;; *) [ -f "$file" ] && tr -d '\n' <"$file" && echo ;; esac
    done
    section spool
    (
        cd "$HOME/.fleet/spool" 2>/dev/null || exit
        stat -c '%n %s' ./* 2>/dev/null | sed 's,^\./,,'
    )
    section pins
    grep -H '"image":' "$HOME"/.fleet/stacks/*/releases/*/compose.yaml \
        "$HOME"/.fleet/stacks/*/releases/*/compose.override.yaml \
        "$HOME"/.fleet/releases/*/compose.override.yaml 2>/dev/null
    section tools
    command -v zstd
    python3 -I -S -c "import argparse, json, zlib" 2>/dev/null && echo python3
}

# Each program of Docker takes a moment to start, on a Pi a tenth of a second: they run side by side.
at_once() { # FUNCTION...: their output comes in this order
    first=$1
    shift
    if [ $# = 0 ]; then
        "$first"
    else
        "$first" | {
            later=$(at_once "$@")
            cat
            printf '%s\n' "$later"
        }
    fi
}
wanted=${1-}
docker=
! command -v docker >/dev/null || docker='images versions containers'
transfers=
[ "$wanted" != images ] || transfers=transfers
identity
# shellcheck disable=SC2086  # words
at_once engine $docker machine stacks $transfers
section end
