"""What does Compose pass on that Docker would refuse, on the robot and after everything was sent?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fleet.config import compose
from fleet.config.image_reference import is_reference
from fleet.config.stack import literal
from fleet.errors import ComposeError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fleet.config.compose import Project, Resolved

_POLICIES = ("no", "always", "on-failure", "unless-stopped")


def check(resolved: Resolved, project: Project) -> None:
    """Refuse the first such value of a stack.

    Raises:
        ComposeError: with file, line and cure.

    """
    for name, service in (resolved.model.get("services") or {}).items():
        image, restart = literal(str(service.get("image") or "")), str(service.get("restart") or "no")
        if image and not is_reference(image):
            cure = "write it as repository:tag, the repository in small letters, such as talker:1.2"
            unset = f" ({resolved.warnings[0]})" if resolved.warnings else ""
            raise _refusal(project, name, "image", f"{image!r} is not a name of an image{unset}", cure)
        if restart.partition(":")[0] not in _POLICIES:
            cure = f"write one of {', '.join(_POLICIES)}"
            raise _refusal(project, name, "restart", f"{restart!r} is not a restart policy", cure)
        if "provider" in service:
            cure = "start it on the robot in another way, and remove the service"
            raise _refusal(project, name, "provider", "robots have no program that provides a service", cure)
        for volume in service.get("volumes") or ():
            _check_volume(volume, project, name)


def _check_volume(volume: Mapping[str, Any], project: Project, service: str) -> None:
    target = literal(str(volume.get("target") or ""))
    if volume.get("type") not in ("bind", "volume", "tmpfs"):
        what = f"fleet cannot bring a volume of the type {volume.get('type')} to a robot"
        raise _refusal(project, service, "volumes", what, "copy what is in it into the image of the service")
    if not target.startswith("/"):
        cure = "write a path that begins with `/`; a volume needs a name of two letters, as one is a drive of Windows"
        raise _refusal(project, service, "volumes", f"{target!r} is not a path in a container", cure)


def _refusal(project: Project, service: str, key: str, what: str, cure: str) -> ComposeError:
    place = compose.where(project, ("services", service, key))
    return ComposeError(f"{place}: services.{service}.{key}: {what}", cure=cure)
