"""What is built into a robot or plugged in, and what does its system need to use it? From sections of the probe's answer."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.robot import raspberry_pi

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

UDEV_RULES = "/etc/udev/rules.d/99-fleet.rules"
"""The rules that `fab provision` writes. `onboard/probe.sh` has the path too."""

_MOST = 5000
"""Devices that are kept: more are no robot's."""


@dataclass(frozen=True, kw_only=True)
class Hardware:
    """The robot's board and what belongs to it.

    ``model`` is the device tree's name of the board, ``l4t`` the version of NVIDIA's Linux on a Jetson (``36.4.0``).
    ``raw_table``: Docker has the iptables table ``raw``, or does not need it; None if that is not known. ``toolkit``: the
    command ``nvidia-ctk`` is there. ``cdi`` names the devices of CDI specifications (``nvidia.com/gpu=all``). ``devices``
    are paths in /dev: those that are plugged in or switched on, or, if the probe asked for images, all.
    ``boot_folder`` is where a Raspberry Pi has its config.txt, ``raspi_config`` whether that command is there,
    ``interfaces`` those that are switched on, ``reboot_for`` those that wait for a reboot. ``udev_rules`` is the text of
    `UDEV_RULES`. ``system_groups`` are the groups that exist.
    """

    model: str = ""
    l4t: str = ""
    raw_table: bool | None = None
    toolkit: bool = False
    cdi: tuple[str, ...] = ()
    devices: tuple[str, ...] = ()
    boot_folder: str = ""
    raspi_config: bool = False
    interfaces: tuple[str, ...] = ()
    reboot_for: tuple[str, ...] = ()
    udev_rules: str = ""
    system_groups: tuple[str, ...] = ()

    @property
    def l4t_major(self) -> str:
        """``36`` of ``36.4.0``; "" if this is no Jetson."""
        return self.l4t.partition(".")[0]

    @property
    def lacks_raw_table(self) -> bool:
        """Whether Docker 28 and newer do not work here, as far as it can be told. Of a Jetson it is assumed."""
        return self.raw_table is False or (self.raw_table is None and bool(self.l4t))


def parse(sections: Mapping[str, str]) -> Hardware:
    """Read the sections; one that is missing or strange leaves its facts at their defaults."""
    model = " ".join(sections["model"].split())[:200]
    folder, raspi_config, cmdline, config = (*sections["pi"].split("\n", 3), "", "", "", "")[:4]
    return Hardware(
        model=model,
        l4t=l4t(sections["l4t"]),
        raw_table={"yes": True, "unused": True, "no": False}.get(sections["raw"]),
        toolkit=bool(sections["toolkit"]),
        cdi=tuple(_cdi(sections["cdi"])),
        devices=tuple(line for line in sections["devices"].splitlines() if line.startswith("/dev/"))[:_MOST],
        boot_folder=folder if folder.startswith("/boot") else "",
        raspi_config=raspi_config.startswith("/"),
        interfaces=raspberry_pi.switched_on(config, cmdline=cmdline, model=model),
        reboot_for=tuple(dict.fromkeys(sections["reboot"].split())),
        udev_rules=sections["udev"],
        system_groups=tuple(sections["groups"].split()),
    )


def l4t(text: str) -> str:
    """The version of NVIDIA's Linux, from /etc/nv_tegra_release or from the version of the package nvidia-l4t-core."""
    if found := re.search(r"\bR([0-9]{1,3}) \(release\), REVISION: ([0-9]{1,3}(?:\.[0-9]{1,3})*)", text):
        return f"{found[1]}.{found[2]}"
    found = re.match(r"[0-9]{1,3}(?:\.[0-9]{1,3})+", text)
    return found[0] if found else ""


def _cdi(text: str) -> Iterable[str]:
    """The qualified names of the devices in CDI specifications, each a line ``spec``, then ``kind`` and ``name`` lines."""
    for spec in f"\n{text}".split("\nspec")[1:]:
        words = [line.split() for line in spec.splitlines() if line.count(" ") == 1]
        kind = next((word[1] for word in words if len(word) == 2 and word[0] == "kind"), "")
        names = (word[1] for word in words if len(word) == 2 and word[0] == "name")
        yield from (f"{kind}={name}" for name in names if kind)
