"""Logs whose time jumps."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from robbie_mp.messages import String
from tests.logs.recording._support.logs import LogFile

SECOND = 1_000_000_000
BEGINNING = 1_795_000_000 * SECOND
"""In 2026."""
WITHOUT_BATTERY = [
    *(at * SECOND // 10 for at in range(5)),
    *(BEGINNING + at * SECOND // 10 for at in range(5)),
]
SET_BACK = [BEGINNING, BEGINNING + SECOND, SECOND, 2 * SECOND]
FAR = [BEGINNING, BEGINNING + SECOND, (1 << 64) - 2, (1 << 64) - 1]


def jumping_log(path: Path, times_ns: Sequence[int], **options: Any) -> Path:
    """Write a log with one message at each time; it tells its number."""
    return log_of_topics(path, [("s", time_ns) for time_ns in times_ns], **options)


def log_of_topics(path: Path, messages: Sequence[tuple[str, int]], **options: Any) -> Path:
    """Write a log with one message for each topic and time; it tells its number."""
    with LogFile(path, **options) as log:
        for number, (topic, time_ns) in enumerate(messages, start=1):
            log.add(String(data=str(number)), topic, time_ns=time_ns)
    return path
