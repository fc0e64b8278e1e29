"""The layout of shared memory: where each word lies.

Each segment has exactly one writing process. Offsets are in words of 8 bytes; `*_WORDS` is a size. When you
change anything here, raise `LAYOUT_VERSION` in `robbie_mp/base/version.py`: every segment carries it, and
attaching checks it.

    segment     written by         read by
    board       supervisor         all: state of every module
    core        core               all: channels, subscriptions, counters, handle and reference tables
    out         the module         core, supervisor, tools: outbound ring, declarations, own counters
    in          core               the module: inbound ring, freed ring
    data        the module         its subscribers: the messages themselves
    checkpoint  the module         its next incarnation: saved state
    clock       one module         all: the run's clock, in a run that has its own time
    history     the module         what writes a capsule after its death: what it has handled
"""

from enum import IntEnum

from robbie_mp.base.version import LAYOUT_VERSION as LAYOUT_VERSION  # noqa: PLC0414 (a part of the layout)

MAGIC = int.from_bytes(b"ROBBIEMP", "little")


class SegmentKind(IntEnum):
    """The kind of a segment's contents."""

    BOARD = 1
    CORE = 2
    OUT = 3
    IN = 4
    DATA = 5
    CHECKPOINT = 6
    CLOCK = 7
    WAKEUP = 8
    HISTORY = 9


# The header of every segment.
HEADER_MAGIC = 0
HEADER_VERSION = 1
HEADER_KIND = 2
HEADER_BYTES = 3
HEADER_SLOT = 4
HEADER_INCARNATION = 5
HEADER_CREATOR_PID = 8
HEADER_CREATOR_START = 9
HEADER_WORDS = 16

NAME_WORDS = 13  # a text of up to 96 bytes: module, type and topic names
NAME_BYTES = (NAME_WORDS - 1) * 8
LINE_WORDS = 33  # a text of up to 256 bytes: status lines, reasons

# board: one row for each slot. Slot 0 is the supervisor, which publishes and subscribes like a module. The
# core has the last row. It is never connected with itself: the newest messages of latched channels wait
# in its queue.
BOARD_GO = HEADER_WORDS
BOARD_SLOTS = HEADER_WORDS + 1
BOARD_GO_NS = HEADER_WORDS + 2  # when BOARD_GO was set, monotonic clock
BOARD_ROWS = HEADER_WORDS + 16
SLOT_STATE = 0
SLOT_PID = 1
SLOT_INCARNATION = 2
SLOT_RESTARTS = 3
SLOT_STARTED_NS = 4
SLOT_PAST_PUBLISHED = 5
SLOT_PAST_REFUSED = 6
SLOT_PAST_HANDLED = 7
SLOT_PAST_CPU_NS = 8
SLOT_NAME = 9
SLOT_REASON = SLOT_NAME + NAME_WORDS
SLOT_LAST_END = SLOT_REASON + LINE_WORDS  # how its last process ended, a text as long as a reason
SLOT_LAST_END_NS = SLOT_LAST_END + LINE_WORDS
SLOT_QUEUE_MESSAGES = SLOT_LAST_END_NS + 1  # limits of the profile, written once
SLOT_QUEUE_BYTES = SLOT_LAST_END_NS + 2
SLOT_MEMORY_BYTES = SLOT_LAST_END_NS + 3
SLOT_PAST_CHECKPOINTS = SLOT_LAST_END_NS + 4
SLOT_PAST_ILL_FORMED = SLOT_PAST_CHECKPOINTS + 1
SLOT_HEALTH = SLOT_PAST_ILL_FORMED + 1  # why its figures make it DEGRADED, a text as long as a reason
SLOT_WORDS = 128

