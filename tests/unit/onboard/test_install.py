"""What `sh install` refuses; that it installs is for tests/lab/test_bundle.py."""

from __future__ import annotations

import hashlib
import os
import subprocess
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet.bundle import index
from fleet.bundle.write import SUMS, Writer, piece
from tests.support.bundles import ROBOT, TALKER, bundle, release
from tests.support.sshd import make_key

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

DOCKER = """#!/bin/sh
case "$1 $*" in
    version*) [ -z "$DOWN" ] || { echo "$DOWN" >&2; exit 1; } ;;
    ps*label=fleet.robot*) printf '%s' "$SHIPPED" ;;
    ps*publish=8080/tcp*) echo "${PUBLISHED-}" ;;
    ps*--all*Names*) echo "${NAMED-}" ;;
    ps*compose.project=talker*) echo c1 ;;
    inspect*fleet.release*) echo "c1 talker $RUNS running 0 healthy" ;;
    inspect*) echo "c1 talker running 0 0 healthy" ;;
    image*inspect*) printf '%s\\n' $IMAGE ;;
    *) exit 0 ;;
esac
"""
SHA256SUM = """#!/bin/sh
PATH=${PATH#*:}
[ "$LC_ALL" = C ] && exec sha256sum "$@"
sha256sum "$@" | sed 's/: OK$/: Correcto/'
"""
"""As in another language."""


class Stick:
    """A stick in a computer: `install` with a Docker that is a few words."""

    def __init__(
        self,
        home: Path,
        *robots: str,
        sign: Callable[[bytes], bytes] | None = None,
        wants: Sequence[tuple[str, str]] = (),
        keys: Mapping[str, str] | None = None,
        **values: object,
    ) -> None:
        if "busybox" in str((home.parent / "bin/sh").resolve()):
            pytest.skip("it has a uname of its own")
        self.folder = home.parent / "stick"
        self.home = home
        self.folder.mkdir(exist_ok=True)
        robot = ROBOT.model_copy(update=values)
        whole, pieces = bundle(*robots, robot=robot)
        found = tuple(
            replace(
                one,
                keys=(("ssh-ed25519", keys[one.name]),) if keys else (),
                stacks=tuple(replace(stack, wants=tuple(wants)) for stack in one.stacks),
            )
            for one in whole.robots
        )
        text = index.text(replace(whole, robots=found)).encode()
        pieces = [one for one in pieces if not one.path.startswith("index-")]
        Writer(self.folder).write([*pieces, piece(f"index-{'1' * 12}", text)], sign=sign)
        self.program("docker", DOCKER)
        self.program("sha256sum", SHA256SUM)
        self.program("uname", '#!/bin/sh\n[ "$1" = -n ] && echo "$NAME" || echo x86_64\n')
        self.program("dpkg", "#!/bin/sh\necho amd64\n")

    def program(self, name: str, text: str) -> None:
        """Put a program of these words first in the path."""
        (self.home.parent / "bin" / name).write_text(text)
        (self.home.parent / "bin" / name).chmod(0o755)

    def run(
        self, *arguments: str, name: str = "pi1", shipped: str = "", down: str = "", **values: str
    ) -> subprocess.CompletedProcess[str]:
        """Run `sh install`."""
        environment = {
            "PATH": f"{self.home.parent / 'bin'}:{os.environ['PATH']}",
            "HOME": str(self.home),
            "LC_ALL": "es_ES.UTF-8",
            "NAME": name,
            "SHIPPED": shipped,
            "DOWN": down,
            **values,
        }
        shell = str(self.home.parent / "bin/sh")
        argv = (shell, str(self.folder / "install"), *arguments)
        return subprocess.run(argv, env=environment, capture_output=True, text=True, timeout=30, check=False)

    def says(self, *arguments: str, **values: str) -> str:
        """What it complains of; it must."""
        done = self.run(*arguments, **values)
        assert done.returncode == 1, (done.stdout, done.stderr)
        assert done.stderr.count("  cure: ") == 1, done.stderr
        return done.stderr

    def about_signature(self) -> str:
        """What it says of the bundle, before the robot is too little for it."""
        return self.run(down="no socket").stdout.partition("\n")[0]


