"""Which values does an inventory take, and what is the message for any other?

Patterns (the models and the JSON Schema use the same ones), each with its message, and a message for everything
else that validation can find. No file is read here.
"""

from __future__ import annotations

from ipaddress import ip_address
from typing import TYPE_CHECKING, Any, Literal

from fleet.config.selection import did_you_mean
from fleet.platforms import NAMES as PLATFORMS
from fleet.platforms import PLATFORM_OF_MACHINE

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

Boot = Literal["docker", "systemd"]
"""Who starts a robot's stacks at power-on."""


Transport = Literal["ssh", "registry"]
"""How images come to a robot."""

REGISTRY_FILES = ("ca", "client_cert", "client_key")
"""The keys of `registry:` that name files."""

_CHOICES = {"boot": ("docker", "systemd"), "transport": ("ssh", "registry")}


def _whole(pattern: str) -> str:
    # `$` alone lets a trailing newline pass.
    return rf"^(?:{pattern})$(?!\n)"


RESERVED: Mapping[str, str] = {
    "ROS_MASTER_URI": "set it as `ros: {master: ...}`",
    "ROS_HOSTNAME": "set it as `ros: {hostname: ...}`; without it the robot's address is used",
    "ROS_IP": "set it as `ros: {ip: ...}`",
    "ROS_NAMESPACE": "set it as `ros: {namespace: ...}`",
    "ROS_DOMAIN_ID": "set it as `ros: {version: 2, domain: ...}`",
    "RMW_IMPLEMENTATION": "set it as `ros: {version: 2, rmw: ...}`",
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "set it as `ros: {version: 2, discovery: ...}`",
    "ROS_STATIC_PEERS": "set it as `ros: {version: 2, peers: [...]}`, with robots and groups",
    "COMPOSE_PROJECT_NAME": "set it as `name:` in the stack's Compose file",
}
"""Variables that fleet sets itself, and where the inventory has their values."""

_PORT = r"(?:6553[0-5]|655[0-2]\d|65[0-4]\d{2}|6[0-4]\d{3}|[1-5]\d{4}|[1-9]\d{0,3})"
_RESERVED = f"(?:{'|'.join(RESERVED)})"

TEXT = r"\S"
NAME = _whole(r"(?!all$)[A-Za-z0-9][A-Za-z0-9_.-]*")
MEMBER = _whole(r"[A-Za-z0-9_.*?\[\]!-]+")
ADDRESS = _whole(r"(?!-)(?:[^\s@/:\[\],]+|[^\s@/:\[\],]*(?::[^\s@/:\[\],]*){2,})")
REGISTRY = _whole(
    rf"(?:localhost|(?=[^/]*[.:])[A-Za-z0-9](?:[A-Za-z0-9.-]*[A-Za-z0-9])?)(?::{_PORT})?(?:/[a-z0-9]+(?:[._-]+[a-z0-9]+)*)*"
)
USER = _whole(r"(?!-)[^\s@:/]+")
MASTER = _whole(rf"own|http://(?:[^\s/:@\[\]]+|\[[0-9A-Fa-f:.]+\]):{_PORT}/?")
HOSTNAME = _whole(r"[A-Za-z0-9](?:[A-Za-z0-9_.-]*[A-Za-z0-9])?")
IP = _whole(r"[0-9]{1,3}(?:\.[0-9]{1,3}){3}|[0-9A-Fa-f:.]*:[0-9A-Fa-f:.]*")
NAMESPACE = _whole(r"/?[A-Za-z][A-Za-z0-9_]*(?:/[A-Za-z][A-Za-z0-9_]*)*")
SHA256 = _whole(r"[0-9A-Fa-f]{64}")
VERSION = _whole(r"[0-9]+\.[0-9]+\.[0-9]+")
SIZE = _whole(r"[1-9][0-9]*[kmg]")
VARIABLE = _whole(rf"(?!{_RESERVED}$|FLEET_)[A-Za-z_][A-Za-z0-9_]*")
DEVICE = _whole(r"/dev(?:/(?!\.{1,2}(?:/|$))[^\s/]+)+")
DEVICE_NAME = _whole(r"(?!(?:tty|video|i2c-|spidev|null$|mem$|console$))[A-Za-z0-9][A-Za-z0-9_.-]*")
USB_ID = _whole(r"[0-9A-Fa-f]{4}")
USB_SERIAL = _whole(r"[A-Za-z0-9][A-Za-z0-9_.:+ -]*")
USB_PORT = _whole(r"[0-9]+-[0-9]+(?:\.[0-9]+)*")
LOGIN_GROUP = _whole(r"[a-z_][a-z0-9_-]{0,31}")
SHELL_VARIABLE = _whole(r"[A-Za-z_][A-Za-z0-9_]*")
COUNTRY = _whole(r"[A-Z]{2}")
TIMEZONE = _whole(r"[A-Za-z0-9_+-]+(?:/[A-Za-z0-9_+-]+){0,2}")
FILE = _whole(r"(?!/)(?!(?:.*/)?\.{1,2}(?:/|$))(?!.*//)(?!.*/$)[^\x00-\x1f\x7f\\]+")

