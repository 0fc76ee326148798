from __future__ import annotations

from fleet.transfer import rebuild_command

HEX = "a" * 64


def test_the_command_names_a_layer_of_a_classic_store() -> None:
    """Isolated, so that nothing of the robot's own Python gets in; the wanted layer comes last."""
    old = rebuild_command.from_chain(f"sha256:{HEX}", root="/data")
    argv = rebuild_command.argv("p.py", old, wanted="sha256:new", patch="p", scratch="/tmp", check=True)
    started, asked = argv[:4], argv[4:]
    assert started == ("python3", "-IS", "p.py", "--root")
    assert asked[:3] == ("/data", "--chain", f"sha256:{HEX}")
    assert asked[3:] == ("--patch", "p", "--scratch", "/tmp", "--check", "sha256:new")


def test_a_blob_may_be_in_two_places() -> None:
    """dockerd's own containerd, and the system's; without a patch it is copied."""
    places = ("/data/containerd/daemon", "/var/lib/containerd")
    paths = [f"{place}/io.containerd.content.v1.content/blobs/sha256/{HEX}" for place in places]
    old = ("--file", paths[0], "--file", paths[1])
    assert rebuild_command.from_blob(f"sha256:{HEX}", root="/data") == old
    assert rebuild_command.argv("p.py", old, wanted="w")[2:] == ("p.py", *old, "--scratch", ".", "w")
