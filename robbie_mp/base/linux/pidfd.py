"""Descriptors of processes (pidfd_open(2), pidfd_send_signal(2)), also with a Python that lacks them.

Python has these functions only if it was built with headers of Linux 5.3 or later. The interpreters that uv
and others download are built with older ones, to run on older systems too.
"""

import ctypes
import os
import signal

P_PIDFD = getattr(os, "P_PIDFD", 3)
"""As in <linux/wait.h>, for waitid(2). Linux has it since 5.4."""
_SEND_SIGNAL, _OPEN = 424, 434
"""Numbers of the system calls, which all processors have in common."""


def open_process(pid: int) -> int:
    """Return a descriptor of a process, which becomes readable when it has ended; children do not inherit it.

    Raises:
        ProcessLookupError: there is no such process.
        OSError: no descriptor is free, or the kernel, or a sandbox, refuses.
    """
    if hasattr(os, "pidfd_open"):
        return os.pidfd_open(pid)
    return _system_call("pidfd_open", _OPEN, ctypes.c_int(pid), ctypes.c_uint(0))


def send_signal(pidfd: int, signum: int) -> None:
    """Send a signal to the process of a descriptor, and to no later one that has its pid.

    Raises:
        ProcessLookupError: it has ended.
    """
    if hasattr(signal, "pidfd_send_signal"):
        signal.pidfd_send_signal(pidfd, signum)
        return
    number = ctypes.c_int(signum)
    _system_call("pidfd_send_signal", _SEND_SIGNAL, ctypes.c_int(pidfd), number, None, ctypes.c_uint(0))


def _system_call(name: str, number: int, *arguments: object) -> int:
    call = ctypes.CDLL(None, use_errno=True).syscall
    call.restype = ctypes.c_long
    result = int(call(ctypes.c_long(number), *arguments))
    if result < 0:
        error = ctypes.get_errno()
        raise OSError(error, f"{name}: {os.strerror(error)}")
    return result
