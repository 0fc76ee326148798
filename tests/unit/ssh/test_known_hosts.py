from __future__ import annotations

import base64
import subprocess
import threading
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fleet.errors import DesktopError, InventoryError, UntrustedHostKey
from fleet.ssh import known_hosts
from fleet.ssh.known_hosts import HostKey, KnownHosts
from tests.support.sshd import known_line, make_key, public_key

if TYPE_CHECKING:
    from pathlib import Path


def wire(*parts: bytes) -> bytes:
    return b"".join(len(part).to_bytes(4, "big") + part for part in parts)


def key(number: int = 1, kind: str = "ssh-ed25519") -> HostKey:
    return HostKey(kind=kind, blob=wire(kind.encode(), bytes([number]) * 32))


def known(*lines: str) -> KnownHosts:
    return KnownHosts(
        lines=tuple((f"known_hosts:{number}", line) for number, line in enumerate(lines, start=1))
    )


def line(names: str, which: HostKey) -> str:
    return known_line(names, which).rstrip()


def test_the_fingerprint_is_the_one_ssh_keygen_prints(tmp_path: Path) -> None:
    """A person compares our fingerprint with ssh-keygen's on the robot."""
    made = make_key(tmp_path / "key")
    said = subprocess.run(("ssh-keygen", "-lf", made), capture_output=True, text=True, check=True).stdout
    assert said.split()[1] == public_key(made).fingerprint


@pytest.mark.parametrize(
    ("lines", "verdict"),
    [
        ([], "unknown"),
        ([line("other", key())], "unknown"),
        ([line("pi1", key())], "known"),
        ([line("PI1,10.0.0.1", key())], "known"),
        ([line("pi?", key())], "known"),
        ([line("*.local,pi*", key())], "known"),
        ([line("pi*,!pi1", key())], "unknown"),
        ([line("[pi1]:2222", key())], "unknown"),
        ([line("pi1", key(2))], "changed"),
        ([line("pi1", key(2)), line("pi1", key())], "known"),
        ([line("pi1", key()), "@revoked " + line("*", key())], "revoked"),
        (["@revoked " + line("*", key(2)), line("pi1", key())], "known"),
        (["@cert-authority " + line("*", key())], "unknown"),
        (["# " + line("pi1", key()), "#," + line("pi1", key())], "unknown"),
        (["pi1 ssh-ed25519 not+base64", "pi1", "", "|1|x|y ssh-ed25519 AAAA"], "unknown"),
        ([line("pi1", key()) + " a comment"], "known"),
        (["@revoked " + line("pi1", key()) + " a comment"], "revoked"),
    ],
)
def test_verdict(lines: list[str], verdict: str) -> None:
    """Every form of line that OpenSSH reads decides as it does there."""
    assert known(*lines).verdict("pi1", key()) == verdict


def test_algorithms_are_those_of_the_known_keys() -> None:
    """A host is asked for the keys we know, RSA under the names by which it signs."""
    lines = known(
        line("pi1", key(1, "ssh-rsa")), line("*", key(2)), line("pi2", key(1, "ecdsa-sha2-nistp256"))
    )
    assert lines.algorithms("pi1") == ("rsa-sha2-512", "rsa-sha2-256", "ssh-ed25519")


NAMES = st.sampled_from(
    ["pi1", "PI1", "pi2", "pi1.local", "10.0.0.1", "[pi1]:2222", "[10.0.0.1]:2222", "::1", "[::1]:22"]
)
PATTERNS = NAMES | st.sampled_from(
    ["*", "pi?", "pi*", "!pi1", "!pi*", "[pi1]:*", "[*]:2222", "10.0.?.1", "#pi1", "p[i]1"]
)
LINES = st.one_of(
    st.lists(PATTERNS, min_size=1, max_size=3).map(lambda names: line(",".join(names), key())),
    st.lists(PATTERNS, min_size=1, max_size=2).map(lambda names: "@revoked " + line(",".join(names), key())),
    PATTERNS.map(lambda name: "# " + line(name, key())),
    PATTERNS.map(lambda name: "  " + line(name, key()) + "  a comment "),
    st.sampled_from(["", "   ", "pi1", "#", "# pi1"]),
)


@given(lines=st.lists(LINES, max_size=6), name=NAMES, hashed=st.booleans())
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_the_same_lines_speak_of_a_host_as_for_ssh_keygen(
    tmp_path: Path, lines: list[str], name: str, *, hashed: bool
) -> None:
    """``ssh-keygen -F`` is the judge of which lines are about a host (it does not look at their keys)."""
    path = tmp_path / "known_hosts"
    path.write_text("".join(text + "\n" for text in lines), encoding="utf-8")
    if hashed:
        subprocess.run(("ssh-keygen", "-q", "-H", "-f", path), capture_output=True, check=False)
    said = subprocess.run(
        ("ssh-keygen", "-F", name.lower(), "-f", path), capture_output=True, text=True, check=False
    )
    theirs = [
        part.split("line ")[1].split()[0] for part in said.stdout.splitlines() if part.startswith("# Host ")
    ]
    ours = [entry.where.rpartition(":")[2] for entry in known_hosts.read((path,)).entries(name)]
    assert ours == theirs


