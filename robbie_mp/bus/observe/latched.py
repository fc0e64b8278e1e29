"""The newest messages of latched channels that the core keeps for later subscribers."""

from contextlib import closing

from robbie_mp.bus.observe.unhandled import STATE_BITS, rows_at
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.tables import ROW_OPEN, ChannelName, CoreTables, Outcome


def latched_bytes(run_id: str) -> dict[ChannelName, int]:
    """Return the latched channels of a run, with the size of the message that the core keeps of each.

    A size is 0 if the core keeps none: none has been published yet, or it was dropped. This only reads the
    core's tables, and so costs the robot nothing; a message that arrives meanwhile may show as 0.

    Args:
        run_id: the run.

    Raises:
        SegmentMissing: the run does not exist.
    """
    with closing(Segment.attach(names.core(run_id), SegmentKind.CORE)) as core:
        tables = CoreTables.attach(core.words)
        sizes = tables.sizes
        latches = {
            row.index: row.name
            for row in tables.subscriptions()
            if row.slot == sizes.slots - 1 and row.state == ROW_OPEN
        }
        references = rows_at(core, tables.reference(0), sizes.references, layout.REFERENCE_WORDS).copy()
        handles = rows_at(core, tables.handle(0), sizes.handles, layout.HANDLE_WORDS).copy()
    found = dict.fromkeys(latches.values(), 0)
    for reference in references[(references[:, layout.REFERENCE_STATE] & STATE_BITS) == Outcome.HELD]:
        name = latches.get(int(reference[layout.REFERENCE_SUBSCRIPTION]))
        handle = int(reference[layout.REFERENCE_HANDLE])
        if name is not None and handle < sizes.handles:
            found[name] = int(handles[handle, layout.HANDLE_BYTES])
    return found
