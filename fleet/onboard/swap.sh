#!/bin/sh
# bring the containers of a stack to a release, watch them, and go back if they do not run
#
# usage: swap.sh VERB STACK RELEASE SEEN BY WAIT SETTLE CONFLICT
#
# VERB is ship, rollback, start, restart, stop, dev (`fab dev --end`) or boot (the end of dev at boot). SEEN is the release
# that was current when this was planned, - for none and ? for unknown. BY is who asked for it (tim@desktop). WAIT is how
# many seconds the containers may take to become healthy, SETTLE how many a container without a health check must run
# without a restart.
# CONFLICT is robot or desktop: whose version of a file wins that both have changed.
#
# A release's file `services` names those that must run, each with its restart policy: no, on-failure (with
# `boot: systemd` also on-failure:3) or always.
#
# One process at a time holds the lock, and the journal says what it is about to do. The result is written by this
# process, in the same breath as `current`, so that nobody has to be connected to hear it. After a power cut it is run again
# with the same arguments.
set -u
umask 022
verb=$1 stack=$2 release=$3 seen=$4 by=$5 wait=$6 settle=$7 conflict=$8
fleet=$HOME/.fleet
here=$fleet/stacks/$stack
busy=75
turn=${FLEET_TURN:-240} # seconds to wait for another command on this robot
limit=$((wait + 120))   # seconds for one call of Compose: it waits for `depends_on` as long as that takes

say() { printf '%s\n' "$*"; }
fail() {
    say "$*" >&2
    exit 1
}

# A file that must be there after a power cut: written beside, synced, renamed, and the folder synced too.
durable() { sync "$@" 2>/dev/null || sync; }
put() {
    cat >"$1.new" && durable "$1.new" && mv -f "$1.new" "$1" && durable "${1%/*}"
}

# --- One at a time

exec 9>>"$fleet/lock"
if ! flock -n 9; then
    read -r holder 2>/dev/null <"$fleet/holder" || holder='another command'
    say "note: waits for $holder"
    flock -w "$turn" 9 || {
        say "$holder has not ended after $turn s" >&2
        exit "$busy"
    }
fi
say "$by, who runs fab $verb since $(date +%H:%M:%S)" >"$fleet/holder"

# --- What is there

# A desktop that came back after the boot goes on with dev, and has prepared another end. One that a power cut has ended
# half-way goes on: it is in the journal.
if [ "$verb" = boot ] && ! grep -qsxF "${FLEET_RUN-}" "$here/journal"; then
    [ "$(cat "$here/dev/back" 2>/dev/null)" = "${FLEET_RUN-}" ] || exit 0
    [ ! -e "$here/stopped" ] || exit "$busy" # it stays stopped, and in dev
fi
folder() { printf '%s/releases/%s' "$here" "$1"; }
before=$(readlink "$here/current" 2>/dev/null) || before=
before=${before##*/}
# While this waited, or before it was asked for, somebody else may have changed what is current.
if [ "$seen" != '?' ] && [ "${before:--}" != "$seen" ] && [ "$before" != "$release" ]; then
    last=$(tail -n 1 "$here/history" 2>/dev/null | tr '\t' ' ')
    case $verb in
        ship) say "note: takes the place of release $before, which came after this was planned: $last" ;;
        rollback) fail "release $before is current now, which came after this was planned: $last. Nothing was done" ;;
        *)
            say "note: $verb of release $before, which came after this was planned: $last"
            release=${before:-$release}
            ;;
    esac
fi
[ -e "$(folder "$release")/compose.yaml" ] ||
    fail "release $release is not on this robot any more; another command has removed it"
[ -z "$before" ] || [ -e "$(folder "$before")/compose.yaml" ] || before=

compose() { # RELEASE ARGUMENT...
    cd "$(folder "$1")" || return 1
    shift
    if [ -e compose.override.yaml ]; then # a release of the first version of fleet
        env -u COMPOSE_FILE -u COMPOSE_PROFILES timeout -k 10 "$limit" docker compose "$@" 9>&-
    else
        env -u COMPOSE_PROFILES timeout -k 10 "$limit" docker compose --project-name "$stack" --file compose.yaml "$@" 9>&-
    fi
}

