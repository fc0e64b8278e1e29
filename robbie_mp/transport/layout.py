"""Where each word of the shared memory lies: one table, for writers, readers and tools alike.

Each segment has exactly one writing process. Offsets are counted in words of 8 bytes; `*_WORDS` is a size.
Change anything here and raise `LAYOUT_VERSION`: it is stamped in every segment and checked on attaching.

    segment     written by         read by
    board       supervisor         all: who runs, in which state
    core        core               all: channels, subscriptions, counters, handle and reference tables
    out         the module         core, supervisor, tools: outbound ring, declarations, own counters
    in          core               the module: inbound ring, freed ring
    data        the module         its subscribers: the messages themselves
    checkpoint  the module         its next incarnation: its state
    clock       one module         all: the run's time, where it is not the machine's
"""

from enum import IntEnum

LAYOUT_VERSION = 7
MAGIC = int.from_bytes(b"ROBBIEMP", "little")


class SegmentKind(IntEnum):
    """What a segment holds."""

    BOARD = 1
    CORE = 2
    OUT = 3
    IN = 4
    DATA = 5
    CHECKPOINT = 6
    CLOCK = 7


# The header of every segment.
HEADER_MAGIC = 0
HEADER_VERSION = 1
HEADER_KIND = 2
HEADER_BYTES = 3
HEADER_SLOT = 4
HEADER_INCARNATION = 5
HEADER_CREATOR_PID = 8
HEADER_CREATOR_START = 9
HEADER_WAKEUP = 10  # tag of the semaphore that wakes who reads this; of "in" segments and the core's
HEADER_WORDS = 16

NAME_WORDS = 13  # a text of up to 96 bytes: module, type and topic names
NAME_BYTES = (NAME_WORDS - 1) * 8
LINE_WORDS = 33  # a text of up to 256 bytes: status lines, reasons

# board: one row a slot. Slot 0 is the supervisor itself, which is a participant like the modules; the core,
# which is none, has the last row.
BOARD_GO = HEADER_WORDS
BOARD_SLOTS = HEADER_WORDS + 1
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
SLOT_WORDS = 96

# core: counters of its own, then five tables whose sizes are in the profile.
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
CORE_SETTLED = HEADER_WORDS + 11  # in lockstep: the last sequence when there was nothing left to handle
CORE_TABLES = HEADER_WORDS + 16

# A publisher's row, one a slot.
PUBLISHER_ROUTED = 0
PUBLISHER_REFUSED = 1
PUBLISHER_WAITING = 2
PUBLISHER_WAITING_BYTES = 3
PUBLISHER_IN_FLIGHT = 4
PUBLISHER_PINNED = 5
PUBLISHER_WAITING_PEAK = 6
PUBLISHER_LINKED = 7  # the incarnation that is connected, 0 if none is
PUBLISHER_READY = 8  # the incarnation that has finished its setup
# Which record was refused last. It is written before the count of refused messages, its commit word, and only
# counts if that has reached `nth`, which is written first.
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
CHANNEL_INTERVALS_SQUARED = 5  # sum over all messages, in us², modulo 2^64
CHANNEL_TYPE = 6
CHANNEL_TOPIC = CHANNEL_TYPE + NAME_WORDS
CHANNEL_WORDS = 32

# A subscription's row. `routed = delivered + replaced + dropped + lost + waiting`, waiting being derived.
SUBSCRIPTION_STATE = 0
SUBSCRIPTION_SLOT = 1
SUBSCRIPTION_HANDLING = 2
SUBSCRIPTION_VERSION = 3
SUBSCRIPTION_ROUTED = 4
SUBSCRIPTION_DELIVERED = 5
SUBSCRIPTION_REPLACED = 6
SUBSCRIPTION_DROPPED = 7
SUBSCRIPTION_LOST = 8
SUBSCRIPTION_LAST_SEQUENCE = 9
SUBSCRIPTION_TYPE = 10
SUBSCRIPTION_TOPIC = SUBSCRIPTION_TYPE + NAME_WORDS
SUBSCRIPTION_LEFT = SUBSCRIPTION_TOPIC + NAME_WORDS  # see `left_waiting`
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
OUT_AWAITED_FREED = HEADER_WORDS + 15  # as many blocks ever freed are waited for
OUT_PINNED_BYTES = HEADER_WORDS + 16
OUT_TICK_PERIOD_NS = HEADER_WORDS + 17  # in lockstep: how often it is to be granted a tick; 0: never
OUT_AWAITS_SETTLED = HEADER_WORDS + 18  # in lockstep: wants to be woken when nothing is left to handle
OUT_COPIED = HEADER_WORDS + 19  # messages copied because too much of their publishers' memory is pinned
OUT_STATUS = HEADER_WORDS + 24
OUT_STATES = OUT_STATUS + LINE_WORDS  # of its state machines, a text like the status line
OUT_DECLARATIONS = OUT_STATES + LINE_WORDS + 6
DECLARATION_COUNT = 256
PATTERN_COUNT = 32  # subscriptions by patterns of a module: the core looks at each for every new channel
DECLARATION_KIND = 0
DECLARATION_VERSION = 1
DECLARATION_HANDLING = 2
DECLARATION_TYPE = 4
DECLARATION_TOPIC = DECLARATION_TYPE + NAME_WORDS
DECLARATION_HANDLER = DECLARATION_TOPIC + NAME_WORDS  # name of the function, of a subscription
DECLARATION_WORDS = 48
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

# data: the messages lie behind these words.
DATA_FREE_BYTES = HEADER_WORDS  # of all the publisher's memory, when it took a block of this segment last
DATA_BLOCKS = HEADER_WORDS + 8

# checkpoint: one of the two that a module alternates between. The sequence is its commit word: written last,
# 0 while there is no checkpoint, or half of one. The image begins at a multiple of 64 bytes.
CHECKPOINT_SEQUENCE = HEADER_WORDS
CHECKPOINT_IMAGE = HEADER_WORDS + 8

# clock: rows are numbered from 1 on and written in turn; the number of the newest, which counts, is written
# after it, and is 0 until the run's time has begun
CLOCK_NUMBER = HEADER_WORDS
CLOCK_ROWS = HEADER_WORDS + 8
CLOCK_MACHINE_NS = 0  # the machine's monotonic time at which ...
CLOCK_RUN_NS = 1  # ... it was this time in the run
CLOCK_RATE = 2  # s of the run in each s of the machine, times 2^32
CLOCK_LIMIT_NS = 3  # the run's time does not pass this
CLOCK_JUMPS = 4  # so often it has been set to another time
CLOCK_SMOOTH_SINCE_NS = 5  # the run's time has gone on at this rate, without a stop, since it was this
CLOCK_ROW_WORDS = 8
CLOCK_ROW_COUNT = 1024  # the last ones, in turn: so the time of what was published before can be told
CLOCK_WORDS = CLOCK_ROWS + CLOCK_ROW_COUNT * CLOCK_ROW_WORDS

RECORD_WORDS = 8
FREED_RECORDS = 8192
OUTSTANDING_LIMIT = FREED_RECORDS // 2  # of a module's messages: cores that take over may free some twice


class Activity(IntEnum):
    """What a module is doing since `OUT_ACTIVITY_SINCE_NS`; a handler adds its subscription from bit 8 on."""

    IDLE = 0
    SETUP = 1
    HANDLER = 2
    TICK = 3
    TEARDOWN = 4


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


def inbound_records(credit: int) -> int:
    """Records of an inbound ring: its credits and as many notices again, rounded up to a power of two."""
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
