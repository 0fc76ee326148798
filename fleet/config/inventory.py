"""Who are the robots?

`load` reads an inventory file, the files it includes, and answers with robots whose values are merged: defaults, then
the robot's groups in file order, then the robot itself. Everything wrong is reported at once, with file and line.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PlainValidator, ValidationError

from fleet.config import card, hardware, merge, validation
from fleet.config.card import Card
from fleet.config.hardware import Hardware
from fleet.config.model import Frozen, Members
from fleet.config.registry import Registry, RegistryValues
from fleet.config.ros import Ros
from fleet.config.selection import choose
from fleet.errors import InventoryError, SelectionError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pydantic_core import ErrorDetails

    from fleet.config.yamlfile import Document, Location

Platform = Literal["linux/arm64", "linux/arm/v7", "linux/amd64"]


def _group(value: object) -> object:
    return {"robots": value or []} if value is None or isinstance(value, list) else value


def _stack(value: object) -> object:
    return {"files": [value]} if isinstance(value, str) else value


def _stacks(value: object) -> object:
    return value if isinstance(value, list) else [value]


def _robot(value: object) -> object:
    return {"address": value} if isinstance(value, str) else {} if value is None else value


Text = Annotated[str, Field(pattern=validation.TEXT)]
Name = Annotated[str, Field(pattern=validation.NAME)]
Address = Annotated[str, Field(pattern=validation.ADDRESS)]
Scalar = str | int | float
Environment = dict[
    Annotated[str, Field(pattern=validation.VARIABLE)],
    Annotated[Scalar, PlainValidator(validation.environment_value, json_schema_input_type=Scalar)],
]
Files = dict[Annotated[str, Field(pattern=validation.FILE)], Text]
# Keys that match no pattern: pydantic refuses them, its JSON Schema has to be told.
_CLOSED = Field(json_schema_extra={"additionalProperties": False})


class Docker(Frozen):
    """How Docker gets onto the robot."""

    script: Text = Field(
        default="https://get.docker.com",
        description="Docker's convenience script: a URL, or a path relative to this file.",
    )
    sha256: Annotated[str, Field(pattern=validation.SHA256)] | None = Field(
        default=None, description="Checksum of the script; another one is not run."
    )
    version: Annotated[str, Field(pattern=validation.VERSION)] | None = Field(
        default=None,
        description="Docker Engine version to install, in full, such as '27.5.1'. Default: the newest.",
    )
    log_max_size: Annotated[str, Field(pattern=validation.SIZE)] = Field(
        default="10m", description="Size at which a container's log file is rotated, such as '10m'."
    )
    log_max_file: int = Field(default=3, ge=1, description="Log files kept per container.")


class StackValues(Frozen):
    """A stack: its Compose files, and how it is sent and watched."""

    files: Annotated[list[Text], Field(min_length=1)] = Field(
        description="Compose files, relative to this file; later ones are merged over earlier ones, as `docker compose -f`."
    )
    outside: list[Text] | None = Field(
        default=None,
        description="Folders outside the Compose file's folder whose files may be sent to robots.",
    )
    settle: Annotated[int, Field(ge=0, le=3600)] = Field(
        default=10,
        description="Seconds that a container without a health check must run without a restart.",
    )
    wait: Annotated[int, Field(ge=1, le=86400)] | None = Field(
        default=None,
        description="Seconds that containers may take to become healthy. Default: 180 plus the longest start_period.",
    )


_Stack = Annotated[StackValues, BeforeValidator(_stack, json_schema_input_type=StackValues | Text)]
_Several = Annotated[list[_Stack], Field(min_length=1)]
Stacks = Annotated[_Several, BeforeValidator(_stacks, json_schema_input_type=_Several | StackValues | Text)]


class Values(Frozen):
    """What a robot, a group or the defaults may say."""

    user: Annotated[str, Field(pattern=validation.USER)] | None = Field(
        default=None, description="Login. Default: what your OpenSSH configuration says."
    )
    port: Annotated[int, Field(ge=1, le=65535)] | None = Field(
        default=None, description="Port of the robot's sshd. Default: what your OpenSSH configuration says."
    )
    identity_file: Text | None = Field(
        default=None,
        description="SSH key, relative to this file. Default: what your OpenSSH configuration says.",
    )
    platform: Platform = Field(
        default="linux/arm64", description="What images are built for: 64-bit ARM, 32-bit ARM or a PC."
    )
    ros: Ros | None = Field(default=None, description="ROS settings.")
    docker: Docker | None = Field(default=None, description="How Docker gets onto the robot.")
    hardware: Hardware | None = Field(default=None, description="What is built in or plugged in.")
    boot: validation.Boot = Field(default="docker", description="Who starts the stacks at power-on.")
    environment: Annotated[Environment, _CLOSED] | None = Field(
        default=None, description="Variables for the stack: `${NAME}` in its Compose file."
    )
    pass_environment: list[Annotated[str, Field(pattern=validation.VARIABLE)]] | None = Field(
        default=None,
        description="Variables for the stack whose values are those of your shell: tokens, for example.",
    )
    stack: Stacks | None = Field(
        default=None, description="The stack, or the stacks, in place of the one of the whole inventory."
    )
    files: Annotated[Files, _CLOSED] | None = Field(
        default=None,
        description="Files for the stack. Name below files/ on the robot: file here, relative to this file.",
    )
    card: Card | None = Field(default=None, description="What `fab card` writes for the first boot.")
    transport: validation.Transport = Field(
        default="ssh",
        description="How images come: over SSH, or pulled by the robot's Docker from a registry; without `registry:` from this computer.",
    )
    registry: RegistryValues | None = Field(default=None, description="The registry for images.")


class GroupValues(Values):
    """A group: its robots, and values for them."""

    robots: Members | None = Field(
        default=None, description="Names and wildcards such as 'pi*', of included robots too."
    )


class RobotValues(Values):
    """A robot: its address, and values of its own."""

    address: Address = Field(
        default="", description="Host name, IP address or OpenSSH alias. Default: its name."
    )


_Group = Annotated[GroupValues, BeforeValidator(_group, json_schema_input_type=GroupValues | Members | None)]
_Robot = Annotated[RobotValues, BeforeValidator(_robot, json_schema_input_type=RobotValues | Address | None)]


class Include(Frozen):
    """Another inventory whose robots join this one."""

    path: Text = Field(description="The other inventory, relative to this file.")
    required: bool = Field(default=True, description="false: no such file, no robots, no error.")


class InventoryFile(Frozen):
    """Who the robots are, and what each of them gets."""

    stack: Stacks = Field(
        default=[StackValues(files=["docker/compose.yaml"])],
        description="What runs on the robots: a Compose file, or a list of stacks.",
        validate_default=False,
        json_schema_extra={"default": "docker/compose.yaml"},  # the short form
    )
    known_hosts: Text = Field(default="known_hosts", description="Host keys, recorded by `fab trust`.")
    include: list[Include] | None = Field(
        default=None, description="Other inventories whose robots join, with their own defaults and groups."
    )
    defaults: Values | None = Field(default=None, description="Values for every robot of this file.")
    groups: Annotated[dict[Name, _Group], _CLOSED] | None = Field(
        default=None, description="Named sets of robots, with values for them."
    )
    robots: Annotated[dict[Name, _Robot], _CLOSED] | None = Field(default=None, description="The robots.")


class StackFiles(Frozen):
    """Where one stack is written, with absolute paths; times are in seconds."""

    files: tuple[Path, ...]
    outside: tuple[Path, ...] = ()
    settle: int = 10
    wait: int | None = None


class Robot(Frozen):
    """One robot with its merged values. ``files``: name below files/ on the robot -> absolute file here.

    ``user``, ``port`` and ``identity_file``: None where OpenSSH decides. ``peers``: addresses of those in ``ros.peers``.
    """

    name: str
    address: str
    user: str | None = None
    port: int | None = None
    identity_file: Path | None = None
    platform: Platform = "linux/arm64"
    boot: validation.Boot = "docker"
    ros: Ros = Field(default_factory=Ros)
    docker: Docker = Field(default_factory=Docker)
    hardware: Hardware = Field(default_factory=Hardware)
    card: Card = Field(default_factory=Card)
    transport: validation.Transport = "ssh"
    registry: Registry | None = None
    environment: dict[str, str] = Field(default={})
    pass_environment: tuple[str, ...] = ()
    files: dict[str, Path] = Field(default={})
    stacks: tuple[StackFiles, ...] = ()
    known_hosts: Path = Path("known_hosts")
    peers: tuple[str, ...] = ()

    def __hash__(self) -> int:
        """Robots are keys, though their mappings are not hashable."""
        return hash((self.name, self.address))


@dataclass(frozen=True, kw_only=True)
class Inventory:
    """The fleet: ``robots`` in file order, ``groups`` (``all`` is one) as names of robots in that order."""

    path: Path
    known_hosts: Path
    robots: Mapping[str, Robot]
    groups: Mapping[str, tuple[str, ...]]

    def select(self, hosts: str) -> tuple[Robot, ...]:
        """The robots that ``hosts`` means: a comma list of robots, groups, wildcards; in file order, each once.

        Raises `SelectionError` where an item means nobody, or there is no robot at all.
        """
        if not self.robots:
            cure = "`fab lab.up` starts three virtual Pis, or add yours under `robots:`"
            raise SelectionError(f"{self.path} names no robots", cure=cure)
        return tuple(self.robots[name] for name in choose(hosts, robots=self.robots, groups=self.groups))


def load(path: Path) -> Inventory:
    """The inventory in the file at ``path``; raises `InventoryError` that lists every problem of it."""
    found, problems = merge.gather(path, check=_check)
    if problems:
        heading = f"{path} has {len(problems)} problems:\n  " if len(problems) > 1 else ""
        raise InventoryError(heading + "\n  ".join(problems))
    return Inventory(
        path=path,
        known_hosts=found.known_hosts,
        robots={
            name: _finished(draft.values, stacks=found.stacks, peers=found.peers(name))
            for name, draft in found.drafts.items()
        },
        groups=found.groups,
    )


def _finished(
    values: Mapping[str, Any], *, stacks: Sequence[Mapping[str, Any]], peers: Sequence[str]
) -> Robot:
    """A robot of its merged values; ``stacks`` are the inventory's, for robots that name none of their own."""
    values = {**values, "stacks": values.get("stack") or stacks, "peers": peers}
    values.pop("stack", None)
    return Robot.model_validate(values, strict=False)


