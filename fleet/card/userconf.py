"""What does Raspberry Pi OS bullseye read at its boot? ``ssh``, ``userconf.txt`` and ``wpa_supplicant.conf``.

See "Headless setup" in the documentation of Raspberry Pi, in its state of 2022. There is no place for keys, a name or a
time zone: the login has a password.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.card.first_boot import MARK

if TYPE_CHECKING:
    from fleet.card.first_boot import FirstBoot

SSH, LOGIN, WIFI = "ssh", "userconf.txt", "wpa_supplicant.conf"


def files(first: FirstBoot) -> dict[str, str]:
    """Return the files by name."""
    # Only its name counts for the system (sshswitch.service), so its text tells whose card it is.
    made = {SSH: f"{MARK}{first.robot}\n", LOGIN: f"{first.user}:{first.password}\n"}
    if not first.networks:
        return made
    lines = [
        f"{MARK}{first.robot}",
        f"country={first.country}",
        "ctrl_interface=DIR=/var/run/wpa_supplicant GROUP=netdev",
        "update_config=1",
    ]
    for one in first.networks:
        lines += ["network={", f"\tssid={one.name.encode().hex()}"]  # hexadecimal: any name, without quoting
        lines += ["\tscan_ssid=1"] if one.hidden else []
        lines += [f"\tpsk={one.key}" if one.key else "\tkey_mgmt=NONE", "}"]
    return {**made, WIFI: "\n".join(lines) + "\n"}


def salt(userconf: str) -> str:
    """Return the salt of the password that a card has already, "" if there is none: then the same password is the same file."""
    match userconf.strip().partition(":")[2].split("$"):
        case ["", "6", salt, _]:
            return salt
        case _:
            return ""


def lost(first: FirstBoot) -> tuple[str, ...]:
    """Say what this system cannot be told."""
    after = f"the name {first.hostname}" + (f" and the time zone {first.timezone}" if first.timezone else "")
    return (
        f"this system takes no SSH key: log in with the password once, as `ssh-copy-id {first.user}@ADDRESS` does",
        f"this system takes no name: set {after} with `sudo raspi-config` on the robot",
    )
