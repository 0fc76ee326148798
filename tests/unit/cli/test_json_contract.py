from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet.cli import find, heard, json_output, status
from fleet.cli.push import Pushed
from fleet.config.hardware import Hardware, Usb
from fleet.config.inventory import StackFiles
from fleet.config.registry import Registry
from fleet.errors import Unreachable
from fleet.images.layer import Blob
from fleet.plan.outcome import Outcome
from fleet.plan.step import Bytes, ImageArchive, Plan, Pull, Pulled, Record, Step, Upload, UploadBatch
from fleet.robot.facts import Dev
from fleet.rollout.sighting import Candidate, Sighting
from fleet.ros.measure import Report
from fleet.ros.message import Message
from fleet.ros.topics import Topic
from tests.support.samples import PI, container, facts

if TYPE_CHECKING:
    from collections.abc import Mapping

PAGE = (Path(__file__).parents[3] / "docs/reference/json.md").read_text(encoding="utf-8")

CONTAINER = {
    *(
        "name",
        "service",
        "release",
        "stack",
        "robot",
        "state",
        "health",
        "code",
        "restarts",
        "policy",
        "since",
    )
}
STACK = {
    "current",
    "checksum",
    "releases",
    "services",
    "history",
    "containers",
    "data",
    "journal",
    "boot",
    "stopped",
    "came",
}
DEV = {"dev", "dev.by", "dev.since"}
STATUS = {
    *("reachable", "healthy"),
    *(f"host.{key}" for key in ("identity", "machine", "userland", "os", "clock")),
    *(f"host.{key}" for key in ("temperature", "memory", "emulates", "missing")),
    *(f"login.{key}" for key in ("name", "home", "groups", "sudo", "noise", "home_state")),
    *(f"disk.{key}" for key in ("size", "free", "home_free", "shared")),
    *(f"docker.{key}" for key in ("state", "kind", "version", "client", "compose", "data_root", "driver")),
    *(f"docker.{key}" for key in ("containerd", "members", "daemon_config", "starts_at_boot", "finish_unit")),
    "docker.boot_unit",
    *("docker.runtimes", "docker.default_runtime", "docker.cdi"),
    *(f"hardware.{key}" for key in ("model", "l4t", "raw_table", "toolkit", "cdi", "devices", "boot_folder")),
    *(
        f"hardware.{key}"
        for key in ("raspi_config", "interfaces", "reboot_for", "udev_rules", "system_groups")
    ),
    *("packages.installed", "packages.interrupted", "packages.docker_source"),
    *("fleet.legacy", "fleet.stacks"),
    *(f"fleet.stacks.NAME.{key}" for key in STACK | DEV),
    *(f"fleet.stacks.NAME.containers[].{key}" for key in CONTAINER),
}
UNREACHABLE = {"reachable", "reason", "cure"}
INVENTORY = {
    *("name", "address", "user", "port", "identity_file", "platform", "boot"),
    *("transport", "registry"),
    *(f"registry.{key}" for key in ("address", "ca", "client_cert", "client_key", "user", "token")),
    *(f"ros.{key}" for key in ("version", "master", "hostname", "ip", "namespace", "strict")),
    *(f"ros.{key}" for key in ("domain", "rmw", "discovery", "peers")),
    *(f"docker.{key}" for key in ("script", "sha256", "version", "log_max_size", "log_max_file")),
    *("hardware.devices", "hardware.udev", "hardware.interfaces", "hardware.groups"),
    *(f"hardware.udev.NAME.{key}" for key in ("kind", "vendor", "product", "serial", "port")),
    *("card.timezone", "card.wifi"),
    *("environment", "pass_environment", "files", "known_hosts", "stacks", "peers"),
    *(f"stacks[].{key}" for key in ("files", "outside", "settle", "wait")),
}
FOUND = {
    *("address", "port", "also", "name", "maker", "system", "model"),
    *("robot", "expected", "here", "key", "fingerprint"),
}
OUTCOME = {
    *("robot", "status", "summary", "step", "reason", "cure"),
    *("seconds", "sent", "transfer", "unusable", "refused"),
}
STEP = {
    *("title", "argv", "feed", "feed.label", "feed.data", "expect", "cure", "limit"),
    *("fresh_login", "until_closed", "harmless", "resumes", "detached"),
}
PLANS = {
    *("plans", "problems"),
    *(
        f"plans[].{key}"
        for key in ("robot", "summary", "stack", "verb", "steps", "explain", "recover", "afterwards")
    ),
    *(f"plans[].steps[].{key}" for key in STEP),
    *(f"plans[].{key}" for key in ("record", "record.verb", "record.release", "record.by")),
    *("plans[].forecast", "plans[].transfer"),
}
IMAGE_FEED = {"image", "reference", "size"}
UPLOADS = {"label", "to", "pieces", *(f"pieces[].{key}" for key in ("digest", "size", "there", "data"))}

