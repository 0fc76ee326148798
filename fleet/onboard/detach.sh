#!/bin/sh
# run a script on the robot so that it ends whether or not the desktop stays connected, and show what it says
#
# usage: detach.sh TOKEN SCRIPT ARGUMENT...
#
# TOKEN names this run. The same command with the same token does not start the script again: it goes on showing, and
# ends with the script's exit code. That is how a desktop comes back after it has lost its connection.
set -u
token=$1 script=$2
shift 2
runs=$HOME/.fleet/runs
run=$runs/$token
restarted=74

mkdir -p "$runs" || exit 1
find "$runs" -mindepth 1 -maxdepth 1 -mtime +7 -exec rm -rf {} + 2>/dev/null
if problem=$(mkdir "$run" 2>&1); then
    : >"$run/out"
    # shellcheck disable=SC2016 # expanded by the shell that is started
    setsid sh -c '
        run=$1 script=$2; shift 2
        echo $$ > "$run/process"
        sh -c "$script" "$@" > "$run/out" 2> "$run/errors" < /dev/null
        echo $? > "$run/code.new" && mv "$run/code.new" "$run/code"
    ' detached "$run" "$script" "$@" >/dev/null 2>&1 </dev/null &
elif [ ! -d "$run" ]; then
    echo "$problem" >&2
    exit 1
fi

# After a restart of the robot the process's number may be another one's.
alive() { process=$(cat "$run/process" 2>/dev/null) && grep -qsaF "$run" "/proc/$process/cmdline"; }

shown=0 quiet=0
show() {
    size=$(stat -c %s "$run/out" 2>/dev/null) || size=0
    [ "$size" -le "$shown" ] || tail -c +$((shown + 1)) "$run/out" | head -c $((size - shown))
    shown=$size
}
while ! [ -e "$run/code" ]; do
    show
    if alive; then quiet=0; else quiet=$((quiet + 1)); fi
    if [ "$quiet" -gt 10 ]; then
        echo 'the command ended early: the robot was restarted, or the command was killed' >&2
        exit "$restarted"
    fi
    sleep 0.2
done
show
cat "$run/errors" >&2
exit "$(cat "$run/code")"
