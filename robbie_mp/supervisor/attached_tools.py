"""Processes that attach to a run without being its children: `robbie echo`, `robbie pub`, `robbie param set`.

A tool has a slot like a module, made ready when it comes and taken back when it goes. Its connection to the
control socket is its life line: the kernel closes it only after the memory of a dead process is unmapped, so
at its end the tool will never touch the run's memory again. No pid is watched, and none can be mistaken.

A tool holds a *lease*: its row on the board. It copies messages out and releases them at once. One that does
not for `STANDSTILL_S` is detached, so that no publisher waits for its memory longer than that. When it goes
on, it sees that the row is not its own any more, and throws away what it was copying.
"""

import contextlib
import json
import socket
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from robbie_mp.errors import RobbieError
from robbie_mp.supervisor.memory import RunMemory
from robbie_mp.supervisor.tree import Tree

STANDSTILL_S = 1.0
PEER_CREDENTIALS = struct.Struct("3i")


class NoPlaceForTool(RobbieError, BlockingIOError):
    """As many tools are attached as the profile allows."""


@dataclass
class _Attached:
    """One tool."""

    name: str
    incarnation: int
    connection: socket.socket
    purpose: str
    progress: object = None
    """What it was doing when it was looked at last."""
    since_s: float = 0.0
    """When it was first seen doing that."""


class AttachedTools:
    """Gives tools their slots and takes them back.

    Args:
        tree: whose event loop hears of their ends.
        memory: the run's memory.
        names: the slots there are for tools.
        clock: a time in s that never goes back.
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
        """Slots that the core has not given back yet."""

    def attach(self, connection: socket.socket, purpose: str) -> None:
        """Give a tool a slot and tell it which; the connection is ours from now on.

        Args:
            connection: non-blocking, watched by nobody.
            purpose: what it is, for errors and lists.

        Raises:
            NoPlaceForTool: all slots are taken; the connection is still the caller's.
            OSError, SharedMemoryFull: likewise; there is no memory for it.
        """
        self._take_back()
        free = [name for name in self._names if name not in self._attached and name not in self._leaving]
        if not free:
            others = ", ".join(tool.purpose for tool in self._attached.values()) or "none"
            raise NoPlaceForTool(
                f"no place for {purpose}: tools.count in the profile allows {len(self._names)}; "
                f"attached: {others}"
            )
        name = free[0]
        incarnation = self._last_incarnation[name] + 1
        pid, _, _ = PEER_CREDENTIALS.unpack(
            connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, PEER_CREDENTIALS.size)
        )
        self._memory.open(name, incarnation)
        self._last_incarnation[name] = incarnation
        self._memory.attached(name, incarnation, pid)
        tool = _Attached(name, incarnation, connection, purpose, since_s=self._clock())
        self._attached[name] = tool
        self._tree.watch(connection.fileno(), lambda: self._detach(tool, "it has ended"))
        _tell(connection, {"done": name, "incarnation": incarnation, "pid": pid})

    def turn(self) -> None:
        """Detach who stands still; called every turn of the loop."""
        self._take_back()
        now_s = self._clock()
        for tool in list(self._attached.values()):
            unread, taken = self._memory.unread(tool.name)
            doing = self._memory.doing(tool.name, tool.incarnation)
            progress = (taken, doing)
            if progress != tool.progress or (unread <= 0 and doing is None):
                tool.progress, tool.since_s = progress, now_s
            elif now_s - tool.since_s >= STANDSTILL_S:
                self._refuse(tool, f"it has not taken its messages for {STANDSTILL_S:g} s")

    def fault(self, name: str, incarnation: int) -> bool:
        """Detach a tool whose records the core refused; False if the name is no tool's."""
        tool = self._attached.get(name)
        if tool is not None and tool.incarnation == incarnation:
            self._refuse(tool, "the core refused its records; core.log says why")
        return name in self._last_incarnation

    def close(self) -> None:
        """Let all go; the run is over, and its memory too."""
        for tool in self._attached.values():
            tool.connection.close()
        self._attached.clear()

    def _refuse(self, tool: _Attached, reason: str) -> None:
        self._detach(tool, reason, {"error": f"detached {tool.purpose}: {reason}"})

    def _detach(self, tool: _Attached, reason: str, answer: dict[str, str] | None = None) -> None:
        del self._attached[tool.name]
        self._leaving.add(tool.name)
        self._memory.detached(tool.name, tool.incarnation, reason)
        if answer:
            _tell(tool.connection, answer)
        self._tree.unwatch(tool.connection.fileno())
        tool.connection.close()

    def _take_back(self) -> None:
        if self._leaving:
            self._leaving = {
                name
                for name in self._leaving
                if not self._memory.is_reclaimed(name, self._last_incarnation[name])
            }


def _tell(connection: socket.socket, answer: dict[str, object] | dict[str, str]) -> None:
    with contextlib.suppress(OSError):  # it is gone, which is heard of by other ways, or does not read
        connection.send(json.dumps(answer).encode() + b"\n")