def test_the_wrong_robot_is_refused_with_those_that_the_stick_has(home: Path) -> None:
    """By its name, by what runs there, and by what a person says."""
    stick = Stick(home)
    assert "releases for pi1, pi2, and nothing says that this computer (other)" in stick.says(name="other")
    assert "nothing for pi9; it has: pi1, pi2" in stick.says("pi9")
    assert "is called pi1, and the bundle has releases for pi1 too" in stick.says("pi2")
    assert "was shipped to as pi7, not as pi1" in stick.says(shipped="pi7\n")
    assert "was shipped to as pi2, not as pi1" in stick.says("pi1", shipped="pi2\n")
    assert "there is no option --force" in stick.says("--force")


def test_the_wrong_processor_and_the_wrong_user_are_refused(home: Path) -> None:
    """Before Docker is asked anything."""
    stick = Stick(home, "pi1", platform="linux/arm/v7")
    if not os.path.exists("/proc/sys/fs/binfmt_misc/qemu-arm"):  # noqa: PTH110
        assert "for another processor than this one's (x86_64)" in stick.says()
    assert "logs in to pi1 as nobody-else, and this is" in Stick(home, "pi1", user="nobody-else").says()


def test_a_robot_that_is_not_ready_is_told_what_it_lacks(home: Path) -> None:
    """As `fab ship` does."""
    stick = Stick(home, "pi1")
    assert "may not use Docker" in stick.says(down="permission denied while trying to connect")
    assert "Docker does not answer: no socket" in stick.says(down="no socket")


@pytest.mark.parametrize("name", ["index-*", "releases/*", "images/*", "programs-*/swap.sh"])
def test_a_stick_that_was_edited_is_refused(home: Path, name: str) -> None:
    """Whatever is used; a file that is missing too."""
    stick = Stick(home, "pi1")
    (file,) = stick.folder.glob(name)
    file.write_bytes(file.read_bytes()[:-1])
    shown = str(file.relative_to(stick.folder))
    assert f"{shown} on the stick is not what fab bundle wrote" in stick.says()
    file.unlink()
    assert f"{shown} is missing on the stick" in stick.says()
    (stick.folder / SUMS).unlink()
    assert "is not whole: SHA256SUMS is missing" in stick.says()


def test_a_layer_that_was_edited_is_told_by_its_name(home: Path) -> None:
    """Its size is compared before anything is sent: `receive.sh` would wait for the rest. A bit is seen by the digest."""
    stick = Stick(home, "pi1")
    file = next(stick.folder.glob("layers/*"))
    data = file.read_bytes()
    for content in (data[:-1], data + b"x", data[:-1] + bytes([data[-1] ^ 1])):
        file.write_bytes(content)
        assert f"layers/{file.name} on the stick is not what fab bundle wrote" in stick.says()
    file.unlink()
    assert f"layers/{file.name} is missing on the stick" in stick.says()


@pytest.mark.parametrize("name", ["SHA256SUMS", "index-*", "releases/*", "images/*", "programs-*/swap.sh"])
@pytest.mark.parametrize("gone", [False, True])
def test_a_stick_that_is_pulled_out_is_not_called_edited(home: Path, name: str, gone: bool) -> None:
    """A file cannot be read (as a folder), because the device does not answer; or nothing is there any more at its turn."""
    stick = Stick(home, "pi1")
    (file,) = stick.folder.glob(name)
    away = home.parent / "away"
    pull = f'mv "{stick.folder}" "{away}"' if gone else f'rm "{file}" && mkdir "{file}"'
    if name == "SHA256SUMS":
        stick.program(
            "cat", f'#!/bin/sh\nPATH=${{PATH#*:}}\ncase "$*" in *SHA256SUMS) {pull} ;; esac\nexec cat "$@"\n'
        )
    else:
        stick.program(
            "sha256sum",
            f'#!/bin/sh\nPATH=${{PATH#*:}}\n[ "$1" != -c ] || {{ {pull}; }}\nexec sha256sum "$@"\n',
        )
    said = stick.says()
    assert "cannot be read from the stick" in said, said
    assert "if the stick was pulled out, put it in and run the same command" in said


