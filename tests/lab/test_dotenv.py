"""What a robot's own Compose makes of the `.env` that we write: the only judge of its quoting."""

from __future__ import annotations

import io
import json
import tarfile
from typing import TYPE_CHECKING

from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from fleet.robot.release import dotenv

if TYPE_CHECKING:
    from tests.lab.conftest import Lab, Pi

NASTY = st.text(alphabet=st.sampled_from("ab \\\"'$\n\r\t#{}()=!`~;&|<>*?%[]-é☃\u00a0\u2028"), max_size=8)
ANY = st.text(alphabet=st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12)


def read_back(pi: Pi, values: list[str]) -> list[str]:
    """The values as a container on the robot would get them."""
    variables = {f"V{number}": value for number, value in enumerate(values)}
    compose = {"services": {"s": {"image": "none", "environment": list(variables)}}}
    files = {"compose.yaml": json.dumps(compose), ".env": dotenv(variables)}
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as tar:
        for name, text in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(text.encode())
            tar.addfile(entry, io.BytesIO(text.encode()))
    script = 'd=$(mktemp -d) && cd "$d" && tar -x && docker compose config --format json; rm -rf "$d"'
    done = pi.ssh(script, stdin=archive.getvalue())
    assert done.stderr == b""
    said = json.loads(done.stdout)["services"]["s"].get("environment", {})
    return [said[name].replace("$$", "$") for name in variables]  # its output is a Compose file again


@example(
    values=[
        "",
        " ",
        "a b",
        "it's",
        'say "hi"',
        "$(reboot)",
        "${HOME}",
        "$$",
        "#",
        "a #b",
        "end\\",
        "\\'",
        "'\\",
    ]
)
@example(
    values=[
        "two\nlines",
        "\r\n",
        "\\n",
        "\\\\n",
        '\\"',
        "\\$",
        "$\\",
        "'$HOME'",
        '"$HOME"',
        "'\\$'",
        "export A=1",
    ]
)
@given(values=st.lists(NASTY | ANY, min_size=30, max_size=60))
@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)
def test_a_robots_compose_reads_back_what_was_written(provisioned: Lab, values: list[str]) -> None:
    """Spaces, quotes, backslashes, dollars, line ends, any letter: the container gets the value and nothing else."""
    assert read_back(provisioned.pis[0], values) == values
