"""Plays one input as a hostile module, and checks the core after each step and at the end."""

import contextlib

from robbie_mp import MessageHandling
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Inbound, Outbound
from tests.bus.core._support.siege import HOSTILE_SLOT, Siege
from tests.bus.core._support.simulated_run import RING_RECORDS, TYPE
from tools.fuzz.core.judge import Standing, Verdict
from tools.fuzz.core.steps import decode
from tools.fuzz.core.words import dictionary

KINDS = (*Outbound, 0, max(Outbound) + 1, 255)
CONTROL_WORDS: tuple[int, ...] = (
    layout.HEADER_MAGIC, *range(layout.OUT_HEAD, layout.OUT_READY + 1), layout.OUT_AWAITED_FREED,
)  # fmt: skip
DECLARED_WORDS = 4 * layout.DECLARATION_WORDS
RECORD_COLUMNS = 7
UNUSED = 255


class CoreFinding(AssertionError):
    """The core did something that it must not do."""


class SimulatedAttack:
    """One input, played against a new simulated run."""

    def __init__(self, data: bytes):
        self.siege = Siege()
        self._data = data
        self._has_scribbled = False
        """Whether the module's segment was overwritten. Its records can then no longer be judged."""
        self._is_faulted = False
        self._standing = self._fresh_standing()
        self._look()

    def run(self) -> None:
        """Take the steps, then check that the innocent modules got everything and that the counters add up.

        Raises:
            Exception: any is a finding.
        """
        for what, numbers in decode(self._data):
            getattr(self, f"_{what.name.lower()}")(numbers)
            self._look()
        self.siege.end()
        self._look()
        check_books(self.siege)

    # -- steps -------------------------------------------------------------------------------------------

    def _record(self, numbers: bytes) -> None:
        """Push a valid record, changed as the numbers say: its kind, then pairs of column and word."""
        self.siege.core()
        self._look()
        self.siege.hold()
        words = self._right_record(KINDS[numbers[0] % len(KINDS)])
        values = dictionary(self.siege)
        for column, value in zip(numbers[1:5:2], numbers[2:5:2], strict=True):
            if column != UNUSED:
                words[column % RECORD_COLUMNS] = values[value % len(values)]
        self._push(words)

    def _scribble(self, numbers: bytes) -> None:
        self._has_scribbled = True
        self.siege.scribble(place(*numbers[:3]), self._value(numbers[3]))

    def _core(self, _numbers: bytes) -> None:
        self.siege.core()

    def _publish(self, _numbers: bytes) -> None:
        self.siege.publish()

    def _handle(self, _numbers: bytes) -> None:
        self.siege.handle()

    def _behave(self, _numbers: bytes) -> None:
        self.siege.behave()

    def _declare(self, numbers: bytes) -> None:
        """Subscribe or advertise correctly. Errors that this causes in the hostile module do not matter."""
        hostile, topic = self.siege.hostile, str(numbers[1] % 4)
        handlings = list(MessageHandling)
        handling = handlings[numbers[2] % len(handlings)]
        with contextlib.suppress(ValueError, OverflowError):
            if numbers[0] % 2:
                hostile.subscribe(handling, topic)
            else:
                self._standing.advertised.add(hostile.advertise(topic, TYPE))
            self._standing.declared += 1

    def _core_dies(self, numbers: bytes) -> None:
        """Let the core die in its next steps, and overwrite a word before the next core reads it."""
        self._has_scribbled = True
        self.siege.core_dies(numbers[0], place(*numbers[1:4]), self._value(numbers[4]))

    def _restart_core(self, _numbers: bytes) -> None:
        self.siege.run.fuse.deaths = []
        self.siege.run.restart_core()

    def _restart_hostile(self, _numbers: bytes) -> None:
        self.siege.restart_hostile()
        self._has_scribbled = self._is_faulted = False
        self._standing = self._fresh_standing()

    # -- records -----------------------------------------------------------------------------------------

    def _right_record(self, kind: int) -> list[int]:
        """Return a valid record of a kind, if the present state allows one."""
        siege = self.siege
        held = next(iter(siege.held.values()), None)
        reference, sequence = (held.reference, held.sequence) if held else (0, 0)
        source = layout.pack_source(HOSTILE_SLOT, 0, siege.hostile.incarnation)
        rest = {
            Outbound.ADVERTISE: [siege.hostile_channel],
            Outbound.SUBSCRIBE: [siege.hostile_channel + 1],
            Outbound.PUBLISH: [siege.hostile_channel, source, 64, 8, 0, 1],
            Outbound.DONE: [reference, sequence],
            Outbound.RELEASE: [reference, sequence],
            Outbound.WAIT_FREED: [1],
            Outbound.MAKE_ROOM: [0, 0, 1 << 60],
            Outbound.MODULE_UP: [siege.publisher.slot, 2],
            Outbound.MODULE_DOWN: [siege.subscriber.slot, 1, 0],
            Outbound.MODULE_GONE: [siege.subscriber.slot, 0],
        }.get(Outbound(kind) if kind in list(Outbound) else Outbound.READY, [])
        return [int(kind), *rest, *[0] * (RECORD_COLUMNS - 1 - len(rest))]

    def _push(self, words: list[int]) -> None:
        """Push a record, let the core take it, and compare what the core did with what it must do."""
        siege, standing = self.siege, self._standing
        standing.held = {one.reference: one.sequence for one in siege.held.values()}
        may_be_said_again = self._may_be_said_again()
        was_faulted, before = self._is_faulted, self._last_sequence()
        siege.record(*words)
        siege.core()
        self._look()
        if self._has_scribbled:
            return
        verdict = Verdict.WRONG if was_faulted else standing.judge(words)
        if verdict is Verdict.WRONG and may_be_said_again and words[0] in (Outbound.DONE, Outbound.RELEASE):
            return  # the previous core may have handled the first record after a takeover
        self._compare(words, verdict)
        routed = self._last_sequence() - before
        if routed not in ((0, 1) if verdict is Verdict.RIGHT and words[0] == Outbound.PUBLISH else (0,)):
            raise CoreFinding(f"record {words}: {routed} messages were routed")
        if verdict is not Verdict.WRONG and not self._is_faulted:
            standing.take(words)
            if words[0] == Outbound.RELEASE:
                del siege.held[words[1]]

    def _compare(self, words: list[int], verdict: Verdict) -> None:
        if verdict is not Verdict.OPEN and self._is_faulted is not (verdict is Verdict.WRONG):
            did = "was" if self._is_faulted else "was not"
            raise CoreFinding(f"record {words} is {verdict.name}, but its module {did} faulted")

    def _may_be_said_again(self) -> bool:
        link = self.siege.run.router._slots[HOSTILE_SLOT].link
        return bool(self.siege.run.fuse.deaths) or link is None or link.is_repeated()

    # -- what holds after each step ------------------------------------------------------------------------

    def _look(self) -> None:
        """Check which modules the core faulted, and which messages the innocent subscriber received."""
        for kind, slot, incarnation in self.siege.run.supervisor_notices():
            if slot != HOSTILE_SLOT:
                raise CoreFinding(f"the core reports {kind.name} for slot {slot}, which is innocent")
            if kind is Inbound.FAULTED and incarnation == self.siege.hostile.incarnation:
                self._is_faulted = True
        if self.siege.seen != self.siege.published[: len(self.siege.seen)]:
            raise CoreFinding(f"the subscriber received {self.siege.seen} of {self.siege.published}")

    def _value(self, number: int) -> int:
        values = dictionary(self.siege)
        return values[number % len(values)]

    def _last_sequence(self) -> int:
        return self.siege.run.words[layout.CORE_LAST_SEQUENCE]

    def _fresh_standing(self) -> Standing:
        source = layout.pack_source(HOSTILE_SLOT, 0, self.siege.hostile.incarnation)
        return Standing(source, declared=3, advertised={self.siege.hostile_channel})


def place(choice: int, high: int, low: int) -> int:
    """Choose a word of the segment: half of the time one of the few control words."""
    number = high << 8 | low
    if choice % 4 < 2:
        return CONTROL_WORDS[number % len(CONTROL_WORDS)]
    if choice % 4 == 2:
        return layout.OUT_DECLARATIONS + number % DECLARED_WORDS
    ring_words = layout.out_words(RING_RECORDS) - layout.OUT_RING
    return layout.OUT_RING + number % ring_words


def check_books(siege: Siege) -> None:
    """Check that every routed message was delivered, replaced, dropped or lost.

    Raises:
        Finding: a message was not, or it still waits although everything has been handled.
    """
    run = siege.run
    for number in range(run.tables.sizes.subscriptions):
        counts = run.counts(number)
        if counts["routed"] != sum(counts.values()) - counts["routed"]:
            raise CoreFinding(f"subscription {number}: {counts}")
    for slot in range(run.tables.sizes.slots):
        if run.waiting(slot):
            raise CoreFinding(f"{run.waiting(slot)} messages of slot {slot} still wait at the end")
