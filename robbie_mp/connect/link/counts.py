"""The counts of a link, in memory that outlives its process.

For each session, robot and channel: sent = received + replaced + dropped + lost + under way. Each word is
written by one process, a store at a time, so the counts balance wherever the process is killed.
"""

import json
import mmap
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from robbie_mp.base.linux.private_files import private_opener, write_private
from robbie_mp.connect.link.header import MAX_COUNTS, ChannelId
from robbie_mp.connect.link.traffic import TrafficClass

MAX_ROWS = 8192
KEPT_SESSIONS = 16
"""Sessions in each direction that have rows of their own; when rows are short, those before are added up."""
ADDED_UP = 0
"""The session of rows that hold the sums of sessions that have ended."""
WORDS = 8
TAKEN, REPLACED, DROPPED, RECEIVED, REFUSED, LOST, RECEIVED_BEFORE, REFUSED_BEFORE = range(WORDS)
"""Words of a channel that is sent: messages taken from the bus; replaced by newer ones; dropped here;
published by the other link; dropped by it; lost. The last two: received and refused by robots of that
name that have been restarted since."""
NEXT, HANDLING = range(2)
"""Words of a stream that is received: sequence of the first packet that was not handled; sequence of the last
packet of the message that is being published, 0 if there is none."""

_FLAGS = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC
OTHERS = "others"


class CountKey(NamedTuple):
    """The key of a row."""

    kind: str
    """"out": a channel that is sent; "in": one that is received; "stream": a stream that is received."""
    peer: str
    """The other robot."""
    session: int
    """The session that sends."""
    traffic: int
    number: int = 0
    """The channel's number in the session."""
    type_name: str = ""
    version: int = 0
    topic: str = ""

    @property
    def channel(self) -> ChannelId:
        """The channel's name."""
        return ChannelId(self.type_name, self.version, self.topic)


class CountRow:
    """The words of one key.

    Args:
        words: the words of all rows.
        place: index of the first one.
    """

    __slots__ = ("_place", "_words")

    def __init__(self, words: memoryview, place: int):
        self._words = words
        self._place = place

    def move(self, words: memoryview, place: int) -> None:
        """Use other words from now on."""
        self._words, self._place = words, place

    def __getitem__(self, column: int) -> int:
        value: int = self._words[self._place + column]
        return value

    def __setitem__(self, column: int, value: int) -> None:
        self._words[self._place + column] = value

    def add(self, column: int, number: int = 1) -> None:
        """Add to a word."""
        self._words[self._place + column] += number


class ExchangeCounts(NamedTuple):
    """The counts of one channel with one robot, over all sessions of this link."""

    is_sent: bool
    """False: this link receives it, and knows only `received` and `dropped`."""
    peer: str
    traffic: TrafficClass
    channel: ChannelId
    sent: int
    received: int
    replaced: int
    dropped: int
    lost: int

    @property
    def under_way(self) -> int:
        """Messages that are none of the others: they wait here, or no report about them has come."""
        return self.sent - self.received - self.replaced - self.dropped - self.lost if self.is_sent else 0


