"""The dictionary: words that are likely to reveal errors. Some of them depend on the present state."""

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.words import WORD_MAX
from tests.bus.core._support.siege import HOSTILE_SLOT, Siege
from tests.bus.core._support.simulated_run import CREDIT, RING_RECORDS

SMALL = tuple(range(13))
EDGES = (
    CREDIT + 1, RING_RECORDS, RING_RECORDS + 1, 64, 255, 256, 257, 1 << 16, 1 << 20, (1 << 20) + 1, 1 << 31,
    1 << 32, (1 << 63) - 1, 1 << 63, WORD_MAX - 1, WORD_MAX,
)  # fmt: skip


def dictionary(siege: Siege) -> list[int]:
    """Return all words. Their number and the meaning of each place never change."""
    hostile = siege.hostile
    held = next(iter(siege.held.values()), None)
    reference, sequence = (held.reference, held.sequence) if held else (0, 0)
    others, others_sequence = _reference_of_another(siege)
    head = hostile.out[layout.OUT_HEAD]
    return [
        *SMALL,
        *EDGES,
        layout.pack_source(HOSTILE_SLOT, 0, hostile.incarnation),
        layout.pack_source(HOSTILE_SLOT, 5, hostile.incarnation),
        layout.pack_source(HOSTILE_SLOT, 0, hostile.incarnation + 1),
        layout.pack_source(HOSTILE_SLOT, 0, hostile.incarnation - 1),
        *(layout.pack_source(slot, 0, 1) for slot in (0, 1, 2)),
        reference,
        sequence,
        (sequence + 1) & WORD_MAX,
        others,
        others_sequence,
        head,
        (head + 1) & WORD_MAX,
        (head - 1) & WORD_MAX,
        (head + RING_RECORDS + 1) & WORD_MAX,
    ]


def _reference_of_another(siege: Siege) -> tuple[int, int]:
    """Return number and sequence of a reference that the hostile module does not hold, or zeros."""
    tables = siege.run.tables
    for number in range(tables.sizes.references):
        at = tables.reference(number)
        if siege.run.words[at] and number not in siege.held:
            return number, siege.run.words[at + layout.REFERENCE_SEQUENCE]
    return 0, 0
