"""Warns of subscriptions that no module publishes for, and of topics renamed in vain."""

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.bus.observe import RunObserver
from robbie_mp.module.calls.peers import topic_of_service
from robbie_mp.run.trace.kinds import Kind

CHECK_PERIOD_S = 1.0
AGAIN_S = 0.2
"""Time until what was found for the first time is checked again."""


class ConnectionWatch:
    """Says once for each subscription that it is unconnected, and for each renamed topic that it is unused.

    A check costs well below a millisecond for each module, and no other process.

    Args:
        observer: reads the run.
        say: writes an entry of the supervisor into the trace.
        renamed: by module, the topics that the profile renames, as the module's code names them.
        clock: monotonic time in s.
    """

    def __init__(
        self,
        observer: RunObserver,
        say: Callable[[Kind, str], None],
        renamed: Mapping[str, Collection[str]] = MappingProxyType({}),
        clock: Callable[[], float] = time.monotonic,
    ):
        self._observer = observer
        self._say = say
        self._clock = clock
        self._renamed = {name: topics for name, topics in renamed.items() if topics}
        self._next_s = 0.0
        self._suspected: set[tuple[object, ...]] = set()
        self._told: set[tuple[object, ...]] = set()

    def turn(self) -> None:
        """Check, if it is time for that."""
        if self._clock() < self._next_s:
            return
        self._next_s = self._clock() + CHECK_PERIOD_S
        found: dict[tuple[object, ...], str] = {
            (module, one.type_name, one.version, one.topic): f"{module} {one}"
            for module, alone in self._observer.unconnected().items()
            for one in alone
        }
        found |= self._renamed_in_vain() if self._renamed else {}
        # A module may subscribe late: only what was found twice counts.
        for key in [key for key in found if key in self._suspected and key not in self._told]:
            self._told.add(key)
            self._say(Kind.WARNING, found[key])
        if set(found) - self._suspected:
            self._next_s = self._clock() + AGAIN_S
        self._suspected = set(found)

    def _renamed_in_vain(self) -> dict[tuple[object, ...], str]:
        """Return a text for each topic that the profile renames, but that its module has never used."""
        used = {module: _with_services(topics) for module, topics in self._observer.own_topics().items()}
        return {
            (module, topic): f"modules.{module}.topics: {module} has not used a topic '{topic}' so far"
            f"{did_you_mean(topic, used[module]) or _named(used[module])}"
            for module, topics in self._renamed.items()
            if module in used
            for topic in topics
            if topic not in used[module]
        }


def _with_services(topics: Sequence[str]) -> list[str]:
    """Return own topics with the names of services in place of the topics of their requests."""
    names = (topic_of_service(topic) for topic in topics)
    return [topic if name is None else name for topic, name in zip(topics, names, strict=True)]


def _named(topics: Sequence[str]) -> str:
    return "; its topics are " + ", ".join(f"'{topic}'" for topic in topics) if topics else ""
