"""What exactly should this robot run of a stack? A release: the stack, the exact images, and the project's files.

On the robot it is a folder that works by hand (``docker compose up -d`` in it). Its ``compose.yaml`` is Compose's own
canonical model with this robot's values, images pinned by what they are, and absolute paths. ``project/`` holds what
containers see read-only; ``seeds/`` what becomes the robot's own data (see `fleet.config.project_files`).
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import tarfile
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any, get_args

from fleet.config.compose import HOME
from fleet.config.project_files import File, ProjectFiles, on_robot
from fleet.config.stack import Restart, Service, is_cdi_name, literal
from fleet.robot import paths

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fleet.config.compose import Project
    from fleet.config.stack import Stack
    from fleet.config.validation import Boot
    from fleet.images.image import Image

_ID = "id-of-the-release"


@dataclass(frozen=True, kw_only=True)
class Release:
    """One robot's release. ``id`` is derived from all the rest: the same content is the same release, anywhere.

    ``compose`` is the text of its Compose file, in which `fleet.config.compose.HOME` stands for the login's home.
    ``folders`` are those of the robot's data that must exist, ``seeds`` the files that it starts with. ``boot`` is who starts
    it at power-on.
    """

    id: str
    stack: str
    robot: str
    services: Mapping[str, Service]
    images: tuple[Image, ...]
    compose: str
    project: Mapping[str, File] = field(default_factory=dict)
    seeds: Mapping[str, File] = field(default_factory=dict)
    folders: tuple[str, ...] = ()
    boot: Boot = "docker"

    def files(self, home: str) -> dict[str, File]:
        """The files of the release's folder, for a login whose home directory is ``home``."""
        text = self.compose.replace(HOME, json.dumps(home.replace("$", "$$"), ensure_ascii=False)[1:-1])
        return {
            # Only the login reads it: the robot's values are in it, tokens among them.
            "compose.yaml": File(data=text.encode(), mode=0o600),
            # For those who start and watch it: which services must run, and which folders of data there are.
            "services": File(
                data="".join(
                    f"{one.name}={_written(one, self.boot)}\n" for one in _must_run(self.services)
                ).encode()
            ),
            "data-folders": File(data="".join(f"{name}\n" for name in self.folders).encode()),
            **({"boot": File(data=b"systemd\n")} if self.boot == "systemd" else {}),
            **{f"project/{name}": file for name, file in self.project.items()},
            **{f"seeds/{name}": file for name, file in self.seeds.items()},
        }

    def checksum(self, home: str) -> str:
        """What the probe says of the folder of this release while all of its files are right."""
        regular = {name: file.data for name, file in self.files(home).items() if file.regular}
        lines = (_checksum_line(regular[name], f"./{name}") for name in _sorted(regular))
        return hashlib.sha256("".join(lines).encode()).hexdigest()

    def archive(self, home: str) -> bytes:
        """The release's folder as a tar archive; the same bytes every time."""
        buffer = io.BytesIO()
        files = self.files(home)
        with tarfile.open(fileobj=buffer, mode="w", format=tarfile.PAX_FORMAT) as archive:
            above = dict.fromkeys(_folders(files), File(folder=True, mode=0o755))
            for name, file in sorted((above | files).items(), key=lambda pair: (not pair[1].folder, pair[0])):
                entry = tarfile.TarInfo(name)
                entry.size, entry.mode = len(file.data), file.mode
                if file.folder:
                    entry.type = tarfile.DIRTYPE
                elif file.link is not None:
                    entry.type, entry.linkname = tarfile.SYMTYPE, file.link
                archive.addfile(entry, io.BytesIO(file.data))
            end = archive.offset + 2 * tarfile.BLOCKSIZE
        return buffer.getvalue()[:end]  # Python fills it up to 10 kB, for tapes


def compose(
    *,
    robot: str,
    stack: Stack,
    project: Project,
    files: ProjectFiles,
    images: Mapping[str, Image],
    boot: Boot = "docker",
) -> Release:
    """One robot's release of a stack; ``images`` has the local image of each service, ``boot`` says who starts it at power-on."""
    rendering = _Rendering(stack, project=project, data=files.data)
    model = rendering.model(images)
    if boot == "systemd":
        _leave_to_systemd(model)
    ours = {**files.files, **rendering.files}
    # With `boot: systemd` the model has no policies any more.
    policies = {one.name: _written(one, boot) for one in _must_run(stack.services)}
    digest = _digest(model, ours, files, images, policies=policies if boot == "systemd" else None)
    labels = {"fleet.release": digest, "fleet.stack": stack.name, "fleet.robot": robot}
    for service in model["services"].values():
        service["labels"] = {**(service.get("labels") or {}), **labels}
    return Release(
        id=digest,
        stack=stack.name,
        robot=robot,
        services=stack.services,
        images=tuple({image.shipped_as: image for image in images.values()}.values()),
        compose=_text(model).replace(_ID, digest),
        project=ours,
        seeds=files.seeds,
        folders=files.folders,
        boot=boot,
    )


