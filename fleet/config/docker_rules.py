"""What does Compose pass on that Docker would refuse, on the robot and after everything was sent?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.config import compose
from fleet.config.image_reference import is_reference
from fleet.config.stack import literal
from fleet.errors import ComposeError

if TYPE_CHECKING:
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


def _refusal(project: Project, service: str, key: str, what: str, cure: str) -> ComposeError:
    place = compose.where(project, ("services", service, key))
    return ComposeError(f"{place}: services.{service}.{key}: {what}", cure=cure)
