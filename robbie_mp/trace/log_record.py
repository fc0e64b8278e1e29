"""What is in a line of a log channel; the sender is not trusted."""

import json
from dataclasses import dataclass
from typing import Any

PLAUSIBLE_S = 3600.0
"""A record cannot be older than this, nor newer than now by more; clocks may be set meanwhile."""


@dataclass(frozen=True)
class LogRecord:
    """A log record as a child has sent it."""

    time_s: float
    level: int
    level_name: str
    logger: str
    text: str
    where: str
    thread: str
    traceback: str


@dataclass(frozen=True)
class LogLine:
    """What a child has said."""

    record: LogRecord | None
    """None if there is nothing but the count."""
    dropped: int
    """Records that it could not send."""


def parse_line(line: bytes, now_s: float) -> LogLine | None:
    """Return what is in a line; None if no `ChannelHandler` has made it."""
    try:
        data = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(data, dict):
        return None
    dropped = _count(data.get("dropped"))
    if "text" not in data:
        return LogLine(None, dropped) if dropped else None
    if not (level := _count(data.get("level"))):
        return None
    record = LogRecord(
        time_s=_time(data.get("time_s"), now_s),
        level=level,
        level_name=_text(data, "level_name"),
        logger=_text(data, "logger"),
        text=_text(data, "text"),
        where=_text(data, "where"),
        thread=_text(data, "thread"),
        traceback=_text(data, "traceback"),
    )
    return LogLine(record, dropped)


def _text(data: dict[str, Any], key: str) -> str:
    value = data.get(key, "")
    return value if isinstance(value, str) else ""


def _count(value: object) -> int:
    return value if isinstance(value, int) and 0 <= value < 1 << 32 else 0


def _time(value: object, now_s: float) -> float:
    if isinstance(value, float) and abs(now_s - value) < PLAUSIBLE_S:  # which not-a-number is not
        return value
    return now_s
