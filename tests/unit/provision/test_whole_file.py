from __future__ import annotations

import hashlib

from fleet.plan.step import Bytes
from fleet.provision import whole_file
from tests.support.samples import facts

DIGEST = hashlib.sha256(b"text").hexdigest()


def test_a_file_goes_with_its_digest() -> None:
    """The robot compares: a connection that is lost ends the input early."""
    one = whole_file.step("write it", ".fleet/boot.sh", b"text", label="boot.sh")
    assert (one.argv[:2], one.argv[3:]) == (("sh", "-c"), ("replace_file", ".fleet/boot.sh", DIGEST))
    assert one.feed == Bytes(label="boot.sh", data=b"text")


def test_a_file_of_the_system_is_roots_and_what_was_there_is_kept() -> None:
    one = whole_file.step("write it", "/etc/x", b"text", label="x", root=facts(), keep=True)
    assert one.argv[:3] == ("sudo", "-n", "sh")
    assert one.argv[-3:] == ("/etc/x", DIGEST, "keep")
