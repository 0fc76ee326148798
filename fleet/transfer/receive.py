"""Which command does a robot run to receive images? It gathers pieces in a spool, and loads them once all are right.

A piece that was cut off is gone on with at the byte where it ended, by whichever desktop sends it next: pieces are called
by their digest, and nothing is used whose digest is wrong. What arrived is proved under a private name; only then does it
get the name by which releases know it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.plan.step import Step
from fleet.transfer import rebuild_command
from fleet.transfer.load_archive import BLOCK, INCOMING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from fleet.images.layer import Blob
    from fleet.plan.step import UploadBatch
    from fleet.transfer.load_archive import ArchiveSkeleton
    from fleet.transfer.rebuild_command import RebuiltLayer

UNUSABLE = 65
"""Exit code: all arrived, and the engine cannot use it. Another way of sending may help (sysexits.h, EX_DATAERR)."""

BUSY = 75
"""Exit code: somebody else is shipping to this robot (sysexits.h, EX_TEMPFAIL)."""

STALE = 70
"""Seconds after which a shipment that receives nothing is taken for dead, and so how long to wait for another one."""


@dataclass(frozen=True, kw_only=True)
class TransferRun:
    """One run's way to one robot: its address, a ``token`` of the run's own, who ships (``tim@desktop``).

    ``rate`` is the link's last known one, in bytes per second.
    """

    to: str
    token: str
    by: str
    rate: float | None = None


SCRIPT = f"""\
# receive what is missing into ~/.fleet/spool, load it into Docker, prove it, name it
set -eu
token=$1 by=$2 frame=$3; shift 3
mkdir -p .fleet/spool .fleet/receipts; cd .fleet/spool
read -r _ _ _ _ group _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ began _ < /proc/$$/stat

# One shipment at a time. One that died with its link still holds the lock: it is ended by who sent it, or when it is stale.
# One whose link died while it waited here does not know, and must not end the one that came after it.
doing() {{ printf '%s %s %s %s %s\\n' "$group" "$began" "$token" "$1" "$by" > holder; }}
exec 9>> lock
waited=0
until flock -n 9; do
  read -r its since theirs does whose 2> /dev/null < holder || {{ its='' since=0 theirs='' does='' whose=somebody; }}
  if {{ [ "$theirs" = "$token" ] && [ "$since" -le "$began" ]; }} || {{ [ "$does" = receive ] && [ -z "$(find . -type f ! -name lock -mmin -1)" ]; }}; then
    [ -z "$its" ] || kill -- "-$its" 2> /dev/null || true
  fi
  [ "$waited" -lt {STALE} ] || {{ echo "$whose is shipping to this robot" >&2; exit {BUSY}; }}
  [ "$waited" != 2 ] || echo "wait for $whose"
  sleep 1; waited=$((waited + 1))
done
doing begin

# What is here by now, because another shipment or this one before it lost its link has brought it, is not asked for again.
missing=
here() {{ id=$(docker image inspect --format '{{{{.Id}}}}' "$4" 2> /dev/null) || id=; [ "$id" = "$5" ] || [ "$id" = "$6" ] || missing=yes; }}
# shellcheck disable=SC2086 # the words of a line are the arguments
each() {{ for line in "$@"; do case $line in "$kind "*) set -f; $do $line; esac; done; }}
empty() {{ find . -type f ! -name lock -exec rm -f {{}} +; }}
kind=image do=here; each "$@"
[ "$missing" ] || {{ empty; exit 0; }}

size_of() {{ stat -c %s "$1" 2> /dev/null || echo 0; }}
receive() {{
  while :; do
    doing receive
    have=$(size_of "$1")
    [ "$have" -le "$2" ] || {{ rm -f "$1"; have=0; }}
    echo "need $1 $have"
    [ "$have" = "$2" ] || head -c $(($2 - have)) >> "$1"
    [ "$(size_of "$1")" = "$2" ] || exit 74 # the input ended: the rest comes another time
    doing verify
    [ "$(sha256sum < "$1")" != "$1  -" ] || return 0
    rm -f "$1"; [ "$have" != 0 ] || {{ echo "piece $1 arrived damaged" >&2; exit {UNUSABLE}; }}
  done
}}
piece() {{ receive "$2" "$3"; }}
kind=piece do=piece; each "$@"
echo enough