# core: its counters, then five tables, whose sizes the profile sets.
CORE_HEARTBEAT_NS = HEADER_WORDS
CORE_LAST_SEQUENCE = HEADER_WORDS + 1
CORE_WAKEUPS = HEADER_WORDS + 2
CORE_FAULTS = HEADER_WORDS + 3
CORE_SLOTS = HEADER_WORDS + 4
CORE_CHANNELS = HEADER_WORDS + 5
CORE_SUBSCRIPTIONS = HEADER_WORDS + 6
CORE_HANDLES = HEADER_WORDS + 7
CORE_REFERENCES = HEADER_WORDS + 8
CORE_HANDLES_USED = HEADER_WORDS + 9
CORE_REFERENCES_USED = HEADER_WORDS + 10
CORE_SETTLED = HEADER_WORDS + 11  # in lockstep: the last sequence when no message was left to handle
CORE_HOT_PATH = HEADER_WORDS + 12  # a HotPath; 0: the core has not chosen yet
CORE_NOT_GIVEN = HEADER_WORDS + 13  # latched messages that new subscribers missed: no reference was free
CORE_ASLEEP = HEADER_WORDS + 14  # whether it sleeps until a post; see wakeup.py
CORE_TABLES = HEADER_WORDS + 16

# A publisher's row, one for each slot.
PUBLISHER_ROUTED = 0
PUBLISHER_REFUSED = 1
PUBLISHER_WAITING = 2
PUBLISHER_WAITING_BYTES = 3
PUBLISHER_IN_FLIGHT = 4
PUBLISHER_PINNED = 5
PUBLISHER_WAITING_PEAK = 6
PUBLISHER_LINKED = 7  # the connected incarnation, 0 if there is none
PUBLISHER_READY = 8  # the incarnation that has finished its setup
# The record that was refused last. `nth` is written first, and the count of refused messages, which commits
# them, last: the words are only valid if that count has reached `nth`.
PUBLISHER_REFUSED_NTH = 9
PUBLISHER_REFUSED_INCARNATION = 10
PUBLISHER_REFUSED_RECORD = 11
PUBLISHER_LAST_INCARNATION = 12  # the last one that was ever connected
PUBLISHER_WORDS = 13

# A channel's row: a message type, its version and a topic. The name is written last, the state after it.
CHANNEL_STATE = 0
CHANNEL_VERSION = 1
CHANNEL_MESSAGES = 2
CHANNEL_BYTES = 3
CHANNEL_LAST_STAMP_NS = 4
CHANNEL_INTERVALS_SQUARED = 5  # of stamps in whole µs; sum over all messages, in µs², modulo 2^64
CHANNEL_TYPE = 6
CHANNEL_TOPIC = CHANNEL_TYPE + NAME_WORDS
CHANNEL_PUBLISHERS = CHANNEL_TOPIC + NAME_WORDS  # a bit for each slot that has ever advertised it
CHANNEL_PUBLISHERS_WORDS = 4  # the slots from 256 on are not noted
CHANNEL_WORDS = CHANNEL_PUBLISHERS + CHANNEL_PUBLISHERS_WORDS

# A subscription's row. `routed = delivered + replaced + dropped + lost + waiting`, waiting being derived.
SUBSCRIPTION_STATE = 0
SUBSCRIPTION_SLOT = 1
SUBSCRIPTION_HANDLING = 2
SUBSCRIPTION_VERSION = 3
SUBSCRIPTION_ROUTED = 4  # the first counter; for the others see `SubscriptionCounts`
SUBSCRIPTION_COUNTERS = 5
SUBSCRIPTION_LAST_SEQUENCE = SUBSCRIPTION_ROUTED + SUBSCRIPTION_COUNTERS
SUBSCRIPTION_TYPE = SUBSCRIPTION_LAST_SEQUENCE + 1
SUBSCRIPTION_TOPIC = SUBSCRIPTION_TYPE + NAME_WORDS
SUBSCRIPTION_LEFT = SUBSCRIPTION_TOPIC + NAME_WORDS  # see `left_waiting`
SUBSCRIPTION_DEADLY = SUBSCRIPTION_LEFT + 1  # latched messages over which its module died; see `note_death`
DEADLY_COUNT = 3
DEADLY_BITS = 24  # of an incarnation; the other bits of the word are of a sequence
SUBSCRIPTION_WORDS = 40

