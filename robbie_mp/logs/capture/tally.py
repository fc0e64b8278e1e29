"""Counts a recorder's messages in memory that outlives its process.

What a recorder holds in memory is lost if it is killed. Its next process compares the messages that it had
received with those in its log: the difference is missing, and is counted in the log like other losses.
"""

import json
import mmap
import os
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path

from robbie_mp.base.linux.private_files import private_opener
from robbie_mp.logs.recording.errors import LogError
from robbie_mp.logs.recording.format import PART_NAME, ChannelKey, RecordedCount
from robbie_mp.logs.recording.info import last_counts
from robbie_mp.logs.recording.reader import open_log

MAX_CHANNELS = 4096
OTHERS = ChannelKey("", 0, "", "")
"""All channels beyond the limit are counted as one."""


_FLAGS = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC
WORDS = 4
RECEIVED, MISSED, RECORDED, DROPPED = range(WORDS)
"""The words of a channel: messages that the recorder has taken into its memory; messages that never reached
it; messages recorded in parts of the log that have ended; and missing messages that these parts count."""


class Tally:
    """The counts of one recorder in one run, by channel.

    Each count is a word of a file that is mapped into memory. One thread counts messages; any thread may call
    `end_part`. If a process is killed right after it has counted a message, that message may be counted as
    lost twice.

    Args:
        folder: the folder of the run's shared memory, which is no disk that could stall.
        recorder: name of the recorder's files there.

    Attributes:
        next_part: number of the first part that had not ended when this process started.

    Raises:
        OSError: there is no room for the files.
    """

    def __init__(self, folder: Path, recorder: str):
        self._keys = folder / f"{recorder}.channels"
        self._keys.touch(mode=0o600)
        counts = os.open(folder / f"{recorder}.counts", _FLAGS, 0o600)
        try:
            size = (MAX_CHANNELS + 2) * WORDS * 8
            os.posix_fallocate(counts, 0, size)  # a full disk is an error here, and not a SIGBUS later
            self._words = memoryview(mmap.mmap(counts, size)).cast("Q")
        finally:
            os.close(counts)
        self._places: dict[ChannelKey, int] = {OTHERS: WORDS}
        """Index of each channel's first word; the first words of all are the number of the next part."""
        for line in self._keys.read_bytes().splitlines():
            self._place(ChannelKey(*json.loads(line)))
        self._lock = threading.Lock()
        self._ended: list[tuple[int, Mapping[ChannelKey, RecordedCount]]] = []
        """Parts of this process that ended before `lost_before` was called."""
        self._knows_past = False
        self.next_part = self._words[0]
        self._past = {place: self._words[place : place + WORDS].tolist() for place in self._rows()}

    def receive(self, key: ChannelKey) -> None:
        """Count a message that the recorder has received."""
        self._words[(self._places.get(key) or self._open(key)) + RECEIVED] += 1

    def miss(self, key: ChannelKey, messages: int) -> None:
        """Count messages that never reached the recorder."""
        self._words[(self._places.get(key) or self._open(key)) + MISSED] += messages

    def received(self) -> dict[ChannelKey, int]:
        """Return how many messages this process and earlier ones have received."""
        return {key: self._words[place + RECEIVED] for key, place in self._places.copy().items()}

    def end_part(self, number: int, counts: Mapping[ChannelKey, RecordedCount]) -> None:
        """Add the counts of a part of the log that has ended."""
        with self._lock:
            if self._knows_past:
                self._add(counts)
                self._words[0] = number + 1
            else:
                self._ended.append((number, counts))

    def lost_before(
        self, unended: Mapping[ChannelKey, RecordedCount], first_part: int
    ) -> dict[ChannelKey, int]:
        """Return the messages that were lost with earlier processes of the recorder; call this once.

        Args:
            unended: what earlier processes have left in the parts from `next_part` on.
            first_part: number of the first part after these.
        """
        with self._lock:
            past = self._past
            for key, count in unended.items():
                row = past.setdefault(self._places.get(key) or self._open(key), [0] * WORDS)
                row[RECORDED] += count.recorded
                row[DROPPED] += count.dropped
            self._add(unended)
            self._words[0] = max(self._words[0], first_part)
            for number, counts in self._ended:
                self._add(counts)
                self._words[0] = number + 1
            self._knows_past = True
        key_of = {place: key for key, place in reversed(self._places.items())}
        missing = {
            place: row[RECEIVED] + row[MISSED] - row[RECORDED] - row[DROPPED] for place, row in past.items()
        }
        return {key_of[place]: count for place, count in missing.items() if count > 0}

    def close(self) -> None:
        """Unmap the counts; the files are removed with all other shared memory of the run."""
        self._words.release()

    def _add(self, counts: Mapping[ChannelKey, RecordedCount]) -> None:
        for key, count in counts.items():
            place = self._places.get(key, WORDS)
            self._words[place + RECORDED] += count.recorded
            self._words[place + DROPPED] += count.dropped

    def _open(self, key: ChannelKey) -> int:
        if len(self._places) > MAX_CHANNELS:
            place = self._places[key] = self._places[OTHERS]
            return place
        with open(self._keys, "ab", buffering=0, opener=private_opener) as file:
            file.write(json.dumps(key).encode() + b"\n")
        return self._place(key)

    def _place(self, key: ChannelKey) -> int:
        place = self._places[key] = WORDS * (len(self._places) + 1)
        return place

    def _rows(self) -> set[int]:
        """Return the index of each channel's first word."""
        return set(self._places.values())


def parts_from(recording: Path, number: int) -> dict[int, Path]:
    """Return the parts of a recording from a number on, by number; none if it does not exist yet."""
    found = {}
    for path in recording.glob("*.mcap"):
        if (match := PART_NAME.fullmatch(path.name)) and int(match["number"]) >= number:
            found[int(match["number"])] = path
    return found


def counts_of(parts: Iterable[Path]) -> dict[ChannelKey, RecordedCount]:
    """Return how many messages are in parts of a recording, and how many missing ones they count.

    A part that cannot be read counts as empty.
    """
    counts: dict[ChannelKey, RecordedCount] = {}
    for path in parts:
        try:
            with open_log(path) as log:
                recorded = {channel.key: count for channel, count in log.counts.items()}
                dropped = {
                    key: count.dropped for part in log.parts for key, count in last_counts(part).items()
                }
        except (LogError, OSError):
            continue
        for key in {*recorded, *dropped}:
            count = counts.setdefault(key, RecordedCount())
            count.recorded += recorded.get(key, 0)
            count.dropped += dropped.get(key, 0)
    return counts


class UnendedParts:
    """Reads the parts that earlier processes of a recorder left without an end, in a thread.

    The recorder does not wait for this, because messages arrive meanwhile.

    Args:
        recording: the folder of the recording, which need not exist.
        first: number of the first such part.

    Attributes:
        after: number of the first part after these.
    """

    def __init__(self, recording: Path, first: int):
        self._counts: dict[ChannelKey, RecordedCount] = {}
        parts = parts_from(recording, first)  # now, before this process begins a part
        self.after = max(parts, default=first - 1) + 1
        self._thread = threading.Thread(
            target=self._read, args=(list(parts.values()),), name="unended parts", daemon=True
        )
        self._thread.start()

    def counts(self, wait_s: float) -> dict[ChannelKey, RecordedCount] | None:
        """Return what is in these parts; None if they have not been read after `wait_s`."""
        self._thread.join(wait_s)
        return None if self._thread.is_alive() else self._counts

    def _read(self, parts: list[Path]) -> None:
        self._counts = counts_of(parts)
