"""How long does asking many robots take at least? The shortest program that does it with Paramiko.

Trusts everybody, knows no jump hosts, agents or ssh_config, and notices no dead link: what `fab status` is held against.
Reads a JSON file with ``command``, ``user``, ``key`` and ``ports``; prints the answers as JSON.
"""

from __future__ import annotations

import json
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import paramiko


def main() -> None:
    """Ask all, 32 at once."""
    asked = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))

    def ask(port: int) -> str:
        with paramiko.SSHClient() as client:
            client.set_missing_host_key_policy(paramiko.AutoAddPolicy())
            client.connect(
                "127.0.0.1",
                port=port,
                username=asked["user"],
                key_filename=asked["key"],
                allow_agent=False,
                look_for_keys=False,
            )
            return client.exec_command(asked["command"])[1].read().decode()

    with ThreadPoolExecutor(32) as pool:
        sys.stdout.write(json.dumps(list(pool.map(ask, asked["ports"]))))


if __name__ == "__main__":
    main()
