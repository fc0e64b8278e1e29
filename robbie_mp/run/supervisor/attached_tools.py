"""Processes that attach to a run without being its children: `robbie echo`, `robbie pub`, `robbie param set`.

A tool gets a slot like a module: the slot is prepared when the tool attaches and reclaimed when it leaves.
The supervisor watches the tool's connection to the control socket, not its pid, so it cannot confuse two
processes. The kernel closes the connection of a dead process only after its memory is unmapped; when the
connection ends, the tool can no longer touch the run's memory.

A tool holds a *lease*: its row on the board. It copies messages out and releases them at once. A tool that
makes no progress for `STALLED_AFTER_S` is detached, so no publisher waits longer than that for its memory.
If the tool continues later, it sees that the row is no longer its own and discards the copy it was making.
"""

import contextlib
import socket
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from robbie_mp.base.errors import RobbieError
from robbie_mp.run.control import pack_line
from robbie_mp.run.supervisor.memory import RunMemory
from robbie_mp.run.supervisor.tree import Tree

STALLED_AFTER_S = 1.0
PEER_CREDENTIALS = struct.Struct("3i")


class TooManyTools(RobbieError, BlockingIOError):
    """The number of attached tools has reached the profile's limit."""


@dataclass
class _Attached:
    """One tool."""

    name: str
    incarnation: int
    connection: socket.socket
    purpose: str
    progress: object = None
    """The tool's activity at the last check."""
    since_s: float = 0.0
    """When the tool was first seen doing that."""


class AttachedTools:
    """Assigns slots to tools and reclaims them.

    Args:
        tree: its event loop watches the connections.
        memory: the run's memory.
        names: the slots reserved for tools.
        clock: monotonic time in s.
    """

    def __init__(
        self, tree: Tree, memory: RunMemory, names: Sequence[str], clock: Callable[[], float] = time.monotonic
    ):
        self._tree = tree
        self._memory = memory
        self._names = names
        self._clock = clock
        self._attached: dict[str, _Attached] = {}
        self._last_incarnation = dict.fromkeys(names, 0)
        self._leaving: set[str] = set()
        """Slots that the core has not reclaimed yet."""

    def attach(self, connection: socket.socket, purpose: str) -> None:
        """Assign a slot to a tool and reply with its name; the connection then belongs to this object.

        Args:
            connection: non-blocking and not watched by any loop.
            purpose: what the tool is, for errors and lists.

        Raises:
            TooManyTools: all slots are taken. The caller keeps the connection.
            OSError, SharedMemoryFull: there is no memory for the tool. The caller keeps the connection.
        """
        self._free_reclaimed_slots()
        free = [name for name in self._names if name not in self._attached and name not in self._leaving]
        if not free:
            others = ", ".join(tool.purpose for tool in self._attached.values()) or "none"
            raise TooManyTools(
                f"no slot is free for {purpose}: tools.count in the profile allows {len(self._names)}; "
                f"attached: {others}"
            )
        name = free[0]
        incarnation = self._last_incarnation[name] + 1
        pid = peer_pid(connection)
        self._memory.open(name, incarnation)
        self._last_incarnation[name] = incarnation
        self._memory.attached(name, incarnation, pid)
        tool = _Attached(name, incarnation, connection, purpose, since_s=self._clock())
        self._attached[name] = tool
        self._tree.watch(connection.fileno(), lambda: self._detach(tool, "it has ended"))
        _send_reply(connection, {"done": name, "incarnation": incarnation, "pid": pid})

    def turn(self) -> None:
        """Detach tools that make no progress; called in every iteration of the event loop."""
        self._free_reclaimed_slots()
        now_s = self._clock()
        for tool in list(self._attached.values()):
            unread, taken = self._memory.unread(tool.name)
            doing = self._memory.doing(tool.name, tool.incarnation)
            progress = (taken, doing)
            if progress != tool.progress or (unread <= 0 and doing is None):
                tool.progress, tool.since_s = progress, now_s
            elif now_s - tool.since_s >= STALLED_AFTER_S:
                self._eject(tool, f"it has not taken its messages for {STALLED_AFTER_S:g} s")

    def fault(self, name: str, incarnation: int, why: str) -> bool:
        """Detach a tool that has done wrong; return False if the name is not a tool's."""
        tool = self._attached.get(name)
        if tool is not None and tool.incarnation == incarnation:
            self._eject(tool, why)
        return name in self._last_incarnation

    def close(self) -> None:
        """Close all connections; the run and its memory are gone."""
        for tool in self._attached.values():
            tool.connection.close()
        self._attached.clear()

    def _eject(self, tool: _Attached, reason: str) -> None:
        self._detach(tool, reason, {"error": f"detached {tool.purpose}: {reason}"})

    def _detach(self, tool: _Attached, reason: str, answer: dict[str, str] | None = None) -> None:
        del self._attached[tool.name]
        self._leaving.add(tool.name)
        self._memory.detached(tool.name, tool.incarnation, reason)
        if answer:
            _send_reply(tool.connection, answer)
        self._tree.unwatch(tool.connection.fileno())
        tool.connection.close()

    def _free_reclaimed_slots(self) -> None:
        if self._leaving:
            self._leaving = {
                name
                for name in self._leaving
                if not self._memory.is_reclaimed(name, self._last_incarnation[name])
            }


def peer_pid(connection: socket.socket) -> int:
    """Return the process at the other end of a connection."""
    found = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, PEER_CREDENTIALS.size)
    pid: int = PEER_CREDENTIALS.unpack(found)[0]
    return pid


def _send_reply(connection: socket.socket, answer: dict[str, object] | dict[str, str]) -> None:
    with contextlib.suppress(OSError):  # it has ended, which the event loop reports, or it does not read
        connection.send(pack_line(answer))
