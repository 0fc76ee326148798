#!/bin/sh
# Remove old releases and images that no release needs, unless another command has begun to use them meanwhile.
# Usage: remove_releases.sh STACK KEEP_SECONDS RELEASE... -- IMAGE...
# What the robot runs, what a swap is about, and what another command has written to start it, less than KEEP_SECONDS ago,
# stays.
set -u
stack=$1 keep=$2
shift 2
cd "$HOME/.fleet" || exit 1
exec 9>>lock
flock --wait 240 9 || {
    echo "$(cat holder 2>/dev/null || echo 'another command') has not ended" >&2
    exit 75
}
here=stacks/$stack
current=$(readlink "$here/current" 2>/dev/null)
while [ "$#" -gt 0 ] && [ "$1" != -- ]; do
    folder=$here/releases/$1
    old=releases/$1
    shipping=$here/releases/.shipping-$1
    age=$(($(date +%s) - $(stat -c %Y "$shipping" 2>/dev/null || echo 0)))
    if [ "releases/$1" != "$current" ] && [ "$age" -ge "$keep" ] && ! grep -qsw "$1" "$here/journal"; then
        rm -rf "$folder" "$shipping"
        if [ -L "$old" ]; then rm -f "$old"; fi
    fi
    shift
done
[ "$#" -eq 0 ] || shift
for image in "$@"; do
    if ! grep -rqsF "\"$image\"" stacks/*/releases/*/compose*.yaml releases/*/compose*.yaml; then
        docker image rm "$image" && rm -f "receipts/${image##*:fleet-}" "pulled/${image##*:fleet-}"
    fi
done