# As JSON Schema: a hostname and an ip, and neither is null.
BOTH_NAMES: dict[str, Any] = {
    "properties": {"hostname": {"type": "string"}, "ip": {"type": "string"}},
    "required": ["hostname", "ip"],
}

ROS_KEYS: Mapping[int, tuple[str, ...]] = {
    1: ("master", "hostname", "ip"),
    2: ("domain", "rmw", "discovery", "peers"),
}
"""The keys of `ros:` that only one version of ROS has."""

# As JSON Schema: where a version is said, the keys of the other one are absent or null.
ROS_VERSIONS: list[dict[str, Any]] = [
    {
        "if": {"properties": {"version": {"const": version}}, "required": ["version"]},
        "then": {"properties": {key: {"type": "null"} for key in ROS_KEYS[3 - version]}},
    }
    for version in ROS_KEYS
]
DOMAIN: dict[str, Any] = {"minimum": 0, "maximum": 232, "not": {"minimum": 102, "maximum": 214}}
RMW = (
    *("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_cyclonedds_cpp"),
    *("rmw_connextdds", "rmw_gurumdds_cpp", "rmw_zenoh_cpp"),
)
DISCOVERY = ("subnet", "localhost", "off", "system_default")

INTERFACES = ("i2c", "spi", "serial", "camera")
KINDS = ("serial", "camera", "input")

_MUST: Mapping[str, str] = {
    REGISTRY: "must be a host with a port or a dot in its name, and a path in small letters if need be, such as registry.local:5000/robots",
    TEXT: "must not be empty",
    NAME: "is not a name: use letters, digits, '_', '.' and '-', a letter or digit first",
    MEMBER: "must be a robot's name or a wildcard such as 'pi*'",
    ADDRESS: "must be a host name or an IP address alone; the login goes under `user`, the port under `port`",
    USER: "must be a login name, without '@', ':' or spaces",
    MASTER: "must be 'own' or a URI such as http://desktop.local:11311",
    HOSTNAME: "must be a host name such as pi1.local; an IP address without a name goes under `ip`",
    IP: "must be an IP address such as 192.168.1.21",
    NAMESPACE: "must be a ROS name such as 'pi1' or '/site/pi1': letters, digits and '_'",
    SHA256: "must be 64 hexadecimal digits, as `sha256sum` prints them",
    VERSION: "must be a full version such as '27.5.1': a shorter one would match several",
    SIZE: "must be a number and k, m or g, such as '10m'",
    VARIABLE: "is not a name for a variable: use letters, digits and '_', not a digit first",
    DEVICE: "must be the path of a device, such as /dev/ttyUSB0 or /dev/serial/by-id/usb-...",
    DEVICE_NAME: "must be a name of your own for /dev, such as 'lidar': letters, digits, '_', '.' and '-'; "
    "not one of the kernel's, such as ttyUSB0 or video0",
    USB_ID: "must be 4 hexadecimal digits in quotes, such as '10c4'; `lsusb` shows them",
    USB_SERIAL: "must be a serial number as `udevadm info -a` shows it, without quotes and wildcards",
    USB_PORT: "must be a USB port such as '1-1.2', as `udevadm info -a` shows it in KERNELS",
    LOGIN_GROUP: "must be the name of a group, such as dialout",
    SHELL_VARIABLE: "is not a name for a variable: use letters, digits and '_', not a digit first",
    COUNTRY: "must be a country's two letters, such as DE, GB or US",
    TIMEZONE: "must be a time zone such as Europe/Berlin, as `timedatectl list-timezones` prints them",
    FILE: "must be a plain relative path: it stays below files/ on the robot (no '/' first or last, no '.' or '..')",
}

