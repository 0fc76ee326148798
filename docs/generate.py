# noqa: INP001  docs/ is a folder of pages, not a package
"""Write the pages of docs/reference/ that come from the code: ``make reference``.

`pages` makes them in memory; a test compares that with the files. ``json.md`` beside them is written by hand.
"""

from __future__ import annotations

import ast
import contextlib
import inspect
import io
import json
import os
import sys
import textwrap
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest import mock

from fleet import cli, errors
from fleet.config.inventory import json_schema
from fleet.onboard import exit_codes
from fleet.provision import daemon_json, steps
from fleet.robot import paths
from fleet.robot.hardware import UDEV_RULES

FOLDER = Path(__file__).parent / "reference"

NOTE = "<!-- Written by `make reference`; do not edit. -->\n"

WIDTH = "100"
"""Columns of the help pages; without it they would be as wide as the terminal of whoever writes them."""

_FLAGS = {name: dict(cli.ns[name].help) for name in cli.ns.task_names}
"""The texts of each verb's flags. Invoke 2 removes them from a task when it reads its arguments, so once per process."""


def pages() -> dict[str, str]:
    """Return each generated page by its file name."""
    made = {
        "verbs.md": _verbs(),
        "inventory.md": _inventory(),
        "exit-codes.md": _exit_codes(),
        "files-on-a-robot.md": _files_on_a_robot(),
    }
    return {name: NOTE + text for name, text in made.items()}


def main() -> None:
    """Write the pages."""
    FOLDER.mkdir(exist_ok=True)
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")


def _verbs() -> str:
    """Return the help page of each verb, as the terminal shows it."""
    names = sorted(cli.ns.task_names, key=lambda name: ("." in name, name))
    index = "\n".join(f"- [`fab {name}`](#fab-{_anchor(name)}): {_summary(name)}" for name in names)
    intro = """\
# The verbs

The text that `fab VERB --help` prints. `fab` finds the verbs through `fabfile.py`. The command `fleet` has the same verbs
and needs no `fabfile.py` ([use fleet without this repository](../how-to/without-the-repository.md)).
"""
    sections = "\n".join(f"## fab {name}\n\n```text\n{_help(name)}\n```\n" for name in names)
    return f"{intro}\n{index}\n\n{sections}"


def _anchor(heading: str) -> str:
    """Return the name that GitHub gives to a heading, for links within a page."""
    return heading.lower().replace(" ", "-").replace(".", "")


def _summary(name: str) -> str:
    """Return the first line of a verb's help."""
    return (inspect.getdoc(cli.ns[name].body) or "").partition("\n")[0]


def _help(name: str) -> str:
    """Return what ``fleet VERB --help`` prints."""
    output = io.StringIO()
    for verb, texts in _FLAGS.items():
        cli.ns[verb].help = dict(texts)
    with (
        mock.patch.object(sys, "argv", ["fleet", name, "--help"]),
        mock.patch.dict(os.environ, {"COLUMNS": WIDTH, "NO_COLOR": "1"}),
        contextlib.redirect_stdout(output),
        contextlib.suppress(SystemExit),
    ):
        cli.main()
    return "\n".join(line.rstrip() for line in output.getvalue().strip().splitlines())


