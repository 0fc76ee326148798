from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path

import pytest

from fleet.config.inventory import Robot, Ros
from fleet.config.stack import Stack, read_stack
from fleet.errors import ImageError, InventoryError
from fleet.images.image import Image
from fleet.robot.release import Release, compose, dotenv
from tests.support.samples import PI, STACK, TALKER, release

HERE = Path(__file__).parents[3]


def stack(tmp_path: Path, text: str, *, folder: str = "") -> Stack:
    """The stack of a Compose file with this text."""
    path = tmp_path / folder / "compose.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return read_stack(path)


def changed(**values: object) -> Robot:
    return PI.model_copy(update=values)


def test_the_same_content_is_the_same_release() -> None:
    """Whoever ships it, whenever: the id comes from the content alone."""
    assert release() == release()
    assert len(release().id) == 12


def test_each_ingredient_changes_the_id(tmp_path: Path) -> None:
    """Stack, image, environment, ROS settings, files, their names, the robot: none may change unseen."""
    (tmp_path / "a").write_text("1")
    (tmp_path / "b").write_text("2")
    other_image = Image(reference="talker", platform="linux/arm64", size=1, identity="another")
    ids = [
        release().id,
        release(stack=Stack(name="talker", text=STACK.text + "\n", images=STACK.images, builds={})).id,
        release(stack=Stack(name="other", text=STACK.text, images=STACK.images, builds={})).id,
        release(image=other_image).id,
        release(robot=changed(environment={"TALKER_RATE": "1"})).id,
        release(robot=changed(environment={"TALKER_RATE": "2"})).id,
        release(robot=changed(ros=Ros(hostname="pi1"))).id,
        release(robot=changed(name="pi2")).id,
        release(robot=changed(files={"x.yaml": tmp_path / "a"})).id,
        release(robot=changed(files={"x.yaml": tmp_path / "b"})).id,
        release(robot=changed(files={"y.yaml": tmp_path / "a"})).id,
    ]
    assert len(set(ids)) == len(ids)


def test_where_things_are_on_the_desktop_does_not_change_the_id(tmp_path: Path) -> None:
    """The image's local name, the file's folder, the order of variables, how the robot is reached."""
    (tmp_path / "a").write_text("1")
    (tmp_path / "b").write_text("1")
    one = changed(files={"x": tmp_path / "a"}, environment={"A": "1", "B": "2"}, ros=Ros(hostname="pi1"))
    two = changed(
        files={"x": tmp_path / "b"},
        environment={"B": "2", "A": "1"},
        ros=Ros(hostname="pi1"),
        address="192.168.1.21",
        user="tim",
        port=2222,
    )
    renamed = Image(reference="talker", platform=TALKER.platform, size=2, identity=TALKER.identity)
    assert release(robot=one).id == release(robot=two, image=renamed).id


def test_what_a_release_holds(tmp_path: Path) -> None:
    """The person's file as it is, the pins, the robot's variables in order, and its own files."""
    (tmp_path / "camera").write_bytes(b"\x00\xff")
    robot = changed(
        environment={"TALKER_RATE": "2", "GREETING": "hello you"}, files={"camera.yaml": tmp_path / "camera"}
    )
    made = release(robot=robot)
    assert (made.stack, made.robot, made.services, made.images) == ("talker", "pi1", ("talker",), (TALKER,))
    assert sorted(made.files) == [".env", "compose.override.yaml", "compose.yaml", "files/camera.yaml"]
    assert made.files["compose.yaml"].decode() == STACK.text
    assert made.files["files/camera.yaml"] == b"\x00\xff"
    assert made.files[".env"].decode() == (
        "FLEET_ROBOT=pi1\n"
        "GREETING='hello you'\n"
        "ROS_HOSTNAME=pi1.local\n"
        "ROS_MASTER_URI=http://localhost:11311\n"
        "TALKER_RATE=2\n"
    )
    assert json.loads(made.files["compose.override.yaml"]) == {
        "name": "talker",
        "services": {
            "talker": {
                "image": TALKER.shipped_as,
                "platform": "linux/arm64",
                "labels": {"fleet.release": made.id, "fleet.stack": "talker", "fleet.robot": "pi1"},
            }
        },
    }