def test_a_program_that_was_cut_off_does_nothing(home: Path) -> None:
    """At any place: the shell reads it to its end first."""
    stick = Stick(home, "pi1")
    text = (stick.folder / "install").read_bytes()
    shell = str(home.parent / "bin/sh")
    for size in range(1000, len(text) - 3, 1501):
        (stick.folder / "install").write_bytes(text[:size])
        done = subprocess.run(
            (shell, str(stick.folder / "install")), capture_output=True, text=True, check=False
        )
        assert (done.returncode != 0, done.stdout) == (True, ""), size
    assert list(home.iterdir()) == []


def test_an_older_stick_is_refused(home: Path) -> None:
    """Older than a ship over SSH, than a rollback, and than another stick: by when that was made, not put in."""
    stick = Stick(home, "pi1")
    here = home / ".fleet/stacks/talker"
    here.mkdir(parents=True)
    later, earlier = "2026-11-28T12:00:01Z", "2026-11-28T11:59:59Z"
    events = {
        f"{later}\tship\tabc\ttim@desktop\tdone": True,
        f"{later}\trollback\tabc\ttim@desktop\tdone": True,
        f"{earlier}\tship\tabc\ttim@desktop by stick of {later}\tdone": True,
        f"{later}\tship\tabc\ttim@desktop by stick of {earlier}\tdone": False,
        f"{earlier}\tship\tabc\ttim@desktop\tdone": False,
        f"{later}\tship\tabc\ttim@desktop\tfailed: tick": False,
    }
    for line, newer in events.items():
        (here / "history").write_text(f"{line}\n")
        said = stick.says()
        assert ("something newer has come to pi1 since" in said) == newer, line
        assert ("sh install pi1 --older" in said) == newer, line


def test_the_release_is_written_as_ship_writes_it(home: Path) -> None:
    """With the login's home in it: `fab ship` must find nothing to do. (Here the image cannot be loaded.)"""
    Stick(home, "pi1").says()
    wanted = release()
    folder = home / ".fleet/stacks/talker/releases" / wanted.id
    assert folder.stat().st_mode & 0o777 == 0o700  # secrets are in it
    for name, file in wanted.files(str(home)).items():
        path = folder / name
        if file.folder:
            assert path.stat().st_mode & 0o777 == file.mode, name
        elif file.link is None:
            assert (path.read_bytes(), path.stat().st_mode & 0o777) == (file.data, file.mode), name
        else:
            assert str(path.readlink()) == file.link


def test_a_robot_in_dev_gets_the_release_back(home: Path) -> None:
    """Its containers run, and have files of `fab dev`: `unchanged` would be wrong."""
    stick = Stick(home, "pi1")
    here = home / ".fleet/stacks/talker"
    here.mkdir(parents=True)
    (here / "releases").mkdir()
    image = TALKER.image
    values = {"RUNS": release().id, "IMAGE": image.identity}
    assert f"pi1: done, release {release().id} of talker runs" in stick.run(**values).stdout
    assert f"pi1: unchanged, runs release {release().id}" in stick.run(**values).stdout
    (here / "dev").mkdir()
    (here / "dev/state").write_text("2026-11-28T11:00:00Z tim@desktop\n")
    assert f"pi1: done, release {release().id} of talker runs" in stick.run(**values).stdout
    assert not (here / "dev").exists()


def test_what_the_release_wants_is_looked_for_before_anything_is_written(home: Path) -> None:
    """As `fab ship` does. What its own stack has is no clash."""
    stick = Stick(home, "pi1", wants=[("device", "/dev/null"), ("port", "8080/tcp"), ("name", "cam")])
    own = {"PUBLISHED": "talker-web-1 talker", "NAMED": "cam talker"}
    assert "the release wants" not in stick.run(**own).stderr
    said = stick.says(**{**own, "PUBLISHED": "web site"})
    assert "the release wants port 8080/tcp, which container web has" in said
    assert "stop the other one: `docker rm -f web`; nothing was changed" in said
    assert "wants name cam, which container cam has" in stick.says(**{**own, "NAMED": "cam "})
    stick = Stick(home, "pi1", wants=[("device", "/dev/ttyUSB77")])
    assert "the release wants /dev/ttyUSB77, which this robot does not have" in stick.says()


