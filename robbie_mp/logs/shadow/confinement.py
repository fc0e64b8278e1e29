"""Keeps the code of a shadow from reaching what belongs to the robot: devices, files, networks, programs.

This catches what a module does by mistake or because it is a driver. It is no defence against code that wants
to get around it: such code should not be run on a robot at all.
"""

import os
import sys
from pathlib import Path
from typing import Any

from robbie_mp.base.errors import RobbieError

WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
HARMLESS = ("/dev/null", "/dev/zero", "/dev/urandom", "/dev/random")
CHANGES = {
    "os.remove": 1, "os.rmdir": 1, "os.mkdir": 1, "os.truncate": 1, "os.chmod": 1, "os.chown": 1,
    "os.utime": 1, "os.rename": 2, "os.link": 2, "os.symlink": 2,
}  # fmt: skip
"""Events that change files, and how many of their first arguments are paths."""
REFUSED = {
    "socket.connect": "the network", "socket.bind": "the network", "socket.sendto": "the network",
    "socket.sendmsg": "the network", "subprocess.Popen": "other programs", "os.system": "other programs",
    "os.exec": "other programs", "os.posix_spawn": "other programs", "os.spawn": "other programs",
    "os.fork": "other processes", "os.forkpty": "other processes", "os.kill": "other processes",
    "os.killpg": "other processes",
}  # fmt: skip


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
                if isinstance(path, str | bytes | os.PathLike):
                    _check_place(_real(path), allowed, "change")
        elif event in REFUSED:
            raise NotForAShadow(f"a shadow must not reach {REFUSED[event]} ({event})")

    sys.addaudithook(check)


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