FED = Step(title="write", argv=("tar",), feed=Bytes(label="2 files", data=b"12"))
PLAN = Plan(
    robot="pi1", summary="", steps=(FED,), record=Record(verb="ship", release="abc", by="tim@desktop")
)
WHOLE = PI.model_copy(
    update={
        "stacks": (StackFiles(files=(Path("compose.yaml"),)),),
        "registry": Registry(address="registry.local:5000"),
        "hardware": Hardware(udev={"lidar": Usb(vendor="10c4", product="ea60")}),
    }
)
SEEN = Sighting(candidate=Candidate(address="192.0.2.7"), fingerprint="SHA256:abc", key="new")
LISTENED: list[Mapping[str, object]] = []
"""A message and a report, as they are printed."""
MESSAGE = Message(at=1.0, monotonic=1.0, size=1, read=dict)
heard.as_json("/time", LISTENED.append)("pi1", MESSAGE, None)
heard.report_as_json("/time", LISTENED.append)("pi1", Report(rate=1, shortest=1, longest=1, bytes=1), None)
PRINTED = {
    "`fab status --json`": (
        STATUS,
        status.record(
            facts(
                current="abc",
                releases=("abc",),
                containers=(container("abc"),),
                dev=Dev(by="tim@desktop", since="2026"),
            )
        ),
    ),
    "A robot that could not be reached": (UNREACHABLE, status.record(Unreachable("away", cure="look"))),
    "`fab find --json`": (FOUND, find.record(SEEN, model="")),
    "`fab push --json`": (
        {"image", "platforms", "bytes"},
        Pushed(image="r:5000/talker:1", platforms=("linux/arm64",), bytes=1)._asdict(),
    ),
    "`fab inventory --json`": (INVENTORY, WHOLE.model_dump(mode="json")),
    "`fab topics --json`": (
        {"name", "type", "publishers", "subscribers", "quality", "unmatched", "rate"},
        Topic(name="/time", type="std_msgs/msg/Header", publishers=1),
    ),
    "`fab listen --json`": ({"robot", "topic", "at", "message"}, LISTENED[0]),
    "`fab listen --rate --json` and `--delay --json`": (
        {
            *("robot", "topic", "rate", "shortest", "longest", "bytes", "delay", "delay_least", "delay_most"),
            *("clock_ahead", "clock_error"),
        },
        LISTENED[1],
    ),
    "`fab ship --json` and other verbs that change robots": (OUTCOME, Outcome(robot="pi1", status="done")),
    "`--dry --json`": (PLANS, {"plans": (PLAN,), "problems": ()}),
    "A feed that is an image": (IMAGE_FEED, ImageArchive(image="a", reference="b", size=1)),
    "A feed that is pulled": (
        {
            *("label", "images", "bytes", "registry"),
            *(f"images[].{key}" for key in ("name", "path", "manifest", "config", "blobs")),
            *(f"images[].blobs[].{key}" for key in ("diff_id", "digest", "size", "media_type", "unpacked")),
        },
        Pull(
            label="a",
            images=(
                Pulled(name="a", path="b", manifest=b"{}", config=b"{}", blobs=(Blob.plain("sha256:1", 1),)),
            ),
            bytes=1,
        ),
    ),
    "A feed that is a batch of uploads": (
        UPLOADS,
        UploadBatch(label="a", to="b", pieces=(Upload(digest="c", size=1),)),
    ),
}
"""Each heading of the page: its keys, and a value as the verb prints it."""


def keys(value: object, path: str = "") -> set[str]:
    """The dotted keys of a JSON value, each list's elements under `[]`."""
    if isinstance(value, list):
        return set().union(*(keys(item, f"{path}[]") for item in value))
    if not isinstance(value, dict):
        return set()
    prefix = f"{path}." if path else ""
    if path in ("fleet.stacks", "hardware.udev") and value:  # by name
        value = {"NAME": next(iter(value.values()))}
    return {f"{prefix}{key}" for key in value} | set().union(
        *(keys(item, f"{prefix}{key}") for key, item in value.items())
    )


SECTIONS = {"card", "host", "login", "disk", "docker", "packages", "hardware", "fleet", "ros"}
"""Objects that the page shows by what is in them."""


def documented(heading: str) -> set[str]:
    """The keys in the table under a heading of the page."""
    text = re.split(r"^#+ ", PAGE.partition(f" {heading}\n")[2], maxsplit=1, flags=re.MULTILINE)[0]
    return set(re.findall(r"^\| `([^`]+)` \|", text, flags=re.MULTILINE))


@pytest.mark.parametrize("heading", PRINTED)
def test_programs_can_rely_on_the_keys(heading: str) -> None:
    """A key that is renamed or gone breaks somebody's program: change this set in a major version only."""
    promised, value = PRINTED[heading]
    assert (
        keys(json.loads(json_output.text(value))) - SECTIONS - {"fleet.stacks.NAME", "hardware.udev.NAME"}
        == promised
    )


@pytest.mark.parametrize("heading", PRINTED)
def test_the_page_names_each_key(heading: str) -> None:
    """It is what authors of programs read."""
    assert documented(heading) == PRINTED[heading][0]


def test_every_table_of_the_page_is_compared() -> None:
    """A section that no test knows would go stale."""
    headings = re.findall(r"^#+ (.*)$", PAGE, flags=re.MULTILINE)
    assert [heading for heading in headings if documented(heading)] == list(PRINTED)
