"""Publishes a log's messages in a run: as fast as possible without loss, or one at a time in lockstep."""

from collections import deque
from collections.abc import Callable, Mapping

from robbie_mp.base.balance import Balance
from robbie_mp.bus.transport.blocks import MessageTooLarge
from robbie_mp.logs.playback.player import GAP, DueTick
from robbie_mp.logs.playback.translation import Translation
from robbie_mp.logs.recording.reader import LoggedMessage, channel_name
from robbie_mp.logs.recording.time_jumps import LogTimeJump
from robbie_mp.messages import MessageError, Tick, Time, TimeJump
from robbie_mp.messages.stock.registry import class_with_rules
from robbie_mp.module.module import Module
from robbie_mp.run.lockstep import Lockstep, TickSchedule

PATIENCE_NS = 15_000_000_000
"""If no message is handled for this long, the subscriber is stalled, and the player stops waiting."""


class BusOutlet:
    """Publishes the messages of a log.

    Args:
        module: publishes the messages.
        translations: how to publish them, by channel id, or why that is impossible.
        remember: called with 1 right before a message is published, and with 0 after anything else. The
            number says how many messages are done that the player has not counted yet.

    Attributes:
        balance: counts the messages published, without those given again after a jump, and those left out.
    """

    def __init__(
        self, module: Module, translations: Mapping[int, Translation | str], remember: Callable[[int], None]
    ):
        self._module = module
        self._translations = translations
        self._remember = remember
        self.balance = Balance()
        self._gaps = 0

    @property
    def skipped(self) -> int:
        """Number of messages that could not be published."""
        return self.balance.read - self.balance.used

    def send(self, message: LoggedMessage, *, is_given: bool = False) -> bool:
        """Publish a message, or leave it out if that is impossible. False if there is no room now."""
        channel = message.channel
        translation = self._translations[channel.id]
        if isinstance(translation, str):
            return self._leave_out(translation)
        try:
            data = translation.translate(message.data)
            if not self._module.ill_formed.admits_encoded(
                class_with_rules(channel.type_name, translation.version),
                data,
                f"on topic '{channel.topic}'",
            ):
                return self._leave_out(f"ill-formed messages of {channel_name(channel)!r}")
            self._remember(0 if is_given else 1)
            is_sent = self._module.publish_encoded(
                channel.type_name, translation.version, data, topic=channel.topic, latched=channel.is_latched
            )
        except (MessageError, MessageTooLarge) as error:
            if (self.skipped + 1).bit_count() == 1:  # the 1st, 2nd, 4th, 8th …
                self._module.log.error(
                    "%d messages of the log left out; the last: %s", self.skipped + 1, error
                )
            what = "too large" if isinstance(error, MessageTooLarge) else "damaged"
            return self._leave_out(f"{what} messages of {channel_name(channel)!r}")
        if is_sent and not is_given:
            self.balance.use()
        return is_sent

    def _leave_out(self, reason: str) -> bool:
        self.balance.leave_out(reason)
        return True

    def announce(self, before_ns: int, after_ns: int, reason: str) -> None:
        """Announce that the time has jumped."""
        self._gaps += reason == GAP
        if reason == GAP and self._gaps.bit_count() == 1:
            jump = LogTimeJump(before_ns, after_ns)
            self._module.log.warning(
                "the log's time jumps from %s: skipped; `--gaps keep` waits (jump %d)", jump, self._gaps
            )
        before, after = Time.from_nanoseconds(before_ns), Time.from_nanoseconds(after_ns)
        self._module.publish(TimeJump(before=before, after=after, reason=reason))
        self._remember(0)