def json_schema() -> dict[str, Any]:
    """The JSON Schema of an inventory file, for editors."""
    schema = InventoryFile.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "Fleet inventory"}


def _check(document: Document) -> tuple[dict[str, Any], list[merge.Complaint]]:
    """What the document says, as plain data without what is wrong; and what is wrong with it, where."""
    file, errors = _validated(document.value)
    complaints = [(_written_at(error["loc"], document), _sentence(error)) for error in errors]
    if errors:
        # The sound rest goes on, so that its problems show in the same run.
        wrong = [error["loc"][:-1] if error["type"] == "missing" else error["loc"] for error in errors]
        unsound = [_written_at(location, document) for location in wrong]
        file, _ = _validated(document.without(unsound))
    always = {"stack": [one.model_dump() for one in file.stack], "known_hosts": file.known_hosts}
    return {**file.model_dump(exclude_unset=True), **always}, complaints


def _validated(data: object) -> tuple[InventoryFile, list[ErrorDetails]]:
    try:
        return InventoryFile.model_validate(data), []
    except ValidationError as bad:
        return InventoryFile(), bad.errors(include_url=False)


def _written_at(location: tuple[str | int, ...], document: Document) -> Location:
    """Where validation's location is in the file: short forms have fewer steps."""
    match location:
        case (*steps, "[key]"):
            return tuple(steps)
        case ("groups", group, "robots", *steps) if document.texts(("groups", group)):
            return ("groups", group, *steps)
        case _ if "stack" in location:
            return document.written(location)
        case _:
            return location


def _sentence(error: ErrorDetails) -> str:
    kind, location, value = error["type"], error["loc"], error["input"]
    if kind == "extra_forbidden":
        return validation.unknown_key(str(location[-1]), _model_at(location[:-1]).model_fields)
    if kind == "string_pattern_mismatch":
        return validation.not_like(error["ctx"]["pattern"], value)
    if kind == "value_error":
        return str(error["ctx"]["error"])
    return validation.wrong(kind, str(location[-1]), value)


_Models = dict[str | int, type[Frozen]]


def _model_at(location: Location) -> type[Frozen]:
    if not location:
        return InventoryFile
    outer: _Models = {"include": Include, "defaults": Values, "groups": GroupValues, "robots": RobotValues}
    inner: _Models = {"ros": Ros, "docker": Docker, "stack": StackValues, "registry": RegistryValues}
    if location[0] == "stack":
        return StackValues
    depth = 1 if location[0] == "defaults" else 2
    if location[depth:][:1] == ("hardware",):
        return hardware.model_at(location[depth + 1 :])
    if location[depth:][:1] == ("card",):
        return card.model_at(location[depth + 1 :])
    return inner[location[depth]] if len(location) > depth else outer[location[0]]
