"""Where the black box keeps the last messages: in the run's shared memory, as parts of a log."""

import contextlib
import os
from pathlib import Path

from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.logs.recording.errors import LogError
from robbie_mp.logs.recording.format import PART_NAME
from robbie_mp.logs.recording.reader import open_log

RING, STATE = "ring", "state.json"


def ring_home(run_id: str, shared_memory: Path = SHARED_MEMORY) -> Path:
    """Return the folder of a run's ring and of the black box's state."""
    return shared_memory / names.folder(run_id) / "black_box"


def ring_parts(ring: Path) -> list[int]:
    """Return the numbers of the parts that are in a ring; none if it does not exist."""
    try:
        found = map(PART_NAME.fullmatch, os.listdir(ring))
    except OSError:
        return []
    return sorted(int(match["number"]) for match in found if match and match["name"] == ring.name)


def last_message_s(log: Path) -> float | None:
    """Return when the last message of a log came, seconds since 1970; None if it has none."""
    with contextlib.suppress(LogError, OSError), open_log(log) as found:
        return found.end_ns / 1e9 if found.message_count else None
    return None