def test_read_takes_the_files_that_are_there(tmp_path: Path) -> None:
    """Files that do not exist are no error; where a key is written is told."""
    path = tmp_path / "known_hosts"
    path.write_text("\n" + line("pi1", key()) + "\r\n", encoding="utf-8")
    entries = known_hosts.read((tmp_path / "none", path, path / "below")).entries("pi1")
    assert [entry.where for entry in entries] == [f"{path}:2"]


def test_read_names_the_file_it_cannot_read(tmp_path: Path) -> None:
    """A known_hosts that cannot be read is not taken for an empty one."""
    with pytest.raises(InventoryError, match=str(tmp_path)):
        known_hosts.read((tmp_path,))


def test_record_replaces_the_lines_of_exactly_that_name(tmp_path: Path) -> None:
    """Other hosts' lines, lists of names and comments stay as they are."""
    path = tmp_path / "new" / "known_hosts"
    known_hosts.record(path, name="pi1", key=key(1))
    others = ["# a comment", line("pi1,pi2", key(3)), line("pi11", key(4)), line("[pi1]:2222", key(5))]
    path.write_text(
        "\n".join([*others, line("pi1", key(6)), line("pi1", key(7, "ssh-rsa"))]), encoding="utf-8"
    )
    known_hosts.record(path, name="pi1", key=key(2))
    assert path.read_text(encoding="utf-8").splitlines() == [*others, line("pi1", key(2))]
    assert [entry.name for entry in path.parent.iterdir()] == ["known_hosts"]


def test_record_by_many_at_once_loses_nothing(tmp_path: Path) -> None:
    """Two people, or threads, may trust robots at the same time."""
    path = tmp_path / "known_hosts"
    threads = [
        threading.Thread(target=lambda n=n: known_hosts.record(path, name=f"pi{n}", key=key(n)))
        for n in range(30)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(text.split()[0] for text in path.read_text().splitlines()) == sorted(
        f"pi{n}" for n in range(30)
    )


def test_record_says_what_it_cannot_write(tmp_path: Path) -> None:
    """A file in the place of the folder is told, not shown as a traceback."""
    (tmp_path / "file").touch()
    with pytest.raises(DesktopError, match=r"cannot write .*known_hosts"):
        known_hosts.record(tmp_path / "file" / "known_hosts", name="pi1", key=key())


@pytest.mark.parametrize(
    ("lines", "jump", "words"),
    [
        ([], False, ["not known yet", key().fingerprint, "fab trust"]),
        ([], True, ["not known yet", "connect to that jump host once with `ssh`"]),
        (
            [line("x", key(2)), line("pi1", key(2))],
            False,
            ["CHANGED", "known_hosts:2", "fab trust --changed"],
        ),
        ([line("pi1", key(2))], True, ["CHANGED", "ssh-keygen -R 'pi1'"]),
        ([line("pi1", key(1)), "@revoked " + line("pi1", key(1))], False, ["revoked"]),
    ],
)
def test_check_refuses_with_the_reason_and_the_cure(
    lines: list[str], *, jump: bool, words: list[str]
) -> None:
    """Unknown, changed and revoked are told apart."""
    with pytest.raises(UntrustedHostKey) as refused:
        known_hosts.check(key(), name="pi1", known=known(*lines), jump=jump)
    assert [word for word in words if word not in str(refused.value)] == []


def test_check_lets_a_known_key_pass() -> None:
    """The usual case is silent."""
    known_hosts.check(key(), name="pi1", known=known(line("pi1", key())))


def test_host_name_brackets_other_ports_only() -> None:
    """As OpenSSH writes it."""
    assert known_hosts.host_name("pi1", 22) == "pi1"
    assert known_hosts.host_name("::1", 2222) == "[::1]:2222"


def test_hashed_lines_are_read(tmp_path: Path) -> None:
    """Debian's OpenSSH hashes names by default."""
    path = tmp_path / "known_hosts"
    path.write_text(line("[pi1]:2222", key()) + "\n", encoding="utf-8")
    subprocess.run(("ssh-keygen", "-q", "-H", "-f", path), capture_output=True, check=True)
    assert path.read_text().startswith("|1|")
    assert base64.b64encode(key().blob).decode() in path.read_text()
    assert known_hosts.read((path,)).verdict("[pi1]:2222", key()) == "known"
    assert known_hosts.read((path,)).verdict("pi1", key()) == "unknown"