_NUMBERS: Mapping[str, str] = {
    "settle": "must be a whole number of seconds, 0 to 3600",
    "wait": "must be a whole number of seconds, 1 to 86400",
    "port": "must be a whole number from 1 to 65535",
    "log_max_file": "must be a whole number, 1 or more",
    "version": "must be 1 or 2",
    "domain": "must be a whole number from 0 to 101, or from 215 to 232",
}

_KINDS: Mapping[str, str] = {
    "model_type": "must hold `key: value` lines",
    "dict_type": "must hold `key: value` lines",
    "list_type": "must be a list",
    "bool_type": "must be true or false",
    "missing": "is missing",
    "too_short": "must name at least one",
}


def unknown_key(key: str, known: Iterable[str]) -> str:
    """The message for a key that does not exist; ``known`` are those that do."""
    known = tuple(known)
    return f"no such key; {did_you_mean(key, known) or 'there are: ' + ', '.join(known)}"


def not_like(pattern: str, value: str) -> str:
    """The message for text that does not match ``pattern``, one of this module's."""
    if pattern == NAME and value == "all":
        return "'all' always means every robot; values for every robot go under `defaults`"
    if pattern == VARIABLE and value in RESERVED:
        return f"fleet sets this variable itself; {RESERVED[value]}"
    if pattern == VARIABLE and value.startswith("FLEET_"):
        return "names that begin with FLEET_ are fleet's own; choose another"
    return _MUST[pattern]


def ip(value: str) -> str:
    """``value`` if it is an IP address; otherwise raise ValueError with the message."""
    try:
        ip_address(value)
    except ValueError:
        raise ValueError(_MUST[IP]) from None
    return value


def ssid(value: str) -> str:
    """``value`` if a Wi-Fi network can have this name; otherwise raise ValueError with the message."""
    # IEEE 802.11: 32 bytes. Control characters are allowed there, and end a line in some systems' files.
    size = len(value.encode())
    if not 1 <= size <= 32:
        raise ValueError(f"must be 1 to 32 bytes long, not {size}")
    if not value.isprintable():
        raise ValueError("has a character that cannot be printed")
    return value


def secret(value: object) -> object:
    """``value`` if it is text; otherwise raise ValueError with a message that does not show it: people send messages on."""
    if isinstance(value, bool | int | float):
        raise ValueError("must be text, and YAML reads this as a number or a truth value; put it in quotes")  # noqa: TRY004  pydantic wants it
    if isinstance(value, list | dict):
        raise ValueError("must be text")  # noqa: TRY004  pydantic wants it
    return value


def environment_value(value: object) -> str | int | float:
    """``value`` if it is text or a number; otherwise raise ValueError with the message."""
    if isinstance(value, bool):
        raise ValueError("YAML reads yes, no, on, off, true and false as a truth value; quote it")  # noqa: TRY004  pydantic wants it
    if isinstance(value, str | int | float):
        return value
    raise ValueError(
        "has no value; write '' for an empty one" if value is None else "must be text or a number"
    )