# A handle's row: one message. The sequence is its commit word: written last, 0 while the row is free.
HANDLE_SEQUENCE = 0
HANDLE_RECORD = 1
HANDLE_SOURCE = 2
HANDLE_OFFSET = 3
HANDLE_BYTES = 4
HANDLE_CHANNEL = 5
HANDLE_STAMP_NS = 6
HANDLE_BLOCK = 7
HANDLE_PUBLISHER_ROUTED = 8
HANDLE_CHANNEL_MESSAGES = 9
HANDLE_CHANNEL_BYTES = 10
HANDLE_WORDS = 12

# A reference's row: one message for one subscription. The state is its commit word.
REFERENCE_STATE = 0
REFERENCE_SEQUENCE = 1
REFERENCE_HANDLE = 2
REFERENCE_SUBSCRIPTION = 3
REFERENCE_PUSHED_AT = 4  # number of the inbound record that brings it, plus one; 0 while it waits
REFERENCE_WORDS = 5

# out: words that the module alone writes.
OUT_HEAD = HEADER_WORDS
OUT_INBOUND_TAIL = HEADER_WORDS + 1
OUT_FREED_TAIL = HEADER_WORDS + 2
OUT_READY = HEADER_WORDS + 3
OUT_ACTIVITY_SINCE_NS = HEADER_WORDS + 4
OUT_ACTIVITY = HEADER_WORDS + 5
OUT_PUBLISHED = HEADER_WORDS + 6
OUT_REFUSED = HEADER_WORDS + 7
OUT_HANDLED = HEADER_WORDS + 8
OUT_TICKS = HEADER_WORDS + 9
OUT_TICKS_MISSED = HEADER_WORDS + 10
OUT_PINNED = HEADER_WORDS + 11
OUT_BLOCKS = HEADER_WORDS + 12
OUT_SEGMENT_BYTES = HEADER_WORDS + 13
OUT_SEGMENTS = HEADER_WORDS + 14
OUT_AWAITED_FREED = HEADER_WORDS + 15  # total of freed blocks that the module waits for
OUT_PINNED_BYTES = HEADER_WORDS + 16
OUT_TICK_PERIOD_NS = HEADER_WORDS + 17  # in lockstep: period of its ticks; 0: none
OUT_AWAITS_SETTLED = HEADER_WORDS + 18  # in lockstep: wake it when no message is left to handle
OUT_COPIED = HEADER_WORDS + 19  # messages copied because too much of their publishers' memory is pinned
OUT_HOT_PATH = HEADER_WORDS + 20  # a HotPath; 0: the process has not chosen yet
# In lockstep with charged handlers: the run's time at which the last one began, and how long it took.
OUT_CHARGED_SINCE_NS = HEADER_WORDS + 21
OUT_CHARGED_NS = HEADER_WORDS + 22
OUT_ILL_FORMED = HEADER_WORDS + 23  # ill-formed messages that no handler got, or that were not let in
OUT_ASLEEP = HEADER_WORDS + 24  # whether it sleeps until a post; see wakeup.py
OUT_TICKS_WAIT = HEADER_WORDS + 25  # whether its ticks wait for a device, so that missed ones mean nothing
OUT_PACES = HEADER_WORDS + 26  # whether it has waited for its blocks or counted them
OUT_STATUS = HEADER_WORDS + 27
OUT_STATES = OUT_STATUS + LINE_WORDS  # states of its state machines, a text like the status line
OUT_HEALTH = OUT_STATES + LINE_WORDS  # why the module is DEGRADED, such a text, too; '': it is OK
OUT_CHECKPOINTS = OUT_HEALTH + LINE_WORDS  # checkpoints that this incarnation has saved
OUT_DECLARATIONS = OUT_CHECKPOINTS + 4
DECLARATION_COUNT = 256
MAX_PATTERNS = 32  # subscriptions by patterns of a module: the core looks at each for every new channel
DECLARATION_KIND = 0
DECLARATION_VERSION = 1
DECLARATION_HANDLING = 2  # of a channel, KEEP_ONLY_NEWEST: it is latched
DECLARATION_TYPE = 4
DECLARATION_TOPIC = DECLARATION_TYPE + NAME_WORDS
DECLARATION_HANDLER = DECLARATION_TOPIC + NAME_WORDS  # name of a subscription's function
DECLARATION_OPTIONAL = DECLARATION_HANDLER + NAME_WORDS  # 1: a subscription that nobody needs to publish for
DECLARATION_OWN_TOPIC = DECLARATION_OPTIONAL + 1  # the topic as the module's code names it
# For a subscription: when its newest message was published, how old that may become, how often it was older,
# and the greatest age then.
DECLARATION_NEWEST_NS = DECLARATION_OWN_TOPIC + NAME_WORDS
DECLARATION_DEADLINE_NS = DECLARATION_NEWEST_NS + 1  # 0: any age
DECLARATION_LATENESSES = DECLARATION_NEWEST_NS + 2
DECLARATION_GREATEST_AGE_NS = DECLARATION_NEWEST_NS + 3
DECLARATION_WORDS = 64
# Four histograms: latency and handler time of messages, lateness and length of ticks.
HISTOGRAM_BUCKETS = 496  # for times up to 2^40 ns
HISTOGRAM_WORDS = 2 + HISTOGRAM_BUCKETS  # sum and maximum before them
OUT_MESSAGE_FIGURES = OUT_DECLARATIONS + DECLARATION_COUNT * DECLARATION_WORDS
OUT_TICK_FIGURES = OUT_MESSAGE_FIGURES + 2 * HISTOGRAM_WORDS
OUT_RING = OUT_TICK_FIGURES + 2 * HISTOGRAM_WORDS

