"""What can go wrong, as one tree.

::

    FleetError                 everything below; ``what`` happened and the ``cure``
    ├── Mistake                the person's: refused before anything is touched, exit code 2
    │   ├── InventoryError     inventory.yaml is not valid (every problem at once)
    │   ├── SelectionError     --hosts names nobody
    │   ├── ComposeError       the stack's Compose file is not usable
    │   └── ImageError         no such local image, or one for another platform
    ├── DesktopError           this computer lacks something: Docker Engine, a tool, a base image; exit code 1
    └── RobotError             one robot's: becomes that robot's outcome, exit code 1
        ├── Unreachable        no SSH connection: name, route, port, timeout
        ├── UntrustedHostKey   the host key is unknown, changed or revoked
        ├── LoginRefused       the robot answered, and does not let this login in
        ├── NotReady           the robot lacks what this verb needs: Docker, space, the right architecture
        ├── LinkLost           the connection died under a command
        ├── TimedOut           a command took longer than it may
        ├── CommandFailed      a command ended with another exit code than 0
        └── NotAsPlanned       a command succeeded, and the proof of what it did fails
"""

from __future__ import annotations


class FleetError(Exception):
    """Something a person can act on: one sentence of what happened, one of what cures it.

    ``what`` is a clause without a full stop; ``cure`` may be empty where there is none to give.
    """

    exit_code = 1

    def __init__(self, what: str, *, cure: str = "") -> None:
        super().__init__(what)
        self.what = what
        self.cure = cure

    def __str__(self) -> str:
        return f"{self.what}; {self.cure}" if self.cure else self.what


class UsageError(FleetError):
    """The person at the terminal asked for something that cannot be meant."""

    exit_code = 2


class InventoryError(UsageError):
    """The inventory file is missing, not YAML, or says something it may not say."""


class SelectionError(UsageError):
    """``--hosts`` names a robot or group that the inventory does not have."""


class ComposeError(UsageError):
    """The stack's Compose file cannot be read or used."""


class ImageError(UsageError):
    """A local image is missing or made for another platform."""


class DesktopError(FleetError):
    """The computer that runs ``fab`` lacks something this verb needs."""


class RobotError(FleetError):
    """One robot's failure. It ends as that robot's outcome; the others go on."""


class Unreachable(RobotError):
    """No SSH connection could be made."""


class UntrustedHostKey(RobotError):
    """The robot's host key is not known, is not the known one, or is revoked."""


class LoginRefused(RobotError):
    """The robot's sshd answered and refused every credential."""


class NotReady(RobotError):
    """The robot lacks what this verb needs; nothing was changed."""


class LinkLost(RobotError):
    """The connection ended while a command ran on it."""


class TimedOut(RobotError):
    """A command ran longer than its limit and was ended on the robot."""


class CommandFailed(RobotError):
    """A command on the robot ended with an exit code other than 0.

    ``code`` is the exit code; ``output`` what the command said (its standard error where it wrote any).
    """

    def __init__(self, what: str, *, cure: str = "", code: int, output: str = "") -> None:
        super().__init__(what, cure=cure)
        self.code = code
        self.output = output


class NotAsPlanned(RobotError):
    """A command said it succeeded, and looking again shows that it did not."""
