"""The bus of a module that runs as a tool.

A tool must not hold messages, so the bus copies each one before it is handled. If the tool is detached, the
bus attaches again with the same subscriptions; messages routed in between are missed.
"""

import logging
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from robbie_mp.attached.tool.tool import LONGEST_WAIT_S, Detached, Received, Tool, attach_again
from robbie_mp.base.linux.forks import REFUSED, keep_from_forks
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages import Message
from robbie_mp.module.bus import CopyingBus
from robbie_mp.module.calls.calls import Calls
from robbie_mp.module.calls.peers import RunPeers
from robbie_mp.module.clock import SystemClock
from robbie_mp.module.envelope import EncodedMessage, Envelope, MessageType
from robbie_mp.module.subscriptions import Subscription
from robbie_mp.run.run_directory import KnownRun


class ToolBus(CopyingBus):
    """Connects a module that runs as a tool with a run, and attaches again after a detach.

    Any thread may publish; only the main thread may do the rest.

    Args:
        run: the run.
        purpose: what this process does, shown as its status.

    Raises:
        ControlRefused: the profile allows no further tools, or shared memory is full.
        RunNotControlled: the run is still starting, or has ended.
    """

    def __init__(self, run: KnownRun, purpose: str):
        super().__init__(self._request)
        self._run = run
        self._purpose = purpose
        self._log = logging.getLogger("robbie.tool")
        self._lock = threading.RLock()
        """Held while any thread publishes or holds a loan, and while the bus attaches again."""
        self._tool = Tool(run, purpose)
        self.subscriptions.check_class = self._check_class
        self._is_open = True
        self.on_new_place: Callable[[], None] = lambda: None
        """Called when the bus has attached again, before it subscribes again."""
        keep_from_forks(self)

    def disown(self) -> None:
        """Keep a forked child from using the run."""
        self._lock = REFUSED

    # -- for the module ----------------------------------------------------------------------------------

    @property
    def peers(self) -> RunPeers:
        """The modules of the run."""
        return self._tool.peers

    @property
    def outstanding(self) -> int:
        """Messages published by this module that subscribers have not released yet."""
        with self._lock:
            return self._tool.outbox.outstanding

    def advertise(self, message_type: type[Message], topic: str) -> None:
        """Declare that the module may publish messages of a type."""
        with self._lock:
            self._tool.outbox.advertise(message_type, topic)

    def publish(self, message: Message | EncodedMessage, topic: str, latched: bool = False) -> bool:
        """Publish a message; False if it was refused, or the tool is not attached at the moment."""
        with self._lock:
            return self._is_attached and self._tool.outbox.publish(message, topic, latched)

    @contextmanager
    def loan(
        self,
        message_type: type[MessageType],
        topic: str,
        fields: Mapping[str, object],
        latched: bool = False,
    ) -> Iterator[MessageType]:
        """Lend a message that is written in place, in shared memory."""
        with self._lock, self._tool.outbox.loan(message_type, topic, fields, latched) as message:
            yield message

    def wake_after_freed(self, messages: int) -> None:
        """End the next `wait` once this many of the module's messages have been released."""
        with self._lock:
            self._tool.outbox.wake_after_freed(messages)

    # -- for its process ---------------------------------------------------------------------------------

    def ready(self) -> None:
        """Start receiving messages."""
        self._tool.ready()

    def show_status(self, line: str) -> None:
        """Set the status line shown for the module."""
        self._purpose = line
        self._tool.show_status(line)

    def handle_next(self) -> bool:
        """Handle the next message; False if there is none.

        Raises:
            ControlRefused: the tool was detached, and another tool has taken its place.
            RunEnded: the tool was detached, and the run has ended.
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
        """Wait for messages; False if nothing has woken this tool.

        Raises:
            RunEnded: the run has ended.
            ControlRefused: as for `handle_next`.
        """
        try:
            return self._tool.wait(timeout_s)
        except Detached as error:
            self._attach_again(error)
            return True

    def room_was_made(self) -> bool:
        """Whether the messages that the module waits for have been released; True only once."""
        outbox = self._tool.outbox
        return outbox.awaits_room and outbox.room_was_made()

    def make_calls(self) -> Calls:
        """Begin, without a module, and return what makes calls; `work_for` does the rest."""
        calls = Calls(self, SystemClock(), logging.getLogger("robbie.call"))
        self.on_new_place = calls.client.forget_place
        self.ready()
        return calls

    def work_for(self, calls: Calls) -> None:
        """Handle a message or wait for one, and do what is due for calls; raises as `wait`."""
        if not self.handle_next():
            self.wait(calls.wait_s())
        calls.run()

    def wake(self) -> None:
        """End the present or next `wait`; any thread may call this."""
        with self._lock:
            if self._is_open:
                self._tool.wake()

    def close(self) -> None:
        """Detach. Messages already published are still routed."""
        with self._lock:
            if self._is_open:
                self._is_open = False
                self._tool.close()

    @property
    def _is_attached(self) -> bool:
        return self._is_open and self._tool.is_attached

    def _request(self, subscription: Subscription) -> int:
        return self._tool.subscribe(*subscription.name, subscription.handling)

    def _check_class(self, message_type: type[Message]) -> None:
        self._tool.types.check(message_type)

    def _handle(self, received: Received) -> None:
        subscription = self.subscriptions.by_number[received.subscription]
        name = ChannelName(received.type_name, received.version, received.topic)
        envelope = Envelope(received.topic, received.sequence, received.sender, received.published_ns)
        self.hand_over(subscription, name, envelope, received.data)

    def _attach_again(self, error: Detached) -> None:
        self._log.warning("%s; attaching again", error)
        with self._lock:
            # If this fails, `close` still needs the old one.
            old, self._tool = self._tool, attach_again(self._run, self._purpose)
            old.close()
        self.on_new_place()
        self.subscriptions.request_again()
        self._tool.ready()
