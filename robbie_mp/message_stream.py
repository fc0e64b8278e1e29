"""All messages of a type, as a tool gets them, and a count of those that it missed."""

from collections.abc import Iterator

from robbie_mp.attachment import Attachment, Detached, Received
from robbie_mp.supervisor.run_directory import KnownRun

OPEN_TIMEOUT_S = 0.5
"""How long to wait for the core to open the subscription: longer only while it is down."""


class MessageStream:
    """Messages of one type from a run, over as many leases as it takes.

    Missed is what was routed and neither received nor waits. While attached, the core's books tell that
    exactly. From one lease to the next the core's channels tell it; a message just being routed at such a
    moment may then count for one more or less.

    Args:
        run: the run.
        type_name: full name of the type.
        version: of the type.
        topic: of the messages; '' for all.
        purpose: what this process is, for people who look at the run.
    """

    def __init__(self, run: KnownRun, type_name: str, version: int, topic: str, purpose: str):
        self._run = run
        self._wish = (type_name, version, topic)
        self._purpose = purpose
        self._attachment = Attachment(run, purpose)
        self._missed = 0
        """In leases that are over, and between them."""
        self._received = 0
        """In this lease."""
        self._passed_before = 0
        """Messages that had passed when this lease began."""
        self._begin()

    def _begin(self) -> None:
        attachment = self._attachment
        attachment.subscribe(*self._wish)
        attachment.ready()
        attachment.wait_for(attachment.is_subscribed, OPEN_TIMEOUT_S)
        self._received = 0
        self._passed_before = attachment.passed(*self._wish) - attachment.books()[0]

    def close(self) -> None:
        """Leave the run."""
        self._attachment.close()

    @property
    def missed(self) -> int:
        """Messages that were routed since the beginning and will never come."""
        routed, waiting = self._attachment.books()
        return self._missed + max(0, routed - waiting - self._received)

    def __iter__(self) -> Iterator[Received]:
        """Yield messages as they come, for ever.

        Raises:
            RunEnded: the run is over.
            ControlRefused: this process was detached because it stood still, and its place was taken.
        """
        while True:
            try:
                received = self._attachment.take()
                if received is None:
                    self._attachment.wait()
            except Detached:
                self._attach_again()
                continue
            if received is not None:
                self._received += 1
                yield received

    def _attach_again(self) -> None:
        """Attach anew and count what passed since the last lease began and was not received."""
        received, passed_before = self._received, self._passed_before
        self._attachment.close()
        self._attachment = Attachment(self._run, self._purpose)
        self._begin()
        self._missed += max(0, self._passed_before - passed_before - received)
