from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.config import inventory
from fleet.config.card import Card, Network, Wifi, model_at
from fleet.errors import InventoryError

if TYPE_CHECKING:
    from pathlib import Path


def load(folder: Path, text: str) -> inventory.Inventory:
    path = folder / "inventory.yaml"
    path.write_text(text)
    return inventory.load(path)


def test_a_card_is_merged_key_by_key(tmp_path: Path) -> None:
    """The Wi-Fi of all, and a time zone of its own. A passphrase is never printed."""
    wifi = "wifi: {country: DE, networks: [{name: Lab, passphrase: geheim12}]}"
    fleet = load(
        tmp_path,
        f"defaults: {{card: {{timezone: UTC, {wifi}}}}}\nrobots: {{pi1: , pi2: {{card: {{timezone: Europe/Berlin}}}}}}\n",
    )
    one, two = fleet.robots.values()
    assert (one.card.timezone, two.card.timezone) == ("UTC", "Europe/Berlin")
    assert one.card.wifi == two.card.wifi
    assert two.card.wifi
    assert two.card.wifi.networks[0].passphrase
    assert two.card.wifi.networks[0].passphrase.get_secret_value() == "geheim12"
    for shown in (repr(two), str(two.model_dump()), two.model_dump_json()):
        assert "geheim" not in shown


@pytest.mark.parametrize(
    ("card", "problem"),
    [
        ("{timezone: 'Berlin time'}", "card.timezone: must be a time zone such as Europe/Berlin"),
        ("{wifi: {networks: [{name: Lab}]}}", "card.wifi.country: is missing"),
        ("{wifi: {country: Germany, networks: [{name: Lab}]}}", "must be a country's two letters"),
        ("{wifi: {country: DE, networks: []}}", "must name at least one"),
        ("{wifi: {country: DE, networks: [{name: ''}]}}", "must be 1 to 32 bytes long, not 0"),
        (f"{{wifi: {{country: DE, networks: [{{name: {'ß' * 17}}}]}}}}", "not 34"),
        ("{wifi: {country: DE, networks: [{name: Lab, hidde: true}]}}", "did you mean 'hidden'?"),
        ("{wifi: {country: DE, networks: [{name: Lab, passphrase_from: $X}]}}", "not a name for a variable"),
        (
            "{wifi: {country: DE, networks: [{name: Lab, open: true, passphrase_from: X}]}}",
            "exclude each other",
        ),
        ("{wlan: 1}", "no such key"),
    ],
)
def test_what_is_wrong_has_a_line_and_a_sentence(tmp_path: Path, card: str, problem: str) -> None:
    with pytest.raises(InventoryError) as refused:
        load(tmp_path, f"robots:\n  pi1:\n    card: {card}\n")
    assert problem in refused.value.what
    assert "inventory.yaml:3: robots.pi1.card" in refused.value.what


@pytest.mark.parametrize(
    ("written", "problem"),
    [
        ("12345678", "must be text, and YAML reads this as a number or a truth value; put it in quotes"),
        ("0123.4567", "put it in quotes"),
        ("true", "put it in quotes"),
        ("[geheim12]", "passphrase: must be text"),
        ("!geheim12", "put text that begins with `!` in quotes"),
        ("*geheim12", "put text that begins with `*` in quotes"),
        ("!geh!eim12", "not YAML"),
        ('"\\geheim12', "not YAML"),
        ("@geheim12", "put it in quotes"),
        ("geheim12: 12", "quote text that holds `: `"),
    ],
)
def test_a_passphrase_is_never_in_a_message(tmp_path: Path, written: str, problem: str) -> None:
    """People send messages on, to logs and to chats."""
    text = f"robots:\n  pi1:\n    card:\n      wifi:\n        country: DE\n        networks:\n          - name: Lab\n            passphrase: {written}\n"
    with pytest.raises(InventoryError) as refused:
        load(tmp_path, text)
    assert problem in str(refused.value)
    assert "inventory.yaml:8" in refused.value.what
    for part in ("1234", "4567", "geh", "eim"):
        assert part not in str(refused.value).removeprefix(str(tmp_path))


def test_the_model_at_a_location() -> None:
    """For the names of keys that a person may have meant."""
    assert model_at(()) is Card
    assert model_at(("wifi",)) is Wifi
    assert model_at(("wifi", "networks", 0)) is Network
