"""Times as text and in names of files: always UTC, in ISO 8601 and with its Z.

A robot, the operator's machine and a log from elsewhere may be in different zones, and a local time is
ambiguous when summer time ends. So no command, page or file name uses a local time.
"""

import re
import time
from datetime import datetime, timezone


def time_text(time_s: float) -> str:
    """Return a time as `2026-11-22T14:30:00.123Z`; '?' if it is not within the years 1 to 9999.

    Args:
        time_s: seconds since 1970, UTC.
    """
    try:
        found = datetime.fromtimestamp(time_s, timezone.utc)
    except (OverflowError, OSError, ValueError):
        return "?"
    return found.replace(tzinfo=None).isoformat(timespec="milliseconds") + "Z"


def time_from(text: str) -> datetime:
    """Return a time in ISO 8601, as Python 3.11 and later read it; 3.10 knows no `Z` and no `.25`.

    Raises:
        ValueError: it is no such time.
    """
    whole = re.sub(r"\.(\d{1,6})\d*", lambda digits: f".{digits[1]:0<6}", text)
    return datetime.fromisoformat(re.sub("[Zz]$", "+00:00", whole))


def time_of_day(time_s: float) -> str:
    """Return the time of day as `14:30:00.123Z`, for lists in which the date would only repeat."""
    return time_text(time_s).rpartition("T")[2]


def file_stamp(time_s: float | None = None) -> str:
    """Return a time as names of files and folders have it, `20261122T143000Z`; they then sort by time.

    Args:
        time_s: seconds since 1970, UTC; None: now.
    """
    return time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(time_s))
