"""Let other processes go first: nice(2), and the time slice, which Python cannot set."""

import ctypes
import logging
import os
import platform
import struct

_SYSTEM_CALLS = {"x86_64": 314, "aarch64": 274}
_SCHED_OTHER = 0
_LONGEST_SLICE_NS = 100_000_000


def step_back(nice: int, log: logging.Logger) -> None:
    """Let others go first: a smaller share when the processors are busy, and at once when they wake up.

    A smaller share alone would still let this process finish its slice of some ms before it makes room: since
    Linux 6.12 who wakes up need not wait for that if its own slice is shorter. Older kernels and other
    processors take no notice of slices. Sandboxes may refuse them, and then there is the smaller share alone.

    Args:
        nice: how far, 1 to 19; 10 is about a tenth of another process's share.
        log: is warned if the slice is refused.
    """
    os.nice(nice)
    try:
        _lengthen_slice()
    except OSError as error:
        log.warning("this process may hold up others that wake up by some ms: %s", error)


def _lengthen_slice() -> None:
    """Let this process be interrupted by whoever wakes up and has a slice of usual length.

    Raises:
        OSError: the kernel, or what stands for it, refuses.
    """
    number = _SYSTEM_CALLS.get(platform.machine())
    if number is None:
        return
    now = os.getpriority(os.PRIO_PROCESS, 0)
    # struct sched_attr: size, policy, flags, nice, priority, runtime, deadline, period, utilisation from, to
    attributes = struct.pack("=IIQiIQQQII", 56, _SCHED_OTHER, 0, now, 0, _LONGEST_SLICE_NS, 0, 0, 0, 1024)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.syscall(number, 0, attributes, 0) != 0:
        error = ctypes.get_errno()
        raise OSError(error, f"sched_setattr: {os.strerror(error)}")
