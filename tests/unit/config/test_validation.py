from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.inventory_files import problems


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """People run `fab` where the inventory is; messages name files from there."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        ("robts: {}", "robts: no such key; did you mean 'robots'?"),
        ("xyz: {}", "xyz: no such key; there are: stack, known_hosts, include, defaults, groups, robots"),
        ("robots: {pi3: {platfrom: x}}", "robots.pi3.platfrom: no such key; did you mean 'platform'?"),
        ("robots: {pi3: {ros: {mster: own}}}", "robots.pi3.ros.mster: no such key; did you mean 'master'?"),
        ("robots: {ros: {prot: 1}}", "robots.ros.prot: no such key; did you mean 'port'?"),
        ("defaults: {docker: {sha: x}}", "defaults.docker.sha: no such key; did you mean 'sha256'?"),
        ("groups: {g: {robot: [x]}}", "groups.g.robot: no such key; did you mean 'robots'?"),
        (
            "defaults: {addres: x}",
            "defaults.addres: no such key; there are: user, port, identity_file, platform, ros, docker, hardware, boot, environment, pass_environment, stack, files, card, transport, registry",
        ),
        ("robots: [pi1]", "robots: must hold `key: value` lines"),
        ("robots: {pi1: [x]}", "robots.pi1: must hold `key: value` lines"),
        ("groups: {g: x}", "groups.g: must hold `key: value` lines"),
        ("include: x", "include: must be a list"),
        ("stack:", "stack: must hold `key: value` lines"),
        ("stack: ' '", "stack: must not be empty"),
        ("robots: {pi1: {port: 0}}", "robots.pi1.port: must be a whole number from 1 to 65535, not 0"),
        (
            "robots: {pi1: {port: 65536}}",
            "robots.pi1.port: must be a whole number from 1 to 65535, not 65536",
        ),
        (
            "robots: {pi1: {port: '22'}}",
            "robots.pi1.port: must be a whole number from 1 to 65535: write 22 without quotes",
        ),
        ("robots: {pi1: {port: 2.5}}", "robots.pi1.port: must be a whole number from 1 to 65535, not 2.5"),
        ("robots: {pi1: {port: yes}}", "robots.pi1.port: must be a whole number from 1 to 65535, not true"),
        ("robots: {port: [1]}", "robots.port: must hold `key: value` lines"),
        ("robots: {pi1: {user: 1000}}", "robots.pi1.user: must be text, not 1000; put it in quotes"),
        ("robots: {pi1: {user: [a]}}", "robots.pi1.user: must be text, not a list"),
        ("robots: {pi1: {user: {}}}", "robots.pi1.user: must be text, not a mapping"),
        ("robots: {pi1: {user: a b}}", "robots.pi1.user: must be a login name, without '@', ':' or spaces"),
        (
            "robots: {pi1: {address: %s}}" % ("9" * 60),
            "robots.pi1.address: must be text, not " + "9" * 37 + "...; put it in quotes",
        ),
        *(
            (
                f"robots: {{pi1: {{address: '{address}'}}}}",
                (
                    "robots.pi1.address: must be a host name or an IP address alone; the login goes under `user`, "
                    "the port under `port`"
                ),
            )
            for address in ("", "-oProxyCommand=x", "a b", "pi@pi1", "pi1:22", "http://pi1", "[::1]", "a,b")
        ),
        (
            "robots: {pi1: pi@pi1}",
            "robots.pi1.address: must be a host name or an IP address alone; the login goes under `user`, the port under `port`",
        ),
        (
            "robots: {a/b: }",
            "robots['a/b']: is not a name: use letters, digits, '_', '.' and '-', a letter or digit first",
        ),
        (
            "robots: {pi*: }",
            "robots['pi*']: is not a name: use letters, digits, '_', '.' and '-', a letter or digit first",
        ),
        (
            "robots: {'a,b': }",
            "robots['a,b']: is not a name: use letters, digits, '_', '.' and '-', a letter or digit first",
        ),
        (
            "groups: {-g: []}",
            "groups.-g: is not a name: use letters, digits, '_', '.' and '-', a letter or digit first",
        ),
        (
            "groups: {all: []}",
            "groups.all: 'all' always means every robot; values for every robot go under `defaults`",
        ),
        (
            "robots: {all: }",
            "robots.all: 'all' always means every robot; values for every robot go under `defaults`",
        ),
        ("robots: {pi1: }\ngroups: {g: [p1]}", "groups.g[0]: no such robot: p1; did you mean 'pi1'?"),
        (
            "robots: {pi1: }\ngroups: {g: {robots: [pi1, all]}}",
            "groups.g.robots[1]: no such robot: all; a group holds robots, not groups",
        ),
        ("groups: {g: [zz]}", "groups.g[0]: no such robot: zz"),
        ("groups: {g: ['a b']}", "groups.g[0]: must be a robot's name or a wildcard such as 'pi*'"),
        ("groups: {g: [1]}", "groups.g[0]: must be text, not 1; put it in quotes"),
        (
            "robots: {a: }\ngroups: {a: []}",
            "groups.a: a robot has this name (inventory.yaml:1); rename one of them",
        ),
        (
            "defaults: {platform: aarch64}",
            "defaults.platform: must be one of linux/arm64, linux/arm/v7, linux/amd64; did you mean 'linux/arm64'?",
        ),
        (
            "defaults: {platform: linux/arm7}",
            "defaults.platform: must be one of linux/arm64, linux/arm/v7, linux/amd64; did you mean 'linux/arm/v7'?",
        ),
        (
            "defaults: {platform: 5}",
            "defaults.platform: must be one of linux/arm64, linux/arm/v7, linux/amd64",
        ),
        ("defaults: {ros: {ip: 10.0.0.300}}", "defaults.ros.ip: must be an IP address such as 192.168.1.21"),
        ("defaults: {ros: {ip: pi1}}", "defaults.ros.ip: must be an IP address such as 192.168.1.21"),
        (
            "defaults: {ros: {hostname: a_b., ip: 10.0.0.1}}",
            "defaults.ros.hostname: must be a host name such as pi1.local; an IP address without a name goes under `ip`",
        ),
        (
            "defaults: {ros: {hostname: a, ip: 10.0.0.1}}",
            "defaults.ros: hostname and ip exclude each other; remove one of them",
        ),
        (
            "defaults: {ros: {namespace: 1a}}",
            "defaults.ros.namespace: must be a ROS name such as 'pi1' or '/site/pi1': letters, digits and '_'",
        ),
        *(
            (
                f"defaults: {{ros: {{master: '{master}'}}}}",
                "defaults.ros.master: must be 'own' or a URI such as http://desktop.local:11311",
            )
            for master in ("mine", "http://desktop", "http://desktop:99999", "https://a:1", "http://a b:1")
        ),
        ("defaults: {ros: {version: 3}}", "defaults.ros.version: must be 1 or 2, not 3"),
        ("defaults: {ros: {version: '2'}}", "defaults.ros.version: must be 1 or 2: write 2 without quotes"),
        (
            "defaults: {ros: {version: 2, domain: 300}}",
            "defaults.ros.domain: must be a whole number from 0 to 101, or from 215 to 232, not 300",
        ),
        (
            "defaults: {ros: {version: 2, domain: 102}}",
            (
                "defaults.ros.domain: must be a whole number from 0 to 101, or from 215 to 232, not 102: Linux gives the "
                "ports of the domains between to other programs"
            ),
        ),
        (
            "defaults: {ros: {version: 2, domain: seven}}",
            "defaults.ros.domain: must be a whole number from 0 to 101, or from 215 to 232, not seven",
        ),
        (
            "defaults: {ros: {version: 2, rmw: rmw_cyclone_cpp}}",
            (
                "defaults.ros.rmw: must be one of rmw_fastrtps_cpp, rmw_fastrtps_dynamic_cpp, rmw_cyclonedds_cpp, "
                "rmw_connextdds, rmw_gurumdds_cpp, rmw_zenoh_cpp; did you mean 'rmw_cyclonedds_cpp'?"
            ),
        ),
        (
            "defaults: {ros: {version: 2, discovery: lan}}",
            "defaults.ros.discovery: must be one of subnet, localhost, off, system_default",
        ),
        (
            "defaults: {ros: {version: 2, discovery: off}}",
            "defaults.ros.discovery: must be text, not false; put it in quotes",
        ),
        (
            "defaults: {ros: {version: 2, peers: [flet]}}\ngroups: {fleet: []}",
            "defaults.ros.peers[0]: no such robot or group: flet; did you mean 'fleet'?",
        ),
        (
            "robots: {pi1: {ros: {version: 2, peers: [pi1, 'nano*']}}}",
            "robots.pi1.ros.peers[1]: no robot matches nano*; name robots and groups of the inventory",
        ),
        (
            "defaults: {ros: {version: 2, master: own}}",
            "defaults.ros: master is a key of ROS 1, and there is `version: 2`; say `version: 1`, or remove master",
        ),
        (
            "groups: {g: {ros: {version: 1, peers: [all]}}}",
            "groups.g.ros: peers is a key of ROS 2, and there is `version: 1`; say `version: 2`, or remove peers",
        ),
        (
            "robots: {pi1: {ros: {domain: 7}}}",
            "robots.pi1.ros: domain is a key of ROS 2, and there is no `version:`, which means ROS 1; say `version: 2`, or remove domain",
        ),
        (
            "defaults: {ros: {rmw: rmw_zenoh_cpp}}\nrobots: {pi1: , pi2: , pi3: {ros: {version: 2}}}",
            "robots.pi1.ros: rmw is a key of ROS 2, and there is no `version:`, which means ROS 1; say `version: 2`, or remove rmw (more robots with the same problem: 1)",
        ),
        (
            "groups: {g: {robots: [pi1], ros: {version: 2}}}\nrobots: {pi1: {ros: {ip: 10.0.0.1}}}",
            "robots.pi1.ros: ip is a key of ROS 1, and there is `version: 2`; say `version: 1`, or remove ip",
        ),
        (
            "defaults: {environment: {ROS_DOMAIN_ID: 7}}",
            "defaults.environment.ROS_DOMAIN_ID: fleet sets this variable itself; set it as `ros: {version: 2, domain: ...}`",
        ),
        (
            "defaults: {docker: {version: 27.5}}",
            "defaults.docker.version: must be text, not 27.5; put it in quotes",
        ),
        (
            "defaults: {docker: {version: '27.5'}}",
            "defaults.docker.version: must be a full version such as '27.5.1': a shorter one would match several",
        ),
        (
            "defaults: {docker: {sha256: abc}}",
            "defaults.docker.sha256: must be 64 hexadecimal digits, as `sha256sum` prints them",
        ),
        (
            "defaults: {docker: {log_max_size: 10MB}}",
            "defaults.docker.log_max_size: must be a number and k, m or g, such as '10m'",
        ),
        (
            "defaults: {docker: {log_max_file: 0}}",
            "defaults.docker.log_max_file: must be a whole number, 1 or more, not 0",
        ),
        ("defaults: {docker: {script: x.sh}}", "defaults.docker.script: no such file: x.sh"),
        (
            "defaults: {environment: {A: yes}}",
            "defaults.environment.A: YAML reads yes, no, on, off, true and false as a truth value; quote it",
        ),
        ("defaults: {environment: {A: }}", "defaults.environment.A: has no value; write '' for an empty one"),
        ("defaults: {environment: {A: [1]}}", "defaults.environment.A: must be text or a number"),
        (
            "defaults: {environment: {A-B: 1}}",
            "defaults.environment.A-B: is not a name for a variable: use letters, digits and '_', not a digit first",
        ),
        (
            "defaults: {environment: {ROS_MASTER_URI: x}}",
            "defaults.environment.ROS_MASTER_URI: fleet sets this variable itself; set it as `ros: {master: ...}`",
        ),
        (
            "defaults: {environment: {ROS_HOSTNAME: x}}",
            "defaults.environment.ROS_HOSTNAME: fleet sets this variable itself; set it as `ros: {hostname: ...}`; without it the robot's address is used",
        ),
        (
            "defaults: {environment: {ROS_IP: x}}",
            "defaults.environment.ROS_IP: fleet sets this variable itself; set it as `ros: {ip: ...}`",
        ),
        (
            "defaults: {environment: {ROS_NAMESPACE: x}}",
            "defaults.environment.ROS_NAMESPACE: fleet sets this variable itself; set it as `ros: {namespace: ...}`",
        ),
        (
            "defaults: {environment: {COMPOSE_PROJECT_NAME: x}}",
            "defaults.environment.COMPOSE_PROJECT_NAME: fleet sets this variable itself; set it as `name:` in the stack's Compose file",
        ),
        (
            "defaults: {environment: {FLEET_X: x}}",
            "defaults.environment.FLEET_X: names that begin with FLEET_ are fleet's own; choose another",
        ),
        *(
            (
                f"defaults: {{files: {{'{name}': inventory.yaml}}}}",
                (
                    f"defaults.files['{name}']: must be a plain relative path: it stays below files/ on the robot "
                    "(no '/' first or last, no '.' or '..')"
                ),
            )
            for name in ("/a", "../a", "a/../b", "a/..", ".", "./a", "a//b", "a/", "")
        ),
        ("defaults: {files: {a: no/file}}", "defaults.files.a: no such file: no/file"),
        ("defaults: {files: {a: .}}", "defaults.files.a: . is a folder; name its files one by one"),
        ("defaults: {files: {a: %s}}" % ("x" * 300), "defaults.files.a: no such file: " + "x" * 300),
        (
            "robots: {pi1: {files: {a: inventory.yaml, a/b: inventory.yaml}}}",
            "robots.pi1.files: 'a' cannot be a file and also the folder of 'a/b'",
        ),
    ],
)
def test_problem(source: str, sentence: str) -> None:
    """Each mistake is one sentence: file, line, key, what is wrong, the cure."""
    found = [problem.replace(f": {Path.cwd()} is", ": . is") for problem in problems(source)]
    assert [re.sub(r"^inventory\.yaml:\d+: ", "", problem) for problem in found] == [sentence]


def test_all_problems_at_once() -> None:
    """One run lists everything, in the order of lines, whatever kind it is."""
    assert problems("""robots:
  pi1:
    platfrom: linux/arm64
    port: 70000
  pi2: {files: {a: nope}}
  pi1: again
  broken: [1]
groups:
  lidar:
    - pi1
    - pi22
    - broken
defaults:
  environment:
    DEBUG: on
""") == [
        "inventory.yaml:3: robots.pi1.platfrom: no such key; did you mean 'platform'?",
        "inventory.yaml:4: robots.pi1.port: must be a whole number from 1 to 65535, not 70000",
        "inventory.yaml:5: robots.pi2.files.a: no such file: nope",
        "inventory.yaml:6: the key 'pi1' is already on line 2; remove one of them",
        "inventory.yaml:7: robots.broken: must hold `key: value` lines",
        "inventory.yaml:11: groups.lidar[1]: no such robot: pi22; did you mean 'pi2'?",
        (
            "inventory.yaml:15: defaults.environment.DEBUG: YAML reads yes, no, on, off, true and false as a truth "
            "value; quote it"
        ),
    ]
