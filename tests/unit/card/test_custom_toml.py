from __future__ import annotations

import tomllib
from dataclasses import replace

from fleet.card import custom_toml
from tests.support.first_boots import FIRST, KEY


def test_what_bookworm_is_told() -> None:
    """Its keys are those of init_config; the login has no password, and so only keys."""
    assert tomllib.loads(custom_toml.files(FIRST)["custom.toml"]) == {
        "config_version": 1,
        "system": {"hostname": "pi7"},
        "user": {"name": "pi"},
        "ssh": {"enabled": True, "password_authentication": False, "authorized_keys": list(FIRST.keys)},
        "wlan": {
            "ssid": 'Lab: "5 GHz" ß',
            "password": KEY,
            "password_encrypted": True,
            "hidden": False,
            "country": "DE",
        },
        "locale": {"timezone": "Europe/Berlin"},
    }


def test_what_is_not_wanted_is_not_said() -> None:
    found = tomllib.loads(custom_toml.files(replace(FIRST, networks=(), timezone=""))["custom.toml"])
    assert found.keys() == {"config_version", "system", "user", "ssh"}
    hidden = tomllib.loads(custom_toml.files(replace(FIRST, networks=FIRST.networks[1:]))["custom.toml"])
    assert hidden["wlan"] == {"ssid": "Guests", "hidden": True, "country": "DE"}


def test_a_second_network_is_lost_and_that_is_said() -> None:
    assert custom_toml.lost(FIRST) == ("this system takes one Wi-Fi network, so these are left out: Guests",)
    assert custom_toml.lost(replace(FIRST, networks=FIRST.networks[:1])) == ()
