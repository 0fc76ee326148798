#!/bin/sh
# run a script on the robot so that it ends whether or not the desktop stays connected, and show what it says
#
# usage: detach.sh TOKEN SCRIPT ARGUMENT...
#
# TOKEN names this run. The same command with the same token does not start the script again: it goes on showing, and
# ends with the script's exit code. That is how a desktop comes back after it has lost its connection. A script that a
# power cut has ended is started again by it, or by fleet-finish.service before: hence the folder has all that this needs.
#
# With FLEET_LATER set, the run is only prepared: fleet-finish.service starts it at the next boot (dev_hold.sh).
set -u
token=$1 script=$2
shift 2
runs=$HOME/.fleet/runs
run=$runs/$token
restarted=74

mkdir -p "$runs" || exit 1
# What is still to be finished, or to be done at boot, stays, however old it is.
find "$runs" -mindepth 1 -maxdepth 1 -mtime +7 2>/dev/null | while IFS= read -r old; do
    grep -qsxF "${old##*/}" "$HOME"/.fleet/stacks/*/journal "$HOME"/.fleet/stacks/*/dev/back || rm -rf "$old"
done
launch() { setsid sh "$run/start" "$run" >/dev/null 2>&1 </dev/null & }
# After a restart of the robot the process's number may be another one's.
alive() { process=$(cat "$run/process" 2>/dev/null) && grep -qsaF "$run" "/proc/$process/cmdline"; }
this_boot=$(cat /proc/sys/kernel/random/boot_id 2>/dev/null)
# All of it, or nothing is started: on a full disk `cat` says so, and the shell's own printf does not.
prepare() { # ARGUMENT...
    printf '%s\n' "$this_boot" | cat >"$run/boot" && : >"$run/out" && printf '%s' "$script" | cat >"$run/script" &&
        for word in "$@"; do printf '%s\n' "$word"; done | cat >"$run/arguments" && cat >"$run/start" <<'END'
run=$1
exec 8>>"$run/lock" && flock -n 8 || exit 0
[ ! -e "$run/code" ] || exit 0
echo $$ >"$run/process"
cat /proc/sys/kernel/random/boot_id >"$run/boot" 2>/dev/null
set --
while IFS= read -r word; do set -- "$@" "$word"; done <"$run/arguments"
export FLEET_RUN="${run##*/}"
sh -c "$(cat "$run/script")" "$@" >"$run/out" 2>"$run/errors" </dev/null 8>&-
code=$?
[ "$code" != 75 ] || [ ! -e "$run/later" ] || exit 0 # not now: at the next boot
echo "$code" >"$run/code.new" && mv "$run/code.new" "$run/code"
END
}
if problem=$(mkdir "$run" 2>&1); then
    if ! problem=$(prepare "$@" 2>&1); then
        rm -rf "$run"
        printf 'nothing was started: %s\n' "$problem" >&2
        exit 1
    fi
    [ -z "${FLEET_LATER-}" ] || : >"$run/later"
    sync "$run"/* "$run" 2>/dev/null || sync
    [ -z "${FLEET_LATER-}" ] || exit 0
    launch
elif [ ! -d "$run" ]; then
    echo "$problem" >&2
    exit 1
elif [ ! -e "$run/code" ] && [ -e "$run/start" ] && [ "$(cat "$run/boot" 2>/dev/null)" != "$this_boot" ]; then
    echo 'note: was cut short: goes on'
    # What was said before the cut is said again, unless somebody has started it again already.
    (exec 8>>"$run/lock" && flock -n 8 && : >"$run/out")
    launch
fi

shown=0 quiet=0
show() {
    size=$(stat -c %s "$run/out" 2>/dev/null) || size=0
    [ "$size" -ge "$shown" ] || shown=0
    [ "$size" -le "$shown" ] || tail -c +$((shown + 1)) "$run/out" | head -c $((size - shown))
    shown=$size
}
while ! [ -e "$run/code" ]; do
    show
    if alive; then quiet=0; else quiet=$((quiet + 1)); fi
    # Before there is a process, the card may have much to write.
    if [ "$quiet" -gt 150 ] || { [ "$quiet" -gt 10 ] && [ -e "$run/process" ]; }; then
        echo 'the command ended early: the robot was restarted, or the command was killed' >&2
        exit "$restarted"
    fi
    sleep 0.2
done
show
cat "$run/errors" >&2
exit "$(cat "$run/code")"
