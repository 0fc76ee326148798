from __future__ import annotations

from dataclasses import replace

import pytest

from fleet import onboard
from fleet.bundle import index
from fleet.errors import UsageError
from tests.support.bundles import bundle


def test_what_is_written_can_be_read() -> None:
    """All of it, also a robot's keys, and what its release wants."""
    whole, _ = bundle()
    wants = (("device", "/dev/ttyUSB0"), ("port", "80/tcp"))
    robots = tuple(
        replace(
            one,
            keys=(("ssh-ed25519", "AAAA"),),
            stacks=tuple(replace(stack, wants=wants) for stack in one.stacks),
        )
        for one in whole.robots
    )
    whole = replace(whole, robots=robots)
    assert index.parse(index.text(whole)) == whole
    assert whole.robot("pi2").stacks[0].name == "talker"


def test_a_robot_that_is_not_there_is_named_with_those_that_are() -> None:
    """For `fab ship --from`."""
    with pytest.raises(UsageError, match="nothing for pi9; it has: pi1, pi2"):
        bundle()[0].robot("pi9")


@pytest.mark.parametrize("old", ["sha256:", "made", "by", "pi1", " talker:fleet"])
def test_a_damaged_index_is_refused(old: str) -> None:
    """Names become paths, so they must look like names."""
    text = index.text(bundle()[0])
    with pytest.raises(UsageError, match="index is damaged"):
        index.parse(text.replace(old, "../x "))


def test_another_version_is_refused() -> None:
    """And nothing is an index too."""
    for text in ("", "fleet-bundle 2\nmade x\n"):
        with pytest.raises(UsageError, match="reads 'fleet-bundle 1'"):
            index.parse(text)


def test_the_program_on_the_robot_reads_the_same_version() -> None:
    """It has the words as its own."""
    assert f"= '{index.FORMAT}'" in onboard.text("install.sh")
