"""How do packages get onto a robot where other programs use apt too, where power is cut, and nobody watches?

A Pi updates itself in the minutes after its first boot, so apt's locks are waited for; everything is bounded on the
robot and inside sudo, because an ordinary login cannot end root's processes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.plan.step import Step
from fleet.provision.sudo import as_root

if TYPE_CHECKING:
    from fleet.robot.facts import Facts

INSTALL = ("apt-get", "install", "--yes", "--no-install-recommends")
REMOVE = ("apt-get", "remove", "--yes")

# Only the two dpkg locks can be waited for by apt itself; for that of the lists the command is run again. `tail --pid`,
# not a pipe: whatever the command leaves running would hold a pipe open. Without Use-Pty, dpkg ends together with apt.
_PATIENTLY = r"""
patience=$1 limit=$2 pause=$3; shift 3; umask 022
work=$(mktemp -d) && trap "rm -rf $work" EXIT
echo "DPkg::Lock::Timeout \"$patience\"; DPkg::Use-Pty \"0\";" > "$work/apt.conf"
end=$(($(date +%s) + patience))
while : > "$work/said"; do
  APT_CONFIG=$work/apt.conf timeout --kill-after=5 "$limit" "$@" >> "$work/said" 2>&1 &
  tail -n +1 -f -s 0.2 --pid=$! "$work/said"
  wait $!; code=$?
  [ $code -ne 0 ] || exit 0
  grep -qE "^E: Could not get lock|^dpkg: error: .* lock was locked" "$work/said" || break
  [ "$(date +%s)" -lt "$end" ] || break
  echo "another program uses apt; trying again in $pause s"; sleep "$pause"
done
[ $code -ne 124 ] && [ $code -ne 137 ] || { echo "it did not end within $limit s, and was ended"; exit 1; }
exit $code
"""

# Docker's own repository, Ubuntu and Debian each call it differently; Debian 12's docker-compose is the old version 1.
_COMPOSE = r"""
apt-get update -qq || exit
for name in docker-compose-plugin docker-compose-v2 docker-compose; do
  apt-cache policy "$name" | grep -qE "Candidate: ([0-9]+:)?([2-9]|[1-9][0-9])" || continue
  exec apt-get install --yes --no-install-recommends "$name"
done
echo "no package of this system brings the Compose plugin" >&2; exit 1
"""

# Without a network apt needs minutes to say so. One archive that answers is enough; a proxy knows more than we do.
_REACH = r"""
apt-config dump | grep -qE "^Acquire::https?::.*Proxy.* \".+\"" && exit 0
found=$(apt-get --print-uris update 2> /dev/null | sort -u | sed -nE "s,^.http://([^][/:@]+)/.*,\1:80,p
  s,^.https://([^][/:@]+)/.*,\1:443,p; s,^.https?://([^][/:@]+:[0-9]+)/.*,\1,p" | uniq)
[ -n "$found" ] || exit 0
for site in $found; do
  host=${site%:*}
  timeout 10 getent ahosts "$host" > /dev/null || { said="Could not resolve host: $host"; continue; }
  timeout 10 bash -c ": > /dev/tcp/\$1/\$2" bash "$host" "${site##*:}" 2> /dev/null && exit 0
  said="Could not connect to $host"
done
echo "$said" >&2; exit 1
"""

COMPOSE_PLUGIN = ("sh", "-c", _COMPOSE)


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """How long things may take, in seconds.

    ``patience``: waiting until another program is done with apt; the updates of a first boot take minutes on a Pi.
    ``limit``: one command, once it may work; Docker's script has no limits of its own, and SD cards are slow.
    ``pause``: before a locked apt is tried again.
    """

    patience: int = 600
    limit: int = 1200
    pause: int = 5


def patiently(title: str, argv: tuple[str, ...], *, facts: Facts, bounds: Bounds, cure: str = "") -> Step:
    """The step that runs ``argv``, which uses apt, as root; again while apt is locked."""
    quiet = ("env", "LC_ALL=C", "DEBIAN_FRONTEND=noninteractive")
    times = (str(bounds.patience), str(bounds.limit), str(bounds.pause))
    return Step(
        title=title,
        argv=as_root(facts, *quiet, "sh", "-c", _PATIENTLY, "sh", *times, *argv),
        limit=bounds.patience + bounds.limit + 30.0,
        cure=cure,
    )


def reachable() -> Step:
    """The step that sees whether the robot reaches any of its package archives: in seconds, and in one sentence."""
    return Step(title="see that it reaches its package archive", argv=("sh", "-c", _REACH), limit=90.0)


def repair(*, facts: Facts, bounds: Bounds) -> Step:
    """The step that lets dpkg finish what a power cut stopped."""
    argv = ("dpkg", "--configure", "-a")
    return patiently("finish what dpkg was stopped in", argv, facts=facts, bounds=bounds)


def zstd(*, facts: Facts, bounds: Bounds) -> tuple[Step, ...]:
    """The step that installs what patches of layers are undone with, where that may be: Docker runs without it."""
    if "zstd" in facts.packages.installed or facts.login.sudo not in ("root", "free"):
        return ()
    return (patiently("install zstd", (*INSTALL, "zstd"), facts=facts, bounds=bounds),)
