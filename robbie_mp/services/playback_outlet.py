"""Puts the messages of a log on a run's bus, as fast as nothing is lost, or one at a time in lockstep."""

from collections import deque
from collections.abc import Callable, Mapping

from robbie_mp.messages import MessageError, Tick, Time, TimeJump
from robbie_mp.module.module import Module
from robbie_mp.playback.player import DueTick
from robbie_mp.playback.translation import Translation
from robbie_mp.recording.reader import LoggedMessage
from robbie_mp.run.lockstep import Lockstep, TickSchedule
from robbie_mp.transport.blocks import MessageTooLarge

PATIENCE_NS = 15_000_000_000
"""Messages that nobody has handled for so long are not waited for: their subscriber stands still."""


class BusOutlet:
    """Publishes messages of a log.

    Args:
        module: who publishes.
        translations: how, by the id of the channel.
        remember: is called right before a message is published, with 1, and after whatever else happened,
            with 0: so many messages are more done with than the player knows.

    Attributes:
        skipped: messages that could not be published.
    """

    def __init__(
        self, module: Module, translations: Mapping[int, Translation], remember: Callable[[int], None]
    ):
        self._module = module
        self._translations = translations
        self._remember = remember
        self.skipped = 0

    def send(self, message: LoggedMessage) -> bool:
        """Publish a message; one that cannot be is skipped and counted. False if there is no room now."""
        channel = message.channel
        translation = self._translations[channel.id]
        try:
            data = translation.translate(message.data)
            self._remember(1)
            return self._module.publish_encoded(
                channel.type_name, translation.version, data, topic=channel.topic
            )
        except (MessageError, MessageTooLarge) as error:
            self.skipped += 1
            if self.skipped.bit_count() == 1:  # the 1st, 2nd, 4th, 8th …
                self._module.log.error("%d messages of the log skipped; the last: %s", self.skipped, error)
            return True

    def announce(self, before_ns: int, after_ns: int, reason: str) -> None:
        """Tell that the time has jumped."""
        before, after = Time.from_nanoseconds(before_ns), Time.from_nanoseconds(after_ns)
        self._module.publish(TimeJump(before=before, after=after, reason=reason))
        self._remember(0)


class PacedOutlet(BusOutlet):
    """Has so many messages on their way that nobody's queue overflows.

    Args:
        module, translations, remember: as for `BusOutlet`.
        limit: messages that may be waiting or in work at once.
        limit_bytes: so large they may be together; a larger one goes alone.
        unhandled: tells how many there are; those that somebody has handled and keeps are not on their way.
    """

    def __init__(
        self,
        module: Module,
        translations: Mapping[int, Translation],
        remember: Callable[[int], None],
        limit: int,
        limit_bytes: int,
        unhandled: Callable[[], int],
    ):
        super().__init__(module, translations, remember)
        self._limit = limit
        self._limit_bytes = limit_bytes
        self._unhandled = unhandled
        self._sizes: deque[int] = deque(maxlen=limit)
        """Of the last messages: of those on their way, if they are handled in order."""
        self._last_unhandled = 0
        self._unchanged_since_ns = 0

    def send(self, message: LoggedMessage) -> bool:
        """Publish a message; see `BusOutlet.send`."""
        is_sent = super().send(message)
        if is_sent:
            self._sizes.append(len(message.data))
            self._last_unhandled = 0
        return is_sent

    def has_room(self, size: int) -> bool:
        """Whether so few messages are on their way that one more may follow."""
        # Those that are kept count here as well, but most often there is room all the same; the exact number
        # takes longer to find.
        return self._fits(self._module.outstanding, size) or self._fits(self._unhandled(), size)

    def _fits(self, on_their_way: int, size: int) -> bool:
        while len(self._sizes) > on_their_way:
            self._sizes.popleft()
        if on_their_way == 0:
            return True
        return on_their_way < self._limit and sum(self._sizes) + size <= self._limit_bytes

    def is_empty(self) -> bool:
        """Whether everything sent has been handled, or nobody goes on with it."""
        if self._module.outstanding == 0:
            return True
        unhandled, now_ns = self._unhandled(), self._module.clock.monotonic_ns()
        if unhandled != self._last_unhandled:
            self._last_unhandled, self._unchanged_since_ns = unhandled, now_ns
        return unhandled == 0 or now_ns - self._unchanged_since_ns > PATIENCE_NS

    def wake(self) -> None:
        """Have the module's next tick as soon as there is more room."""
        self._module.wake_after_freed(max(1, self._module.outstanding // 2))

    def next_tick(self) -> DueTick | None:
        """None: modules tick by the clock."""
        return None

    def send_tick(self, tick: DueTick) -> bool:
        """Never asked for."""
        raise NotImplementedError(tick)


class LockstepOutlet(BusOutlet):
    """Has one message or tick on its way, and goes on when all that came of it is over.

    Args:
        module, translations, remember: as for `BusOutlet`.
        lockstep: what the module knows of the others.
        now_ns: the run's time.
    """

    def __init__(
        self,
        module: Module,
        translations: Mapping[int, Translation],
        remember: Callable[[int], None],
        lockstep: Lockstep,
        now_ns: Callable[[], int],
    ):
        super().__init__(module, translations, remember)
        self._lockstep = lockstep
        self._now_ns = now_ns
        self.schedule = TickSchedule(now_ns())

    def has_room(self, _size: int) -> bool:
        """Whether all that came of the last message or tick is over."""
        return self._lockstep.is_settled()

    def is_empty(self) -> bool:
        """Likewise."""
        return self._lockstep.is_settled()

    def wake(self) -> None:
        """Have the module's next tick as soon as that is so."""
        self._lockstep.wake_when_settled()

    def next_tick(self) -> DueTick | None:
        """Return the tick that is to be granted next."""
        self.schedule.update(self._lockstep.periods(), self._now_ns())
        following = self.schedule.next()
        return DueTick(*following) if following else None

    def send_tick(self, tick: DueTick) -> bool:
        """Grant a tick; False if there is no room for it now."""
        self.schedule.granted(tick.module)
        self._remember(0)
        if self._module.publish(Tick(due=Time.from_nanoseconds(tick.due_ns)), topic=tick.module):
            return True
        self.schedule.due_ns[tick.module] = tick.due_ns
        return False

    def announce(self, before_ns: int, after_ns: int, reason: str) -> None:
        """Tell that the time has jumped; everybody has the next tick right then."""
        self.schedule.restart(after_ns)
        super().announce(before_ns, after_ns, reason)
