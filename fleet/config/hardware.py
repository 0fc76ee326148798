"""What may an inventory say about what is built into a robot or plugged in? The key ``hardware:``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Self

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from fleet.config import validation
from fleet.config.model import Frozen

if TYPE_CHECKING:
    from fleet.config.yamlfile import Location

_Interface = Annotated[
    str,
    Field(json_schema_extra={"enum": list(validation.INTERFACES)}),
    AfterValidator(validation.interface),
]
_Kind = Annotated[
    str, Field(json_schema_extra={"enum": list(validation.KINDS)}), AfterValidator(validation.kind)
]
_UsbId = Annotated[str, Field(pattern=validation.USB_ID)]


class Usb(Frozen):
    """How a USB device is recognised. All that is said must match."""

    model_config = ConfigDict(
        json_schema_extra={
            "anyOf": [{"required": ["vendor"]}, {"required": ["port"]}],
            "dependentRequired": {"vendor": ["product"], "product": ["vendor"]},
        }
    )

    kind: _Kind = Field(
        default="serial",
        description="What it is: a serial port, a camera, or an input device (gamepad, keyboard).",
    )
    vendor: _UsbId | None = Field(
        default=None, description="Vendor ID: 4 digits in quotes, as `lsusb` shows them before the colon."
    )
    product: _UsbId | None = Field(
        default=None, description="Product ID: 4 digits in quotes, as `lsusb` shows them after the colon."
    )
    serial: Annotated[str, Field(pattern=validation.USB_SERIAL)] | None = Field(
        default=None, description="Serial number, if the robot has several devices of this kind."
    )
    port: Annotated[str, Field(pattern=validation.USB_PORT)] | None = Field(
        default=None,
        description="USB port such as '1-1.2', for devices without a serial number of their own.",
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        validation.usb(self.model_dump())
        return self


class Hardware(Frozen):
    """What is built into a robot or plugged in.

    A robot gets what the defaults, its groups and itself name, all of it. ``devices`` is checked by `fab ship`, the rest is
    set by `fab provision`.
    """

    devices: list[Annotated[str, Field(pattern=validation.DEVICE)]] = Field(
        default=[],
        description="Devices that must be there, such as /dev/lidar: without them `fab ship` starts nothing.",
    )
    udev: dict[Annotated[str, Field(pattern=validation.DEVICE_NAME)], Usb] = Field(
        default={},
        description="Stable names of USB devices: `lidar` is /dev/lidar, at whatever port it is plugged in.",
        json_schema_extra={"additionalProperties": False},
    )
    interfaces: list[_Interface] = Field(
        default=[], description="Interfaces of a Raspberry Pi that are switched on: i2c, spi, serial, camera."
    )
    groups: list[Annotated[str, Field(pattern=validation.LOGIN_GROUP)]] = Field(
        default=[], description="Groups of the system that the login joins, such as dialout, i2c, video."
    )


def model_at(location: Location) -> type[Frozen]:
    """Return the model at a location below ``hardware``."""
    return Usb if location[:1] == ("udev",) and len(location) > 1 else Hardware
