from __future__ import annotations

import pytest

from fleet.errors import UsageError
from fleet.images import registry_images as images
from fleet.images.image import tagged_for

D = f"sha256:{'3f2a9c1b5d0e'.ljust(64, '0')}"
NAME = f"registry.local:5000/robots/talker:latest@{D}"


@pytest.mark.parametrize(
    ("text", "is_"),
    [
        ("bundle.tar", False),
        ("/media/me/STICK", False),
        ("/home/me@work/bundle.tar", False),
        ("ghcr.io/me/talker", False),
        ("me@work.tar", False),
        (NAME, True),
        (f"{NAME},ghcr.io/me/nav", True),
        ("talker@sha256:12", True),
    ],
)
def test_images_and_bundles_are_told_apart(text: str, is_: bool) -> None:
    """A digest is what only an image has."""
    assert images.meant(text) == is_


def test_names_are_separated_by_commas() -> None:
    """As `fab push` prints them, one for each image."""
    assert images.parse(f"{NAME}, ghcr.io/me/nav@{D}") == (NAME, f"ghcr.io/me/nav@{D}")


@pytest.mark.parametrize(
    "text",
    [
        f"{NAME},",
        f"{NAME},registry.local:5000/robots/nav:latest",
        f"talker@{D}",
        f"me/talker@{D}",
        f"ghcr.io/me/talker@{D}0",
        f"ghcr.io/me/Talker@{D}",
        "ghcr.io/me/talker@sha256:12",
    ],
)
def test_what_is_no_image_with_a_registry_and_a_digest(text: str) -> None:
    """A tag may move between two robots."""
    with pytest.raises(UsageError, match="is not an image of a registry with its digest"):
        images.parse(text)


@pytest.mark.parametrize(
    ("names", "wanted", "pins"),
    [
        ((NAME,), ("talker",), {"talker": NAME}),
        ((NAME,), ("talker:2", "nav"), {"talker:2": NAME}),
        ((NAME,), ("talker:1", "talker:2"), {"talker:1": NAME, "talker:2": NAME}),
        ((NAME,), ("ghcr.io/robots/talker", "talker"), {"ghcr.io/robots/talker": NAME}),
        ((NAME,), ("registry.local:5000/robots/talker",), {"registry.local:5000/robots/talker": NAME}),
        ((f"ghcr.io/me/mytalker@{D}",), ("talker", "mytalker"), {"mytalker": f"ghcr.io/me/mytalker@{D}"}),
    ],
)
def test_an_image_stands_for_that_of_its_name(
    names: tuple[str, ...], wanted: tuple[str, ...], pins: dict[str, str]
) -> None:
    """The path in the registry ends with it, whatever the registry is."""
    assert images.pins(names, wanted=wanted) == pins


def test_an_image_that_stands_for_none_or_two_for_one() -> None:
    """Nothing would be shipped, or one of them at random."""
    with pytest.raises(UsageError, match="no stack of these robots has the image") as caught:
        images.pins([NAME], wanted=["nav:1", "nav:2", "map"])
    assert caught.value.cure == "they have: map, nav"
    other = f"ghcr.io/me/talker@{D}"
    with pytest.raises(UsageError, match=f"two images for talker: {NAME} and {other}"):
        images.pins([NAME, other], wanted=["talker"])


def test_it_is_pulled_for_each_platform_and_called_like_one_that_was_built() -> None:
    """One platform after the other: all of them have the image's own name in turn."""
    commands = images.commands({"talker": NAME}, {"talker": {"linux/arm64", "linux/arm/v7"}, "nav": set()})
    assert [one.argv for one in commands] == [
        ("docker", "pull", "--platform", "linux/arm/v7", NAME),
        ("docker", "tag", NAME, "talker:sha256-3f2a9c1b5d0e-armv7"),
        ("docker", "pull", "--platform", "linux/arm64", NAME),
        ("docker", "tag", NAME, "talker:sha256-3f2a9c1b5d0e-arm64"),
    ]
    assert {one.turn for one in commands} == {NAME}
    assert all(one.only_missing for one in commands if one.pulls)
    assert tagged_for(images.local("talker", NAME), "linux/arm64") == "talker:sha256-3f2a9c1b5d0e-arm64"
