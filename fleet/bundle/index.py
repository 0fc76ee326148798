"""What does a bundle hold? Its index: lines of words, which a desktop and the shell of a robot can both read.

A bundle is a folder, often the root of a stick with FAT32, where names are case-insensitive and files are at most 4 GB::

    install                 the program for the robot: `sh install` (onboard/install.sh)
    SHA256SUMS              the digest of every file; written last, so it says which bundle is whole
    index-<digest>          what this module reads and writes
    layers/<digest>.01      a packed layer, in parts of at most `write.PART` bytes; once for all robots
    images/<digest>         an image without its layers (`fleet.transfer.load_archive`)
    releases/<digest>       a robot's release as a tar archive
    programs-<digest>/      the scripts of `fleet.onboard` that `install` runs
    signed-<digest>.sig     SHA256SUMS signed with SSH, if a person has signed it
    READ-ME.txt             for the person who finds the stick

All but ``install``, SHA256SUMS and READ-ME.txt are named by their content. So a bundle that is written over an older one
leaves that usable until SHA256SUMS is replaced.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fleet.errors import UsageError
from fleet.images.image import Image
from fleet.images.layer import PLAIN, Blob

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from fleet.transfer.codec import Encoding

FORMAT = "fleet-bundle 1"
"""The first line. `onboard/install.sh` has it too."""

ENCODING: Encoding = "gzip"
"""Of the layers: every Docker from 20.10 on reads it, and whoever stands at the robot cannot make another bundle."""

MEDIA_TYPE = f"{PLAIN}+{ENCODING}"

_HEX = re.compile("[0-9a-f]{64}").fullmatch
_DIGEST = re.compile("sha256:[0-9a-f]{64}").fullmatch
_NAME = re.compile("[A-Za-z0-9][A-Za-z0-9._-]{0,127}").fullmatch
_TIME = re.compile("[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}Z").fullmatch


@dataclass(frozen=True, kw_only=True)
class BundledImage:
    """An image, and the file ``images/<file>`` with its configuration and manifest.

    ``ids`` are the IDs that ``docker image inspect`` may print for it. In the file, the manifest has ``length`` bytes from
    ``offset``.
    """

    image: Image
    file: str
    ids: tuple[str, str]
    offset: int
    length: int


@dataclass(frozen=True, kw_only=True)
class BundledStack:
    """A robot's release of a stack, in ``releases/<file>``; times are in seconds, images are the names on the robot.

    ``wants`` is what `install` looks for on the robot before it changes anything: pairs such as ``device /dev/ttyUSB0``,
    ``port 80/tcp`` and ``name camera``.
    """

    name: str
    release: str
    file: str
    wait: int
    settle: int
    images: tuple[str, ...]
    wants: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, kw_only=True)
class BundledRobot:
    """A robot, and how it is recognized. ``user`` is "" if the inventory leaves it to OpenSSH.

    ``keys`` are its recorded SSH host keys, each its type and its bytes in base64.
    """

    name: str
    platform: str
    address: str
    user: str = ""
    keys: tuple[tuple[str, str], ...] = ()
    stacks: tuple[BundledStack, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Bundle:
    """All that a bundle holds. ``made`` is in ISO 8601, ``by`` is ``tim@desktop``; layers are by diff ID, images by name."""

    made: str
    by: str
    robots: tuple[BundledRobot, ...]
    images: Mapping[str, BundledImage] = field(default_factory=dict)
    layers: Mapping[str, Blob] = field(default_factory=dict)

    def robot(self, name: str) -> BundledRobot:
        """Find a robot. Raises `UsageError` if the bundle has nothing for it."""
        if found := next((one for one in self.robots if one.name == name), None):
            return found
        there = ", ".join(one.name for one in self.robots)
        raise UsageError(f"the bundle has nothing for {name}", cure=f"it has: {there}")


def text(bundle: Bundle) -> str:
    """The index of a bundle."""
    lines: list[Sequence[object]] = [(FORMAT,), ("made", bundle.made), ("by", "_".join(bundle.by.split()))]
    lines += (("layer", one.diff_id, one.digest, one.size, one.unpacked) for one in bundle.layers.values())
    for name, one in bundle.images.items():
        image = one.image
        what = (name, image.reference, image.platform, image.size, image.identity, image.fingerprint)
        lines.append(("image", *what, one.file, *one.ids, one.offset, one.length, *image.layers))
    for robot in bundle.robots:
        lines.append(("robot", robot.name, robot.platform, robot.address, robot.user or "-"))
        lines += (("key", robot.name, *key) for key in robot.keys)
        lines += (
            ("stack", robot.name, one.name, one.release, one.file, one.wait, one.settle, *one.images)
            for one in robot.stacks
        )
        lines += (("wants", robot.name, one.name, *want) for one in robot.stacks for want in one.wants)
    return "".join(" ".join(map(str, words)) + "\n" for words in lines)


def parse(written: str) -> Bundle:
    """Read an index.

    Raises:
        UsageError: it is not the index of a bundle, or of another version of fleet.

    """
    first, *lines = written.splitlines() or [""]
    if first != FORMAT:
        raise UsageError(
            f"the bundle's index begins with {first[:40]!r}, and this version of fleet reads {FORMAT!r}",
            cure="make the bundle again with this version: `fab bundle`",
        )
    words = [line.split() for line in lines]
    try:
        return _bundle(words)
    except (ValueError, KeyError, IndexError):
        raise UsageError(
            "the bundle's index is damaged", cure="make the bundle again: `fab bundle`"
        ) from None


def _bundle(lines: Sequence[Sequence[str]]) -> Bundle:
    (made,), (by,) = _of("made", lines), _of("by", lines)
    layers = {
        diff_id: Blob(diff_id=_sound(_DIGEST, diff_id), digest=_sound(_DIGEST, digest), size=int(size),
                      unpacked=int(unpacked), media_type=MEDIA_TYPE)
        for diff_id, digest, size, unpacked in _of("layer", lines)
    }  # fmt: skip
    images = {words[0]: _image(words) for words in _of("image", lines)}
    keys, stacks, wants = (list(_of(kind, lines)) for kind in ("key", "stack", "wants"))
    robots = tuple(
        BundledRobot(
            name=_sound(_NAME, name),
            platform=platform,
            address=address,
            user="" if user == "-" else user,
            keys=tuple((kind, data) for owner, kind, data in keys if owner == name),
            stacks=tuple(
                _stack(words[1:], [one[2:] for one in wants if one[:2] == words[:2]])
                for words in stacks
                if words[0] == name
            ),
        )
        for name, platform, address, user in _of("robot", lines)
    )
    wanted = {name for robot in robots for stack in robot.stacks for name in stack.images}
    if (
        wanted - images.keys()
        or {diff for one in images.values() for diff in one.image.layers} - layers.keys()
    ):
        raise KeyError
    return Bundle(made=_sound(_TIME, made[0]), by=by[0], robots=robots, images=images, layers=layers)


def _of(kind: str, lines: Iterable[Sequence[str]]) -> list[Sequence[str]]:
    return [words[1:] for words in lines if words and words[0] == kind]


def _image(words: Sequence[str]) -> BundledImage:
    name, reference, platform, size, identity, _, file, config, manifest, offset, length, *layers = words
    image = Image(
        reference=reference,
        platform=platform,
        size=int(size),
        identity=_sound(_DIGEST, identity),
        layers=tuple(_sound(_DIGEST, one) for one in layers),
    )
    if image.shipped_as != name:
        raise ValueError
    ids = (_sound(_DIGEST, config), _sound(_DIGEST, manifest))
    return BundledImage(image=image, file=_sound(_HEX, file), ids=ids, offset=int(offset), length=int(length))


def _stack(words: Sequence[str], wants: Sequence[Sequence[str]]) -> BundledStack:
    name, release, file, wait, settle, *images = words
    return BundledStack(
        name=_sound(_NAME, name),
        release=_sound(_NAME, release),
        file=_sound(_HEX, file),
        wait=int(wait),
        settle=int(settle),
        images=tuple(images),
        wants=tuple((kind, what) for kind, what in wants),
    )


def _sound(like: object, word: str) -> str:
    if not callable(like) or not like(word):
        raise ValueError
    return word