# in: words that the core alone writes.
IN_OUTBOUND_TAIL = HEADER_WORDS
IN_HEAD = HEADER_WORDS + 1
IN_FREED_HEAD = HEADER_WORDS + 2
IN_WANT_RELEASE = HEADER_WORDS + 3
IN_RING = HEADER_WORDS + 16

# data: the messages lie after these words.
DATA_FREE_BYTES = HEADER_WORDS  # free memory of the publisher when it last took a block of this segment
DATA_BLOCKS = HEADER_WORDS + 8

# checkpoint: a module alternates between two. The sequence is the commit word: written last, and 0 while the
# segment has no complete checkpoint. Its highest bit is set when a newer one is complete. The image starts at
# a multiple of 64 bytes.
CHECKPOINT_SEQUENCE = HEADER_WORDS
CHECKPOINT_IMAGE = HEADER_WORDS + 8

# clock: rows are numbered from 1 and written in turn. The number of the newest row, which is the valid one,
# is written after the row; it is 0 until the run's time has begun.
CLOCK_NUMBER = HEADER_WORDS
CLOCK_ROWS = HEADER_WORDS + 8
CLOCK_MACHINE_NS = 0  # the machine's monotonic time at which ...
CLOCK_RUN_NS = 1  # ... it was this time in the run
CLOCK_RATE = 2  # s of the run in each s of the machine, times 2^32
CLOCK_LIMIT_NS = 3  # the run's time does not pass this
CLOCK_JUMPS = 4  # times that it has been set to another time
CLOCK_SMOOTH_SINCE_NS = 5  # run's time since when it has run at this rate without a stop
CLOCK_ROW_WORDS = 8
CLOCK_ROW_COUNT = 1024  # the last rows, to convert the stamps of earlier messages
CLOCK_WORDS = CLOCK_ROWS + CLOCK_ROW_COUNT * CLOCK_ROW_WORDS

