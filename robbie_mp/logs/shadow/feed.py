"""What waits for a shadow that is busy: bounded, and the oldest goes first and is counted."""

from collections import deque

from robbie_mp.logs.shadow.frames import Given

MOST_MESSAGES = 2000
MOST_BYTES = 64 << 20


class Feed:
    """The queue of a shadow.

    Attributes:
        lost: messages that were dropped, because it was full.
        replaced: messages that were replaced by a newer one, of which only the newest is wanted.
    """

    def __init__(self, most_messages: int = MOST_MESSAGES, most_bytes: int = MOST_BYTES):
        self._most_messages = most_messages
        self._most_bytes = most_bytes
        self._waiting: deque[Given] = deque()
        self._bytes = 0
        self.lost = self.replaced = 0

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def messages(self) -> int:
        """How many messages wait."""
        return sum(bool(given.type_name) for given in self._waiting)

    @property
    def is_full(self) -> bool:
        """Whether the oldest goes if another one comes."""
        return len(self._waiting) >= self._most_messages or self._bytes >= self._most_bytes

    def add(self, given: Given, *, only_newest: bool = False) -> None:
        """Add a message, or the time.

        Args:
            given: the message.
            only_newest: whether it replaces one of the same channel.
        """
        if only_newest:
            self._replace(given)
        self._waiting.append(given)
        self._bytes += len(given.data)
        while len(self._waiting) > self._most_messages or (
            self._bytes > self._most_bytes and len(self._waiting) > 1
        ):
            self.lost += bool(self.take().type_name)

    def _replace(self, given: Given) -> None:
        key = given.type_name, given.version, given.topic
        for place, waiting in enumerate(self._waiting):
            if (waiting.type_name, waiting.version, waiting.topic) == key:
                self._bytes -= len(waiting.data)
                del self._waiting[place]
                self.replaced += 1
                return

    def take(self) -> Given:
        """Take the oldest; there is one."""
        given = self._waiting.popleft()
        self._bytes -= len(given.data)
        return given
