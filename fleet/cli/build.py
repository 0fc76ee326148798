"""Which verb makes images? ``fab build``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.cli import doubts
from fleet.cli.beside import beside
from fleet.cli.console import Screen
from fleet.cli.selection import select
from fleet.cli.stacks import Stacks, images_of, warnings_of
from fleet.cli.verb import verb
from fleet.errors import ImageError, UsageError
from fleet.images import build as builds
from fleet.images import builder
from fleet.images.docker_cli import buildkit_client
from fleet.images.store import Store
from fleet.platforms import NAMES as PLATFORMS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from fleet.cli.console import AnyProgress
    from fleet.cli.stacks import RobotStack
    from fleet.config.compose import Project
    from fleet.config.inventory import Robot
    from fleet.images.image import Image

_NOT_PULLED = "--pull has no effect, because it is built from Debian images that fleet makes"


@verb(
    {
        "no_cache": "build every step again",
        "pull": "ask registries for newer base images",
        "platform": f"build for this platform, not the robots' own: {', '.join(PLATFORMS)}",
    }
)
def build(
    hosts: str = "all",
    no_cache: bool = False,
    pull: bool = False,
    platform: str = "",
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
    stack: str = "",
) -> None:
    """Build the stacks' images for the robots' platforms.

    One image per platform, tagged for it: talker:latest-arm64. Services without `build:` are pulled. What `build:` says
    in the Compose file becomes the flags of `docker build`. The output of each image's last build is kept in
    ~/.cache/fleet/builds. If a step fails, its last lines are shown.
    """
    robots, screen = _for_platform(select(inventory, hosts)[1], platform), Screen()
    with beside(buildkit_client) as client, beside(Store) as opened, Stacks(variables=variables_of) as stacks:
        found = stacks.of(robots, only=stack)
        screen.warnings(warnings_of(found))
        doubts.tell(robots, found, screen=screen)
        wanted = [(robot, one) for robot in robots for one in found[robot.name]]
        flags = ["--no-cache"] * no_cache + ["--pull"] * pull
        commands = commands_for(wanted, flags, client=client())
        if pull:
            screen.warnings({one.reference: [_NOT_PULLED] for one in commands if one.bases})
        if dry:
            screen.json(commands) if json else screen.lines(builds.lines(commands))
            return
        with screen.progress() as progress:
            builder.run_all(commands, watcher=Watcher(progress), memory=builder.free_memory())
        with opened() as store:
            images = [image for robot, one in wanted for image in _built(one, robot, store)]
            screen.warnings(doubts.of_images(robots, found, store))
        screen.images(list({image.reference: image for image in images}.values()), json=json)


def _built(one: RobotStack, robot: Robot, store: Store) -> Iterable[Image]:
    """The images of a stack after its build. Raises `ImageError` if the build made another one."""
    try:
        return images_of(one, robot, store).values()
    except ImageError as problem:
        if "fab build" not in problem.cure:
            raise
        cure = "`FROM --platform` in the Dockerfile or the image's own platform decides: correct it, or `platform:` in the inventory"
        raise ImageError(problem.what, cure=cure) from None


def _for_platform(robots: Sequence[Robot], platform: str) -> Sequence[Robot]:
    if not platform:
        return robots
    if platform not in PLATFORMS:
        raise UsageError(f"there is no platform {platform}", cure=f"there are: {', '.join(PLATFORMS)}")
    return [robot.model_copy(update={"platform": platform}) for robot in robots]


def variables_of(project: Project, robot: Robot) -> dict[str, str]:
    """The variables that name the base images which fleet makes, for a stack's Compose file."""
    return {name: base.tag for name, base in builds.bases(project, robot.platform).items()}


def commands_for(
    wanted: Iterable[tuple[Robot, RobotStack]], flags: Sequence[str], *, client: Sequence[str]
) -> list[builds.Command]:
    """What has to be run for all robots, each once."""
    commands: list[builds.Command] = []
    for robot, one in wanted:
        needs = builds.bases(one.project, robot.platform).values()
        # The Debian bases that fleet makes are in no registry, where --pull would look for them.
        useful = [flag for flag in flags if not (needs and flag == "--pull")]
        made = builds.plan(
            one.stack, one.project, platform=robot.platform, client=client, needs=needs, flags=useful
        )
        commands += [command for command in made if command not in commands]
    return commands


class Watcher:
    """Shows how builds go: a moving line for each image, or a line when it ends."""

    def __init__(self, progress: AnyProgress) -> None:
        self._progress = progress

    def note(self, name: str, text: str) -> None:
        """See `fleet.images.builder.Watcher`."""
        self._progress.note(name, text)

    def step(self, name: str, title: str) -> None:
        """See `fleet.images.builder.Watcher`."""
        self._progress.step_started(name, title, None)

    def built(self, name: str, built: builder.Built) -> None:
        """See `fleet.images.builder.Watcher`."""
        self._progress.ended(name)
        self._progress.note(name, str(built))


VERBS = (build,)