def _inventory() -> str:
    """Return every key of an inventory, from its JSON Schema."""
    schema = json_schema()
    kinds: dict[str, dict[str, Any]] = schema["$defs"]
    shared = kinds["Values"]["properties"] if "Values" in kinds else {}
    parts = [
        """\
# inventory.yaml

All keys, from [`inventory.schema.json`](../../inventory.schema.json). The commented example is
[`inventory.yaml`](../../inventory.yaml). `fab inventory` shows the values that each robot ends up with.

Paths are relative to the inventory file. A robot gets the values of `defaults`, then those of its groups in the order of
the file, then its own. Later values win; `ros`, `docker`, `card`, `environment` and `files` are merged key by key,
`hardware` adds up, `stack` and `pass_environment` are replaced as a whole.
""",
        "## The file\n\n" + _table(schema["properties"], required=schema.get("required", [])),
    ]
    for name, kind in sorted(kinds.items(), key=lambda pair: (pair[0] != "Values", pair[0])):
        keys = kind.get("properties", {})
        inherits = name != "Values" and bool(shared) and shared.keys() <= keys.keys()
        own = {key: value for key, value in keys.items() if not (inherits and key in shared)}
        also = "\n\nAnd each key of [Values](#values)." if inherits else ""
        description = kind.get("description", "").replace("``", "`")
        table = _table(own, required=kind.get("required", []))
        parts.append(f"## {_title(name)}\n\n{description}{also}\n\n{table}")
    return "\n".join(parts)


def _title(kind: str) -> str:
    """Return the heading of a part of the schema: ``Group`` for ``GroupValues``."""
    return kind.removesuffix("Values") or kind


def _table(keys: dict[str, dict[str, Any]], *, required: list[str]) -> str:
    rows = [
        f"| `{name}` | {_type(value)} | {_default(value, needed=name in required)} | {_cell(value.get('description', ''))} |"
        for name, value in keys.items()
    ]
    return "\n".join(("| key | value | default | meaning |", "| --- | --- | --- | --- |", *rows, ""))


def _cell(text: str) -> str:
    return text.replace("``", "`").replace("|", "\\|")


def _default(value: dict[str, Any], *, needed: bool) -> str:
    if needed:
        return "required"
    default = value.get("default")
    if default in (None, ""):
        return ""
    return f"`{default if isinstance(default, str) else json.dumps(default)}`"


def _type(value: dict[str, Any]) -> str:  # noqa: PLR0911  one line for each form of a schema
    """Return what a value may be, in words."""
    if reference := value.get("$ref"):
        name = _title(reference.rpartition("/")[2])
        return f"[{name}](#{name.lower()})"
    if choices := value.get("anyOf"):
        kinds = dict.fromkeys(_type(choice) for choice in choices if choice.get("type") != "null")
        # A list's own choices come last, where no other kind can be taken for one of them.
        return " or ".join(sorted(kinds, key=lambda kind: kind.startswith("list of")))
    if "enum" in value:
        return ", ".join(f"`{choice}`" for choice in value["enum"])
    match value.get("type"):
        case "array":
            return f"list of {_type(value.get('items', {}))}"
        case "object":
            inner = value.get("patternProperties") or {"": value.get("additionalProperties") or {}}
            each = dict.fromkeys(_type(item) for item in inner.values() if isinstance(item, dict))
            return f"names, each with {' or '.join(filter(None, each)) or 'a value'}"
        case "integer" if "minimum" in value and "maximum" in value:
            return f"whole number, {value['minimum']} to {value['maximum']}"
        case kind:
            words = {
                "string": "text",
                "integer": "whole number",
                "number": "number",
                "boolean": "true or false",
            }
            return words.get(str(kind), "")


def _exit_codes() -> str:
    """Return the exit codes of `fab`, and those of the programs on a robot."""
    robot = "\n".join(f"| {code} | `{name}` | {text} |" for name, code, text in _constants(exit_codes))
    return f"""\
# Exit codes

## Of `fab`

| code | meaning |
| --- | --- |
| 0 | every robot is in the state that was asked for |
| {errors.FleetError.exit_code} | at least one robot failed or could not be reached, or this computer lacks something |
| {errors.UsageError.exit_code} | the command line, the inventory, the Compose file or an image is wrong, or does not fit a robot; nothing was changed |

"Does not fit" means what a look at the robot shows before anything is sent: a port or a container name that something
else there has, two robots that are one computer, another platform, a release or a stack that is not there. It is 1 if
another robot was changed or has failed in the same run, and if the robot itself is not ready: no Docker, a full disk, a device that is not plugged in.

`fab status` ends with 1 if a robot does not answer or one of its containers is not healthy. `fab run` ends with 1 if the
command fails on a robot.

## Of the programs that fleet runs on a robot

A user sees these only with `--dry`, or after running the command by hand. The names are those of BSD's `sysexits.h`.

| code | name | meaning |
| --- | --- | --- |
{robot}
"""


