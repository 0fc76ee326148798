"""From which registry do robots pull images? The key ``registry:`` of the inventory."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  pydantic reads it
from typing import Annotated, Self

from pydantic import Field, model_validator

from fleet.config import validation
from fleet.config.model import Frozen

Text = Annotated[str, Field(pattern=validation.TEXT)]


class RegistryValues(Frozen):
    """The registry that robots with `transport: registry` pull from. It must speak TLS."""

    address: Annotated[str, Field(pattern=validation.REGISTRY)] = Field(
        description="Host, port and path, such as 'registry.local:5000/robots', as computer and robots reach it."
    )
    ca: Text | None = Field(
        default=None,
        description="Certificate that has signed the registry's, relative to this file. Default: the system's.",
    )
    client_cert: Text | None = Field(
        default=None, description="Certificate by which the registry knows computer and robots."
    )
    client_key: Text | None = Field(default=None, description="The private key of client_cert.")
    user: Text | None = Field(
        default=None,
        description="Login at the registry. Default: the one of `docker login` on this computer.",
    )
    token: Annotated[str, Field(pattern=validation.SHELL_VARIABLE)] | None = Field(
        default=None, description="Variable of your shell that holds the password or token of `user`."
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        validation.registry(self.model_dump())
        return self


class Registry(Frozen):
    """The same with absolute paths."""

    address: str
    ca: Path | None = None
    client_cert: Path | None = None
    client_key: Path | None = None
    user: str | None = None
    token: str | None = None

    @property
    def host(self) -> str:
        """The address without a path: what Docker calls the registry."""
        return self.address.partition("/")[0]

    @property
    def prefix(self) -> str:
        """The path with a slash at its end; "" without one."""
        path = self.address.partition("/")[2]
        return f"{path}/" if path else ""
