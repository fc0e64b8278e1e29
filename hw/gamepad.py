"""Gamepads and joysticks, as Linux shows them in /dev/input.

Source: Linux, Documentation/input/input.rst and event-codes.rst.
"""

import os
import select
import struct
from contextlib import suppress
from dataclasses import dataclass, field

# struct input_event: two words of time, type, code, value.
EVENT = struct.Struct("llHHi")
EV_SYN, EV_KEY, EV_ABS = 0, 1, 3
SYN_REPORT, SYN_DROPPED = 0, 3
READ_EVENTS = 64


@dataclass
class GamepadState:
    """The buttons and axes as the operator holds them.

    Attributes:
        pressed: codes of the buttons that are held.
        axes: the sticks' raw values, by code.
    """

    pressed: set[int] = field(default_factory=set)
    axes: dict[int, int] = field(default_factory=dict)


class GamepadEvents:
    """Reads `input_event` structures; a state counts only when its report is complete.

    When the kernel has dropped events, nothing counts as held any more until it is pressed again.
    """

    def __init__(self) -> None:
        self.state = GamepadState()
        self.dropped = 0
        """How often the kernel has dropped events, because nobody read them in time."""
        self._next = GamepadState()
        self._rest = b""
        self._skips = False

    def forget(self) -> None:
        """Let nothing count as held or pushed any more until it is pressed or moved again."""
        self.state, self._next = GamepadState(), GamepadState()

    def feed(self, data: bytes) -> bool:
        """Take bytes in pieces of any length; return whether `state` has changed."""
        data = self._rest + data
        whole = len(data) - len(data) % EVENT.size
        self._rest = data[whole:]
        changed = False
        for _, _, kind, code, value in EVENT.iter_unpack(data[:whole]):
            changed |= self._event(kind, code, value)
        return changed

    def _event(self, kind: int, code: int, value: int) -> bool:
        if kind == EV_SYN and code == SYN_DROPPED:
            self.dropped += 1
            self._skips = True
            self._next = GamepadState()
        elif kind == EV_SYN and code == SYN_REPORT:
            self._skips = False
            self.state = GamepadState(set(self._next.pressed), dict(self._next.axes))
            return True
        elif self._skips:
            return False
        elif kind == EV_KEY:
            (self._next.pressed.add if value else self._next.pressed.discard)(code)
        elif kind == EV_ABS:
            self._next.axes[code] = value
        return False


class Gamepad:
    """A gamepad that may be pulled out and plugged in again; without it nothing is held or pushed.

    Args:
        path: such as "/dev/input/by-id/usb-...-event-joystick".
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.reason = "not yet connected"
        """Why it is not connected, in plain words; '' while it is."""
        self.connections = 0
        self.losses = 0
        self._events = GamepadEvents()
        self._descriptor = -1

    @property
    def is_connected(self) -> bool:
        """Return whether the gamepad can be used."""
        return self._descriptor >= 0

    @property
    def state(self) -> GamepadState:
        """Return what is held and pushed now."""
        return self._events.state

    def poll(self) -> None:
        """Read what has happened since the last call; connect if the gamepad is there. Never waits."""
        if not self.is_connected:
            self._open()
        while self.is_connected and select.select([self._descriptor], [], [], 0)[0]:
            try:
                data = os.read(self._descriptor, READ_EVENTS * EVENT.size)
                if not data:
                    raise OSError("it has ended")
            except BlockingIOError:
                return
            except OSError as error:
                self._lose(error)
                return
            self._events.feed(data)

    def forget(self) -> None:
        """Let nothing count as held or pushed any more until it is pressed or moved again."""
        self._events.forget()

    def close(self) -> None:
        """Close the gamepad."""
        if self.is_connected:
            with suppress(OSError):
                os.close(self._descriptor)
        self._descriptor = -1
        self._events = GamepadEvents()
        self.reason = "closed"

    def _open(self) -> None:
        try:
            self._descriptor = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            self.reason = str(error)
            return
        self.reason = ""
        self.connections += 1

    def _lose(self, error: OSError) -> None:
        self.close()
        self.losses += 1
        self.reason = str(error)
