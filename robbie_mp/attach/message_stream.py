"""All messages that a tool wants, as it gets them, and a count of those that it missed."""

from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase

from robbie_mp.attach.tool import LONGEST_WAIT_S, Detached, Received, Tool, attach_again
from robbie_mp.run.run_directory import KnownRun
from robbie_mp.transport.records import ANY_VERSION
from robbie_mp.transport.tables import ChannelName

OPEN_TIMEOUT_S = 0.5
"""How long to wait for the core to open the subscription: longer only while it is down."""


class MessageStream:
    """Messages from a run, over as many leases as it takes.

    Missed is what was routed and neither received nor waits. While attached, the core's books tell that
    exactly. From one lease to the next the core's channels tell it; a message just being routed at such a
    moment may then count for one more or less.

    Args:
        run: the run.
        wishes: what messages: name and version of a type, and a topic or '' for all of them; or, with
            ANY_VERSION, shell patterns for type and topic.
        purpose: what this process is, for people who look at the run.
    """

    def __init__(self, run: KnownRun, wishes: Sequence[ChannelName], purpose: str):
        self._run = run
        self._wishes = wishes
        self._purpose = purpose
        self._tool = Tool(run, purpose)
        self._missed = 0
        """In leases that are over, and between them."""
        self._received = 0
        """In this lease."""
        self._passed_before = 0
        """Messages that had passed when this lease began."""
        self._begin()

    def _begin(self) -> None:
        tool = self._tool
        for wish in self._wishes:
            tool.subscribe(*wish)
        tool.ready()
        tool.wait_for(tool.is_subscribed, OPEN_TIMEOUT_S)
        self._received = 0
        self._passed_before = sum(self.passed().values()) - tool.books()[0]

    def close(self) -> None:
        """Leave the run."""
        self._tool.close()

    @property
    def missed(self) -> int:
        """Messages that were routed since the beginning and will never come."""
        routed, waiting = self._tool.books()
        return self._missed + max(0, routed - waiting - self._received)

    def passed(self) -> dict[ChannelName, int]:
        """Return how many messages have ever passed through each channel that is wanted."""
        return {
            name: passed
            for name, passed in self._tool.passed().items()
            if any(_matches(wish, name) for wish in self._wishes)
        }

    def __iter__(self) -> Iterator[Received]:
        """Yield messages as they come, for ever; raises as `receive` does."""
        while True:
            received = self.receive()
            if received is not None:
                yield received

    def receive(self) -> Received | None:
        """Return the next message; None if none came for a little while.

        Raises:
            RunEnded: the run is over.
            ControlRefused: this process was detached because it stood still, and its place was taken.
        """
        try:
            received = self._tool.take()
            if received is None:
                self._tool.wait(LONGEST_WAIT_S)
                return None
        except Detached:
            self._attach_again()
            return None
        self._received += 1
        return received

    def _attach_again(self) -> None:
        """Attach anew and count what passed since the last lease began and was not received."""
        received, passed_before = self._received, self._passed_before
        # The old one is still needed if there is no other any more.
        old, self._tool = self._tool, attach_again(self._run, self._purpose)
        old.close()
        self._begin()
        self._missed += max(0, self._passed_before - passed_before - received)


def _matches(wish: ChannelName, name: ChannelName) -> bool:
    if wish.version == ANY_VERSION:
        return fnmatchcase(name.type_name, wish.type_name) and fnmatchcase(name.topic, wish.topic)
    return wish[:2] == name[:2] and wish.topic in ("", name.topic)
