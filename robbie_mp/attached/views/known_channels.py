"""The channels that a run knows."""

from contextlib import closing

from robbie_mp.bus.observe import RunObserver
from robbie_mp.bus.transport.declarations import read_declarations
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.run.run_directory import KnownRun


def channels_of_run(run: KnownRun) -> set[ChannelName]:
    """Return the channels that modules publish or have published, or subscribe to by type and topic."""
    with closing(RunObserver(run.run_id)) as observer:
        routed = {ChannelName(one.type_name, one.version, one.topic) for one in observer.channels()}
    declared = {entry.name for entry in read_declarations(run.run_id) if not entry.is_by_patterns}
    current = {(one.type_name, one.topic) for one in declared}  # so another version there is of the past
    return declared | {one for one in routed if (one.type_name, one.topic) not in current}
