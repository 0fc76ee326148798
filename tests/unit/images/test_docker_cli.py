from collections.abc import Callable
from pathlib import Path

import pytest

from fleet.errors import DesktopError
from fleet.images.docker_cli import buildkit_client, docker, docker_or_none

Client = Callable[..., str]


@pytest.fixture
def client(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Client:
    """Put stand-in docker clients on PATH, one folder each, and nothing else."""
    monkeypatch.setenv("PATH", "")

    def make(*, version: str, buildx: bool = False, context: str = "default") -> str:
        folder = tmp_path / version
        folder.mkdir()
        program = folder / "docker"
        program.write_text(
            "#!/bin/sh\n"
            'case "$*" in\n'
            f"--version) echo 'Docker version {version}, build abc' ;;\n"
            f"buildx*) exit {0 if buildx else 1} ;;\n"
            f"context*) echo {context} ;;\n"
            "esac\n"
        )
        program.chmod(0o755)
        monkeypatch.setenv("PATH", str(folder), prepend=":")
        return str(program)

    return make


def test_a_client_with_buildx_builds_where_local_images_are(client: Client) -> None:
    """The builder of the context in use sees local bases; one in a container would not."""
    program = client(version="28.2.2", buildx=True, context="bench")
    assert buildkit_client() == ("env", "BUILDX_BUILDER=bench", program)


def test_an_old_client_has_buildkit_inside(client: Client) -> None:
    """Docker 20.10 needs a variable and no plugin."""
    program = client(version="20.10.24+dfsg1")
    assert buildkit_client() == ("env", "DOCKER_BUILDKIT=1", program)


def test_an_old_client_is_found_behind_a_new_one_without_buildx(client: Client) -> None:
    """Every client on PATH is asked, not only the first."""
    old = client(version="20.10.24+dfsg1")
    client(version="28.2.2")
    assert buildkit_client()[-1] == old


def test_a_new_client_without_buildx_is_refused_with_the_cure(client: Client) -> None:
    """The person learns which package is missing before a build fails in its own words."""
    client(version="28.2.2")
    with pytest.raises(DesktopError, match=r"BuildKit; install the docker-buildx package"):
        buildkit_client()


def test_no_docker_at_all_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A missing program is the desktop's lack, not a traceback."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DesktopError, match=r"Docker is not installed .*docs.docker.com/engine/install"):
        docker("ps")


def saying(folder: Path, words: str) -> None:
    program = folder / "docker"
    program.write_text(f"#!/bin/sh\necho '{words}' >&2\nexit 1\n")
    program.chmod(0o755)


@pytest.mark.parametrize(
    ("words", "cure"),
    [
        ("permission denied while trying to connect to the Docker daemon socket", "usermod -aG docker"),
        ("Cannot connect to the Docker daemon at unix:///var/run/docker.sock", "systemctl start docker"),
        ("write /var/lib/docker/tmp: no space left on device", "docker system df"),
    ],
)
def test_what_docker_says_comes_with_a_cure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, cure: str
) -> None:
    """Docker's usual refusals tell what happened; the cure is added."""
    saying(tmp_path, words)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DesktopError) as caught:
        docker("ps")
    assert words in caught.value.what
    assert cure in caught.value.cure


def test_asking_for_what_is_not_there_is_no_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Absence is an answer; a Docker that cannot be used is not."""
    monkeypatch.setenv("PATH", str(tmp_path))
    saying(tmp_path, "Error: No such image: x")
    assert docker_or_none("image", "inspect", "x") is None
    saying(tmp_path, "Cannot connect to the Docker daemon")
    with pytest.raises(DesktopError):
        docker_or_none("image", "inspect", "x")


def test_a_docker_that_hangs_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing waits for ever."""
    program = tmp_path / "docker"
    program.write_text("#!/bin/sh\nexec /bin/sleep 60\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DesktopError, match=r"did not finish in 0\.2 s"):
        docker("ps", timeout=0.2)
