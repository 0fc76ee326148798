"""What may an inventory say about the first boot of a robot? The key ``card:``, which `fab card` reads."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import AfterValidator, BeforeValidator, Field, SecretStr, model_validator

from fleet.config import validation
from fleet.config.model import Frozen

if TYPE_CHECKING:
    from fleet.config.yamlfile import Location


Secret = Annotated[SecretStr, BeforeValidator(validation.secret)]
"""Text that no message shows, not even one about a wrong value."""


class Network(Frozen):
    """A Wi-Fi network that the robot may join. Without another key, `fab card` asks for its passphrase."""

    name: Annotated[str, Field(json_schema_extra={"minLength": 1}), AfterValidator(validation.ssid)] = Field(
        description="Its name (SSID), as phones show it."
    )
    hidden: bool = Field(default=False, description="true: it does not announce its name.")
    open: bool = Field(default=False, description="true: it has no passphrase.")
    passphrase_from: Annotated[str, Field(pattern=validation.SHELL_VARIABLE)] | None = Field(
        default=None, description="Variable of your shell that holds the passphrase."
    )
    passphrase: Secret | None = Field(
        default=None, description="The passphrase itself. Whoever reads this file can then join the network."
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if sum((self.open, self.passphrase is not None, self.passphrase_from is not None)) > 1:
            raise ValueError("open, passphrase and passphrase_from exclude each other; keep one of them")
        return self


class Wifi(Frozen):
    """The Wi-Fi of the robot."""

    country: Annotated[str, Field(pattern=validation.COUNTRY)] = Field(
        description="Country whose radio rules hold, in two letters such as DE: without it, the radio stays off."
    )
    networks: Annotated[list[Network], Field(min_length=1)] = Field(description="Networks to join.")


class Card(Frozen):
    """What `fab card` writes for the first boot, besides name, login and host key."""

    timezone: Annotated[str, Field(pattern=validation.TIMEZONE)] | None = Field(
        default=None, description="Time zone such as Europe/Berlin. Default: the system's."
    )
    wifi: Wifi | None = Field(default=None, description="Wi-Fi. Default: only a cable.")


def model_at(location: Location) -> type[Frozen]:
    """Return the model at a location below ``card``."""
    model: Any = Card
    for step in location:
        model = {"wifi": Wifi, "networks": Network}.get(str(step), model)
    return model  # type: ignore[no-any-return]