# Not those of `docker compose run`, which end when a person has done with them.
ours() {
    docker ps --all --no-trunc --filter "label=com.docker.compose.project=$stack" \
        --filter label=com.docker.compose.oneoff=False "$@"
}

# A swap that was cut leaves containers that were created and never started; Compose trips over their names.
clear_half_made() {
    ours --quiet --filter status=created | xargs -r docker rm --force >/dev/null 2>&1
}

journal() { # PHASE
    printf '%s %s %s %s %s %s\n%s\n' "$1" "$verb" "$release" "${before:--}" "$(date -u +%Y-%m-%dT%H:%M:%SZ)" "$by" \
        "${FLEET_RUN:-}" | put "$here/journal"
}

note_history() { # RELEASE OUTCOME
    line=$(printf '%s\t%s\t%s\t%s\t%s' "$(date -u +%Y-%m-%dT%H:%M:%SZ)" "$verb" "$1" "$by" "$2" | tr '\n' ' ')
    # A line that a power cut has torn, or that ends in NUL bytes, is not continued.
    {
        tr -d '\000' 2>/dev/null <"$here/history" | awk 'length'
        printf '%s\n' "$line"
    } | put "$here/history"
}

become_current() {
    ln -sfn "releases/$1" "$here/current.new" && mv -fT "$here/current.new" "$here/current" && durable "$here"
}

# --- The robot's own data