# A layer that is made here is made twice: first only to see that it comes out right, so that it is never on the disk as a file.
root() {{ if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@"; fi; }}
check() {{ [ "$4" = cat ] || {{ shift 3; root "$@" --check || exit {UNUSABLE}; }}; }}
kind=layer do=check; each "$@"

# The archive is put together as it flows: a header from the frame, the layer, up to a whole block; then the frame's rest.
count=0
member() {{
  size=$3; dd if="$frame" bs={BLOCK} skip="$count" count=1 status=none; count=$((count + 1))
  if [ "$4" = cat ]; then cat "$2"; else shift 3; root "$@"; fi || exit 1
  head -c $(((-size % {BLOCK} + {BLOCK}) % {BLOCK})) /dev/zero
}}
archive() {{ do=member; each "$@"; tail -c +$((count * {BLOCK} + 1)) "$frame"; head -c {2 * BLOCK} /dev/zero; }}
load() {{ said=$(archive "$@" | docker load --quiet 2>&1) && case $said in *'Error unpacking'*) return 1; esac; }}
forget() {{ # the private names, and what an attempt that broke off has left of its proof
  docker ps -aq --filter label={INCOMING} | xargs -r docker rm --volumes > /dev/null
  docker image ls --format '{{{{.Repository}}}}:{{{{.Tag}}}}' {INCOMING} | xargs -r docker image rm > /dev/null
}}
doing load
forget
if ! load "$@"; then
  case $said in *'no space left'*) echo "$said" >&2; exit 1; esac
  for _ in $(seq 30); do ! docker version > /dev/null 2>&1 || break; sleep 2; done # an engine that restarts
  load "$@" || {{ echo "$said" >&2; exit {UNUSABLE}; }}
fi

# What an engine says of a load proves nothing. The image has the ID it must have, and makes a container.
image() {{
  id=$(docker image inspect --format '{{{{.Id}}}}' "$2") || exit {UNUSABLE}
  [ "$id" = "$5" ] || [ "$id" = "$6" ] || {{ echo "$4 arrived as $id" >&2; exit {UNUSABLE}; }}
  made=$(docker create --label {INCOMING} "$2" true) || exit {UNUSABLE}
  docker rm --volumes "$made" > /dev/null
  tail -c +"$(($7 + 1))" "$frame" | head -c "$8" > ../receipts/new && mv ../receipts/new "../receipts/$3"
  docker tag "$2" "$4" # the private name stays for now: two images may be one, called differently
}}
sync # a card that loses its power now has the layers, and not only their names
kind=image do=image; each "$@"
forget
empty
"""


def step(
    parcel: UploadBatch,
    frame: ArchiveSkeleton,
    members: Sequence[Blob],
    made: Mapping[str, RebuiltLayer],
    *,
    title: str,
    shipment: TransferRun,
) -> Step:
    """Send a parcel, put ``members`` into the frame's archive, those of ``made`` as the robot makes them, and load it."""
    by = "_".join(shipment.by.split())
    pieces = (f"piece {piece.digest} {piece.size}" for piece in parcel.pieces)
    layers = (f"layer {blob.hex} {blob.size} {_comes(blob, made.get(blob.diff_id))}" for blob in members)
    images = (
        f"image {r.image.incoming} {r.image.fingerprint} {r.image.name} {' '.join(r.ids)} {r.offset} {r.length}"
        for r in frame.receipts
    )
    return Step(
        title=title,
        argv=(
            *("sh", "-c", SCRIPT, "receive", shipment.token, by, frame.hex),
            *(*pieces, *layers, *images),
        ),
        feed=parcel,
        limit=None,
        harmless=True,
        resumes=True,
    )


def _comes(blob: Blob, made: RebuiltLayer | None) -> str:
    """How a layer comes into the archive: ``cat`` stands for the piece of its name, else a command that writes it."""
    if made is None:
        return "cat"
    patch = made.patch.digest if made.patch else ""
    program = rebuild_command.program_digest()
    return " ".join(rebuild_command.argv(program, made.source.where, wanted=blob.diff_id, patch=patch))