def test_two_services_two_images() -> None:
    """Each service is pinned to its own image; one that two services share is sent once."""
    found = {
        name: Image(reference=name, platform="linux/arm64", size=1, identity=name) for name in ("a", "b")
    }
    asked: list[tuple[str, str]] = []

    def find(name: str, platform: str) -> Image:
        asked.append((name, platform))
        return found[name]

    three = Stack(name="s", text="", images={"one": "a", "two": "b", "three": "a"}, builds={})
    made = compose(robot=changed(platform="linux/arm/v7"), stack=three, find=find)
    assert set(asked) == {("a", "linux/arm/v7"), ("b", "linux/arm/v7")}
    assert made.services == ("one", "two", "three")
    assert made.images == (found["a"], found["b"])
    pins = json.loads(made.files["compose.override.yaml"])["services"]
    assert {name: pin["image"] for name, pin in pins.items()} == {
        "one": found["a"].shipped_as,
        "two": found["b"].shipped_as,
        "three": found["a"].shipped_as,
    }


def test_a_missing_image_is_the_stores_to_tell() -> None:
    """Composing a release adds nothing to what the store says."""

    def find(name: str, platform: str) -> Image:
        raise ImageError(f"there is no image {name} for {platform} here")

    with pytest.raises(ImageError, match="there is no image talker for linux/arm64 here"):
        compose(robot=PI, stack=STACK, find=find)


def test_a_file_that_is_gone_is_named_with_the_key_it_came_from(tmp_path: Path) -> None:
    """The inventory was read a moment ago; its files may go meanwhile, or not be readable."""
    with pytest.raises(InventoryError) as caught:
        release(robot=changed(files={"x": tmp_path / "none"}))
    assert caught.value.what == f"cannot read {tmp_path / 'none'}: No such file or directory"
    assert caught.value.cure == "see `files:` in the inventory"


def test_the_archive_is_the_same_bytes_every_time() -> None:
    """No clock, no owner and no order of a dictionary in it."""
    one = release()
    backwards = Release(
        id=one.id,
        stack=one.stack,
        robot=one.robot,
        services=one.services,
        images=one.images,
        files=dict(reversed(list(one.files.items()))),
    )
    assert one.archive() == backwards.archive()
    with tarfile.open(fileobj=io.BytesIO(one.archive())) as archive:
        said = [(m.name, m.mode, m.mtime, m.uid, m.uname, m.isdir()) for m in archive]
    assert said == [
        ("files", 0o755, 0, 0, "", True),
        (".env", 0o600, 0, 0, "", False),
        ("compose.override.yaml", 0o644, 0, 0, "", False),
        ("compose.yaml", 0o644, 0, 0, "", False),
    ]


@pytest.mark.parametrize(
    ("value", "written"),
    [
        ("", ""),
        ("2", "2"),
        ("http://pi1:11311", "http://pi1:11311"),
        ("/dev/ttyUSB0", "/dev/ttyUSB0"),
        ("a b", "'a b'"),
        ("#hash", "'#hash'"),
        ("$(reboot) `x` ${HOME}", "'$(reboot) `x` ${HOME}'"),
        ('say "hi"', "'say \"hi\"'"),
        ("it's", '"it\'s"'),
        ("it's $5", '"it\'s \\$5"'),
        ("two\nlines", '"two\\nlines"'),
        ("end\\", '"end\\\\"'),
        ("a\\b", "'a\\b'"),
        ('it\'s a\\b "c"', '"it\'s a\\\\b \\"c\\""'),
        ("Grüße ☃", "'Grüße ☃'"),
    ],
)
def test_values_are_written_as_compose_reads_them_back(value: str, written: str) -> None:
    """One line per variable, plain where that is safe, else quoted by the rules of Compose's ``.env``."""
    assert dotenv({"A": value, "B": "next"}) == f"A={written}\nB=next\n"
