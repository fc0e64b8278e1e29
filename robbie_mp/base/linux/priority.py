"""A process's priority, nice(2) for its threads and its session, and the time slices of its threads."""

import contextlib
import ctypes
import logging
import os
import platform
import struct
import time
from collections.abc import Callable
from pathlib import Path

_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
"""Number of the system call, which Python does not offer, by type of processor."""
_SCHED_OTHER = 0
MIN_SLICE_MS, MAX_SLICE_MS = 0.1, 100.0
_AUTOGROUP = Path("/proc/self/autogroup")
_AUTOGROUP_TIMEOUT_S = 5.0
_AUTOGROUP_RETRY_S = 0.05
_THREADS = Path("/proc/self/task")
_MAX_PASSES = 20


def lower_priority(nice: int, log: logging.Logger) -> None:
    """Give this process a smaller share of busy processors, and let other processes interrupt it.

    A smaller share alone does not let a process that wakes up run at once: this one could first finish its
    slice of some ms. So this also lengthens its slices; if that is refused, only the smaller share takes
    effect.

    Args:
        nice: 1 to 19; 10 is about a tenth of another process's share.
        log: receives a warning for each part that the system refuses.
    """
    least = min(os.getpriority(os.PRIO_PROCESS, 0) + nice, 19)
    for_all_threads(lambda thread: _raise_niceness(thread, least))
    set_time_slice(MAX_SLICE_MS, log)
    if os.getsid(0) == os.getpid():  # a session that it shares, for example with a shell, stays as it is
        try:
            _lower_session(nice)
        except OSError as error:
            log.warning("this process may get as large a share as others: %s: %s", _AUTOGROUP, error.strerror)


def set_time_slice(slice_ms: float, log: logging.Logger) -> None:
    """Set how long this process may compute before it is the turn of others; its share stays the same.

    Since Linux 6.12, a process that wakes up interrupts at once one with a longer slice; usual are some ms.
    Older kernels and unknown processors ignore slices, and sandboxes may refuse the call.

    Args:
        slice_ms: `MIN_SLICE_MS` to `MAX_SLICE_MS`.
        log: receives a warning if the system refuses.
    """
    try:
        for_all_threads(lambda thread: _set_slice(thread, slice_ms))
    except OSError as error:
        log.warning("this process may delay others that wake up by some ms: %s", error)


def for_all_threads(apply: Callable[[int], object]) -> None:
    """Apply a setting that the kernel keeps for each thread to every thread of this process.

    That includes threads started by libraries. A new thread inherits the setting from the thread that starts
    it, so this repeats until it finds no new thread, or `_MAX_PASSES` times.

    Args:
        apply: called once with the id of each thread; may raise ProcessLookupError if that thread has ended.
    """
    done: set[int] = set()
    for _ in range(_MAX_PASSES):
        new = {int(thread.name) for thread in _THREADS.iterdir()} - done
        if not new:
            return
        for thread in new:
            with contextlib.suppress(ProcessLookupError):
                apply(thread)
        done |= new


def _raise_niceness(thread: int, least: int) -> None:
    if os.getpriority(os.PRIO_PROCESS, thread) < least:
        os.setpriority(os.PRIO_PROCESS, thread, least)


def _lower_session(nice: int) -> None:
    """Lower the priority of this process's session, among which Linux first shares the processors.

    With autogroup (sched(7)), which most desktops enable, the niceness of a process only counts within its
    session, and every module has its own session. Without root, only one session of the whole machine can be
    set in 0.1 s, so this retries.

    Raises:
        OSError: the kernel refuses.
    """
    until_s = time.monotonic() + _AUTOGROUP_TIMEOUT_S
    while True:
        try:
            _AUTOGROUP.write_text(str(nice))
        except FileNotFoundError:
            return  # a kernel without autogroup
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise
            time.sleep(_AUTOGROUP_RETRY_S)
        else:
            return


def _set_slice(thread: int, slice_ms: float) -> None:
    """Set the slice of a thread.

    Raises:
        OSError: the kernel, or a sandbox, refuses.
    """
    number = _SCHED_SETATTR.get(platform.machine())
    if number is None:
        return
    now = os.getpriority(os.PRIO_PROCESS, thread)
    # struct sched_attr: size, policy, flags, nice, priority, runtime, deadline, period, utilisation from, to
    slice_ns = round(slice_ms * 1e6)
    attributes = struct.pack("=IIQiIQQQII", 56, _SCHED_OTHER, 0, now, 0, slice_ns, 0, 0, 0, 1024)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.syscall(number, thread, attributes, 0) != 0:
        error = ctypes.get_errno()
        raise OSError(error, f"sched_setattr: {os.strerror(error)}")
