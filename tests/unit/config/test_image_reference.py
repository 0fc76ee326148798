from __future__ import annotations

import pytest

from fleet.config.image_reference import is_reference, one_image, repository


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
    ("reference", "alone"),
    [
        ("talker", "talker:latest"),
        ("talker:1.2", "talker:1.2"),
        ("registry.local:5000/talker", "registry.local:5000/talker:latest"),
        ("talker@sha256:" + "a" * 64, "talker@sha256:" + "a" * 64),
    ],
)
def test_a_name_without_a_tag_means_one_image(reference: str, alone: str) -> None:
    """`docker save talker` would save every tag of it."""
    assert one_image(reference) == alone


@pytest.mark.parametrize(
    ("text", "good"),
    [
        ("talker", True),
        ("ghcr.io/me/talker:1.2", True),
        ("localhost:5000/a__b/c-d.e:X_1", True),
        ("talker@sha256:" + "a" * 64, True),
        ("talker:" + "x" * 128, True),
        ("talker:" + "x" * 129, False),
        ("Talker", False),
        ("a:1:2", False),
        ("", False),
        ("a b", False),
        ("http://registry/x", False),
        ("talker@sha256:aa", False),
        ("a" * 256, False),
        ("-talker", False),
    ],
)
def test_what_docker_takes_for_a_name(text: str, good: bool) -> None:
    """By the grammar of github.com/distribution/reference."""
    assert is_reference(text) is good
