#!/bin/sh
# install on this robot what `fab bundle` has written to this stick, as `fab ship` does over SSH
# shellcheck disable=SC2016 # awk's fields, and commands that a person types
{ # read to its end before anything is done: the stick may be pulled out
    usage() {
        cat <<'END'
Usage: sh install [ROBOT] [--older] [--renamed] [--prefer desktop]

Run it on the robot, as the user that fab logs in as, in the folder of the stick.

  ROBOT             which robot of the bundle this is; default: found by SSH host key, containers, host name
  --older           install it although something newer has come to this robot since the bundle was made
  --renamed         this is the robot, although its host key or its name says another one
  --prefer desktop  replace files that both the robot and the desktop have changed; default: keep the robot's
END
    }
    set -u
    export LC_ALL=C # the words of tools are read
    say() { printf '%s\n' "$*"; }
    fail() { # WHAT CURE
        printf '%s\n  cure: %s\n' "$1" "$2" >&2
        exit 1
    }
    in_words() { printf '%s\n' "$1" | paste -sd ' ' | sed 's/ /, /g'; }
    has() { printf '%s\n' "$1" | grep -qxF -e "$2"; } # LINES LINE
    pulled='if the stick was pulled out, put it in and run the same command: it goes on where it stopped; what ran before still runs'

    older='' renamed='' prefer=robot robot=''
    while [ "$#" -gt 0 ]; do
        case $1 in
            --older) older=yes ;;
            --renamed) renamed=yes ;;
            --prefer)
                [ "${2-}" = desktop ] || [ "${2-}" = robot ] || fail '--prefer takes robot or desktop' 'sh install --help'
                prefer=$2
                shift
                ;;
            -h | --help)
                usage
                exit 0
                ;;
            -* | '') fail "there is no option $1" 'sh install --help' ;;
            *) robot=$1 ;;
        esac
        shift
    done
    unreadable() { fail "$1 cannot be read from the stick" "$pulled"; } # FILE
    stick=$(cd "$(dirname "$0")" 2>/dev/null && pwd) || unreadable install
    cd "${HOME:?}" || exit 1

    # --- What is on the stick

    edited() { # FILE
        fail "$1 on the stick is not what fab bundle wrote: it was cut short or edited" 'make the bundle again: `fab bundle`'
    }
    missing() { # FILE; if the stick was pulled out, its folders are not there either, although single files may seem to be
        names=$(ls "$stick" "$stick/${1%/*}" 2>/dev/null)
        if ! has "$names" install || has "$names" "${1##*/}"; then unreadable "$1"; fi
        fail "$1 is missing on the stick" 'make the bundle again: `fab bundle`'
    }
    names=$(ls "$stick" 2>/dev/null)
    if has "$names" install && ! has "$names" SHA256SUMS; then
        fail "the bundle in $stick is not whole: SHA256SUMS is missing" 'run `fab bundle` again: it was interrupted'
    fi
    sums=$(cat "$stick/SHA256SUMS" 2>/dev/null) || unreadable SHA256SUMS
    if ! checked=$(cd "$stick" 2>/dev/null && printf '%s\n' "$sums" |
        grep -E '^[0-9a-f]{64}  (index-|images/|releases/|programs-)' | sha256sum -c 2>/dev/null); then
        checked=$(printf '%s\n' "$checked" | grep -v ': OK$' | head -n 1)
        file=${checked%%:*}
        [ -e "$stick/${file:=SHA256SUMS}" ] || missing "$file"
        case $checked in *': FAILED open or read') unreadable "$file" ;; esac
        edited "$file"
    fi
    named() { printf '%s\n' "$sums" | sed -n "s/^[0-9a-f]*  \\($1.*\\)/\\1/p" | head -n 1; }
    index=$(cat "$stick/$(named index-)" 2>/dev/null) || unreadable 'the index'
    [ "$(printf '%s\n' "$index" | head -n 1)" = 'fleet-bundle 1' ] ||
        fail 'the bundle was made by another version of fleet than this program' 'make it again: `fab bundle`'
    programs=$stick/$(named programs-)
    programs=${programs%/*}
    program() { cat "$programs/$1.sh" 2>/dev/null || unreadable "$1.sh"; }
    receive=$(program receive) && prove_image=$(program prove_image) && unpack_release=$(program unpack_release) &&
        detach=$(program detach) && swap=$(program swap) || exit 1
    words() { printf '%s\n' "$index" | awk "$@"; } # AWK-ARGUMENT...
    made=$(words '$1 == "made" { print $2 }')
    who=$(words '$1 == "by" { print $2 }')
    robots=$(words '$1 == "robot" { print $2 }')

    # The keys that may log in here and do all, as ssh-keygen wants them; options may have blanks in quotes.
    signers() {
        awk '
            function is_key(word) { return word ~ /^(ssh-(ed25519|rsa)|ecdsa-sha2-nistp[0-9]+|sk-[a-z0-9-]+@openssh\.com)$/ }
            { gsub(/\r/, ""); sub(/^[ \t]+/, ""); options = "" }
            /^#/ { next }
            !is_key($1) {
                quoted = 0
                for (i = 1; i <= length($0); i++) {
                    letter = substr($0, i, 1)
                    if (letter == "\\") i++
                    else if (letter == "\"") quoted = !quoted
                    else if (!quoted && letter ~ /[ \t]/) break
                }
                options = tolower(substr($0, 1, i - 1))
                $0 = substr($0, i)
            }
            is_key($1) && options !~ /(^|,)(cert-authority|command=|principals=)/ { print "fleet", $1, $2 }' \
            .ssh/authorized_keys 2>/dev/null
    }
    # What to say of a signature: it counts if its key may log in here. Fails if there is no such key.
    judged() { # FILE
        if ! command -v ssh-keygen >/dev/null; then
            echo 'its signature cannot be checked: ssh-keygen is missing'
            return
        fi
        case $(ssh-keygen -Y 2>&1) in *'requires an argument'*) ;; *)
            echo 'its signature cannot be checked: OpenSSH here is older than 8.1'
            return
            ;;
        esac
        allowed=$(mktemp) || exit 1
        signers >"$allowed"
        ssh-keygen -Y verify -f "$allowed" -I fleet -n fleet-bundle -s "$1" <"$stick/SHA256SUMS" >/dev/null 2>&1
        code=$?
        rm -f "$allowed"
        [ "$code" != 0 ] || echo 'signed with a key that may log in here'
        return "$code"
    }
    # Its name says of which list it is: a bundle that was interrupted may have left its signature beside the one before.
    signed='not signed'
    signature=signed-$(sha256sum <"$stick/SHA256SUMS" | cut -c1-12).sig
    if [ -e "$stick/$signature" ]; then
        signed=$(judged "$stick/$signature") || {
            cat "$stick/$signature" "$stick/SHA256SUMS" >/dev/null 2>&1 || unreadable "$signature"
            fail 'the signature of this bundle is not by a key that may log in to this robot' \
                'sign with a key of ~/.ssh/authorized_keys here, or make the bundle without --sign'
        }
    fi
    say "bundle of $made by $who ($signed), for: $(in_words "$robots")"

    # --- Which robot this is

    name=$(uname -n)
    name=${name%%.*}
    by_key=$(cat /etc/ssh/ssh_host_*_key.pub 2>/dev/null | while read -r kind data _; do
        words -v kind="$kind" -v data="$data" '$1 == "key" && $3 == kind && $4 == data { print $2 }'
    done | sort -u)
    shipped=$(docker ps --all --filter label=fleet.robot --format '{{.Label "fleet.robot"}}' 2>/dev/null | sort -u)
    if [ -z "$robot" ]; then
        by_address=$(words -v name="$name" '$1 == "robot" { split($4, part, "."); if (part[1] == name) print $2 }')
        # Cards that were copied have one host key: then the next of these decides between their robots.
        for found in "$by_key" "$shipped" "$name" "$by_address"; do
            both=$(printf '%s\n' "${robot:-$robots}" | grep -xF -e "$found") || continue
            robot=$both
            [ "$(printf '%s\n' "$robot" | wc -l)" != 1 ] || break
        done
        case $robot in *'
'*) fail "this computer ($name) may be each of $(in_words "$robot")" 'say which robot it is: sh install ROBOT' ;; esac
        [ -n "$robot" ] || fail "the bundle has releases for $(in_words "$robots"), and nothing says that this computer ($name) is one of them" \
            'say which robot it is: sh install ROBOT'
    fi
    has "$robots" "$robot" || fail "the bundle has nothing for $robot; it has: $(in_words "$robots")" \
        'say one of these, or make a bundle for this robot'
    again="if this is $robot: sh install $robot --renamed"
    if [ -z "$renamed" ]; then
        keys=$(words -v robot="$robot" '$1 == "key" && $2 == robot { print $3 }')
        if [ -n "$by_key" ] && ! has "$by_key" "$robot"; then
            fail "this computer has the SSH host key of $(in_words "$by_key"), not of $robot" "$again"
        elif [ -n "$keys" ] && [ -z "$by_key" ] && cat /etc/ssh/ssh_host_*_key.pub >/dev/null 2>&1; then
            fail "this computer ($name) does not have the SSH host key that was recorded for $robot" "$again"
        elif [ -n "$shipped" ] && ! has "$shipped" "$robot"; then
            fail "this computer was shipped to as $(in_words "$shipped"), not as $robot" "$again"
        elif [ "$name" != "$robot" ] && [ -z "$by_key$shipped" ] && has "$robots" "$name"; then
            fail "this computer is called $name, and the bundle has releases for $name too" "sh install $name; or, $again"
        fi
    fi
    # shellcheck disable=SC2046 # the words of a line
    set -- $(words -v robot="$robot" '$1 == "robot" && $2 == robot { print $3, $5 }')
    platform=$1 user=$2
    [ "$user" = - ] || [ "$user" = "$(id -un)" ] ||
        fail "fab logs in to $robot as $user, and this is $(id -un): its releases are in the home of $user" \
            "log in as $user and run \`sh install\` without sudo"
    [ "$(id -u)" != 0 ] || [ -z "${SUDO_USER-}" ] || [ "$user" = root ] ||
        fail "with sudo the releases would be in root's home" "run \`sh install\` as the user that fab logs in as, without sudo"
    emulated() { grep -qs '^enabled' "/proc/sys/fs/binfmt_misc/qemu-$1"; }
    case "$platform $(dpkg --print-architecture 2>/dev/null || uname -m)" in
        'linux/arm64 arm64' | 'linux/arm64 aarch64' | 'linux/arm/v7 armhf' | 'linux/arm/v7 armv7l') ;;
        'linux/amd64 amd64' | 'linux/amd64 x86_64') ;;
        linux/arm64*) emulated aarch64 || platform=other ;;
        linux/arm/v7*) emulated arm || platform=other ;;
        *) emulated x86_64 || platform=other ;;
    esac
    [ "$platform" != other ] || fail "the release for $robot is for another processor than this one's ($(uname -m))" \
        "correct \`platform:\` of $robot in the inventory, and make the bundle again"
    case $HOME in *[!A-Za-z0-9/._@+-]*) fail "the path of this home, $HOME, has characters that install cannot write" 'use `fab ship`' ;; esac

    # --- What the robot needs

    for tool in awk env flock sha256sum setsid tar timeout; do
        command -v "$tool" >/dev/null || fail "the command $tool is missing on this robot" "install it; \`fab status\` names what fleet needs"
    done
    problem=$(docker version --format '{{.Server.Version}}' 2>&1 >/dev/null) || {
        command -v docker >/dev/null || fail 'Docker is not installed on this robot' 'connect the robot once and run `fab provision`'
        case $problem in *'permission denied'*) fail "$(id -un) may not use Docker" "sudo usermod -aG docker $(id -un), and log in again" ;; esac
        fail "Docker does not answer: $(printf '%s\n' "$problem" | tail -n 1)" 'sudo systemctl start docker; `journalctl -u docker` shows why not'
    }
    docker compose version >/dev/null 2>&1 || fail "Docker's Compose plugin is missing on this robot" 'connect the robot once and run `fab provision`'
    [ ! -L .fleet/current ] || fail 'the releases here are of the first version of fleet' 'connect the robot once and run `fab ship`'

    # --- At work

    work=$HOME/.fleet/stick
    mkdir -p "$work" || exit 1
    exec 7>>"$work/lock"
    flock -n 7 || fail 'another `sh install` is at work on this robot' 'wait until it has ended'
    clean() { rm -rf "$work/release" "$work/skeleton" "$work/send" "$work/requests" "$work/answers" "$work/errors"; }
    trap clean EXIT
    trap 'exit 130' INT TERM HUP
    clean
    bundle_by="$who by stick of $made"
    token=stick.$(cat /proc/sys/kernel/random/uuid)
    containerd=''
    case $(docker info --format '{{.DriverStatus}}' 2>/dev/null) in *io.containerd.snapshotter*) containerd=yes ;; esac

    # Which layers of an image are to be sent, one a line: its place in the archive, digest, size, unpacked size.
    # A classic store finds a layer by its place above others, a containerd store by the digest of its packed bytes.
    lacking() { # IMAGE all|missing
        there=''
        if [ "$2" = missing ] && [ -n "$containerd" ]; then
            there=$(for receipt in .fleet/receipts/*; do
                id=sha256:$(sha256sum 2>/dev/null <"$receipt" | cut -c1-64)
                docker image inspect --format . "$id" >/dev/null 2>&1 && grep -o 'sha256:[0-9a-f]*' "$receipt"
            done)
        elif [ "$2" = missing ]; then
            there=$(docker image ls -aq --no-trunc | sort -u |
                xargs -r docker image inspect --format '{{range .RootFS.Layers}}{{.}} {{end}}' 2>/dev/null)
        fi
        printf '%s\n' "$index" | there=$there awk -v image="$1" -v containerd="$containerd" '
            $1 == "layer" { digest[$2] = $3; size[$2] = $4; unpacked[$2] = $5 }
            $1 == "image" && $2 == image { n = NF - 12; for (i = 1; i <= n; i++) wanted[i] = $(i + 12) }
            END {
                lines = split(ENVIRON["there"], line, "\n")
                for (l = 1; l <= lines; l++) {
                    if (containerd) { have[line[l]] = 1; continue }
                    count = split(line[l], chain, " ")
                    for (i = 1; i <= count && i <= n && chain[i] == wanted[i]; i++) ;
                    if (i - 1 > prefix) prefix = i - 1
                }
                for (i = 1; i <= n; i++) if (!(digest[wanted[i]] in place)) place[digest[wanted[i]]] = places++
                for (i = prefix + 1; i <= n; i++) {
                    d = digest[wanted[i]]
                    if (d in sent || d in have) continue
                    sent[d] = 1
                    print place[d], substr(d, 8), size[wanted[i]], unpacked[wanted[i]]
                }
            }'
    }

    free() { df -Pk "$1" 2>/dev/null | awk 'NR == 2 { printf "%.0f\n", $4 * 1024 }'; }
    room() { # what it takes: the packed layers in the spool, Docker's copy of them, and the unpacked ones
        root=/var/lib/containerd
        [ -n "$containerd" ] || root=$(docker info --format '{{.DockerRootDir}}')
        [ -d "$root" ] || root=/var/lib
        spooled=$(while read -r _ digest _; do stat -c %s ".fleet/spool/$digest" 2>/dev/null; done <"$work/send" | awk '{ n += $1 } END { printf "%.0f\n", n }')
        needed=$(awk -v spooled="$spooled" '{ n += 2 * $3 + 1.05 * $4 } END { printf "%.0f\n", n - spooled }' "$work/send")
        have=$(free "$root")
        [ "${have:-$needed}" -ge "$needed" ] || fail "$robot needs $((needed / 1000000)) MB of free disk, and has $((have / 1000000)) MB" \
            'free some: `docker system df` shows what Docker uses; nothing was changed'
    }

    on_stick() { # FILE SIZE: all of its parts are there
        [ -e "$stick/$1.01" ] || missing "$1.01"
        there=$(stat -c %s "$stick/$1".[0-9][0-9] 2>/dev/null | awk '{ n += $1 } END { printf "%.0f\n", n }')
        [ "$there" = "$2" ] || edited "$1.01"
    }
    uncopied() { # FILE
        have=$(free "$work")
        [ "${have:-1000001}" -gt 1000000 ] || fail 'the disk of this robot is full' 'free some: `df -h`; nothing was changed'
        unreadable "$1"
    }

    # Answers what receive.sh asks for. A stick that cannot be read ends it, and so the transfer; the spool keeps what came.
    serve() {
        while read -r word digest offset; do
            case $word in
                need)
                    if [ "$digest" = "$skeleton" ]; then
                        tail -c "+$((offset + 1))" "$work/skeleton" || exit 1
                        continue
                    fi
                    for part in "$stick/layers/$digest".[0-9][0-9]; do
                        size=$(stat -c %s "$part" 2>/dev/null) || exit 1
                        if [ "$offset" -ge "$size" ]; then
                            offset=$((offset - size))
                            continue
                        fi
                        tail -c "+$((offset + 1))" "$part" 2>/dev/null || exit 1
                        offset=0
                    done
                    ;;
                enough)
                    say 'load the image into Docker' >&2
                    break
                    ;;
                wait) say "$word $digest $offset, who is shipping to this robot" >&2 ;;
            esac
        done
    }

    transfer() { # all|missing; then the words of the image's line in the index
        which=$1 image=$3 fingerprint=$8 file=$9
        shift 9
        config=$1 manifest=$2 offset=$3 length=$4
        shift 4
        lacking "$image" "$which" >"$work/send"
        headers=$(words -v image="$image" '
            $1 == "layer" { digest[$2] = $3 }
            $1 == "image" && $2 == image { for (i = 13; i <= NF; i++) if (!seen[digest[$i]]++) n++; print n + 0 }')
        sent=$(($(wc -l <"$work/send")))
        say "$image: $sent of $headers layers are missing, $(awk '{ n += $3 } END { printf "%.1f", n / 1e6 }' "$work/send") MB"
        room
        while read -r _ digest size _; do on_stick "layers/$digest" "$size"; done <"$work/send"
        (
            while read -r place _; do dd if="$stick/images/$file" bs=512 skip="$place" count=1 status=none || exit 1; done <"$work/send"
            tail -c "+$((headers * 512 + 1))" "$stick/images/$file"
        ) >"$work/skeleton" 2>/dev/null || uncopied "images/$file"
        skeleton=$(sha256sum <"$work/skeleton" | cut -c1-64)
        set -- "upload $skeleton $(stat -c %s "$work/skeleton")"
        while read -r _ digest size _; do set -- "$@" "upload $digest $size"; done <"$work/send"
        while read -r _ digest size _; do set -- "$@" "layer $digest $size cat"; done <"$work/send"
        set -- "$@" "image fleet/incoming:$fingerprint $fingerprint $image $config $manifest $((offset - 512 * (headers - sent))) $length"
        rm -f "$work/requests" "$work/answers"
        mkfifo "$work/requests" "$work/answers" || exit 1
        serve <"$work/requests" >"$work/answers" 7>&- &
        sh -c "$receive" receive "$token" "$(printf %s "$bundle_by" | tr ' ' _)" "$skeleton" fleet/incoming 70 "$@" \
            >"$work/requests" <"$work/answers" 2>"$work/errors" 7>&-
        code=$?
        wait
        return "$code"
    }

    deliver() { # IMAGE
        identity=$(words -v image="$1" '$1 == "image" && $2 == image { print $6, $7 }')
        proved() { sh -c "$prove_image" prove_image "$1" "${identity% *}" "${identity#* }" >/dev/null 2>&1; }
        if proved "$1"; then return; fi
        line=$(words -v image="$1" '$1 == "image" && $2 == image')
        for which in missing all; do
            # shellcheck disable=SC2086 # the words of a line
            transfer "$which" $line
            case $? in
                0) if proved "$1"; then return; fi ;;
                65) say "$(tail -n 1 "$work/errors"); trying again with all layers" ;;
                74) fail "the stick cannot be read to its end" "$pulled" ;;
                *) fail "$1 could not be loaded: $(tail -n 1 "$work/errors")" 'run the same command again; what ran before still runs' ;;
            esac
        done
        damaged=$(sed -n 's/^upload \([0-9a-f]*\) arrived damaged$/\1/p' "$work/errors")
        [ -z "$damaged" ] || edited "layers/$damaged.01"
        fail "$1 arrived, and Docker cannot use it: $(tail -n 1 "$work/errors")" 'make the bundle again: `fab bundle`; what ran before still runs'
    }

    # Whether a release is current, and everything it must run runs.
    runs() { # STACK RELEASE
        here=.fleet/stacks/$1
        [ "$(readlink "$here/current" 2>/dev/null)" = "releases/$2" ] && [ ! -s "$here/journal" ] || return 1
        [ ! -e "$here/dev/state" ] || return 1 # its containers have files of `fab dev`
        docker ps --all --quiet --no-trunc --filter "label=com.docker.compose.project=$1" --filter label=com.docker.compose.oneoff=False |
            xargs -r docker inspect --format '{{.ID}} {{index .Config.Labels "com.docker.compose.service"}} {{index .Config.Labels "fleet.release"}} {{.State.Status}} {{.State.ExitCode}} {{with .State.Health}}{{.Status}}{{else}}none{{end}}' |
            proved=$(cat "$here/proved" 2>/dev/null) awk -v release="$2" -v services="$(tr '\n' ' ' <"$here/current/services")" '
                { ended = $4 == "exited" && $5 == 0; healthy = $6 == "none" || $6 == "healthy" || index(ENVIRON["proved"], $1) }
                $3 != release { bad = 1 }
                { well[$2] = well[$2] " " ($4 == "running" && healthy ? "runs" : ended ? "ended" : "bad") }
                END {
                    n = split(services, pairs, " ")
                    for (i = 1; i <= n; i++) {
                        split(pairs[i], pair, "=")
                        states = well[pair[1]]
                        if (!states || states ~ /bad/ || (states ~ /ended/ && pair[2] == "always")) bad = 1
                    }
                    exit bad
                }'
    }

    # The stick may be older than what has come to the robot since: by SSH at the time of its line, by a stick made then.
    newer() { # STACK
        awk -F '\t' -v made="$made" '
            ($2 == "ship" || $2 == "rollback") && $5 == "done" {
                when = $1
                if ($2 == "ship" && match($4, / by stick of [0-9TZ:-]+/)) when = substr($4, RSTART + 13, RLENGTH - 13)
                if (when > made) last = $1 " " $2 " " $3 " by " $4
            }
            END { if (last) print last }' ".fleet/stacks/$1/history" 2>/dev/null
    }

    # What `fab ship` asks too before it sends anything: devices, and names and ports that other containers have. What is
    # wanted and not to be had, a cure in the second line.
    unmet() { # STACK
        project='{{.Label "com.docker.compose.project"}}'
        words -v robot="$robot" -v stack="$1" '$1 == "wants" && $2 == robot && $3 == stack { print $4, $5 }' |
            while read -r kind what; do
                has=''
                case $kind in
                    device) [ -e "$what" ] || printf '%s\n' "$what, which this robot does not have" 'plug it in' ;;
                    port) has=$(docker ps --filter "publish=$what" --format "{{.Names}} $project" </dev/null) ;;
                    name) has=$(docker ps --all --format "{{.Names}} $project" </dev/null | what=$what awk '$1 == ENVIRON["what"]') ;;
                esac
                printf '%s\n' "$has" | awk -v stack="$1" -v what="$kind $what" '
                    $1 && $2 != stack { print what ", which container " $1 " has"; print "stop the other one: `docker rm -f " $1 "`" }'
            done
    }

    install_stack() { # STACK RELEASE FILE WAIT SETTLE IMAGE...
        stack=$1 release=$2 file=$3 wait=$4 settle=$5
        shift 5
        here=.fleet/stacks/$stack
        current=$(readlink "$here/current" 2>/dev/null) || current=
        current=${current##*/}
        later=$(newer "$stack")
        if [ -n "$later" ] && [ "$current" != "$release" ] && [ -z "$older" ]; then
            fail "this bundle is of $made, and something newer has come to $robot since: $later" \
                "make a new bundle; or, to have release $release anyway: sh install $robot --older"
        fi
        say "$robot: release $release of $stack"
        problem=$(runs "$stack" "$release" || unmet "$stack")
        [ -z "$problem" ] ||
            fail "the release wants $(printf '%s\n' "$problem" | head -n 1)" "$(printf '%s\n' "$problem" | sed -n 2p); nothing was changed"
        rm -rf "$work/release"
        mkdir -m 700 "$work/release" || exit 1 # secrets are in it
        tar -x -p -f "$stick/releases/$file" -C "$work/release" 2>/dev/null || uncopied "releases/$file"
        sed -i "s|/home-of-the-robots-login|$HOME|g" "$work/release/compose.yaml" || exit 1
        [ ! -e "$work/release/boot" ] || systemctl is-enabled fleet-boot >/dev/null 2>&1 ||
            fail 'systemd shall start this release at power-on, and fleet-boot.service is not installed' \
                'connect the robot once and run `fab provision`; or set `boot: docker`, and make the bundle again'
        tar -c -f - -C "$work/release" . | sh -c "$unpack_release" unpack_release "$here/releases/$release" ||
            fail "release $release could not be written to ~/$here" 'see whether the disk is full: `df -h`; nothing was changed'
        problem=$(env -C "$here/releases/$release" -u COMPOSE_FILE -u COMPOSE_PROFILES -u COMPOSE_PROJECT_NAME \
            docker compose config --quiet 2>&1) ||
            fail "this robot's Compose cannot read the release: $(printf '%s\n' "$problem" | tail -n 1)" 'it may be too old: `docker compose version`'
        for image in "$@"; do deliver "$image"; done
        if [ "$prefer" = robot ] && runs "$stack" "$release"; then
            say "$robot: unchanged, runs release $release of $stack"
            return
        fi
        # From here on the stick is not needed any more, and the robot ends it by itself.
        if sh -c "$detach" detach "$token.$stack" "$swap" swap ship "$stack" "$release" "${current:--}" "$bundle_by" "$wait" "$settle" "$prefer" \
            7>&- 2>"$work/errors"; then
            say "$robot: done, release $release of $stack runs"
        else
            sed "s/$(printf '\033')\[[0-9;]*[A-Za-z]//g" "$work/errors" >&2 # Compose colours logs even without a terminal
            fail "release $release of $stack did not start" 'the lines above say why; `docker ps` shows what runs now'
        fi
    }

    stacks=$(words -v robot="$robot" '$1 == "stack" && $2 == robot { print substr($0, length($1 $2) + 3) }')
    while read -r line; do
        # shellcheck disable=SC2086 # the words of a line
        install_stack $line </dev/null
    done <<END
$stacks
END
    exit
}
