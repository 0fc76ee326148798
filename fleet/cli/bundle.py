"""Which verb writes a USB stick for robots that no link reaches? ``fab bundle``."""

from __future__ import annotations

import base64
import subprocess
import tempfile
from dataclasses import asdict
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.bundle import index
from fleet.bundle.make import Entry, Member, PackedImage, make
from fleet.bundle.write import Writer, check_folder, write_tar
from fleet.cli import wanted, whose
from fleet.cli.console import Screen
from fleet.cli.execute import whoami
from fleet.cli.selection import select
from fleet.cli.verb import verb
from fleet.errors import UsageError
from fleet.ssh import known_hosts
from fleet.transfer import layer_cache
from fleet.transfer.layer_cache import LayerCache
from fleet.units import human_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from fleet.bundle.write import Piece, Written
    from fleet.cli.console import AnyProgress
    from fleet.cli.wanted import Wanted
    from fleet.config.inventory import Robot
    from fleet.transfer.sender import Images

_LINE = "bundle"
"""The name of the line of progress."""


@verb(
    {
        "out": "where to: a folder, such as the mounted stick, or a file NAME.tar",
        "sign": "sign the list of digests with this SSH key, such as ~/.ssh/id_ed25519",
    }
)
def bundle(
    hosts: str = "all",
    out: str = "",
    sign: str = "",
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
    stack: str = "",
) -> None:
    """Write releases to a USB stick, for robots without a link.

    On the robot, `sh install` in the folder of the stick does what `fab ship` does over SSH. Each layer is written once
    for all robots. A second run writes only what is new. `fab ship --from` ships what a bundle holds.
    """
    if not out:
        raise UsageError("where to?", cure="fab bundle --out /media/me/STICK, or --out bundle.tar")
    fleet, robots = select(inventory, hosts)
    screen, target = Screen(), Path(out).expanduser()
    whose.once(robots, among=fleet.robots.values())
    check_folder(target.parent if _is_tar(target) else target)
    if sign and not Path(sign).expanduser().is_file():
        raise UsageError(f"there is no key {sign}", cure="name an SSH key, such as --sign ~/.ssh/id_ed25519")
    with (
        screen.progress() as progress,
        wanted.opened(robots, out_of="", only=stack, screen=screen) as (images, releases),
    ):
        pieces = _pieces(robots, releases, images=images, progress=progress)
        writer = _writer(progress)
        new = pieces if dry and _is_tar(target) else writer(target).plan(pieces) if dry else []
        written = None if dry else _written(target, pieces, writer=writer, sign=sign)
        progress.ended(_LINE)
    if written is None:
        _show(new, screen, json=json)
    else:
        _report(target, robots, written, screen, json=json)


def _writer(progress: AnyProgress) -> Callable[[Path], Writer]:
    return partial(
        Writer,
        on_write=lambda name, size: progress.step_started(_LINE, f"write {name[:20]}", size),
        on_bytes=lambda count: progress.bytes_sent(_LINE, count),
    )


def _report(target: Path, robots: Sequence[Robot], written: Written, screen: Screen, *, json: bool) -> None:
    names = [robot.name for robot in robots]
    if json:
        screen.json({"out": str(target), "robots": names, **asdict(written)})
        return
    kept = f", {human_bytes(written.kept)} were there already" * bool(written.kept)
    files = f"{written.files} files written, {human_bytes(written.new)}{kept}"
    screen.lines([f"{target}: a bundle for {', '.join(names)}; {files}"])


def _pieces(
    robots: Sequence[Robot],
    releases: Mapping[str, Sequence[Wanted]],
    *,
    images: Images,
    progress: AnyProgress,
) -> list[Piece]:
    """The files of a bundle for robots. Each image is packed once."""
    members = [
        Member(
            robot=robot,
            keys=_keys(robot),
            entries=[
                Entry(release=one.release, wait=one.wait, settle=one.settle) for one in releases[robot.name]
            ],
        )
        for robot in robots
    ]
    cache = LayerCache(directory=layer_cache.folder(), export=images.export, pushed=images.pushed)
    needed = {
        image.shipped_as: image for one in members for entry in one.entries for image in entry.release.images
    }
    packed = []
    for image in needed.values():
        progress.step_started(_LINE, f"pack {image.reference}", None)
        layers = cache.pack(image, image.layers, index.ENCODING)
        packed.append(PackedImage(image=image, config=cache.config(image), layers=layers))
    made = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return make(members, packed, open_layer=cache.open, made=made, by=whoami())[1]


def _keys(robot: Robot) -> tuple[tuple[str, str], ...]:
    """The robot's recorded host keys: a computer with other keys is another one."""
    known = known_hosts.read([robot.known_hosts])
    entries = known.entries(known_hosts.host_name(robot.address, robot.port or 22))
    return tuple(
        (one.key.kind, base64.b64encode(one.key.blob).decode()) for one in entries if not one.revoked
    )


def _is_tar(target: Path) -> bool:
    return target.suffix == ".tar"


def _written(
    target: Path, pieces: Sequence[Piece], *, writer: Callable[[Path], Writer], sign: str
) -> Written:
    signature = partial(_signature, key=Path(sign).expanduser()) if sign else None
    if _is_tar(target):
        return write_tar(target, lambda folder: writer(folder).write(pieces, sign=signature))
    return writer(target).write(pieces, sign=signature)


def _signature(text: bytes, *, key: Path) -> bytes:
    """Sign a text with an SSH key, as ``ssh-keygen -Y verify -n fleet-bundle`` checks it; an agent may hold the key."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "SHA256SUMS")
        file.write_bytes(text)
        command = ("ssh-keygen", "-Y", "sign", "-q", "-f", str(key), "-n", "fleet-bundle", str(file))
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except FileNotFoundError:
            raise UsageError(
                "ssh-keygen is not installed", cure="sudo apt-get install openssh-client"
            ) from None
        if done.returncode:
            what = f"{key} did not sign: {(done.stderr.strip().splitlines() or ['no reason given'])[-1]}"
            raise UsageError(
                what, cure="name a private key, or the public key of one that your SSH agent holds"
            )
        return Path(f"{file}.sig").read_bytes()


def _show(new: Iterable[Piece], screen: Screen, *, json: bool) -> None:
    """What would be written, for ``--dry``."""
    if json:
        screen.json([{"path": one.path, "size": one.size} for one in new])
    else:
        screen.lines([f"would write {one.path}, {human_bytes(one.size)}" for one in new])
        screen.say("nothing was written (--dry)")


VERBS = (bundle,)
