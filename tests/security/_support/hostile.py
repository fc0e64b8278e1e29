"""An attacker's texts, and checks whether they reach a terminal."""

import unicodedata

HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202egnp\x08\x7f\r[bold]x\nFORGED laser RUNNING"
"""Names the window, clears the screen, colours by C1, turns around, goes back, is markup, begins a line."""
BIDIRECTIONAL = {"LRO", "RLO", "LRE", "RLE", "PDF", "LRI", "RLI", "FSI", "PDI"}
MARKS = {"\u200e", "\u200f", "\u061c"}


def obeyed(text: str) -> set[str]:
    """Return the characters of a text that a terminal or a reader would be misled by; not ends of lines."""
    return {
        character
        for character in text
        if character not in "\n\t"
        and (
            unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp")
            or unicodedata.bidirectional(character) in BIDIRECTIONAL
            or character in MARKS
        )
    }


def check_plain(text: str, where: object, *, may_have_lines: bool = False) -> None:
    """Fail if a text that a command printed, not to a terminal, holds anything that one would obey."""
    assert not obeyed(text), f"{where} let through {obeyed(text)!r} in {text!r:.2000}"
    if not may_have_lines:
        forged = [line for line in text.splitlines() if line.startswith("FORGED")]
        assert not forged, f"{where} let a name begin a line: {text!r:.2000}"


def check_terminal(text: str, where: object) -> None:
    """Fail if what a command sent to a terminal holds an order of the attacker's; its own are allowed."""
    for order in ("\x1b]0;", "\x9b", "\x1b[2J\x9b", "\u202e", "\x08", "\x7f", "owned\x07"):
        assert order not in text, f"{where} let through {order!r} in {text!r:.2000}"
