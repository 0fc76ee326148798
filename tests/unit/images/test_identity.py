from __future__ import annotations

from typing import Any

import pytest

from fleet.images.identity import identity

CONFIG: dict[str, Any] = {
    "Env": ["PATH=/bin", "GREETING=hello you"],
    "Entrypoint": ["/entry point"],
    "Cmd": ["talk", "--fast"],
    "User": "1000:1000",
    "WorkingDir": "/srv",
    "Volumes": {"/b": {}, "/a": {}},
    "StopSignal": "SIGINT",
    "Healthcheck": {"Test": ["CMD", "check", "a b"], "Interval": 5_000_000_000, "Retries": 2},
}


@pytest.mark.parametrize(
    "change",
    [
        {"Env": ["PATH=/usr/bin"]},
        {"Entrypoint": ["/other"]},
        {"Cmd": ["talk"]},
        {"User": "root"},
        {"WorkingDir": "/"},
        {"Volumes": {"/a": {}}},
        {"StopSignal": "SIGTERM"},
        {"Healthcheck": {"Test": ["CMD", "check", "a", "b"], "Interval": 5_000_000_000, "Retries": 2}},
        {"Healthcheck": {"Test": ["CMD", "check", "a b"], "Interval": 6_000_000_000, "Retries": 2}},
    ],
)
def test_whatever_changes_how_an_image_runs_changes_its_identity(change: dict[str, Any]) -> None:
    """A new healthcheck adds no layer, and must be shipped all the same."""
    described = {"Os": "linux", "Architecture": "arm64", "RootFS": {"Layers": ["sha256:aa"]}}
    before = identity({**described, "Config": CONFIG})
    assert identity({**described, "Config": {**CONFIG, **change}}) != before
    assert identity({**described, "Config": CONFIG, "Architecture": "arm"}) != before
    assert identity({**described, "Config": CONFIG, "RootFS": {"Layers": ["sha256:bb"]}}) != before


def test_names_and_times_are_not_part_of_an_identity() -> None:
    """The same build on another day is the same image."""
    described = {"Os": "linux", "Architecture": "arm64", "RootFS": {"Layers": None}, "Config": None}
    assert identity({**described, "Id": "1", "Created": "then", "RepoTags": ["a"]}) == identity(described)
    assert identity(described) == "linux/arm64\nuser \ndirectory"