def _constants(module: object) -> list[tuple[str, int, str]]:
    """Return the numbers of a module with the text below each."""
    source = inspect.getsource(module)  # type: ignore[arg-type]  # any module
    body = ast.parse(source).body
    found = []
    for statement, below in pairwise(body):
        match statement, below:
            case (
                ast.Assign(targets=[ast.Name(id=name)], value=ast.Constant(value=int(code))),
                ast.Expr(value=ast.Constant(value=str(text))),
            ):
                found.append((name, code, " ".join(text.split()).rstrip(".")))
            case _:
                pass
    return found


def _files_on_a_robot() -> str:
    """Return what stands where on a robot, and what remains when it leaves the fleet."""
    lines = (inspect.getdoc(paths) or "").split("::\n", 1)[1].splitlines()
    end = next(number for number, line in enumerate(lines) if line and not line.startswith(" "))
    listing = textwrap.dedent("\n".join(lines[:end])).strip("\n")
    return f"""\
# Files on a robot

## In the home directory of the login

Everything that `fab ship` needs is in `~/{paths.HOME}/`. These are plain files, and they work by hand:

```text
{listing}
```

To start a stack without a desktop, log in to the robot and run `cd ~/{paths.STACKS}/NAME/current && docker compose up -d`.

- `compose.yaml` of a release is what Compose on the desktop made of your files with this robot's values: one file, without
  variables, with the exact images, absolute paths, and labels. It is JSON, which is also YAML. Only the login can read it.
- `project/` holds the files that containers see read-only, `seeds/` those that the robot's data begins with.
- `data/` holds what belongs to the robot ([keep what robots write](../how-to/keep-what-robots-write.md)).
- `data-folders` of a release names the folders that must be in `data/`, `services` the services that must run, each with
  its restart policy.
- `runs/` is cleared of what is older than a week.
- Outside of it there is one file: `/etc/systemd/system/fleet-finish.service`, by `fab provision`. After a power cut in the
  middle of a swap, it goes on with the swap at boot, as the login's user.
- `~/{steps.SCRIPT}` is Docker's convenience script while `fab provision` runs it.

## In Docker

- Images of a release are named `NAME:fleet-` and 12 hexadecimal digits. The digits say what is in the image, so such a
  name never moves to another image. `fab prune` removes images of this form only.
- Containers have the labels `fleet.release`, `fleet.stack` and `fleet.robot`.

## In the system

Only `fab provision` changes the system, as root: Docker and its Compose plugin, `zstd`, the group `docker` with the login
in it, `{daemon_json.PATH}` (size and number of log files, the runtime nvidia), the files of `registry:` in
`/etc/docker/certs.d`, and the clock if it is wrong. For
`hardware:` of the inventory it also changes the login's groups, `{UDEV_RULES}`, and on a
Raspberry Pi `config.txt` and `cmdline.txt` in `/boot/firmware`, and `/etc/modules-load.d/fleet-i2c.conf`. Files that are not
fleet's own are kept as `NAME.before-fleet` before the first change. `/run/fleet-reboot` names what waits for a reboot.

## To remove all of it

`fab remove --stack NAME --data` removes one stack with its data. To remove everything, also **the data of all stacks**, run
this on the robot. It removes all containers and images that fleet brought, and its files:

```sh
docker ps -aq --filter label=fleet.release | xargs -r docker rm -f
docker image ls --format '{{{{.Repository}}}}:{{{{.Tag}}}}' | grep -E ':fleet-[0-9a-f]{{12}}$' | xargs -r docker image rm
rm -rf ~/{paths.HOME}
```
"""


if __name__ == "__main__":
    main()
