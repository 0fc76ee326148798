"""What can go wrong, as one tree.

::

    FleetError                 all errors below: ``what`` happened, and the ``cure``
    ├── UsageError             the user's mistake, refused before anything is changed; exit code 2
    │   ├── InventoryError     inventory.yaml is not valid (every problem at once)
    │   ├── SelectionError     --hosts selects no robot
    │   ├── ComposeError       the stack's Compose file cannot be used
    │   └── ImageError         a local image is missing, or for another platform
    ├── DesktopError           the desktop lacks something: Docker Engine, a tool, a base image; exit code 1
    └── RobotError             the failure of one robot, which becomes its outcome; exit code 1
        ├── Unreachable        no SSH connection: name, route, port, timeout
        ├── UntrustedHostKey   the host key is unknown, changed or revoked
        ├── LoginRefused       the robot answered and refuses the login
        ├── NotReady           the robot lacks something that the verb needs: Docker, disk space
        │   └── Refused        what was asked does not fit the robot: a port that is taken, another platform; exit code 2
        ├── LinkLost           the connection was lost while a command ran
        ├── TimedOut           a command took longer than its limit
        ├── CommandFailed      a command ended with an exit code other than 0
        └── NotAsPlanned       a command succeeded, but the check of its effect failed
"""

from __future__ import annotations


class FleetError(Exception):
    """An error that the user can act on: what happened, and the cure.

    ``what`` is a clause without a full stop. ``cure`` may be empty.
    """

    exit_code = 1

    def __init__(self, what: str, *, cure: str = "") -> None:
        super().__init__(what)
        self.what = what
        self.cure = cure

    def __str__(self) -> str:
        return f"{self.what}; {self.cure}" if self.cure else self.what


class UsageError(FleetError):
    """The user asked for something that is not possible."""

    exit_code = 2


class InventoryError(UsageError):
    """The inventory file is missing, is not YAML, or breaks a rule of the schema."""


class SelectionError(UsageError):
    """``--hosts`` names a robot or group that the inventory does not have."""


class ComposeError(UsageError):
    """The stack's Compose file cannot be read or used."""


class ImageError(UsageError):
    """A local image is missing or made for another platform."""


class DesktopError(FleetError):
    """The desktop lacks something that this verb needs."""


class RobotError(FleetError):
    """The failure of one robot. It becomes that robot's outcome; the work on other robots continues."""


class Unreachable(RobotError):
    """No SSH connection could be made."""


class UntrustedHostKey(RobotError):
    """The robot's host key is unknown, has changed, or is revoked."""


class LoginRefused(RobotError):
    """The robot's sshd answered and refused every credential."""


class NotReady(RobotError):
    """The robot lacks something that this verb needs; nothing was changed."""


class Refused(NotReady):
    """What the command, the inventory or the Compose file asks for does not fit this robot; nothing was changed."""

    exit_code = 2


class LinkLost(RobotError):
    """The connection was lost while a command ran."""


class TimedOut(RobotError):
    """A command ran longer than its limit and was stopped on the robot."""


class CommandFailed(RobotError):
    """A command on the robot ended with an exit code other than 0.

    ``code`` is the exit code; ``output`` is its standard error, or its standard output if that is empty.
    """

    def __init__(self, what: str, *, cure: str = "", code: int, output: str = "") -> None:
        super().__init__(what, cure=cure)
        self.code = code
        self.output = output


class NotAsPlanned(RobotError):
    """A command reported success, but the check of its effect failed."""
