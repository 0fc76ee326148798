from __future__ import annotations

import re
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet import terminal

RED = "\x1b[31mred\x1b[0m"


@pytest.mark.parametrize(
    ("said", "plain"),
    [
        ("hello you\tand\nme", "hello you\tand\nme"),
        ("Grüße ☃ 你好", "Grüße ☃ 你好"),
        (RED, "red"),
        ("\x1b[2J\x1b[1;1Hcleared", "cleared"),
        ("\x9b2Jcleared", "cleared"),
        ("\x1b]0;title\x07after", "after"),
        ("\x1b]0;title\x1b\\after", "after"),
        ("\x9d0;title\x9cafter", "after"),
        ("\x1b]52;c;cm0gLXJm\x07clipboard", "clipboard"),
        ("\x1bP+q\x1b\\device", "device"),
        ("\x1bcreset", "reset"),
        ("\x1b(0line drawing", "line drawing"),
        ("10%\r20%\b\x00\x07\x0e\x7f", "10%20%"),
        ("\u202egnp.exe", "gnp.exe"),
        ("\u200f\u061c\u2067right to left", "right to left"),
        ("two\u2028lines", "twolines"),
        ("half \ud83d of a letter", "half  of a letter"),
        ("cut\x1b", "cut"),
        ("cut\x1b[", "cut"),
    ],
)
def test_what_is_left_of_control_sequences(said: str, plain: str) -> None:
    """Sequences go whole where they are whole; what is left cannot do anything."""
    assert terminal.plain(said) == plain


@pytest.mark.parametrize(
    ("said", "left"),
    [
        (f"a {RED} line", f"a {RED} line"),
        ("\x1b[1;38;5;208morange", "\x1b[1;38;5;208morange"),
        ("\x1b[?25l\x1b[31mx\x1b[2K", "\x1b[31mx"),
        ("\x1b]8;;http://x\x07link\x1b]8;;\x07", "link"),
    ],
)
def test_colours_may_stay(said: str, left: str) -> None:
    """A program's warnings are yellow for a reason."""
    assert terminal.coloured(said) == left


@given(st.text(alphabet=st.sampled_from("\x1b\x9b\x9d[]();?0123mHJcPX\\\x07\x9c\n\t\rab ")))
def test_nothing_but_colours_survives(said: str) -> None:
    """Whatever is cut out, what is left of it does not join to a new sequence."""
    control = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
    assert not control.search(terminal.plain(said))
    assert not control.search(re.sub(r"\x1b\[[0-9;]*m", "", terminal.coloured(said)))


@given(st.text(st.characters(exclude_categories=())))
def test_no_control_and_no_change_of_direction_survives(said: str) -> None:
    """Whatever Unicode counts as such, but tab and line end; and what is left can be written."""
    for text in (terminal.plain(said), re.sub(r"\x1b\[[0-9;]*m", "", terminal.coloured(said))):
        text.encode()
        assert not [letter for letter in text if is_unsafe(letter)]


def is_unsafe(letter: str) -> bool:
    """Whether Unicode's tables call it a control character, or one that changes the direction of text."""
    if letter in "\t\n":
        return False
    explicit = unicodedata.bidirectional(letter) in {
        "LRE",
        "RLE",
        "LRO",
        "RLO",
        "PDF",
        "LRI",
        "RLI",
        "FSI",
        "PDI",
    }
    return (
        unicodedata.category(letter) in {"Cc", "Cs", "Zl", "Zp"} or explicit or letter in "\u061c\u200e\u200f"
    )


def test_all_of_unicode() -> None:
    """Each letter alone."""
    assert not [
        code
        for code in range(0x110000)
        if is_unsafe(chr(code)) != (terminal.plain(chr(code)) == "") and not 0x206A <= code <= 0x206F
    ]
