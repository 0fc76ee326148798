from __future__ import annotations

import pytest

from fleet.images.image import Image, repository, tagged_for


@pytest.mark.parametrize(
    ("reference", "name"),
    [
        ("talker", "talker"),
        ("talker:1.2", "talker"),
        ("me/talker:1.2", "me/talker"),
        ("registry.local:5000/talker", "registry.local:5000/talker"),
        ("registry.local:5000/me/talker:1.2", "registry.local:5000/me/talker"),
        ("talker@sha256:" + "a" * 64, "talker"),
        ("talker:1.2@sha256:" + "a" * 64, "talker"),
    ],
)
def test_the_repository_of_a_reference(reference: str, name: str) -> None:
    """Neither tag nor digest; a port is none of them."""
    assert repository(reference) == name


@pytest.mark.parametrize(
    ("reference", "platform", "tag"),
    [
        ("talker", "linux/arm64", "talker:latest-arm64"),
        ("talker", "linux/arm/v7", "talker:latest-armv7"),
        ("talker:1.2", "linux/amd64", "talker:1.2-amd64"),
        ("registry.local:5000/talker", "linux/arm64", "registry.local:5000/talker:latest-arm64"),
        ("talker@sha256:" + "a" * 64, "linux/arm64", "talker:latest-arm64"),
    ],
)
def test_builds_for_each_platform_have_tags_of_their_own(reference: str, platform: str, tag: str) -> None:
    """In Docker's classic store one name holds one platform."""
    assert tagged_for(reference, platform) == tag


def test_an_image_is_shipped_under_a_name_that_says_what_it_is() -> None:
    """The same content has the same name whatever it is called here; other content has another."""
    one = Image(reference="talker:latest-arm64", platform="linux/arm64", size=1, identity="x")
    moved = Image(reference="talker:1.2", platform="linux/arm64", size=1, identity="x")
    other = Image(reference="talker:latest-arm64", platform="linux/arm64", size=1, identity="y")
    assert one.shipped_as == "talker:fleet-2d711642b726"  # the first digits of `printf x | sha256sum`
    assert moved.shipped_as == one.shipped_as
    assert other.shipped_as != one.shipped_as