# dpkg's rule for configuration files: `delivered` says what was laid there last. What the robot has not changed is
# updated; what it has changed is kept; what both have changed is kept too, and said once, with the new one laid beside
# it. Such a file keeps its old entry, so that a later command can still decide for the desktop's.
digest() {
    if [ -L "$1" ]; then
        readlink "$1" | sha256sum | cut -c1-64
    elif [ -f "$1" ] && [ -r "$1" ]; then
        sha256sum <"$1" | cut -c1-64
    elif [ -d "$1" ]; then
        echo folder | sha256sum | cut -c1-64
    elif [ -e "$1" ]; then
        echo other
    fi
}
lay() { # FROM TO
    mkdir -p "${2%/*}" || return 1
    if [ -d "$1" ] && [ ! -L "$1" ]; then
        rm -f "$2" && mkdir "$2" && chmod --reference="$1" "$2"
        return
    fi
    # A folder that has become a file: what the robot has in it is kept.
    if [ -d "$2" ] && [ ! -L "$2" ] && ! rmdir "$2" 2>/dev/null; then mv -T --backup=numbered "$2" "$2.from-robot" || return 1; fi
    cp -P -p "$1" "$2.fleet-part" && durable "$2.fleet-part" && mv -fT "$2.fleet-part" "$2"
}
# A folder that a container has closed hides what is in it.
reachable() { # PATH
    up=${1%/*}
    while [ ! -d "$up" ]; do up=${up%/*}; done
    [ -x "$up" ] && return
    say "cannot reach '$up/${1##*/}': Permission denied" >&2
    return 1
}
delivered() { path=$1 awk 'substr($0, 66) == ENVIRON["path"] { print substr($0, 1, 64) }' "$here/delivered" 2>/dev/null | tail -n 1; }
merge_data() {
    seeds=$(folder "$release")/seeds
    mkdir -p "$here/data"
    [ -d "$seeds" ] || return 0
    rm -f "$here/delivered.changed"
    find "$seeds" -mindepth 1 -printf '%P\n' | LC_ALL=C sort >"$here/delivered.list"
    : >"$here/delivered.new"
    kept=/ # a folder in whose place the robot has something else
    while IFS= read -r path; do
        case $path in "$kept"/*) continue ;; esac
        new=$(digest "$seeds/$path") now=$(digest "$here/data/$path") last=$(delivered "$path")
        entry=$new
        case $now in
            "$new") ;;
            '')
                [ "$new" = "$last" ] || reachable "$here/data/$path" || return 1
                # Never delivered: the robot gets it. Delivered, and removed by the robot: it stays removed.
                if [ -z "$last" ] || { [ "$conflict" = desktop ] && [ "$new" != "$last" ]; }; then
                    lay "$seeds/$path" "$here/data/$path" || return 1
                fi
                ;;
            "$last") lay "$seeds/$path" "$here/data/$path" || return 1 ;;
            *)
                if [ "$new" = "$last" ]; then
                    : # only the robot has changed it
                elif [ "$conflict" = desktop ]; then
                    # An earlier one of that name is kept too.
                    mv -T --backup=numbered "$here/data/$path" "$here/data/$path.from-robot" || return 1
                    lay "$seeds/$path" "$here/data/$path" || return 1
                    : >"$here/delivered.changed"
                    say "note: $path was changed on the robot too: replaced, the robot's is $path.from-robot"
                else
                    entry=$last
                    [ -L "$seeds/$path" ] || [ ! -d "$seeds/$path" ] || kept=$path
                    if [ "$(digest "$here/data/$path.from-desktop")" != "$new" ]; then
                        lay "$seeds/$path" "$here/data/$path.from-desktop" || return 1
                        say "note: $path was changed on the robot too: kept, the new one is $path.from-desktop"
                    fi
                fi
                ;;
        esac
        [ -z "$entry" ] || printf '%s %s\n' "$entry" "$path" >>"$here/delivered.new"
    done <"$here/delivered.list"
    # Files that this release does not deliver any more keep their entry: the robot's stay as they are.
    if [ -e "$here/delivered" ]; then
        awk 'NR == FNR { seen[substr($0, 66)]; next } !(substr($0, 66) in seen)' "$here/delivered.new" "$here/delivered" >"$here/delivered.rest"
        cat "$here/delivered.rest" >>"$here/delivered.new"
    fi
    durable "$here/delivered.new" && mv -f "$here/delivered.new" "$here/delivered"
    rm -f "$here/delivered.list" "$here/delivered.rest"
}
data_folders() {
    if [ -e "$(folder "$release")/data-folders" ]; then
        while IFS= read -r path; do mkdir -p "$here/data/$path" || return 1; done <"$(folder "$release")/data-folders"
    fi
}

# --- Watching

# id, service, state, exit code, restarts, health. (With `.Id` Docker takes another way, on which a missing Health is an error.)
template='{{.ID}} {{index .Config.Labels "com.docker.compose.service"}} {{.State.Status}} {{.State.ExitCode}} {{.RestartCount}} {{with .State.Health}}{{.Status}}{{else}}none{{end}}'
states() { ours --quiet | xargs -r docker inspect --format "$template" 2>/dev/null; }

# Docker asks a container for its health every so many seconds, 30 if nothing else is said. Here the check's own command
# is run as often as it takes, as Docker would run it. Prints the ID if it passes.
check() { # ID
    form='{{with .Config.Healthcheck}}{{printf "%d" .Timeout}} {{len .Test}}{{range .Test}}{{println}}{{.}}{{end}}{{end}}'
    test=$(docker inspect --format "$form" "$1" 2>/dev/null)
    head=${test%%
*}
    id=$1 limit_ns=${head%% *} words=${head##* } kind=$(printf '%s\n' "$test" | sed -n 2p)
    rest=$(printf '%s\n' "$test" | sed 1,2d)
    set --
    case $kind in
        CMD)
            # A word of several lines cannot be told from several words: Docker does it, later.
            [ "$(printf '%s\n' "$test" | wc -l)" = $((words + 1)) ] || return
            while IFS= read -r word; do set -- "$@" "$word"; done <<END
$rest
END
            ;;
        CMD-SHELL) set -- sh -c "$rest" ;;
        *) return ;;
    esac
    [ "$limit_ns" -gt 0 ] || limit_ns=30000000000
    timeout -k 1 $((limit_ns / 1000000000 + 1)) docker exec "$id" "$@" >/dev/null 2>&1 </dev/null && echo "$id"
}
check_all() { # ID...
    for one in "$@"; do check "$one" & done
    wait
}

# One line: `ok`, `wait WHY` or `bad WHY`. A container that was there before may have restarted in an earlier life.
judge() { # SECONDS
    states | awk -v settled="$([ "$1" -ge "$settle" ] && echo yes)" -v wanted="$wanted" -v earlier="$earlier" -v proved="$proved" '
        BEGIN {
            n = split(wanted, pairs, " ")
            for (i = 1; i <= n; i++) { split(pairs[i], pair, "="); policy[pair[1]] = pair[2] }
            n = split(earlier, pairs, " ")
            for (i = 1; i <= n; i++) { split(pairs[i], pair, "="); count[pair[1]] = pair[2] }
            n = split(proved, pairs, " ")
            for (i = 1; i <= n; i++) passed[pairs[i]] = 1
        }
        !($2 in policy) { next }
        { seen[$2] = 1 }
        # The exit code of one that runs again is lost.
        $5 > count[$1] + 0 { bad = bad $2 " has restarted" ($3 == "running" ? "; " : " (exit code " $4 "); "); next }
        $3 == "restarting" { bad = bad $2 " ends again and again (exit code " $4 "); "; next }
        $3 == "exited" && $4 == 0 && policy[$2] != "always" { next }
        $3 == "exited" || $3 == "dead" { bad = bad $2 " has ended with code " $4 "; "; next }
        $3 != "running" { wait = wait $2 " is " $3 "; "; next }
        $6 == "unhealthy" { bad = bad $2 " is unhealthy; "; next }
        $6 == "starting" && !($1 in passed) { wait = wait $2 " is not healthy yet; "; next }
        $6 == "none" && !settled { wait = wait $2 " has no health check; " }
        END {
            for (name in policy) if (!seen[name]) bad = bad name " has no container; "
            if (bad) print "bad " substr(bad, 1, length(bad) - 2)
            else if (wait) print "wait " substr(wait, 1, length(wait) - 2)
            else print "ok"
        }'
}

# Hundredths of seconds since the boot. The clock of a robot without a battery jumps by months when it finds a time server.
uptime() { cut -d' ' -f1 /proc/uptime | tr -d .; }

watch() {
    began=$(uptime) most=$wait proved=
    [ "$settle" -le "$most" ] || most=$settle
    while :; do
        # shellcheck disable=SC2046 # one word per container
        proved="$proved $(check_all $(states | awk -v proved="$proved" '$3 == "running" && $6 == "starting" && !index(proved, $1) { print $1 }') | tr '\n' ' ')"
        passed=$((($(uptime) - began) / 100))
        verdict=$(judge "$passed")
        case $verdict in
            ok)
                rm -f "$here/proved"
                for id in $proved; do echo "$id" >>"$here/proved"; done
                return 0
                ;;
            bad*)
                why=${verdict#bad }
                return 1
                ;;
        esac
        if [ "$passed" -ge "$most" ]; then
            why="${verdict#wait } after $passed s"
            return 1
        fi
        # At first a moment counts; what takes longer need not keep the processor busy.
        if [ "$passed" -lt 10 ]; then sleep 0.2; else sleep 1; fi
    done
}

# Compose stops the old container, removes it, and only then starts the new one. Docker starts a container at boot that
# was stopped only if its policy is `always`: so the old ones have it for as long as it takes, and a power cut in between
# leaves the old release running.
stay_at_boot() {
    ids=$(ours --quiet --filter status=running)
    # shellcheck disable=SC2086 # one word per container
    ids=$([ -z "$ids" ] || docker inspect --format '{{.Id}} {{.HostConfig.RestartPolicy.Name}}' $ids | awk '$2 == "unless-stopped" { print $1 }')
    [ -n "$ids" ] || return 0
    {
        printf '%s\n' "$ids"
        cat "$here/policies" 2>/dev/null # of a swap that a power cut has ended
    } | put "$here/policies"
    # shellcheck disable=SC2086
    docker update --restart always $ids >/dev/null
    sync
}
restore_policies() {
    [ -e "$here/policies" ] || return 0
    while read -r id; do docker update --restart unless-stopped "$id" >/dev/null 2>&1; done <"$here/policies"
    rm -f "$here/policies"
}

# Files that `fab dev` has brought into containers end with these containers.
leave_dev() {
    back=$(cat "$here/dev/back" 2>/dev/null)
    rm -rf "${here:?}/dev"
    [ -z "$back" ] || [ "$back" = "${FLEET_RUN-}" ] || rm -rf "$fleet/runs/$back"
}

# Start a release and see it run; `why` says why not.
run() { # RELEASE
    if [ -e "$(folder "$1")/services" ]; then
        wanted=$(tr '\n' ' ' <"$(folder "$1")/services")
    else
        wanted=$(compose "$1" config --services 2>/dev/null | sed 's/$/=always/' | tr '\n' ' ')
    fi
    why=
    earlier=$(states | awk '{ printf "%s=%s ", $1, $5 }')
    # A container that has a single file mounted keeps the one that was replaced: it is made anew.
    anew=
    [ ! -e "$here/delivered.changed" ] || anew=--force-recreate
    if [ -e "$here/dev/state" ] && [ "$verb" != start ] && [ "$verb" != restart ]; then anew=--force-recreate; fi
    [ "$1" = "$before" ] || stay_at_boot
    # shellcheck disable=SC2086 # no word if it is empty
    output=$(compose "$1" up --detach --no-build --pull never --remove-orphans $anew 2>&1)
    code=$?
    if [ "$code" = 0 ]; then
        [ -z "$anew" ] || [ ! -e "$here/dev/state" ] || leave_dev
        watch
        return
    fi
    # Its progress is indented; and a warning is not why.
    why=$(printf '%s\n' "$output" | sed -n '/^time=[^ ]* level=warning/d; /^[^ ]/p' | tail -n 12)
    [ "$code" != 124 ] || why="Compose did not end within $limit s: $(printf '%s\n' "$output" | tail -n 1)"
    [ -n "$why" ] || why='Compose could not start it'
    return 1
}

# --- The swap

if [ "$verb" = stop ]; then
    : >"$here/stopped" # boot.sh leaves it alone
    compose "$release" stop || exit 1
    restore_policies
    note_history "$release" 'done'
    exit 0
fi

journal begin
rm -f "$here/stopped"
rm -f "$here/releases/.shipping-$release" # from here on the journal says that it is needed
clear_half_made
why=
exec 3>&1 # for notes
if ! problem=$({ merge_data && data_folders; } 2>&1 >&3); then
    why="the robot's data cannot be written: $(printf '%s\n' "$problem" | tail -n 1)"
elif [ "$verb" = restart ] && ! output=$(compose "$release" restart 2>&1); then
    why=$(printf '%s\n' "$output" | tail -n 1)
else
    journal swap
    run "$release"
fi

rm -f "$here/delivered.changed"
if [ -z "$why" ]; then
    restore_policies
    sync # Docker's own files too: what is said to run must be there after a power cut
    # What cannot be written down is not done: the next command would go back to another release.
    if problem=$({ become_current "$release" && note_history "$release" 'done'; } 2>&1); then
        rm -f "$here/journal"
        exit 0
    fi
    say "release $release runs, and this cannot be recorded: $problem" >&2
    exit 1
fi

say "$why" >&2
compose "$release" logs --no-color --no-log-prefix --tail 8 2>/dev/null | tail -n 40 >&2
note_history "$release" "failed: $why"
clear_half_made
if [ "$release" = "$before" ]; then
    : # it was current already, and may be healthy a minute later: Docker goes on with it
elif [ -n "$before" ]; then
    journal back
    if run "$before"; then
        restore_policies
        sync
        say "went back to release $before, which runs" >&2
    else
        say "went back to release $before, which does not run either: $why" >&2
    fi
else
    compose "$release" stop >/dev/null 2>&1
    say 'stopped it, as nothing ran before' >&2
fi
rm -f "$here/journal"
exit 1