# history: records of what a module has handled, in a ring of bytes; see history.py. Both byte numbers count
# from the module's start, and the tail is advanced before the record there is overwritten. The ring's
# capacity grows until it is overwritten for the first time.
HISTORY_HEAD = HEADER_WORDS
HISTORY_TAIL = HEADER_WORDS + 1
HISTORY_RECORDS = HEADER_WORDS + 2  # number of records ever written
HISTORY_START_BYTES = HEADER_WORDS + 3
HISTORY_CAPACITY = HEADER_WORDS + 4  # of the ring, bytes
HISTORY_START = HEADER_WORDS + 8  # what the module began with, a text that is never overwritten
HISTORY_START_WORDS = 8192
HISTORY_RING = HISTORY_START + HISTORY_START_WORDS
HISTORY_RECORD_WORDS = 8  # kind and whole size, number, size of the data, time, four words; then the data

# What wakes a process; all that wake it write it. See wakeup.py.
WAKEUP_POSTS = HEADER_WORDS + 0  # a change of its lower half is a post
WAKEUP_WORDS = HEADER_WORDS + 1

RECORD_WORDS = 8
FREED_RECORDS = 8192
MAX_OUTSTANDING = FREED_RECORDS // 2  # live messages of a module; a core that takes over may free some twice


class Activity(IntEnum):
    """A module's activity since `OUT_ACTIVITY_SINCE_NS`; a handler adds its subscription from bit 8 on."""

    IDLE = 0
    SETUP = 1
    HANDLER = 2
    TICK = 3
    TEARDOWN = 4


class ModulePhase(IntEnum):
    """How far a module has come, in `OUT_READY`."""

    READY = 1
    """Its setup is finished."""
    ENDED = 2
    """It has ended as it was meant to."""


class HotPath(IntEnum):
    """The language of a process's hot path."""

    PYTHON = 1
    C = 2


def core_words(slots: int, channels: int, subscriptions: int, handles: int, references: int) -> int:
    """Size of the core segment in words."""
    return (
        CORE_TABLES
        + slots * PUBLISHER_WORDS
        + channels * CHANNEL_WORDS
        + subscriptions * SUBSCRIPTION_WORDS
        + handles * HANDLE_WORDS
        + references * REFERENCE_WORDS
    )


def board_words(slots: int) -> int:
    """Size of the board in words."""
    return BOARD_ROWS + slots * SLOT_WORDS


def out_words(ring_records: int) -> int:
    """Size of a module's out segment in words."""
    return OUT_RING + ring_records * RECORD_WORDS


def newest_at(declaration: int) -> int:
    """Word of an out segment that shows when the newest message of a subscription was published."""
    return OUT_DECLARATIONS + declaration % DECLARATION_COUNT * DECLARATION_WORDS + DECLARATION_NEWEST_NS


def inbound_records(credit: int) -> int:
    """Records of an inbound ring: room for its credit and as many notices, rounded up to a power of two."""
    return 1 << (2 * credit - 1).bit_length()


def in_words(credit: int) -> int:
    """Size of a module's in segment in words."""
    return IN_RING + inbound_records(credit) * RECORD_WORDS + FREED_RECORDS


def pack_source(slot: int, segment: int, incarnation: int) -> int:
    """One word that names a data segment of a run: 16 bits slot, 16 bits segment, 32 bits incarnation."""
    return slot | segment << 16 | incarnation << 32


SOURCE_SLOT = 0xFFFF
"""Mask of the slot in such a word."""
SOURCE_OF_INCARNATION = pack_source(0xFFFF, 0, 0xFFFFFFFF)
"""Mask of what all data segments of an incarnation have in common."""


def unpack_source(source: int) -> tuple[int, int, int]:
    """Return slot, segment and incarnation."""
    return source & 0xFFFF, source >> 16 & 0xFFFF, source >> 32
