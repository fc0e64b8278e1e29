"""Let other processes go first: nice(2), also as a session, and the time slice, which Python cannot set."""

import ctypes
import logging
import os
import platform
import struct
import time
from pathlib import Path

from robbie_mp.linux.own_threads import for_all_threads

_SYSTEM_CALLS = {"x86_64": 314, "aarch64": 274}
_SCHED_OTHER = 0
_LONGEST_SLICE_NS = 100_000_000
_AUTOGROUP = Path("/proc/self/autogroup")
_PATIENCE_S = 5.0
_PAUSE_S = 0.05


def step_back(nice: int, log: logging.Logger) -> None:
    """Let others go first: a smaller share when the processors are busy, and at once when they wake up.

    A smaller share alone would still let this process finish its slice of some ms before it makes room: since
    Linux 6.12 who wakes up need not wait for that if its own slice is shorter. Older kernels and other
    processors take no notice of slices. Sandboxes may refuse them, and then there is the smaller share alone.

    Args:
        nice: how far, 1 to 19; 10 is about a tenth of another process's share.
        log: is warned if something of it is refused.
    """
    least = min(os.getpriority(os.PRIO_PROCESS, 0) + nice, 19)
    for_all_threads(lambda thread: _go_behind(thread, least))
    try:
        for_all_threads(_lengthen_slice)
    except OSError as error:
        log.warning("this process may hold up others that wake up by some ms: %s", error)
    if os.getsid(0) == os.getpid():  # else its session is also that of others, such as a shell
        try:
            _step_back_as_session(nice)
        except OSError as error:
            log.warning("this process may get as large a share as others: %s: %s", _AUTOGROUP, error.strerror)


def _go_behind(thread: int, least: int) -> None:
    if os.getpriority(os.PRIO_PROCESS, thread) < least:
        os.setpriority(os.PRIO_PROCESS, thread, least)


def _step_back_as_session(nice: int) -> None:
    """Have this process's session step back, where Linux first shares processors among sessions.

    With autogroup (sched(7)), as most desktops have it, the niceness of a process only counts within its
    session, and every module has one of its own. All sessions of a machine may be set once in 0.1 s together,
    unless root does it.

    Raises:
        OSError: the kernel refuses.
    """
    until_s = time.monotonic() + _PATIENCE_S
    while True:
        try:
            _AUTOGROUP.write_text(str(nice))
        except FileNotFoundError:
            return  # a kernel without it
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise
            time.sleep(_PAUSE_S)
        else:
            return


def _lengthen_slice(thread: int) -> None:
    """Let a thread be interrupted by whoever wakes up and has a slice of usual length.

    Raises:
        OSError: the kernel, or what stands for it, refuses.
    """
    number = _SYSTEM_CALLS.get(platform.machine())
    if number is None:
        return
    now = os.getpriority(os.PRIO_PROCESS, thread)
    # struct sched_attr: size, policy, flags, nice, priority, runtime, deadline, period, utilisation from, to
    attributes = struct.pack("=IIQiIQQQII", 56, _SCHED_OTHER, 0, now, 0, _LONGEST_SLICE_NS, 0, 0, 0, 1024)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.syscall(number, thread, attributes, 0) != 0:
        error = ctypes.get_errno()
        raise OSError(error, f"sched_setattr: {os.strerror(error)}")
