from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.config.selection import choose, did_you_mean, is_wildcard, matching
from fleet.errors import SelectionError

ROBOTS = ("pi1", "pi2", "pi10", "nano", "lab.1")
GROUPS = {"lidar": ("pi2", "nano"), "empty": (), "all": ROBOTS}


@pytest.mark.parametrize(
    ("hosts", "names"),
    [
        ("all", ROBOTS),
        ("pi1", ("pi1",)),
        ("lidar", ("pi2", "nano")),
        ("nano,pi1", ("pi1", "nano")),
        (" nano , pi1 ,", ("pi1", "nano")),
        ("pi1,pi1,lidar,nano", ("pi1", "pi2", "nano")),
        ("*", ROBOTS),
        ("pi*", ("pi1", "pi2", "pi10")),
        ("pi?", ("pi1", "pi2")),
        ("pi[2-9]", ("pi2",)),
        ("[!p]*", ("nano", "lab.1")),
        ("*1,lidar", ("pi1", "pi2", "nano", "lab.1")),
        ("lab.?", ("lab.1",)),
    ],
)
def test_choose(hosts: str, names: tuple[str, ...]) -> None:
    """Names, groups and wildcards choose robots in file order, each once."""
    assert choose(hosts, robots=ROBOTS, groups=GROUPS) == names


@pytest.mark.parametrize(
    ("hosts", "sentence"),
    [
        ("", "--hosts is empty; name robots or groups, or say 'all'"),
        (" , ", "--hosts is empty; name robots or groups, or say 'all'"),
        ("pi11", "--hosts pi11: no such robot or group; did you mean 'pi1'?"),
        ("PI1", "--hosts PI1: no such robot or group; did you mean 'pi1'?"),
        ("lidr", "--hosts lidr: no such robot or group; did you mean 'lidar'?"),
        (
            "xyzzy",
            "--hosts xyzzy: no such robot or group; there are: pi1, pi2, pi10, nano, lab.1, lidar, empty, all",
        ),
        (
            "pi1,nan0,lida",
            (
                "--hosts nan0: no such robot or group; --hosts lida: no such robot or group; "
                "did you mean 'nano'? did you mean 'lidar'?"
            ),
        ),
        (
            "empty",
            "--hosts empty: the group has no robots; there are: pi1, pi2, pi10, nano, lab.1, lidar, empty, all",
        ),
        ("lid*", "--hosts lid*: matches no robot; did you mean 'lidar'?"),
        ("lab[1", "--hosts lab[1: matches no robot; did you mean 'lab.1'?"),
        (
            "user@pi1",
            "--hosts user@pi1: no such robot or group; there are: pi1, pi2, pi10, nano, lab.1, lidar, empty, all",
        ),
    ],
)
def test_choose_nobody(hosts: str, sentence: str) -> None:
    """What means nobody is refused, all of it at once, with the nearest name or the names there are."""
    with pytest.raises(SelectionError) as raised:
        choose(hosts, robots=ROBOTS, groups=GROUPS)
    assert str(raised.value) == sentence


def test_many_names_are_cut() -> None:
    """A fleet of 200 is not listed to the end."""
    with pytest.raises(SelectionError, match=r"there are: r000, .*, r011 and 189 more$"):
        choose("zz", robots=[f"r{n:03}" for n in range(200)], groups={"all": ()})


def test_wildcards_mean_robots_only() -> None:
    """A wildcard does not reach into groups of a matching name."""
    assert matching("li*", ROBOTS) == ()
    assert [is_wildcard(name) for name in ("pi*", "p?", "[p]i", "pi1", "p-i.1")] == [
        True,
        True,
        True,
        False,
        False,
    ]


def test_did_you_mean_nothing() -> None:
    """What is near nothing gets no suggestion."""
    assert did_you_mean("camera", ("user", "port")) == ""


@given(st.text())
def test_any_hosts(hosts: str) -> None:
    """Whatever is typed is robots in file order, or a SelectionError."""
    try:
        chosen = choose(hosts, robots=ROBOTS, groups=GROUPS)
    except SelectionError:
        return
    assert chosen
    assert chosen == tuple(name for name in ROBOTS if name in chosen)


@given(st.lists(st.sampled_from([*ROBOTS, "lidar", "pi*"]), min_size=1))
def test_order_does_not_count(items: list[str]) -> None:
    """The same items in another order choose the same robots."""
    chosen = [choose(",".join(order), robots=ROBOTS, groups=GROUPS) for order in (items, items[::-1])]
    assert chosen[0] == chosen[1]