def domain(value: int) -> int:
    """``value`` if a ROS 2 domain can have it; otherwise raise ValueError with the message."""
    # https://docs.ros.org/en/jazzy/Concepts/Intermediate/About-Domain-ID.html: Linux's ephemeral ports are 32768 to 60999.
    if 0 <= value <= 101 or 215 <= value <= 232:
        return value
    why = ": Linux gives the ports of the domains between to other programs" if 101 < value < 215 else ""
    raise ValueError(wrong("int_range", "domain", value) + why)


def rmw(value: str) -> str:
    """``value`` if it is a middleware of ROS 2; otherwise raise ValueError with the message."""
    return _one_of(RMW, value)


def discovery(value: str) -> str:
    """``value`` if it is a range of discovery; otherwise raise ValueError with the message."""
    return _one_of(DISCOVERY, value)


def interface(value: str) -> str:
    """``value`` if it is an interface of a Raspberry Pi; otherwise raise ValueError with the message."""
    return _one_of(INTERFACES, value)


def kind(value: str) -> str:
    """``value`` if it is a kind of USB device; otherwise raise ValueError with the message."""
    return _one_of(KINDS, value)


def usb(said: Mapping[str, Any]) -> None:
    """Raise ValueError with the message if nothing, or too little, says which USB device is meant."""
    if not said["vendor"] and not said["port"]:
        raise ValueError("say which device it is: `vendor` and `product` (`lsusb` shows them), or `port`")
    if bool(said["vendor"]) != bool(said["product"]):
        raise ValueError("vendor and product go together; `lsusb` shows both, as vendor:product")


def registry(said: Mapping[str, Any]) -> None:
    """Raise ValueError with the message if a client certificate has no key, or a key no certificate."""
    if bool(said["client_cert"]) != bool(said["client_key"]):
        raise ValueError("client_cert and client_key go together; name both, or none")


def _one_of(choices: tuple[str, ...], value: str) -> str:
    if value in choices:
        return value
    hint = did_you_mean(value, choices)
    raise ValueError(f"must be one of {', '.join(choices)}" + (f"; {hint}" if hint else ""))


def ros(said: Mapping[str, Any]) -> None:
    """Raise ValueError with the message if the keys of one `ros:` exclude each other."""
    if said.get("hostname") is not None and said.get("ip") is not None:
        raise ValueError("hostname and ip exclude each other; remove one of them")
    # Without a version here, a group or the defaults may say it.
    if "version" in said and (sentence := other_version(said)):
        raise ValueError(sentence)


def other_version(ros: Mapping[str, Any]) -> str:
    """The message if a `ros:` has a key that its version does not know, else "". Without ``version`` it is 1."""
    version = ros.get("version", 1)
    wrong = next((key for key in ROS_KEYS[3 - version] if ros.get(key) is not None), "")
    if not wrong:
        return ""
    stated = f"`version: {version}`" if "version" in ros else f"no `version:`, which means ROS {version}"
    return f"{wrong} is a key of ROS {3 - version}, and there is {stated}; say `version: {3 - version}`, or remove {wrong}"


def wrong(kind: str, key: str, value: object) -> str:
    """The message for a wrong ``value`` at ``key``; ``kind`` is pydantic's name of the error."""
    if key in _NUMBERS and kind.startswith(("int_", "greater_", "less_")):
        if isinstance(value, str) and value.isdecimal():
            return f"{_NUMBERS[key]}: write {value} without quotes"
        return f"{_NUMBERS[key]}, not {_shown(value)}"
    if kind == "literal_error" and key in _CHOICES:
        return f"must be {' or '.join(_CHOICES[key])}, not {_shown(value)}"
    if kind == "literal_error":
        hint = did_you_mean(PLATFORM_OF_MACHINE.get(str(value), str(value)), PLATFORMS)
        return f"must be one of {', '.join(PLATFORMS)}" + (f"; {hint}" if hint else "")
    if kind == "string_type":
        cure = "; put it in quotes" if isinstance(value, bool | int | float) else ""
        return f"must be text, not {_shown(value)}{cure}"
    return _KINDS[kind]


def _shown(value: object) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "a mapping"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
