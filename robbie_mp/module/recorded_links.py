"""The links to a module's devices, on which everything that crosses is recorded in the module's history."""

import json
import threading
import time
from collections.abc import Callable
from typing import TypeVar

from robbie_mp.base.device_links import DeviceLink, MachineLinks
from robbie_mp.bus.transport.history import Event, PortAct

T = TypeVar("T")


class RecordedLinks(MachineLinks):
    """Opens links that record; see `Links`. What other threads than the main one do is not recorded.

    Args:
        append: adds to the module's history.
    """

    def __init__(self, append: Callable[..., None]):
        self._append = append
        self._thread = threading.get_ident()
        self._opened = 0

    def open(self, url: str, opened: Callable[[], DeviceLink]) -> DeviceLink:
        """See `Links`."""
        if not self.is_here:
            return opened()
        self._opened += 1
        number = self._opened
        return RecordedLink(self.tell(PortAct.OPENED, number, opened, url.encode()), self, number)

    def sleep(self, wait_s: float) -> None:
        """See `Links`."""
        self.tell(PortAct.SLEPT, 0, lambda: time.sleep(wait_s))

    @property
    def is_here(self) -> bool:
        """Whether this is the main thread."""
        return threading.get_ident() == self._thread

    def tell(self, act: PortAct, number: int, do: Callable[[], T], crossed: bytes = b"") -> T:
        """Do something on a link, and record it with the time of its end.

        Args:
            act: what is done.
            number: of the link.
            do: does it.
            crossed: the bytes that cross; those that are read are known afterwards.
        """
        if not self.is_here:
            return do()
        try:
            result = do()
        except (OSError, ValueError, TypeError) as error:
            why = json.dumps([getattr(error, "errno", None), str(error)])
            self._append(Event.PORT, time.monotonic_ns(), act, number, 1, 0, why.encode())
            raise
        data = result if isinstance(result, bytes) else crossed
        self._append(Event.PORT, time.monotonic_ns(), act, number, 0, 0, data)
        return result


class RecordedLink:
    """A link on which everything that crosses is recorded; see `DeviceLink`.

    Args:
        link: the link.
        links: records.
        number: counts the links from 1.
    """

    def __init__(self, link: DeviceLink, links: RecordedLinks, number: int):
        self._link = link
        self._links = links
        self._number = number

    @property
    def descriptor(self) -> int | None:
        """See `DeviceLink`."""
        return self._link.descriptor

    def read(self, wait_s: float) -> bytes:
        """See `DeviceLink`."""
        return self._links.tell(PortAct.READ, self._number, lambda: self._link.read(wait_s))

    def drain(self, quiet_s: float, limit_s: float) -> None:
        """See `DeviceLink`."""
        self._links.tell(PortAct.DRAINED, self._number, lambda: self._link.drain(quiet_s, limit_s))

    def write(self, data: bytes) -> None:
        """See `DeviceLink`."""
        self._links.tell(PortAct.WRITTEN, self._number, lambda: self._link.write(data), data)

    def set_bit_rate(self, bit_rate: int) -> None:
        """See `DeviceLink`."""
        text = str(bit_rate).encode()
        self._links.tell(PortAct.RATE, self._number, lambda: self._link.set_bit_rate(bit_rate), text)

    def set_motor_line(self, is_high: bool) -> None:
        """See `DeviceLink`."""
        data = b"1" if is_high else b"0"
        self._links.tell(PortAct.MOTOR, self._number, lambda: self._link.set_motor_line(is_high), data)

    def close(self) -> None:
        """See `DeviceLink`."""
        self._links.tell(PortAct.CLOSED, self._number, self._link.close)
