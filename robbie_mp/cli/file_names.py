"""Names of files for channels, which every file system takes."""

import hashlib
import re
import unicodedata
from collections.abc import Sequence
from itertools import chain
from itertools import count as count_from

from robbie_mp.logs.recording.reader import LogChannel, channel_name

UNSAFE = re.compile(r"[^\w.-]|\.$")
"""Characters that are not safe in the names of files."""
MAX_NAME_BYTES = 200
"""File systems allow 255; a suffix, or the name of a picture, comes behind."""
RESERVED = {
    "CON",
    "PRN",
    "AUX",
    "NUL",
    *(f"{port}{number}" for port in ("COM", "LPT") for number in range(10)),
}
"""Names that Windows keeps for devices, with any suffix."""


def file_names(channels: Sequence[LogChannel]) -> dict[LogChannel, str]:
    """Return a name for each channel: of its topic, and as much more as makes it the only one.

    Names that differ only in capital letters count as the same, as in the file systems of USB sticks.
    """
    names: dict[LogChannel, str] = {}
    taken: set[str] = set()
    for channel in channels:
        words = [channel_name(channel), channel.type_name.rpartition("/")[2], channel.sender, str(channel.id)]
        longer = ("-".join(words[:count]) for count in range(1, len(words) + 1))
        further = (f"{'-'.join(words)}-{number}" for number in count_from(2))
        for name in map(safe_name, chain(longer, further)):
            key = unicodedata.normalize("NFKC", name).casefold()
            if key not in taken:
                break
        taken.add(key)
        names[channel] = name
    return names


def safe_name(text: str) -> str:
    """Return a text as the name of a file, without a suffix: bounded, and with all file systems' letters.

    A name that is cut ends with a digest of the text, so that long names stay apart.
    """
    name = UNSAFE.sub("_", text)
    if len(name.encode()) > MAX_NAME_BYTES:
        digest = hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()[:12]
        name = name.encode()[: MAX_NAME_BYTES - 13].decode(errors="ignore") + "-" + digest
    is_reserved = name.partition(".")[0].upper() in RESERVED or name.startswith(".")
    return f"_{name}" if is_reserved or not name else name
