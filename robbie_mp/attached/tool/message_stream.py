"""The messages a tool subscribes to, and a count of those it missed."""

from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase

from robbie_mp.attached.tool.tool import LONGEST_WAIT_S, Detached, Received, Tool, attach_again
from robbie_mp.bus.transport.records import ANY_VERSION
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages import Message
from robbie_mp.run.run_directory import KnownRun

OPEN_TIMEOUT_S = 0.5
"""Maximum time for the core to open the subscriptions. It takes longer only while the core is down."""

MAX_READS = 100
"""How often counters are read that change meanwhile; after that, the last two are good enough."""


class MessageStream:
    """Messages from a run. A tool that is detached attaches again.

    A message is missed if it was routed but neither received nor waits. While the tool is attached, the
    core's counters give the exact number. While it is detached, the counters of channels give it; a message
    that is being routed at that moment may be counted wrongly.

    Args:
        run: the run.
        subscriptions: name and version of a type, and a topic or '' for all topics; or, with ANY_VERSION,
            shell patterns for type and topic.
        purpose: what this process does, shown as its status.
    """

    def __init__(self, run: KnownRun, subscriptions: Sequence[ChannelName], purpose: str):
        self._run = run
        self._subscriptions = list(subscriptions)
        self._purpose = purpose
        self._tool = Tool(run, purpose)
        self._missed = 0
        """Before the tool was attached last."""
        self._received = 0
        """Since the tool was attached last."""
        self._passed_before = 0
        """Messages routed before the tool was attached last."""
        self._begin()

    def _begin(self) -> None:
        tool = self._tool
        for subscription in self._subscriptions:
            tool.subscribe(*subscription)
        tool.ready()
        tool.wait_for(tool.is_subscribed, OPEN_TIMEOUT_S)
        self._received = 0
        self._passed_before = self._passed_before_attached()

    def subscribe(self, subscription: ChannelName) -> None:
        """Also take these messages from now on; the argument is like one of `subscriptions`."""
        self._subscriptions.append(subscription)
        self._tool.subscribe(*subscription)
        self._tool.wait_for(self._tool.is_subscribed, OPEN_TIMEOUT_S)
        self._passed_before = self._passed_before_attached()

    def _passed_before_attached(self) -> int:
        """Read two counters of the core at a moment when neither changes, and return their difference."""
        for _ in range(MAX_READS):
            routed = self._tool.counts()[0]
            passed = sum(self.passed().values())
            if self._tool.counts()[0] == routed:
                break
        return passed - routed

    def check_class(self, message_type: type[Message]) -> None:
        """Check a class that is to decode the messages.

        Raises:
            ChangedType: the run knows this version of the type with other fields.
        """
        self._tool.types.check(message_type)

    def close(self) -> None:
        """Detach from the run."""
        self._tool.close()

    @property
    def missed(self) -> int:
        """Messages that were routed since the stream began and will never be received."""
        routed, waiting = self._tool.counts()
        return self._missed + max(0, routed - waiting - self._received)

    def passed(self) -> dict[ChannelName, int]:
        """Return how many messages were routed through each channel that is subscribed to."""
        return {
            name: passed
            for name, passed in self._tool.passed().items()
            if any(_matches(subscription, name) for subscription in self._subscriptions)
        }

    def __iter__(self) -> Iterator[Received]:
        """Yield messages as they arrive, without end; raises as `receive` does."""
        while True:
            received = self.receive()
            if received is not None:
                yield received

    def receive(self, timeout_s: float = LONGEST_WAIT_S) -> Received | None:
        """Return the next message; None if none arrived within the timeout, or LONGEST_WAIT_S.

        Raises:
            RunEnded: the run has ended.
            ControlRefused: the tool was detached, and another tool has taken its place.
        """
        try:
            received = self._tool.take()
            if received is None:
                self._tool.wait(timeout_s)
                return None
        except Detached:
            self._attach_again()
            return None
        self._received += 1
        return received

    def _attach_again(self) -> None:
        """Attach again, and count as missed the messages routed since the last time but not received."""
        received, passed_before = self._received, self._passed_before
        # If this fails, `missed` still needs the old one.
        old, self._tool = self._tool, attach_again(self._run, self._purpose)
        old.close()
        self._begin()
        self._missed += max(0, self._passed_before - passed_before - received)


def _matches(wanted: ChannelName, name: ChannelName) -> bool:
    if wanted.version == ANY_VERSION:
        return fnmatchcase(name.type_name, wanted.type_name) and fnmatchcase(name.topic, wanted.topic)
    return wanted[:2] == name[:2] and wanted.topic in ("", name.topic)
