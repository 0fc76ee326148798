from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.sshd import known_line, make_key, public_key

if TYPE_CHECKING:
    from tests.support.project import Project


def test_trust_records_what_a_person_says_yes_to(own: Project) -> None:
    """Unknown: nobody there is a no, --yes is a yes, and the second time it is known."""
    (own.folder / "known_hosts").unlink()
    refused = own.fleet("trust", "--hosts", "pi1")
    assert (refused.code, (own.folder / "known_hosts").exists()) == (1, False)
    assert "was not recorded: ssh-ed25519 SHA256:" in refused.out
    assert own.fleet("trust", "--hosts", "pi1", "--dry").out.startswith(
        "pi1  planned      would record ssh-ed25519"
    )
    assert own.fleet("run", "--hosts", "pi1", "--", "true").code == 1
    recorded = own.fleet("trust", "--hosts", "pi1", "--yes")
    assert (recorded.code, recorded.out[:24]) == (0, "pi1  done         record")
    assert own.fleet("trust", "--hosts", "pi1").out.startswith("pi1  unchanged    known ssh-ed25519 SHA256:")
    assert own.fleet("run", "--hosts", "pi1", "--", "true").code == 0


def test_a_changed_key_is_refused_by_every_verb_and_replaced_on_demand(own: Project) -> None:
    """--yes alone does not: somebody may be in the middle."""
    server = own.robots["pi1"].server
    other = public_key(make_key(own.folder / "other"))
    server.known_hosts.write_text(known_line(server.known_as, other))
    for words in (("run", "--", "true"), ("start",), ("status",), ("trust", "--yes")):
        done = own.fleet(words[0], "--hosts", "pi1", *words[1:])
        assert done.code == 1
        assert "changed" in (done.out + done.err).lower()
    assert own.fleet("trust", "--hosts", "pi1", "--yes", "--changed").code == 0
    assert own.fleet("run", "--hosts", "pi1", "--", "true").code == 0