class PacedOutlet(BusOutlet):
    """Limits the messages in flight so that no subscriber's queue overflows.

    Args:
        module, translations, remember: as for `BusOutlet`.
        limit: maximum number of messages that wait or are being handled.
        limit_bytes: limit of their total size; a larger message is sent alone.
        unhandled: returns the exact number. Messages that a subscriber has handled but keeps do not count.
    """

    def __init__(
        self,
        module: Module,
        translations: Mapping[int, Translation | str],
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
        """Sizes of the last messages sent: those in flight, if they are handled in order."""
        self._last_unhandled = 0
        self._unchanged_since_ns = 0

    def send(self, message: LoggedMessage, *, is_given: bool = False) -> bool:
        """Publish a message; see `BusOutlet.send`."""
        is_sent = super().send(message, is_given=is_given)
        if is_sent:
            self._sizes.append(len(message.data))
            self._last_unhandled = 0
        return is_sent

    def has_room(self, size: int) -> bool:
        """Whether one more message may be in flight."""
        # This count includes messages that subscribers keep. It usually suffices to find room, and the exact
        # number takes longer to find.
        return self._fits(self._module.outstanding, size) or self._fits(self._unhandled(), size)

    def _fits(self, on_their_way: int, size: int) -> bool:
        while len(self._sizes) > on_their_way:
            self._sizes.popleft()
        if on_their_way == 0:
            return True
        return on_their_way < self._limit and sum(self._sizes) + size <= self._limit_bytes

    def is_empty(self) -> bool:
        """Whether everything sent has been handled, or the subscribers have stalled."""
        if self._module.outstanding == 0:
            return True
        unhandled, now_ns = self._unhandled(), self._module.clock.monotonic_ns()
        if unhandled != self._last_unhandled:
            self._last_unhandled, self._unchanged_since_ns = unhandled, now_ns
        return unhandled == 0 or now_ns - self._unchanged_since_ns > PATIENCE_NS

    def wake(self) -> None:
        """Schedule the module's next tick for when there is more room."""
        self._module.wake_after_freed(max(1, self._unhandled() // 2))

    def next_tick(self) -> DueTick | None:
        """Return None: modules tick by the clock."""
        return None

    def next_free(self) -> DueTick | None:
        """Return None: modules are busy by the machine's clock."""
        return None

    def send_tick(self, tick: DueTick) -> bool:
        """Never called."""
        raise NotImplementedError(tick)


class LockstepOutlet(BusOutlet):
    """Has one message or tick in flight, and continues once everything it caused has finished.

    Args:
        module, translations, remember: as for `BusOutlet`.
        lockstep: the module's view of the other modules in lockstep.
        now_ns: the run's time.
    """

    def __init__(
        self,
        module: Module,
        translations: Mapping[int, Translation | str],
        remember: Callable[[int], None],
        lockstep: Lockstep,
        now_ns: Callable[[], int],
    ):
        super().__init__(module, translations, remember)
        self._lockstep = lockstep
        self._now_ns = now_ns
        self.schedule = TickSchedule(now_ns())

    def has_room(self, _size: int) -> bool:
        """Whether everything that the last message or tick caused has finished."""
        return self._lockstep.is_settled()

    def is_empty(self) -> bool:
        """Whether everything that the last message or tick caused has finished, at any time."""
        return self._lockstep.is_settled() and self.next_free() is None

    def wake(self) -> None:
        """Schedule the module's next tick for when everything has finished."""
        self._lockstep.wake_when_settled()

    def next_tick(self) -> DueTick | None:
        """Return the tick to grant next."""
        self.schedule.update(self._lockstep.periods(), self._now_ns())
        following = self.schedule.next()
        return DueTick(*following) if following else None

    def next_free(self) -> DueTick | None:
        """Return when a busy module gets a message that waits for it."""
        free_ns = self._lockstep.next_free_ns(self._now_ns())
        return DueTick(free_ns, "") if free_ns is not None else None

    def send_tick(self, tick: DueTick) -> bool:
        """Grant a tick; False if there is no room for it now."""
        if not tick.module:
            # No module gets this message. It makes the core look which module is free now.
            return self._module.publish(Tick(due=Time.from_nanoseconds(tick.due_ns)))
        self.schedule.granted(tick.module)
        self._remember(0)
        if self._module.publish(Tick(due=Time.from_nanoseconds(tick.due_ns)), topic=tick.module):
            return True
        self.schedule.due_ns[tick.module] = tick.due_ns
        return False

    def announce(self, before_ns: int, after_ns: int, reason: str) -> None:
        """Announce that the time has jumped; every module's next tick is then due at once."""
        self.schedule.restart(after_ns)
        super().announce(before_ns, after_ns, reason)
