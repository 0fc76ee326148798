from pathlib import Path

import pytest

from fleet.images.emulation import desktop_platform, emulates, runs

HANDLER = "enabled\ninterpreter /usr/libexec/qemu-binfmt/aarch64-binfmt-P\nflags: {flags}\noffset 0\n"


@pytest.mark.parametrize(
    ("flags", "works"), [("PF", True), ("F", True), ("OCF", True), ("P", False), ("", False)]
)
def test_only_a_handler_that_works_inside_containers_counts(tmp_path: Path, flags: str, works: bool) -> None:
    """Without flag F the emulator is looked up in the container, where it is not."""
    (tmp_path / "qemu-aarch64").write_text(HANDLER.format(flags=flags))
    assert emulates("linux/arm64", binfmt=tmp_path) is works


def test_a_disabled_handler_does_not_count(tmp_path: Path) -> None:
    """`update-binfmts --disable` leaves the file there."""
    (tmp_path / "qemu-aarch64").write_text(HANDLER.format(flags="F").replace("enabled", "disabled"))
    assert not emulates("linux/arm64", binfmt=tmp_path)


def test_no_handler_means_no_emulation(tmp_path: Path) -> None:
    """binfmt_misc may not be mounted at all."""
    assert not emulates("linux/arm64", binfmt=tmp_path / "not-mounted")


def test_a_platform_nobody_knows_is_not_emulated(tmp_path: Path) -> None:
    """A typing error is an answer, not an exception."""
    assert not emulates("linux/pdp11", binfmt=tmp_path)


def test_this_desktop_runs_its_own_platform() -> None:
    """Whatever it is, it needs no emulation."""
    assert desktop_platform().startswith("linux/")
    assert runs(desktop_platform())
