"""The queues of a run in lockstep: one message at a time is delivered. See `robbie_mp.module.lockstep`."""

from collections.abc import Sequence, Set

from robbie_mp.core.directory import Subscription
from robbie_mp.core.ledger import Handle, Ledger
from robbie_mp.core.link import Link, Slot
from robbie_mp.core.queues import Queues
from robbie_mp.transport.words import Words


class LockstepQueues(Queues):
    """Hands out the oldest message that waits for any module, once nobody has one.

    What a handler publishes is in the core's books before the handler's message is released, for both come
    through one ring. Of several modules that want the same message, the first in the profile gets it first.
    A module that is just being restarted is waited for.

    Args:
        words: the core segment, for the figures.
        ledger: every reference there is.
        slots: the modules.
        tools: slots of tools, which get their messages as they come.
    """

    def __init__(self, words: Words, ledger: Ledger, slots: Sequence[Slot], tools: Set[int]):
        super().__init__(words, ledger, slots)
        self._in_step = [slot for slot in slots if slot.index not in tools]
        self._tools = tools

    def add(self, subscription: Subscription, reference: int, handle: Handle) -> None:
        """Let a message wait for its turn; the oldest goes if too many wait."""
        if subscription.slot in self._tools:
            super().add(subscription, reference, handle)
            return
        slot = self._slots[subscription.slot]
        self._queue(slot, subscription, reference, handle.size)
        self.outdate(slot)

    def pump(self, slot: Slot, link: Link) -> None:
        """Push nothing: that is done at the end of each round, when all that was said has been heard."""
        if slot.index in self._tools:
            super().pump(slot, link)

    def end_round(self) -> None:
        """Hand out the next message if nobody has one."""
        if not self._is_anyone_busy():
            self._hand_out()
        super().end_round()

    def is_settled(self) -> bool:
        """Whether no module has a message or will get one."""
        return not self._is_anyone_busy() and not any(slot.waiting for slot in self._in_step)

    def _is_anyone_busy(self) -> bool:
        return any(slot.link is not None and self._is_busy(slot.link) for slot in self._in_step)

    def _is_busy(self, link: Link) -> bool:
        """Whether a module has a message that it still wants.

        One that was given up, because it hangs in the kernel and cannot be killed, has it for good.
        """
        return any(self._ledger.reference(reference)[2].is_open for reference in link.pushed)

    def _hand_out(self) -> None:
        waiting = [slot for slot in self._in_step if slot.waiting]
        if not waiting:
            return
        slot = min(waiting, key=self._next_sequence)  # the first of those that want the same one
        link = slot.link
        if link is None or not link.ready:
            return
        reference = next(iter(slot.waiting))
        _, handle, subscription = self._ledger.reference(reference)
        self.remove(slot, reference)
        self._push(subscription, reference, self._ledger.handle(handle), link)
        self.to_post.add(link)
        self.outdate(slot)

    def _next_sequence(self, slot: Slot) -> int:
        return self._ledger.reference(next(iter(slot.waiting)))[0]
