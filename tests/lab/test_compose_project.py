"""A project as people have it, shipped as it is: its containers are those of `docker compose up` in its folder."""

from __future__ import annotations

import json
import subprocess
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.lab_project import TINY, Project, wipe

if TYPE_CHECKING:
    from pathlib import Path

    from tests.lab.conftest import Lab, Pi

FILES = {
    "compose.yaml": """
name: rover
x-node: &node
  restart: unless-stopped
  stop_signal: SIGKILL
  env_file: [node.env]
  logging: {driver: json-file, options: {max-size: 1m}}
include: [tools.yaml]
services:
  driver:
    <<: *node
    extends: {file: common.yaml, service: base}
    command: ["sh", "-c", "while cat /etc/driver.yaml; do sleep 1; done"]
    volumes: ["./config/driver.yaml:/etc/driver.yaml:ro", "/dev/shm:/dev/shm"]
    environment: {RATE: "${RATE:-10}", DOMAIN: "${ROS_DOMAIN_ID}", DOLLAR: "a$$b"}
    cap_add: [NET_RAW]
    ulimits: {nofile: 4096}
  mapper:
    <<: *node
    extends: {file: common.yaml, service: base}
    command: ["sh", "-c", "while sleep 1; do cat /maps/house.pgm; done"]
    volumes: ["./maps:/maps", "cache:/cache"]
    depends_on: {setup: {condition: service_completed_successfully}}
    shm_size: 64m
  web:
    <<: *node
    image: ${IMAGE}
    ports: ["127.0.0.1:8080:80"]
    healthcheck: {test: ["CMD", "true"], interval: 5s, start_period: 20s, start_interval: 100ms}
    extra_hosts: ["base:10.0.0.1"]
    configs: [{source: site, target: /etc/site.conf}]
    secrets: [token]
    user: "1001"
    volumes: ["./logs:/logs", "./config:/config:ro"]
  setup:
    image: ${IMAGE}
    command: ["true"]
    restart: "no"
secrets:
  token: {file: ./config/token}
configs:
  site: {file: ./config/site.conf}
volumes:
  cache:
""",
    "compose.override.yaml": "services: {web: {environment: {THEME: dark}, labels: {robot.part: web}}}\n",
    "common.yaml": "services: {base: {image: '${IMAGE}', network_mode: host, environment: {COMMON: 'yes'}}}\n",
    "tools.yaml": "services: {viz: {image: '${IMAGE}', profiles: [viz], stop_signal: SIGKILL}}\n",
    ".env": "ROS_DOMAIN_ID=7\nIMAGE=" + TINY + "\n",
    "node.env": "# values\nGREETING=hello there\nQUOTED='single'\n",
    "config/driver.yaml": "port: /dev/ttyUSB0\n",
    "config/site.conf": "listen 80\n",
    "config/token": "t0ken\n",
    "config/key": "private\n",
    "config/odd/-rf \\ $HOME": "odd\n",
}


@pytest.fixture
def pi(provisioned: Lab) -> Pi:
    """One robot, to which nothing was shipped."""
    wipe(provisioned.pis[0])
    return provisioned.pis[0]


@pytest.fixture
def project(provisioned: Lab, images: None, tmp_path: Path) -> Project:  # noqa: ARG001  they must be there
    """The project; the inventory only says where it is, and switches a profile on."""
    made = Project.made(tmp_path, provisioned)
    for name, text in FILES.items():
        made.write(f"rover/{name}", text)
    for name, mode in {"logs": 0o777, "config/empty/deep": 0o755, "config/shut": 0o700}.items():
        (tmp_path / "rover" / name).mkdir(parents=True)
        (tmp_path / "rover" / name).chmod(mode)
    (tmp_path / "rover/config/key").chmod(0o600)
    inventory = json.loads((tmp_path / "inventory.yaml").read_text())
    inventory["stack"] = "rover/compose.yaml"
    inventory["groups"]["seen"] = {"robots": ["pi1"], "environment": {"COMPOSE_PROFILES": "viz"}}
    made.write("inventory.yaml", json.dumps(inventory))
    return made


