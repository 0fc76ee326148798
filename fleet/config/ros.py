"""How do a robot's ROS nodes find each other? The key ``ros:`` of the inventory."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from fleet.config import validation
from fleet.config.model import Frozen, Members

_Domain = Annotated[int, Field(json_schema_extra=validation.DOMAIN), AfterValidator(validation.domain)]
_RMW = Field(json_schema_extra={"enum": list(validation.RMW)})
_DISCOVERY = Field(json_schema_extra={"enum": list(validation.DISCOVERY)})


class Ros(Frozen):
    """How the robot's ROS nodes find each other.

    ``master``, ``hostname`` and ``ip`` are for ROS 1, at most one of ``hostname`` and ``ip``; ``domain``, ``rmw``,
    ``discovery`` and ``peers`` are for ROS 2.
    """

    model_config = ConfigDict(
        json_schema_extra={"allOf": [{"not": validation.BOTH_NAMES}, *validation.ROS_VERSIONS]}
    )

    version: Annotated[int, Field(ge=1, le=2)] = Field(default=1, description="ROS 1 or ROS 2.")
    master: Annotated[str, Field(pattern=validation.MASTER)] = Field(
        default="own",
        description="ROS 1. 'own': each robot runs its roscore. Else a shared one's URI, http://host:port.",
    )
    hostname: Annotated[str, Field(pattern=validation.HOSTNAME)] | None = Field(
        default=None,
        description="ROS 1. ROS_HOSTNAME: the name others reach the robot by. Default: its address.",
    )
    ip: Annotated[str, Field(pattern=validation.IP), AfterValidator(validation.ip)] | None = Field(
        default=None, description="ROS 1. ROS_IP, instead of hostname, where names do not resolve."
    )
    domain: _Domain | None = Field(
        default=None,
        description="ROS 2. ROS_DOMAIN_ID, 0 to 101 or 215 to 232: only nodes of one domain hear each other. Default: 0.",
    )
    rmw: Annotated[str, _RMW, AfterValidator(validation.rmw)] | None = Field(
        default=None,
        description="ROS 2. RMW_IMPLEMENTATION: the middleware, which must be in the image. Default: the image's.",
    )
    discovery: Annotated[str, _DISCOVERY, AfterValidator(validation.discovery)] | None = Field(
        default=None,
        description="ROS 2. ROS_AUTOMATIC_DISCOVERY_RANGE: how far nodes look for others. Default: ROS's, the subnet.",
    )
    peers: Members | None = Field(
        default=None,
        description="ROS 2. ROS_STATIC_PEERS: robots and groups that are found without multicast, by their addresses.",
    )
    namespace: Annotated[str, Field(pattern=validation.NAMESPACE)] | None = Field(
        default=None,
        description="ROS_NAMESPACE: goes before every name. ROS 2 needs it in the command: `__ns:=/...`.",
    )
    strict: bool = Field(default=False, description="ROS 2: refuse stacks that get a warning about it.")

    @model_validator(mode="after")
    def _check(self) -> Self:
        validation.ros(self.model_dump(exclude_unset=True))
        return self
