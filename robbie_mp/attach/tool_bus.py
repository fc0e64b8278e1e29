"""The bus of a module that is a program in a run: it has the place of a tool, and not one of the profile's.

A tool must not hold messages, so each one is copied before it is handled. A program that stood still and was
detached attaches itself again, with the same subscriptions; what passed meanwhile is missed.
"""

import logging
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from robbie_mp.attach.tool import LONGEST_WAIT_S, Detached, Received, Tool, attach_again
from robbie_mp.linux.forks import REFUSED, keep_from_forks
from robbie_mp.messages import Message
from robbie_mp.messages.errors import MessageError
from robbie_mp.module.bus import Envelope, MessageType
from robbie_mp.module.subscriptions import Subscription, Subscriptions
from robbie_mp.run.run_directory import KnownRun
from robbie_mp.transport.tables import ChannelName


class ToolBus:
    """Joins a module with a run that it is no part of, over as many leases as it takes.

    Publishing may happen in any thread; everything else belongs to the main thread.

    Args:
        run: the run.
        purpose: what this process is, for people who look at the run.

    Raises:
        ControlRefused: as many tools are attached as the profile allows, or there is no memory.
        RunNotControlled: the run is just starting, or over.
    """

    def __init__(self, run: KnownRun, purpose: str):
        self._run = run
        self._purpose = purpose
        self._log = logging.getLogger("robbie.tool")
        self.subscriptions = Subscriptions(self._request, self._current_name)
        self._current: Received | None = None
        self._lock = threading.RLock()
        """Held while this lease is used by other threads, or replaced by another one; during loans, too."""
        self._tool = Tool(run, purpose)
        self._is_open = True
        keep_from_forks(self)

    def disown(self) -> None:
        """Let a forked process do nothing in the run."""
        self._lock = REFUSED

    # -- what a module does ------------------------------------------------------------------------------

    @property
    def outstanding(self) -> int:
        """Messages published by this module that somebody still waits for or holds."""
        with self._lock:
            return self._tool.outbox.outstanding

    def publish(self, message: Message, topic: str) -> bool:
        """Send a message; False if it was refused, or this process is not attached just now."""
        with self._lock:
            return self._is_attached and self._tool.outbox.publish(message, topic)

    def publish_encoded(
        self, type_name: str, version: int, data: bytes | bytearray | memoryview, topic: str
    ) -> bool:
        """Send a message given as its bytes; False as for `publish`."""
        with self._lock:
            outbox = self._tool.outbox
            return self._is_attached and outbox.publish_encoded(type_name, version, data, topic)

    @contextmanager
    def loan(
        self, message_type: type[MessageType], topic: str, fields: Mapping[str, object]
    ) -> Iterator[MessageType]:
        """Have a message written in place."""
        with self._lock, self._tool.outbox.loan(message_type, topic, fields) as message:
            yield message

    def wake_after_freed(self, messages: int) -> None:
        """End the next `wait` when so many of its messages have been let go by everybody."""
        with self._lock:
            self._tool.outbox.wake_after_freed(messages)

    def envelope(self) -> Envelope:
        """What came with the message being handled.

        Raises:
            LookupError: no message is being handled.
        """
        if self._current is None:
            raise LookupError("there is an envelope only while a message is being handled")
        received = self._current
        return Envelope(received.topic, received.sequence, received.sender, received.published_ns)

    # -- what its process does ---------------------------------------------------------------------------

    def ready(self) -> None:
        """Let messages come."""
        self._tool.ready()

    def show_status(self, line: str) -> None:
        """Show who looks at the run how the module is doing."""
        self._purpose = line
        self._tool.show_status(line)

    def handle_next(self) -> bool:
        """Handle the next message; False if there is none.

        Raises:
            ControlRefused: this process was detached because it stood still, and its place was taken.
            RunEnded: likewise, and the run is over.
        """
        try:
            received = self._tool.take()
        except Detached as error:
            self._attach_again(error)
            return False
        if received is not None:
            self._handle(received)
        return received is not None

    def wait(self, timeout_s: float = LONGEST_WAIT_S) -> bool:
        """Wait for messages; say whether there is room again that was waited for.

        Raises:
            RunEnded: the run is over.
            ControlRefused: as for `handle_next`.
        """
        try:
            self._tool.wait(timeout_s)
        except Detached as error:
            self._attach_again(error)
        outbox = self._tool.outbox
        return outbox.awaits_room and outbox.room_was_made()

    def close(self) -> None:
        """Leave. What was published is still routed."""
        with self._lock:
            if self._is_open:
                self._is_open = False
                self._tool.close()

    @property
    def _is_attached(self) -> bool:
        return self._is_open and self._tool.is_attached

    def _request(self, subscription: Subscription) -> int:
        return self._tool.subscribe(*subscription.name, subscription.handling)

    def _current_name(self) -> ChannelName:
        received = self._current
        assert received is not None
        return ChannelName(received.type_name, received.version, received.topic)

    def _handle(self, received: Received) -> None:
        subscription = self.subscriptions.by_number[received.subscription]
        self._current = received
        try:
            message = subscription.decoder.decode(memoryview(received.data))
        except MessageError as error:
            self._log.error("a message was lost: %s", error)
        else:
            subscription.handler(message)
        self._current = None

    def _attach_again(self, error: Detached) -> None:
        self._log.warning("%s; attaches again", error)
        with self._lock:
            # The old one is still needed if there is no other any more.
            old, self._tool = self._tool, attach_again(self._run, self._purpose)
            old.close()
        self.subscriptions.request_again()
        self._tool.ready()
