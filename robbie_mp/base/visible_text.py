"""Removes what a terminal would obey from text; this file alone lists those characters.

Topics, status lines and files from elsewhere may contain them: escape sequences that move the cursor, clear
    the screen, set the window title or answer in your place, and marks that reverse the direction of text.
"""

import re

_RANGES = (
    (0x00, 0x1F),  # C0 controls, including ESC
    (0x7F, 0x9F),  # DEL and C1 controls, including CSI and OSC
    (0x061C, 0x061C),  # direction marks, as are all up to 2069
    (0x200E, 0x200F),
    (0x2028, 0x2029),  # line and paragraph separators
    (0x202A, 0x202E),
    (0x2066, 0x2069),
    (0xD800, 0xDFFF),  # surrogate halves, which cannot be written in UTF-8
)
_CODES = [code for first, last in _RANGES for code in range(first, last + 1)]
_ONE_LINE = {code: f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" for code in _CODES}
_LINES = {code: shown for code, shown in _ONE_LINE.items() if code not in (ord("\t"), ord("\n"))}
_NOTHING = dict.fromkeys(_ONE_LINE)
_JSON = re.compile(f"[{''.join(map(chr, _LINES))}]")


def visible(text: str) -> str:
    """Return a text with its control characters made visible, except tabs and line ends."""
    return text if text.isprintable() else text.translate(_LINES)


def one_line(text: str) -> str:
    """Return a text with all its control characters made visible, including tabs and line ends."""
    return text if text.isprintable() else text.translate(_ONE_LINE)


def visible_json(text: str) -> str:
    """Return a JSON text with the same meaning, its control characters written as JSON escapes."""
    return text if text.isprintable() else _JSON.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def is_visible(text: str) -> bool:
    """Whether a text has no control characters, not even tabs or line ends."""
    return text.isprintable() or text.translate(_ONE_LINE) == text


def without_controls(text: str) -> str:
    """Return a text without its control characters."""
    return text if text.isprintable() else text.translate(_NOTHING)
