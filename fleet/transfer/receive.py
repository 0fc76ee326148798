"""Which command does a robot run to receive images? It gathers pieces in a spool, and loads them once all are right.

A piece that was cut off is gone on with at the byte where it ended, by whichever desktop sends it next: pieces are called
by their digest, and nothing is used whose digest is wrong. What arrived is proved under a private name; only then does it
get the name by which releases know it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.plan import Step
from fleet.transfer.archive import BLOCK, INCOMING

if TYPE_CHECKING:
    from fleet.plan import Parcel
    from fleet.transfer.archive import Frame

UNUSABLE = 65
"""Exit code: all arrived, and the engine cannot use it. Another way of sending may help (sysexits.h, EX_DATAERR)."""

BUSY = 75
"""Exit code: somebody else is shipping to this robot (sysexits.h, EX_TEMPFAIL)."""

STALE = 70
"""Seconds after which a shipment that receives nothing is taken for dead, and so how long to wait for another one."""

SCRIPT = f"""\
# receive what is missing into ~/.fleet/spool, load it into Docker, prove it, name it
set -eu
token=$1 by=$2 frame=$3; shift 3
mkdir -p .fleet/spool .fleet/receipts; cd .fleet/spool
read -r _ _ _ _ group _ < /proc/$$/stat

# One shipment at a time. One that died with its link still holds the lock: it is ended by who sent it, or when it is stale.
doing() {{ printf '%s %s %s %s\\n' "$group" "$token" "$1" "$by" > holder; }}
exec 9>> lock
waited=0
until flock -n 9; do
  read -r its theirs does whose < holder 2> /dev/null || {{ its='' theirs='' does='' whose=somebody; }}
  if [ "$theirs" = "$token" ] || {{ [ "$does" = receive ] && [ -z "$(find . -type f ! -name lock -mmin -1)" ]; }}; then
    [ -z "$its" ] || kill -- "-$its" 2> /dev/null || true
  fi
  [ "$waited" -lt {STALE} ] || {{ echo "$whose is shipping to this robot" >&2; exit {BUSY}; }}
  [ "$waited" != 2 ] || echo "wait for $whose"
  sleep 1; waited=$((waited + 1))
done
doing receive

size_of() {{ stat -c %s "$1" 2> /dev/null || echo 0; }}
receive() {{
  while :; do
    have=$(size_of "$1")
    [ "$have" -le "$2" ] || {{ rm -f "$1"; have=0; }}
    echo "need $1 $have"
    [ "$have" = "$2" ] || head -c $(($2 - have)) >> "$1"
    [ "$(size_of "$1")" = "$2" ] || exit 74 # the input ended: the rest comes another time
    [ "$(sha256sum < "$1")" != "$1  -" ] || return 0
    rm -f "$1"; [ "$have" != 0 ] || {{ echo "piece $1 arrived damaged" >&2; exit {UNUSABLE}; }}
  done
}}
each() {{ for line in "$@"; do case $line in "$kind "*) set -f; $do $line; esac; done; }}
blob() {{ receive "$2" "$3"; }}
kind=blob do=blob; each "$@"
echo enough

# The archive is put together as it flows: a header from the frame, the layer, up to a whole block; then the frame's rest.
count=0
member() {{
  [ "$2" != "$frame" ] || return 0
  dd if="$frame" bs={BLOCK} skip="$count" count=1 status=none; cat "$2"; head -c $(((-$3 % {BLOCK} + {BLOCK}) % {BLOCK})) /dev/zero
  count=$((count + 1))
}}
archive() {{ do=member; each "$@"; tail -c +$((count * {BLOCK} + 1)) "$frame"; head -c {2 * BLOCK} /dev/zero; }}
load() {{ said=$(archive "$@" | docker load --quiet 2>&1) && case $said in *'Error unpacking'*) return 1; esac; }}
doing load
docker image ls --format '{{{{.Repository}}}}:{{{{.Tag}}}}' {INCOMING} | xargs -r docker image rm > /dev/null
if ! load "$@"; then
  case $said in *'no space left'*) echo "$said" >&2; exit 1; esac
  for _ in $(seq 30); do ! docker version > /dev/null 2>&1 || break; sleep 2; done # an engine that restarts
  load "$@" || {{ echo "$said" >&2; exit {UNUSABLE}; }}
fi

# What an engine says of a load proves nothing. The image has the ID it must have, and makes a container.
image() {{
  id=$(docker image inspect --format '{{{{.Id}}}}' "$2") || exit {UNUSABLE}
  [ "$id" = "$5" ] || [ "$id" = "$6" ] || {{ echo "$4 arrived as $id" >&2; exit {UNUSABLE}; }}
  made=$(docker create "$2" true) || exit {UNUSABLE}
  docker rm "$made" > /dev/null
  tail -c +"$(($7 + 1))" "$frame" | head -c "$8" > ../receipts/new && mv ../receipts/new "../receipts/$3"
  docker tag "$2" "$4"; docker image rm "$2" > /dev/null
}}
kind=image do=image; each "$@"
find . -type f ! -name lock -exec rm -f {{}} +
"""


def step(parcel: Parcel, frame: Frame, *, title: str, token: str, by: str) -> Step:
    """Send a parcel, whose first piece is the frame, and have it loaded; ``token`` is this run's own, ``by`` who ships."""
    blobs = (f"blob {piece.digest} {piece.size}" for piece in parcel.pieces)
    images = (
        f"image {r.image.incoming} {r.image.fingerprint} {r.image.name} {' '.join(r.ids)} {r.offset} {r.length}"
        for r in frame.receipts
    )
    return Step(
        title=title,
        argv=("sh", "-c", SCRIPT, "receive", token, by.replace(" ", "_"), frame.hex, *blobs, *images),
        feed=parcel,
        limit=None,
        harmless=True,
        resumes=True,
    )
