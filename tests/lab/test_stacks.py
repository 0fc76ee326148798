from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.support.lab_project import TINY, Project, current, eventually, running, service

if TYPE_CHECKING:
    from tests.lab.conftest import Pi

DATA = "/home/pi/.fleet/stacks/tiny/data"


def mapper(*, owner: str, colour: str = "red") -> str:
    """A service that writes a map into the project's folder, and gives it to some user."""
    return f"""
    image: {TINY}
    command: sh -c 'echo $$COLOUR > /maps/house.pgm; while echo tick; do sleep 1; done'
    user: "{owner}"
    environment: {{COLOUR: {colour}}}
    volumes: ["./maps:/maps"]
    restart: unless-stopped
    stop_signal: SIGKILL
"""


@pytest.mark.parametrize("owner", ["0", "1000", "4321"])
def test_what_a_robot_writes_outlives_everything(project: Project, pi: Pi, owner: str) -> None:
    """A second ship, a new release, a rollback, a prune, a removal of the stack: the map is there, whoever owns it."""
    project.inventory(everyone={"robots": ["*"], "stack": {"files": ["docker/compose.yaml"], "settle": 1}})
    project.stack(mapper=mapper(owner=owner))
    pi.exec("sh", "-c", f"mkdir -p {DATA}/maps && chown -R pi: /home/pi/.fleet && chown {owner} {DATA}/maps")
    project.well("ship", "--hosts", "pi1")
    assert project.well("ship", "--hosts", "pi1", "--json").status == {"pi1": "unchanged"}

    def there() -> bool:
        return pi.exec("cat", f"{DATA}/maps/house.pgm") in ("red", "green")

    assert eventually(there)
    project.stack(mapper=mapper(owner=owner, colour="green"))
    for line in ("ship", "ship", "rollback", "prune --keep 2", "remove --stack tiny"):
        project.well(*line.split(), "--hosts", "pi1")
        assert there(), line
    assert pi.exec("stat", "-c", "%u", f"{DATA}/maps/house.pgm") == owner


def test_files_beside_the_compose_file_travel(project: Project, pi: Pi) -> None:
    """Read-only ones are the release's; writable ones are the robot's from then on, merged as dpkg merges."""
    project.write("docker/nav.yaml", "nav: 1\n")
    project.write("docker/tune.yaml", "tune: 1\n")
    more = 'volumes: ["./nav.yaml:/nav.yaml:ro", "./tune.yaml:/tune.yaml"]'
    project.stack(tick=service(more=more))

    def inside(path: str) -> str:
        return pi.exec("docker", "exec", running(pi)["tick"][0], "cat", path)

    project.well("ship", "--hosts", "pi1")
    assert (inside("/nav.yaml"), inside("/tune.yaml")) == ("nav: 1", "tune: 1")
    project.write("docker/nav.yaml", "nav: 2\n")
    project.write("docker/tune.yaml", "tune: 2\n")
    project.well("ship", "--hosts", "pi1")
    assert (inside("/nav.yaml"), inside("/tune.yaml")) == ("nav: 2", "tune: 2")
    pi.ssh(f"echo 'tune: robot' > {DATA}/tune.yaml")
    project.write("docker/tune.yaml", "tune: 3\n")
    said = project.well("ship", "--hosts", "pi1")
    assert "tune.yaml was changed on the robot too" in said.all
    assert inside("/tune.yaml") == "tune: robot"
    assert pi.exec("cat", f"{DATA}/tune.yaml.from-desktop") == "tune: 3"


def test_a_release_that_crashes_after_a_while_goes_back(project: Project, pi: Pi) -> None:
    """Without a health check it is watched for the settling time; the one before runs again, and the person is told."""
    project.well("ship", "--hosts", "pi1")
    before = current(pi)
    crash = f"""
    image: {TINY}
    command: sh -c 'echo all is well; sleep 5; echo battery is empty; exit 3'
    restart: always
"""
    project.stack(tick=crash)
    said = project.fab("ship", "--hosts", "pi1")
    assert (said.code, current(pi)) == (1, before)
    assert "tick has restarted" in said.all
    assert "battery is empty" in said.all
    assert f"went back to release {before}, which runs" in said.all
    assert running(pi)["tick"][1] == before


def test_one_shots_are_done_when_they_have_ended_well(project: Project, pi: Pi) -> None:
    """Also where another service waits for them; a second ship starts nothing again."""
    once = f'\n    image: {TINY}\n    command: "true"\n    restart: "no"\n'
    waits = "depends_on: {setup: {condition: service_completed_successfully}}"
    project.stack(setup=once, tick=service(more=waits))
    project.well("ship", "--hosts", "pi1")
    before = pi.exec("docker", "ps", "--all", "--quiet")
    assert project.well("ship", "--hosts", "pi1", "--json").status == {"pi1": "unchanged"}
    assert pi.exec("docker", "ps", "--all", "--quiet") == before
    assert "setup completed" in project.well("status", "--hosts", "pi1").out


def test_one_computer_is_one_robot(project: Project, pi: Pi) -> None:
    """A second name for it is refused, whether the address says so or the computer itself."""
    key = project.lab.inventory.with_name("id_ed25519")
    also = project.write(
        "also.yaml", f"robots: {{twin: {{address: {pi.address}, user: pi, identity_file: {key}}}}}"
    )
    project.inventory(also=also)
    said = project.fab("ship", "--hosts", "pi1,twin")
    assert (said.code, "pi1 and twin have the same address" in said.err) == (2, True)
    assert project.fab("ship", "--hosts", "pi1").code == 2
    project.inventory()
    project.well("ship", "--hosts", "pi1")
    project.well("trust", "--yes", "--inventory", str(also))
    said = project.fab("ship", "--hosts", "twin", "--inventory", str(also))
    assert said.code == 2
    assert "was shipped to as pi1, and the inventory calls it twin" in said.all
