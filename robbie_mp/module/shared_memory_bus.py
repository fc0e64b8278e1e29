"""The bus of a module that runs in its own process."""

from collections.abc import Callable

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.blocks import BlockStore
from robbie_mp.bus.transport.history import OwnHistory
from robbie_mp.bus.transport.views import SegmentViews
from robbie_mp.messages import Message
from robbie_mp.module.calls.peers import Peers
from robbie_mp.module.clock import Clock, SystemClock
from robbie_mp.module.envelope import Envelope
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.membership import Membership
from robbie_mp.module.outbox import Outbox
from robbie_mp.module.recorded import RecordedPeers
from robbie_mp.module.wiring import Wiring

NOTHING_HANDLED = "there is an envelope only while a message is being handled"


class SharedMemoryBus(Outbox):
    """A module's outbox, with what its inbox, the core's tables and the board tell.

    Args:
        place: the module's memory and connection.
        blocks: the memory for its messages.
        views: maps of the publishers' memory.
        clock: the module's clock, for envelopes.
        wiring: the names that the profile gives to the module's topics.
        check_class: raises an error if a class may not be exchanged in this run.

    Attributes:
        inbox: receives messages for the module.
        peers: the other modules.
    """

    def __init__(
        self,
        place: Membership,
        blocks: BlockStore,
        views: SegmentViews,
        clock: Clock,
        wiring: Wiring,
        check_class: Callable[[type[Message]], None],
    ):
        native = place.native
        super().__init__(place.endpoint, blocks, place.words, SystemClock(), native, wiring)
        self.inbox = Inbox(place.endpoint, views, place.words, place.channel_name, native, wiring)
        self.peers: Peers = place.peers
        self.subscriptions = self.inbox.subscriptions
        self.check_class = self.subscriptions.check_class = check_class
        self.newest_stamp_ns = self.inbox.newest_stamp_ns
        self.show_deadline = self.inbox.show_deadline
        self._channel_name = place.channel_name
        self._own_topic = wiring.own
        self._clock_at = clock.at
        self._name_of_slot = place.board.name
        self._names: dict[int, str] = {}
        """Names of slots, which never change."""

    def record_into(self, history: OwnHistory) -> None:
        """Record from now on what is handled, published, and asked of the other modules."""
        super().record_into(history)
        self.inbox.record_into(history)
        self.peers = RecordedPeers(self.peers, history.append)

    def sender(self) -> str:
        """Return the name of the module that published the message being handled; raises as `envelope`."""
        source = self.inbox.source
        if source is None:
            raise LookupError(NOTHING_HANDLED)
        return self._sender(source)

    def _sender(self, source: int) -> str:
        slot = source & layout.SOURCE_SLOT
        sender = self._names.get(slot)
        if sender is None:
            sender = self._names[slot] = self._name_of_slot(slot)
        return sender

    def envelope(self) -> Envelope:
        """Return the envelope of the message being handled.

        Raises:
            LookupError: no message is being handled.
        """
        current = self.inbox.current
        if current is None:
            raise LookupError(NOTHING_HANDLED)
        name = self._channel_name(current.channel)
        topic = self._own_topic(name.type_name, name.topic)
        return Envelope(
            topic, current.sequence, self._sender(current.source), self._clock_at(current.stamp_ns)
        )
