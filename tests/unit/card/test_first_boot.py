from __future__ import annotations

import pytest

from fleet.card import first_boot
from fleet.errors import UsageError
from tests.support.first_boots import FIRST, KEY
from tests.support.samples import PI


def test_the_key_of_a_passphrase() -> None:
    """The test vectors of IEEE 802.11i, H.4.3; a key is already one."""
    key = first_boot.wifi_key("password", network="IEEE")
    assert key == "f42c6fc52df0ebef9ebb4b90b38a5f902e83fe1b135a70e23aed762e9710a12e"
    assert first_boot.wifi_key("AB" * 32, network="IEEE") == "ab" * 32


@pytest.mark.parametrize(
    ("passphrase", "reason"),
    [
        ("geheim1", "has 7 characters"),
        ("x" * 64, "has 64 characters"),
        ("straße12", "has a character that Wi-Fi does not take"),
        ("", "has 0 characters"),
    ],
)
def test_a_passphrase_that_cannot_be_one(passphrase: str, reason: str) -> None:
    """The sentence has the network, and not the passphrase."""
    with pytest.raises(UsageError) as refused:
        first_boot.wifi_key(passphrase, network="Lab")
    assert f"the passphrase of the Wi-Fi Lab {reason}" in refused.value.what
    assert not passphrase or passphrase not in str(refused.value)


def test_the_name_of_a_computer() -> None:
    """As others reach it, or as the inventory calls it."""
    assert first_boot.hostname(PI.model_copy(update={"address": "robi.local"})) == "robi"
    assert first_boot.hostname(PI.model_copy(update={"address": "192.168.1.7"})) == "pi1"
    for wrong in ("my_robot", "-pi", "a" * 64, "pi.7"):
        with pytest.raises(UsageError, match=f"a computer cannot be called {wrong}"):
            first_boot.hostname(PI.model_copy(update={"address": "192.168.1.7", "name": wrong}))


def test_a_time_zone_that_does_not_exist() -> None:
    """A desktop without a list of them lets it pass."""
    first_boot.check_timezone("Europe/Berlin", known={"Europe/Berlin"})
    first_boot.check_timezone("", known={"Europe/Berlin"})
    first_boot.check_timezone("Europe/Berlin", known=())
    with pytest.raises(UsageError, match="no time zone Europe/Brelin"):
        first_boot.check_timezone("Europe/Brelin", known={"Europe/Berlin"})


def test_whose_file_it_is() -> None:
    """One of the first lines says so; a sentence somewhere else does not."""
    assert first_boot.prepared_for(f"#cloud-config\n{first_boot.MARK}pi7\nhostname: x\n") == "pi7"
    assert first_boot.prepared_for("#cloud-config\nhostname: pi7\n") == ""
    assert first_boot.prepared_for("a\nb\nc\n" + first_boot.MARK + "pi7\n") == ""


def test_secrets_are_not_shown() -> None:
    """Neither on purpose nor in a traceback."""
    for shown in (repr(FIRST), str(FIRST.without_secrets()), repr(FIRST.without_secrets())):
        assert KEY not in shown
        assert "abc" not in shown
        assert "$6$" not in shown
    assert FIRST.without_secrets().networks[0].key == first_boot.HIDDEN
