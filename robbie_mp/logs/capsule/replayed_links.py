"""The links to devices of a module that is replayed: what crossed them comes from a capsule."""

import json
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence

from robbie_mp.base.device_links import DeviceLink
from robbie_mp.bus.transport.history import Event, PortAct
from robbie_mp.logs.capsule.form import EventForm
from robbie_mp.logs.capsule.read import Step

LEAST_READ_S = 1e-3
"""A read of nothing lets this much time pass at least, so that loops that wait for an answer end."""
LEAST_LOOK_S = 1e-6
"""The same for a look at the clock."""


class LinkFailed(OSError):
    """A link to a device failed, as it did on the robot."""


class ReplayedLinks:
    """Opens links that give again what crossed them; see `Links`.

    The time is that of what happened last.

    Args:
        steps: what the module did.
    """

    def __init__(self, steps: Sequence[Step]):
        self._numbers = deque(sorted({event.values[1] for step in steps for event in _acts(step)} - {0}))
        self._acts: dict[int, deque[EventForm]] = defaultdict(deque)
        self._now_s = 0.0
        self.difference = ""
        """What was written first that was not written then, or otherwise."""

    def begin(self, step: Step) -> None:
        """Take what happened in a step. What was not yet read remains."""
        for number, acts in self._acts.items():
            self._acts[number] = deque(one for one in acts if one.values[0] == PortAct.READ and one.data)
        for event in _acts(step):
            self._acts[event.values[1]].append(event)
        if step.event is not None and step.event.time_ns:
            self._pass_to(step.event.time_ns)

    def open(self, _url: str, _opened: Callable[[], DeviceLink]) -> DeviceLink:
        """See `Links`."""
        opened = [number for number in self._numbers if self._waits(number, PortAct.OPENED)]
        number = opened[0] if opened else self._numbers[0] if self._numbers else -1
        while self._numbers and self._numbers[0] <= number:
            self._numbers.popleft()
        self.take(number, PortAct.OPENED)  # of a device that another module offers, the URL is another
        return ReplayedLink(self, number)

    def monotonic(self) -> float:
        """See `Links`."""
        self._now_s += LEAST_LOOK_S
        return self._now_s

    def sleep(self, wait_s: float) -> None:
        """See `Links`."""
        if self.take(0, PortAct.SLEPT) is None:
            self._now_s += max(wait_s, 0.0)

    def take(self, number: int, act: PortAct, crossed: bytes | None = None) -> bytes | None:
        """Do on a link what was done next then, and return the bytes that crossed it.

        Args:
            number: the link.
            act: what is done.
            crossed: the bytes that cross it now.

        Returns:
            None: it was not done then.

        Raises:
            LinkFailed: it failed then.
        """
        acts = self._acts[number]
        event = next((one for one in acts if one.values[0] == act), None)
        if event is None:
            return None
        acts.remove(event)
        self._pass_to(event.time_ns)
        data = event.data or b""
        if event.values[2]:
            raise failure(data)
        if crossed is not None and crossed != data and not self.difference:
            self.difference = f"{act.name.lower()} {crossed!r:.60}, it was {data!r:.60}"
        return data

    def read(self, number: int, wait_s: float) -> bytes:
        """Return what came next on a link."""
        data = self.take(number, PortAct.READ)
        if data is None:
            self._now_s += max(wait_s, LEAST_READ_S)
        return data or b""

    def _waits(self, number: int, act: PortAct) -> bool:
        return any(one.values[0] == act for one in self._acts[number])

    def _pass_to(self, time_ns: int) -> None:
        self._now_s = max(self._now_s, time_ns / 1e9)


class ReplayedLink:
    """A link that gives again what crossed it; see `DeviceLink`.

    Args:
        links: knows what crossed it.
        number: of the link.
    """

    descriptor = None

    def __init__(self, links: ReplayedLinks, number: int):
        self._links = links
        self._number = number

    def read(self, wait_s: float) -> bytes:
        """See `DeviceLink`."""
        return self._links.read(self._number, wait_s)

    def drain(self, _quiet_s: float, _limit_s: float) -> None:
        """See `DeviceLink`."""
        self._links.take(self._number, PortAct.DRAINED)

    def write(self, data: bytes) -> None:
        """See `DeviceLink`."""
        self._links.take(self._number, PortAct.WRITTEN, data)

    def set_bit_rate(self, bit_rate: int) -> None:
        """See `DeviceLink`."""
        self._links.take(self._number, PortAct.RATE, str(bit_rate).encode())

    def set_motor_line(self, is_high: bool) -> None:
        """See `DeviceLink`."""
        self._links.take(self._number, PortAct.MOTOR, b"1" if is_high else b"0")

    def close(self) -> None:
        """See `DeviceLink`."""
        self._links.take(self._number, PortAct.CLOSED)


def failure(data: bytes) -> LinkFailed:
    """Return the error that was recorded."""
    try:
        number, text = json.loads(data)
    except (ValueError, TypeError):
        number, text = None, "it failed"
    error = LinkFailed(str(text))
    error.errno = number if isinstance(number, int) else None
    return error


def _acts(step: Step) -> Iterator[EventForm]:
    return (event for kind, event in step.told if kind is Event.PORT)