class LinkCounts:
    """The counts of one link in one run.

    Args:
        folder: the folder of the run's shared memory; None: counts that end with this process, for tests.
        link: name of the link's files there.
        session: the session of this process.

    Attributes:
        unlisted: rows that there was no room for. Each has counts of its own, which are in no list and
            end with this process.

    Raises:
        OSError: there is no room for the files.
    """

    def __init__(self, folder: Path | None, link: str, session: int):
        self.session = session
        self.unlisted = 0
        self._rows: dict[CountKey, CountRow] = {}
        self._sessions: dict[tuple[str, bool], dict[int, None]] = {}
        """By other robot, and whether they send to it: the sessions that have rows, oldest first."""
        self._received: dict[tuple[str, int, int], list[tuple[int, CountRow]]] = {}
        """Numbers and rows of the channels received, by robot, session and class."""
        self._keys: Path | None = None
        if folder is None:
            self._words = memoryview(bytearray(_size())).cast("Q")
            return
        self._keys = folder / f"{link}.link-keys"
        if not self._keys.exists():
            self._write_keys(f"{link}.link-counts-1", [])
        counts, *keys = map(json.loads, self._keys.read_bytes().splitlines())
        self._counts = folder / counts
        for left in (*folder.glob(f"{link}.link-counts-*"), folder / f"{link}.link-new"):
            if left != self._counts:  # a process was killed while it wrote new files
                left.unlink(missing_ok=True)
        self._words = _map(self._counts)
        for key in keys:
            self._place(CountKey(*key))

    def row(self, key: CountKey) -> CountRow:
        """Return the row of a key, a new one if there is none."""
        row = self._rows.get(key)
        if row is None:
            row = self._open(key)
        return row

    def sessions_of(self, peer: str) -> list[int]:
        """Return the sessions from which this link has received a stream, in the order of their first."""
        return list(
            dict.fromkeys(key.session for key in self._rows if key.kind == "stream" and key.peer == peer)
        )

    def streams_of(self, peer: str, session: int) -> dict[int, CountRow]:
        """Return the streams received from a session, by class."""
        return {
            key.traffic: row
            for key, row in self._rows.items()
            if key.kind == "stream" and key.peer == peer and key.session == session
        }

    def received_from(self, peer: str, session: int, traffic: int) -> list[tuple[int, int, int]]:
        """Return number, received and refused of each channel of a stream that is received."""
        found = self._received.get((peer, session, traffic), ())
        return [(number, row[RECEIVED], row[REFUSED]) for number, row in found]

    def has_room_for(self, key: CountKey) -> bool:
        """Whether a channel that is received has a row, or is one of those that a report can tell about."""
        return key in self._rows or len(self._received.get(key[1:4], ())) < MAX_COUNTS

    def settle_past(self, peer: str, session: int, counts: dict[int, tuple[int, int]]) -> None:
        """Take over what the other link has received of an earlier session of this link.

        Args:
            peer: the other robot.
            session: the earlier session.
            counts: received and refused, by number of the channel.
        """
        if session == ADDED_UP:
            return
        for key, row in self._rows.items():
            if key.kind == "out" and key.peer == peer and key.session == session and key.number in counts:
                received, refused = counts[key.number]
                received = max(row[RECEIVED], row[RECEIVED_BEFORE] + received)
                refused = max(row[REFUSED], row[REFUSED_BEFORE] + refused)
                # Nobody has received more than was sent.
                if received + refused + row[REPLACED] + row[DROPPED] <= row[TAKEN]:
                    row[RECEIVED], row[REFUSED] = received, refused

    def channels(self) -> list[ExchangeCounts]:
        """Return the counts by robot, channel and class, over all sessions.

        Nothing of a session that has ended is under way any more: what is not accounted for is lost.
        """
        sums: dict[tuple[bool, str, int, ChannelId], list[int]] = {}
        for key, row in self._rows.items():
            if key.kind == "stream":
                continue
            name = (key.kind == "out", key.peer, key.traffic, key.channel)
            total = sums.setdefault(name, [0] * 5)
            dropped = row[DROPPED] + row[REFUSED]
            counts = [row[TAKEN], row[RECEIVED], row[REPLACED], dropped, row[LOST]]
            if key.kind == "out" and key.session != self.session:
                counts[4] = max(0, counts[0] - sum(counts[1:4]))
            for column, count in enumerate(counts):
                total[column] += count
        return [
            ExchangeCounts(is_sent, peer, TrafficClass(traffic), channel, *total)
            for (is_sent, peer, traffic, channel), total in sums.items()
        ]

    def __iter__(self) -> Iterator[tuple[CountKey, CountRow]]:
        return iter(self._rows.items())

    def close(self) -> None:
        """Unmap the counts; the files are removed with all other shared memory of the run."""
        self._words.release()

    def _open(self, key: CountKey) -> CountRow:
        if len(self._rows) >= MAX_ROWS:
            self._add_up()
        if len(self._rows) >= MAX_ROWS:
            self.unlisted += 1
            return CountRow(memoryview(bytearray(WORDS * 8)).cast("Q"), 0)
        if self._keys is not None:
            with open(self._keys, "ab", buffering=0, opener=private_opener) as file:
                file.write(json.dumps(key).encode() + b"\n")
        return self._place(key)

    def _write_keys(self, counts: str, keys: Iterable[CountKey]) -> None:
        """Write the file of the keys again. A process that is killed here leaves the old one or the new one.

        Args:
            counts: name of the file of the counts that belong to it.
            keys: the keys in the order of their rows.
        """
        assert self._keys is not None
        write_private(self._keys, "".join(json.dumps(line) + "\n" for line in (counts, *keys)))

    def _add_up(self) -> None:
        """Give back the rows of sessions that ended long ago; the sums of their channels stay."""
        ended = {
            (*direction, session)
            for direction, sessions in self._sessions.items()
            for session in [one for one in sessions if one not in (ADDED_UP, self.session)][:-KEPT_SESSIONS]
        }
        if not ended:
            return
        kept = {
            key: row
            for key, row in self._rows.items()
            if (key.peer, key.kind == "out", key.session) not in ended
        }
        sums: dict[CountKey, list[int]] = {
            key: [row[one] for one in range(WORDS)] for key, row in kept.items()
        }
        for key, row in self._rows.items():
            if key not in kept and key.kind != "stream":
                total = sums.setdefault(key._replace(session=ADDED_UP, number=0), [0] * WORDS)
                for column in range(WORDS):
                    total[column] += row[column]
        self._replace(sums, kept)

    def _replace(self, counts: dict[CountKey, list[int]], kept: dict[CountKey, CountRow]) -> None:
        """Go on with new files. A kept row moves to them, so everything that holds one can go on using it."""
        old = None
        if self._keys is None:
            self._words = memoryview(bytearray(_size())).cast("Q")
        else:
            old, number = self._counts, int(self._counts.name.rpartition("-")[2])
            self._counts = old.with_name(f"{old.name.rpartition('-')[0]}-{number + 1}")
            self._counts.unlink(missing_ok=True)  # of a process that was killed here
            self._words = _map(self._counts)
        self._rows.clear()
        self._sessions.clear()
        self._received.clear()
        for key, values in counts.items():
            row = self._place(key, kept.get(key))
            for column, value in enumerate(values):
                row[column] = value
        if old is not None:
            self._write_keys(self._counts.name, counts)
            old.unlink()

    def _place(self, key: CountKey, known: CountRow | None = None) -> CountRow:
        row = self._rows[key] = known or CountRow(self._words, 0)
        row.move(self._words, WORDS * len(self._rows))
        self._sessions.setdefault((key.peer, key.kind == "out"), {})[key.session] = None
        if key.kind == "in":
            self._received.setdefault((key.peer, key.session, key.traffic), []).append((key.number, row))
        return row


def _size() -> int:
    """Return the bytes of a file of counts."""
    return (MAX_ROWS + 1) * WORDS * 8


def _map(file: Path) -> memoryview:
    counts = os.open(file, _FLAGS, 0o600)
    try:
        os.posix_fallocate(counts, 0, _size())  # full memory is an error here, and not a SIGBUS later
        return memoryview(mmap.mmap(counts, _size())).cast("Q")
    finally:
        os.close(counts)
