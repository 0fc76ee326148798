from __future__ import annotations

from dataclasses import replace

from fleet.card import userconf
from fleet.card.first_boot import MARK
from tests.support.first_boots import FIRST, KEY


def test_what_bullseye_is_told() -> None:
    """Names of networks are hexadecimal: no character of them needs quoting."""
    files = userconf.files(FIRST)
    assert (files["ssh"], files["userconf.txt"]) == (f"{MARK}pi7\n", "pi:$6$salt$hash\n")
    assert files["wpa_supplicant.conf"].splitlines()[1:] == [
        "country=DE",
        "ctrl_interface=DIR=/var/run/wpa_supplicant GROUP=netdev",
        "update_config=1",
        "network={",
        "\tssid=" + 'Lab: "5 GHz" ß'.encode().hex(),
        f"\tpsk={KEY}",
        "}",
        "network={",
        f"\tssid={b'Guests'.hex()}",
        "\tscan_ssid=1",
        "\tkey_mgmt=NONE",
        "}",
    ]
    assert set(userconf.files(replace(FIRST, networks=()))) == {"ssh", "userconf.txt"}


def test_the_salt_of_a_card_is_read_back() -> None:
    """With it, the same password is the same file."""
    assert userconf.salt("pi:$6$salt$hash\n") == "salt"
    assert userconf.salt("pi:$5$salt$hash\n") == userconf.salt("") == userconf.salt("nonsense") == ""


def test_what_is_lost_is_said() -> None:
    key, name = userconf.lost(FIRST)
    assert "ssh-copy-id pi@ADDRESS" in key
    assert "the name pi7 and the time zone Europe/Berlin" in name