def _leave_to_systemd(model: Mapping[str, Any]) -> None:
    """Switch Docker's restart policies off: with any of them, Docker may start a container before network and clock."""
    for service in model["services"].values():
        service["restart"] = "no"
        (service.get("deploy") or {}).pop("restart_policy", None)


def unpacked(data: bytes, *, name: str, stack: str, robot: str, images: tuple[Image, ...]) -> Release:
    """The release ``name`` that was packed with `Release.archive` for the home `fleet.config.compose.HOME`.

    Raises:
        ValueError, KeyError, tarfile.TarError: it is not the archive of a release.

    """
    files = _members(data)
    text = files["compose.yaml"].data.decode()
    policies = (line.partition("=") for line in files["services"].data.decode().splitlines())
    model = json.loads(text)["services"]
    services = {
        service: Service(name=service, image=model[service]["image"], **_policy(policy))
        for service, _, policy in policies
    }
    return Release(
        id=name,
        stack=stack,
        robot=robot,
        services=services,
        images=images,
        compose=text,
        project=_below("project/", files),
        seeds=_below("seeds/", files),
        folders=tuple(files["data-folders"].data.decode().splitlines()),
        boot="systemd" if "boot" in files else "docker",
    )


def _members(data: bytes) -> dict[str, File]:
    """The files and folders of an archive."""
    files: dict[str, File] = {}
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        for member in archive:
            if ".." in PurePosixPath(member.name).parts or member.name.startswith("/"):
                raise ValueError(member.name)
            content = archive.extractfile(member) if member.isfile() else None
            if content:
                files[member.name] = File(data=content.read(), mode=member.mode)
            elif member.issym():
                files[member.name] = File(link=member.linkname, mode=member.mode)
            else:
                files[member.name] = File(folder=True, mode=member.mode)
    # `Release.archive` adds these.
    implied = dict.fromkeys(_folders(files), File(folder=True, mode=0o755))
    return {name: file for name, file in files.items() if implied.get(name) != file}


def _below(folder: str, files: Mapping[str, File]) -> dict[str, File]:
    return {name.removeprefix(folder): file for name, file in files.items() if name.startswith(folder)}


def _written(service: Service, boot: Boot) -> str:
    """The restart policy of a service, for the file ``services``; who counts retries is Docker, or `boot.sh`."""
    return (
        f"{service.restart}:{service.retries}" if boot == "systemd" and service.retries else service.restart
    )


def _policy(words: str) -> dict[str, Any]:
    word, _, retries = words.partition(":")
    if word not in get_args(Restart):
        raise ValueError(words)
    return {"restart": word, "retries": int(retries or 0)}


def _digest(
    model: Mapping[str, Any],
    ours: Mapping[str, File],
    files: ProjectFiles,
    images: Mapping[str, Image],
    *,
    policies: Mapping[str, str] | None,
) -> str:
    """The ID of a release: all that it consists of."""
    content = {
        "model": model,
        "project": {name: file.digest for name, file in ours.items()},
        "seeds": {name: file.digest for name, file in files.seeds.items()},
        "folders": files.folders,
        "images": {service: image.fingerprint for service, image in images.items()},
        **({"policies": policies} if policies is not None else {}),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]


class _Rendering:
    """A stack's model as a robot gets it: pinned, with paths of the robot, and readable for old versions of Compose."""

    def __init__(self, stack: Stack, *, project: Project, data: frozenset[str]) -> None:
        self.files: dict[str, File] = {}
        self._stack = stack
        self._project = project
        self._data = data
        self._stacks_folder = f"{HOME}/{paths.stack(stack.name)}"

    def model(self, images: Mapping[str, Image]) -> dict[str, Any]:
        """The whole model; files that it needs beside those of the project go to ``files``."""
        source = json.loads(json.dumps(self._stack.model))
        model = {key: value for key, value in source.items() if not key.startswith("x-") and value}
        for name, service in model["services"].items():
            image = images[name]
            model["services"][name] = self._service(service, image)
        for volume in (model.get("volumes") or {}).values():
            options = (volume or {}).get("driver_opts") or {}
            if "device" in options:
                options["device"] = self._moved(options["device"])
        for kind in ("configs", "secrets"):
            for name, one in (model.get(kind) or {}).items():
                model[kind][name] = self._given(kind, name, one)
        # What is left of the project's folder came from `${PWD}`: it differs in each run.
        place = f"{self._stacks_folder}/releases/{_ID}/project"
        moved: dict[str, Any] = _replaced(model, old=str(self._project.folder), new=place)
        return moved

    def _service(self, service: dict[str, Any], image: Image) -> dict[str, Any]:
        left_out = ("build", "develop", "profiles", "pull_policy", "image", "platform")
        kept = {
            key: value for key, value in service.items() if key not in left_out and not key.startswith("x-")
        }
        for key in ("command", "entrypoint"):  # Compose before 2.6 does not read `null` here
            if kept.get(key, ...) is None:
                del kept[key]
        if "environment" in kept:  # one without a value would be taken from the login's shell on the robot
            kept["environment"] = {
                key: value for key, value in kept["environment"].items() if value is not None
            }
        kept |= {"image": image.shipped_as, "platform": image.platform}
        for volume in kept.get("volumes") or ():
            if volume.get("type") == "bind":
                volume["source"] = self._moved(volume["source"])
                # From Compose 5 on this is the default and left out; older ones would refuse a missing folder.
                volume["bind"] = {"create_host_path": True, **(volume.get("bind") or {})}
        return _for_old_versions(kept)

    def _moved(self, source: str) -> str:
        """A path on this computer as the robot has it; an absolute one is the robot's own and stays."""
        path = self._project.relative(literal(source))
        if path is None:
            return source
        name = on_robot(path)
        place = "data" if name in self._data else f"releases/{_ID}/project"
        whole = str(PurePosixPath(self._stacks_folder) / place / name)
        return whole.replace("$", "$$")

    def _given(self, kind: str, name: str, one: Any) -> Any:  # noqa: ANN401  a model's value
        """A config or a secret as a file: what old versions of Compose do not know becomes one."""
        if not isinstance(one, dict):
            return one
        rest = {key: value for key, value in one.items() if key not in ("file", "content", "environment")}
        if "file" in one:
            return {**rest, "file": self._moved(one["file"])}
        if "content" in one:
            inside = f"{kind}/{name}"
            self.files[inside] = File(data=literal(one["content"]).encode())
            folder = PurePosixPath(self._stacks_folder) / "releases" / _ID / "project"
            return {**rest, "file": str(folder / inside)}
        return one


