"""Which Debian package has a command that is missing?

Only commands that fleet, Docker's script or Docker itself call on a robot.
"""

from __future__ import annotations

from types import MappingProxyType

_COMMANDS = {
    "apt": "apt-cache apt-config apt-get",
    "bash": "bash",
    "ca-certificates": "update-ca-certificates",
    "coreutils": "cat cp cut date dd df dirname du env head id ln ls mkdir mktemp mv readlink rm sha256sum sleep sort stat"
    " sync tail timeout tr uname uniq wc",
    "curl": "curl",
    "diffutils": "diff",
    "dpkg": "dpkg dpkg-query",
    "findutils": "find xargs",
    "gpg": "gpg",
    "grep": "grep",
    "iptables": "iptables ip6tables",
    "kmod": "modprobe",
    "libc-bin": "getconf getent ldd",
    "mawk": "awk",
    "passwd": "chsh groupadd useradd usermod",
    "procps": "ps pgrep",
    "python3": "python3",
    "sed": "sed",
    "sudo": "sudo",
    "systemd": "journalctl systemctl timedatectl",
    "tar": "tar",
    "uidmap": "newuidmap newgidmap",
    "util-linux": "flock lsblk setsid",
    "wget": "wget",
    "xz-utils": "xz",
    "zstd": "zstd",
}

PACKAGES = MappingProxyType(
    {command: package for package, commands in _COMMANDS.items() for command in commands.split()}
)
"""Command -> the package of Debian and its descendants that has it."""
