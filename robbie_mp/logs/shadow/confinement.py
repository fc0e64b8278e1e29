"""Keeps the code of a shadow from reaching what belongs to the robot: devices, files, networks, programs.

This catches what a module does by mistake or because it is a driver. It is no defence against code that wants
to get around it: such code should not be run on a robot at all.
"""

import multiprocessing
import os
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from robbie_mp.base.errors import RobbieError

WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
IN_MEMORY = ":memory:"
"""The data base of SQLite that is in no file."""
HARMLESS = ("/dev/null", "/dev/zero", "/dev/urandom", "/dev/random")
CHANGES = {
    "os.remove": 1, "os.rmdir": 1, "os.mkdir": 1, "os.truncate": 1, "os.chmod": 1, "os.chown": 1,
    "os.utime": 1, "os.rename": 2, "os.link": 2, "os.symlink": 2,
    "os.setxattr": 1, "os.removexattr": 1, "sqlite3.connect": 1,
}  # fmt: skip
"""Events that change files, and how many of their first arguments are paths."""
REFUSED = {
    "socket.connect": "the network", "socket.bind": "the network", "socket.sendto": "the network",
    "socket.sendmsg": "the network", "subprocess.Popen": "other programs", "os.system": "other programs",
    "os.exec": "other programs", "os.posix_spawn": "other programs", "os.spawn": "other programs",
    "os.fork": "other processes", "os.forkpty": "other processes", "os.kill": "other processes",
    "os.killpg": "other processes",
}  # fmt: skip
UNHEARD = {
    "_posixsubprocess.fork_exec": "other programs", "_posixshmem.shm_open": "shared memory",
    "_posixshmem.shm_unlink": "shared memory", "signal.pidfd_send_signal": "other processes",
    "os.mkfifo": "pipes", "os.mknod": "devices",
}  # fmt: skip
"""Functions of which Python raises no event; processes that multiprocessing starts would be free."""


class NotForAShadow(RobbieError, PermissionError):
    """The code of a shadow does something that only the module itself may do.

    Example scenarios:
      - it opens a device, or connects to one in the network
      - it writes a file that is not among its results
    """


def confine(folder: str) -> None:
    """Let this process write below one folder only, and reach no device, network or other process.

    Args:
        folder: where it may write; absolute.
    """
    allowed = os.path.join(os.path.realpath(folder), "")
    sys.dont_write_bytecode = True

    def check(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            _check_open(arguments, allowed)
        elif event in CHANGES:
            for path in arguments[: CHANGES[event]]:
                if isinstance(path, str | bytes | os.PathLike) and os.fsdecode(path) != IN_MEMORY:
                    _check_place(_real(path), allowed, "change")
        elif event in REFUSED:
            raise NotForAShadow(f"a shadow must not reach {REFUSED[event]} ({event})")

    # Locks, also those of thread pools, then need no helper process, as Python 3.14 starts one otherwise.
    multiprocessing.set_start_method("fork", force=True)
    sys.addaudithook(check)
    for name, what in UNHEARD.items():
        module, _, function = name.rpartition(".")
        setattr(import_module(module), function, _refusal(name, what))


def _refusal(name: str, what: str) -> Callable[..., None]:
    def refuse(*_: object, **__: object) -> None:
        raise NotForAShadow(f"a shadow must not reach {what} ({name})")

    return refuse


def _check_open(arguments: tuple[Any, ...], allowed: str) -> None:
    path, _, flags = arguments
    if not isinstance(path, str | bytes | os.PathLike):
        return  # a descriptor: it is open already
    place = _real(path)
    if place in HARMLESS:
        return
    if place.startswith("/dev/"):
        raise NotForAShadow(f"a shadow must not open {place}; that is for the module itself")
    if isinstance(flags, int) and flags & WRITING:
        _check_place(place, allowed, "write")


def _check_place(place: str, allowed: str, what: str) -> None:
    if not os.path.join(place, "").startswith(allowed):
        raise NotForAShadow(f"a shadow must not {what} {place}; its results go to self.output_directory")


def _real(path: Any) -> str:
    return os.path.realpath(os.fsdecode(path))


def be_the_first_to_go() -> None:
    """Let the system end this process first when memory runs out."""
    Path("/proc/self/oom_score_adj").write_text("1000")
