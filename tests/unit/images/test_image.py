from __future__ import annotations

import hashlib
import json

import pytest

from fleet.images.image import (
    Image,
    configuration,
    l4t,
    same_platform,
    tagged_for,
)

X = "sha256:2d711642b726b04401627ca9fbac32f5c8530fb1903cc4db02258717921a4881"
Y = f"sha256:{'1' * 64}"


@pytest.mark.parametrize(
    ("reference", "platform", "tag"),
    [
        ("talker", "linux/arm64", "talker:latest-arm64"),
        ("talker", "linux/arm/v7", "talker:latest-armv7"),
        ("talker:1.2", "linux/amd64", "talker:1.2-amd64"),
        ("registry.local:5000/talker", "linux/arm64", "registry.local:5000/talker:latest-arm64"),
        ("talker@sha256:" + "a" * 64, "linux/arm64", f"talker:sha256-{'a' * 12}-arm64"),
        ("talker:1@sha256:" + "b" * 64, "linux/arm64", f"talker:sha256-{'b' * 12}-arm64"),
        ("talker:" + "x" * 128, "linux/amd64", f"talker:{'x' * 80}-24da1b81d0b1-amd64"),
    ],
)
def test_builds_for_each_platform_have_tags_of_their_own(reference: str, platform: str, tag: str) -> None:
    """In Docker's classic store one name holds one platform."""
    assert tagged_for(reference, platform) == tag


def test_an_image_is_shipped_under_a_name_that_says_what_it_is() -> None:
    """The same content has the same name whatever it is called here; other content has another."""
    one = Image(reference="talker:latest-arm64", platform="linux/arm64", size=1, identity=X)
    moved = Image(reference="talker:1.2", platform="linux/arm64", size=1, identity=X)
    other = Image(reference="talker:latest-arm64", platform="linux/arm64", size=1, identity=Y)
    assert one.shipped_as == "talker:fleet-2d711642b726"
    assert moved.shipped_as == one.shipped_as
    assert other.shipped_as != one.shipped_as


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("linux/arm64", "linux/arm64/v8", True),
        ("linux/arm", "linux/arm/v7", True),
        ("linux/arm/v6", "linux/arm/v7", False),
        ("linux/amd64", "linux/arm64", False),
        ("linux/amd64", "linux/amd64/v1", True),
        ("linux/amd64", "linux/amd64/v3", False),
    ],
)
def test_platforms_have_more_than_one_name(one: str, other: str, same: bool) -> None:
    """Compose files say linux/arm64/v8 where Docker says linux/arm64."""
    assert same_platform(one, other) is same


def test_the_configuration_for_a_platform_is_found_through_an_index() -> None:
    """A containerd store saves an index of manifests, of which some are no images."""

    def add(value: object) -> str:
        data = json.dumps(value).encode()
        digest = hashlib.sha256(data).hexdigest()
        members[f"blobs/sha256/{digest}"] = data
        return f"sha256:{digest}"

    members: dict[str, bytes] = {}
    configs = {name: add({"os": "linux", "architecture": name, "config": {}}) for name in ("amd64", "arm64")}
    manifests = [{"digest": add({"config": {"digest": digest}})} for digest in configs.values()]
    index = add({"manifests": [*manifests, {"digest": f"sha256:{'0' * 64}"}, "nonsense"]})
    members["index.json"] = json.dumps({"manifests": [{"digest": index}]}).encode()
    found = configuration(members, "linux/arm64/v8")
    assert found
    assert f"sha256:{hashlib.sha256(found).hexdigest()}" == configs["arm64"]
    assert configuration(members, "linux/arm/v7") is None


@pytest.mark.parametrize("text", ["", "[", "[" * 100_000, "[1]", '{"manifests": 7}', '[{"Config": "x"}]'])
def test_an_archive_that_says_nonsense_holds_nothing(text: str) -> None:
    """Whoever wrote it."""
    assert configuration({"manifest.json": text.encode(), "index.json": text.encode()}, "linux/arm64") is None


@pytest.mark.parametrize(
    ("reference", "config", "version"),
    [
        ("nvcr.io/nvidia/l4t-base:r36.2.0", {}, "36.2.0"),
        ("nvcr.io/nvidia/l4t-pytorch:r35.2.1-pth2.0-py3", {}, "35.2.1"),
        ("dustynv/ros:humble-desktop-l4t-r36.4.0", {"Env": ["PATH=/bin"], "Labels": None}, "36.4.0"),
        ("dustynv/ros:humble-desktop-l4t-r36.4.0-arm64", {"Env": None}, "36.4.0"),
        ("talker:latest", {"Env": ["L4T_VERSION=36.4"]}, "36.4"),
        ("talker:latest", {"Env": ["L4T_VERSION=r35.4.1"]}, "35.4.1"),
        ("talker:latest", {"Env": ["L4T_MAJOR_VERSION=32", "L4T_MINOR_VERSION=6"]}, "32"),
        ("talker:latest", {"Labels": {"l4t_version": "r36.3.0"}}, "36.3.0"),
        ("l4t-base:r36.2.0", {"Env": ["L4T_VERSION="]}, ""),
        ("talker:latest", {"Env": ["L4T_VERSION=newest"]}, ""),
        ("talker:r36.2.0", {}, ""),
        ("talker:latest", {}, ""),
    ],
)
def test_the_l4t_that_an_image_is_made_for(reference: str, config: dict[str, object], version: str) -> None:
    """Variables and labels as people write them; the tags of NVIDIA and jetson-containers. An empty variable says: any."""
    assert l4t(reference, config) == version