def _replaced(value: Any, *, old: str, new: str) -> Any:  # noqa: ANN401  a model's value
    if isinstance(value, dict):
        return {key: _replaced(inner, old=old, new=new) for key, inner in value.items()}
    if isinstance(value, list):
        return [_replaced(inner, old=old, new=new) for inner in value]
    return value.replace(old, new) if isinstance(value, str) else value


def _for_old_versions(service: dict[str, Any]) -> dict[str, Any]:
    """The same service in words that Compose from 2.5 on reads; the canonical model uses those of today."""
    for condition in (service.get("depends_on") or {}).values():
        if isinstance(condition, dict) and condition.get("required") is True:
            del condition["required"]  # the default, and known from 2.20 on
    named = [_source(one) for one in service.get("devices") or () if is_cdi_name(_source(one))]
    if devices := [_device(one) for one in service.pop("devices", None) or () if _source(one) not in named]:
        service["devices"] = devices
    if hosts := service.get("extra_hosts"):  # `name=address` is known from 2.24 on
        service["extra_hosts"] = (
            [host.replace("=", ":", 1) for host in hosts] if isinstance(hosts, list) else hosts
        )
    wanted = [
        {"capabilities": ["gpu"], **one} for one in service.pop("gpus", None) or ()
    ]  # known from 2.30 on
    if named:  # in `devices` they are known from 2.30 on; Docker's CDI driver does not look at capabilities
        wanted.append({"driver": "cdi", "capabilities": ["cdi"], "device_ids": named})
    if wanted:
        reserved = service.setdefault("deploy", {}).setdefault("resources", {}).setdefault("reservations", {})
        reserved["devices"] = [*(reserved.get("devices") or ()), *wanted]
    return service


def _source(device: Any) -> str:  # noqa: ANN401  a model's value
    return str(device["source"] if isinstance(device, dict) else device)


def _device(one: Any) -> Any:  # noqa: ANN401  a model's value
    """A device as text: mappings are known from 2.33 on, and text has no place for a path with a colon in it."""
    if not isinstance(one, dict) or ":" in one["source"]:
        return one
    return ":".join((one["source"], one.get("target") or one["source"], one.get("permissions") or "rwm"))


# What YAML does not allow as it is: control characters, and a few that end a line.
_UNPRINTABLE = re.compile("[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]")


def _text(model: Mapping[str, Any]) -> str:
    """A model as text. JSON is YAML, and quotes itself: every value stays as it is, byte for byte."""
    text = json.dumps(model, indent=2, ensure_ascii=False)
    return _UNPRINTABLE.sub(lambda found: f"\\u{ord(found[0]):04x}", text) + "\n"


def _must_run(services: Mapping[str, Service]) -> list[Service]:
    return [service for service in services.values() if service.replicas > 0]


def _checksum_line(data: bytes, name: str) -> str:
    """What ``sha256sum`` prints of a file: a backslash in its name is doubled, and another one begins the line."""
    escaped = name.replace("\\", r"\\")
    return f"{chr(92) if escaped != name else ''}{hashlib.sha256(data).hexdigest()}  {escaped}\n"


def _sorted(names: Mapping[str, Any]) -> list[str]:
    return sorted(names, key=str.encode)


def _folders(files: Mapping[str, File]) -> list[str]:
    above = {parent.as_posix() for name in files for parent in PurePosixPath(name).parents}
    return sorted(above - {"."})
