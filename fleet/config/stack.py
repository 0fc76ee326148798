"""What do robots run? A stack, as Compose's canonical model says it (`fleet.config.compose`). Pure: a model in, values out."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from fleet.errors import ComposeError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import PurePosixPath

    from fleet.config.compose import Project, Resolved

Restart = Literal["no", "on-failure", "always"]


@dataclass(frozen=True, kw_only=True)
class Service:
    """One service of a stack, for one robot.

    ``image`` is the reference that its file names, or Compose's default name for what it builds. ``platform`` is empty
    if the file leaves that to the robot. ``build`` is Compose's ``build:``, or None for an image that is only pulled.
    ``retries`` are those of ``restart: on-failure:3``, 0 without a limit. ``start_period`` is in seconds. ``checked``: the file has a health check (True), switches the image's off (False),
    or leaves it to the image (None).
    """

    name: str
    image: str
    platform: str = ""
    build: Mapping[str, Any] | None = None
    restart: Restart = "no"
    retries: int = 0
    replicas: int = 1
    checked: bool | None = None
    start_period: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Mount:
    """A path of the project that a container sees: ``path`` lies below the project's folder (or beside it, ``../x``).

    ``must_exist``: the file says that nobody is to make it (``create_host_path: false``).
    """

    service: str
    path: PurePosixPath
    target: str
    read_only: bool
    must_exist: bool = False
    kind: Literal["bind", "config", "secret"] = "bind"


@dataclass(frozen=True, kw_only=True)
class Stack:
    """What one robot runs. ``name`` is its Compose project name, which is its identity on the robot."""

    name: str
    services: Mapping[str, Service]
    mounts: tuple[Mount, ...]
    model: Mapping[str, Any]

    @property
    def start_period(self) -> float:
        """The longest time, in seconds, that the file gives a service to become healthy."""
        return max((service.start_period for service in self.services.values()), default=0.0)


def read(resolved: Resolved, project: Project) -> Stack:
    """The stack of Compose's answer.

    Raises:
        ComposeError: it has no service that this robot would run.

    """
    model = resolved.model
    services = model.get("services") or {}
    if not services:
        raise ComposeError(
            f"{project.files[0]}: there is no service in it, or its profile is not active",
            cure="a stack is a Compose file with `services:`; COMPOSE_PROFILES in the inventory chooses profiles",
        )
    name = str(model["name"])
    return Stack(
        name=name,
        services={key: _service(key, value, project=name) for key, value in services.items()},
        mounts=tuple(_mounts(model, project)),
        model=model,
    )


def _service(name: str, value: Mapping[str, Any], *, project: str) -> Service:
    check = value.get("healthcheck")
    deploy = value.get("deploy") or {}
    replicas = value.get("scale", deploy.get("replicas", 1))
    disabled = check is not None and (check.get("disable") or list(check.get("test") or ()) == ["NONE"])
    return Service(
        name=name,
        image=literal(str(value.get("image") or f"{project}-{name}")),
        platform=str(value.get("platform") or ""),
        build=value.get("build"),
        restart=_restart(value),
        retries=_retries(value),
        replicas=1 if replicas is None else int(replicas),
        checked=None if check is None else not disabled,
        start_period=0.0 if disabled or not check else seconds(str(check.get("start_period") or "0s")),
    )


def _restart(value: Mapping[str, Any]) -> Restart:
    """When Docker starts a container again, from ``restart:`` or ``deploy.restart_policy``."""
    policy = ((value.get("deploy") or {}).get("restart_policy") or {}).get("condition")
    written = str(value.get("restart") or policy or "no").partition(":")[0]
    if written in ("always", "unless-stopped", "any"):
        return "always"
    return "on-failure" if written == "on-failure" else "no"


def _retries(value: Mapping[str, Any]) -> int:
    """How often Docker starts a container again that fails; 0 if there is no limit."""
    policy = (value.get("deploy") or {}).get("restart_policy") or {}
    written = str(value.get("restart") or "").partition(":")[2] or str(policy.get("max_attempts") or "")
    return int(written) if _restart(value) == "on-failure" and written.isdecimal() else 0


def _mounts(model: Mapping[str, Any], project: Project) -> Iterable[Mount]:
    for name, service in (model.get("services") or {}).items():
        for volume in service.get("volumes") or ():
            if volume.get("type") == "bind" and (path := project.relative(literal(volume["source"]))):
                yield Mount(
                    service=name,
                    path=path,
                    target=volume["target"],
                    read_only=bool(volume.get("read_only")),
                    must_exist=(volume.get("bind") or {}).get("create_host_path") is False,
                )
        for volume in service.get("volumes") or ():
            named = (model.get("volumes") or {}).get(volume.get("source") or "") or {}
            device = str((named.get("driver_opts") or {}).get("device") or "")
            if volume.get("type") == "volume" and (path := project.relative(literal(device))):
                # Docker keeps a volume as it was made, so its place cannot be a release's.
                yield Mount(service=name, path=path, target=volume["target"], read_only=False)
        for kind in ("config", "secret"):
            for use in service.get(f"{kind}s") or ():
                file = (model.get(f"{kind}s") or {}).get(use["source"], {}).get("file")
                if file and (path := project.relative(literal(file))):
                    target = str(use.get("target") or f"/{use['source']}")
                    yield Mount(service=name, path=path, target=target, read_only=True, kind=kind)


def literal(text: str) -> str:
    """Text of the canonical model as containers see it: Compose writes a literal ``$`` as ``$$``."""
    return text.replace("$$", "$")


# https://github.com/cncf-tags/container-device-interface/blob/main/SPEC.md: vendor/class=device
_CDI_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*/[A-Za-z][A-Za-z0-9_-]*=[A-Za-z0-9_.:-]+")


def is_cdi_name(device: str) -> bool:
    """Whether a device of a service is named by CDI (``nvidia.com/gpu=all``), and not by a path."""
    return bool(_CDI_NAME.fullmatch(device))


_DURATION = re.compile(r"([0-9.]+)(h|ms|us|ns|m|s)")
_UNITS = {"h": 3600.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def seconds(duration: str) -> float:
    """A duration as Go and Compose write it (``1m30s``), in seconds."""
    return sum(float(number) * _UNITS[unit] for number, unit in _DURATION.findall(duration))