def test_cards_that_were_copied_have_one_host_key(home: Path) -> None:
    """Then the name decides, else a person."""
    same = {"pi1": "AAAA", "pi2": "AAAA", "pi3": "BBBB"}
    stick = Stick(home, "pi1", "pi2", "pi3", keys=same)
    stick.program(
        "cat",
        '#!/bin/sh\nPATH=${PATH#*:}\ncase $1 in /etc/ssh/*) echo ssh-ed25519 AAAA x ;; *) exec cat "$@" ;; esac\n',
    )
    assert "this computer (other) may be each of pi1, pi2" in stick.says(name="other")
    assert "pi2: release" in stick.run(name="pi2").stdout
    assert "pi1: release" in stick.run(name="other", shipped="pi1\n").stdout
    assert "pi1: release" in stick.run("pi1", name="other").stdout
    assert "has the SSH host key of pi1, pi2, not of pi3" in stick.says("pi3")


class Signed:
    """Keys that may log in to a robot, and one that signs."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self.key, self.other = (make_key(home.parent / name) for name in ("key", "other"))
        (home / ".ssh").mkdir()

    def public(self, key: Path) -> str:
        words = ("ssh-keygen", "-y", "-f", str(key))
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()

    def sign(self, text: bytes) -> bytes:
        words = ("ssh-keygen", "-Y", "sign", "-q", "-f", str(self.key), "-n", "fleet-bundle")
        return subprocess.run(words, input=text, capture_output=True, check=True).stdout

    def allow(self, *lines: str) -> None:
        """As a person writes them: KEY and OTHER are keys."""
        text = (
            "\n".join(lines).replace("KEY", self.public(self.key)).replace("OTHER", self.public(self.other))
        )
        (self.home / ".ssh/authorized_keys").write_text(f"{text}\n")


GOOD = "(signed with a key that may log in here)"
BAD = "the signature of this bundle is not by a key that may log in to this robot"


@pytest.mark.parametrize(
    ("lines", "good"),
    [
        (["OTHER", "KEY tim@desktop"], True),
        (["KEY tim@desktop", "KEY tim@old-desktop"], True),
        (['from="10.0.0.0/8,*.lan",no-pty KEY', "OTHER"], True),
        (['environment="A=an \\"ssh-ed25519 AAAA\\" key" KEY'], True),
        (["  KEY\r"], True),
        (["# KEY", "OTHER"], False),
        (['command="rsync --server" KEY'], False),
        (['command="echo KEY" OTHER'], False),
        (["cert-authority KEY"], False),
        ([""], False),
    ],
)
def test_a_signature_counts_if_its_key_may_log_in(home: Path, lines: list[str], good: bool) -> None:
    """And do all: not one that is commented out, nor one that may run a single command."""
    signed = Signed(home)
    stick = Stick(home, "pi1", sign=signed.sign)
    signed.allow(*lines)
    if good:
        assert GOOD in stick.about_signature()
    else:
        assert BAD in stick.says()


def test_a_signature_is_of_one_list_of_digests(home: Path) -> None:
    """One of another bundle beside it is neither forged nor good; nor is a renamed one."""
    signed = Signed(home)
    signed.allow("KEY")
    stick = Stick(home, "pi1", sign=signed.sign)
    (signature,) = stick.folder.glob("signed-*.sig")
    data = signature.read_bytes()
    Stick(home, "pi1", "pi2")
    (stick.folder / "signed-0123456789ab.sig").write_bytes(data)
    assert "(not signed)" in stick.about_signature()
    digest = hashlib.sha256((stick.folder / SUMS).read_bytes()).hexdigest()
    (stick.folder / f"signed-{digest[:12]}.sig").write_bytes(data)
    assert BAD in stick.says()


def test_a_signature_that_cannot_be_checked_is_told_as_such(home: Path) -> None:
    """OpenSSH 7.9 of Debian buster has no `ssh-keygen -Y`."""
    signed = Signed(home)
    stick = Stick(home, "pi1", sign=signed.sign)
    signed.allow("KEY")
    stick.program(
        "ssh-keygen", "#!/bin/sh\necho 'unknown option -- Y' >&2\necho 'usage: ssh-keygen' >&2\nexit 1\n"
    )
    assert "(its signature cannot be checked: OpenSSH here is older than 8.1)" in stick.about_signature()
