"""Text without anything that a terminal would obey: one place says which characters those are.

A topic, a status line or a file of others may hold them: escape sequences that move the cursor, clear the
screen, name the window or answer in the user's place, and marks that make text run backwards.
"""

import re

_RANGES = (
    (0x00, 0x1F),  # C0 controls, ESC among them
    (0x7F, 0x9F),  # DEL and C1 controls, CSI and OSC among them
    (0x061C, 0x061C),  # marks of direction, as all up to 2069
    (0x200E, 0x200F),
    (0x2028, 0x2029),  # separators of lines and paragraphs
    (0x202A, 0x202E),
    (0x2066, 0x2069),
    (0xD800, 0xDFFF),  # halves of surrogate pairs, which cannot be written in UTF-8
)
_CODES = [code for first, last in _RANGES for code in range(first, last + 1)]
_ONE_LINE = {code: f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" for code in _CODES}
_LINES = {code: shown for code, shown in _ONE_LINE.items() if code not in (ord("\t"), ord("\n"))}
_NOTHING = dict.fromkeys(_ONE_LINE)
_JSON = re.compile(f"[{''.join(map(chr, _LINES))}]")


def visible(text: str) -> str:
    """Return a text with its control characters, but for tabs and ends of lines, made visible."""
    return text if text.isprintable() else text.translate(_LINES)


def one_line(text: str) -> str:
    """Return a text with all its control characters made visible, tabs and ends of lines among them."""
    return text if text.isprintable() else text.translate(_ONE_LINE)


def visible_json(text: str) -> str:
    """Return a JSON text that means the same, its control characters as JSON's escapes."""
    return text if text.isprintable() else _JSON.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def is_visible(text: str) -> bool:
    """Whether a text has no control characters, not even tabs and ends of lines."""
    return text.isprintable() or text.translate(_ONE_LINE) == text


def without_controls(text: str) -> str:
    """Return a text without its control characters."""
    return text if text.isprintable() else text.translate(_NOTHING)