def test_containers_are_those_of_compose(project: Project, pi: Pi) -> None:
    """Compared are all that Docker knows of each, but for names, paths and what fleet and Compose write on their own."""
    said = project.well("ship", "--hosts", pi.name, "--json", within=240)
    assert said.status == {pi.name: "done"}
    shipped = inspected(pi, "rover")
    assert sorted(shipped) == ["driver", "mapper", "setup", "viz", "web"]
    assert (
        asked(pi, f"docker exec {name_of(pi, 'driver')} cat /etc/driver.yaml")
        == FILES["config/driver.yaml"].strip()
    )
    assert (
        asked(pi, f"docker exec {name_of(pi, 'web')} cat /etc/site.conf") == FILES["config/site.conf"].strip()
    )
    web = name_of(pi, "web")
    seen = listing(pi, asked(pi, f"docker inspect --format '/proc/{{{{.State.Pid}}}}/root' {web}"))
    assert "./config/empty/deep d 755 1000" in seen
    assert asked(pi, f"docker exec {web} cat /run/secrets/token") == FILES["config/token"].strip()
    by_hand(project, pi, image=shipped["web"]["Config"]["Image"])
    expected = inspected(pi, "byhand")
    assert listing(pi, "/home/pi/rover") == seen
    asked(
        pi,
        "docker ps -aq --filter label=com.docker.compose.project=byhand | xargs docker rm --force --volumes",
    )
    assert {name: compared(one) for name, one in shipped.items()} == {
        name: compared(one) for name, one in expected.items()
    }
    assert project.well("ship", "--hosts", pi.name, "--json").status == {pi.name: "unchanged"}


def by_hand(project: Project, pi: Pi, *, image: str) -> None:
    """Make the containers with the robot's own Compose, in a copy of the folder, without starting them."""
    archive = subprocess.run(
        ("tar", "-c", "-C", project.directory / "rover", "."), capture_output=True, check=True
    ).stdout
    unpack = (
        "docker",
        "exec",
        "-i",
        "-u",
        "pi",
        pi.container,
        "sh",
        "-c",
        "mkdir -p ~/rover && tar -x -p -C ~/rover",
    )
    subprocess.run(unpack, input=archive, check=True)
    asked(pi, f"docker tag {image} {TINY}")
    up = (
        "cd ~pi/rover && COMPOSE_PROFILES=viz docker compose --project-name byhand up --no-start --pull never"
    )
    done = subprocess.run(
        ("docker", "exec", pi.container, "sh", "-c", up), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def inspected(pi: Pi, stack: str) -> dict[str, Any]:
    """What `docker inspect` says of each service's container."""
    listing = f"docker ps -aq --filter label=com.docker.compose.project={stack} | xargs docker inspect"
    containers = json.loads(asked(pi, listing))
    return {one["Config"]["Labels"]["com.docker.compose.service"]: one for one in containers}


def listing(pi: Pi, folder: str) -> list[str]:
    """Name, kind, mode and owner of what web mounts, in a folder or in a container's own view."""
    return sorted(asked(pi, f"cd {folder} && find ./config ./logs -printf '%p %y %m %U\\n'").splitlines())


def name_of(pi: Pi, service: str) -> str:
    return asked(pi, f"docker ps -q --filter label=com.docker.compose.service={service}")


OWN = ("Hostname", "Image", "Labels", "Env")
PLACES = ("Binds", "Mounts", "NetworkMode", "ContainerIDFile")


def compared(container: dict[str, Any]) -> dict[str, Any]:
    """All but what must differ."""
    config, host = container["Config"], container["HostConfig"]
    labels = {
        key: value
        for key, value in config["Labels"].items()
        if not key.startswith(("com.docker.compose.", "fleet."))
    }
    network = host["NetworkMode"]
    return {
        **{key: value for key, value in config.items() if key not in OWN},
        **{key: value for key, value in host.items() if key not in PLACES},
        "Labels": labels,
        "Env": sorted(config["Env"]),
        "NetworkMode": network if network in ("host", "none") else "a network of the stack",
        "Mounts": sorted((one["Destination"], one["Type"], one["RW"]) for one in container["Mounts"]),
    }


def asked(pi: Pi, script: str) -> str:
    return subprocess.run(
        ("docker", "exec", pi.container, "sh", "-c", script), capture_output=True, text=True, check=True
    ).stdout.strip()
