"""Sleeping until a word of memory changes, and waking those who do: futex(2), which Python does not offer."""

import ctypes
import errno
import functools
import os
import platform
from collections.abc import Callable

_NUMBERS = {"x86_64": 202, "ppc64le": 221}
"""Number of the system call by type of processor; all newer types have the same."""
_COMMON_NUMBER = 98
_WAKE, _WAIT_BITSET = 1, 9
_ANY = 0xFFFFFFFF
_ALL_SLEEPERS = (1 << 31) - 1
_NS_PER_S = 1_000_000_000


class _Time(ctypes.Structure):
    _fields_ = (("s", ctypes.c_int64), ("ns", ctypes.c_int64))


@functools.cache
def _system_call() -> Callable[..., int]:
    call = ctypes.CDLL(None, use_errno=True).syscall
    call.restype = ctypes.c_long
    number = _NUMBERS.get(platform.machine(), _COMMON_NUMBER)
    return functools.partial(call, ctypes.c_long(number))


def sleep_while(word: ctypes.c_uint32, value: int, until_ns: int | None) -> bool:
    """Sleep while a word has a value; return False after the time-out or a signal.

    Other processes may write the word, and wake this one without a reason: look at the word afterwards.

    Args:
        word: lies in shared memory.
        value: its value.
        until_ns: when to give up, monotonic clock; None: never.

    Raises:
        OSError: the kernel, or a sandbox, refuses.
    """
    until = None
    if until_ns is not None:
        until = ctypes.byref(_Time(*divmod(until_ns, _NS_PER_S)))
    wanted, anybody = ctypes.c_uint32(value), ctypes.c_uint32(_ANY)
    failed = _system_call()(ctypes.byref(word), ctypes.c_int(_WAIT_BITSET), wanted, until, None, anybody)
    error = ctypes.get_errno() if failed else 0
    if error in (0, errno.EAGAIN):
        return True
    if error in (errno.ETIMEDOUT, errno.EINTR, errno.EFAULT):  # EFAULT: the file was truncated just now
        return False
    raise OSError(error, f"futex: {os.strerror(error)}")


def wake_sleepers(word: ctypes.c_uint32) -> None:
    """Wake all that sleep while this word has a value."""
    count = ctypes.c_int(_ALL_SLEEPERS)
    _system_call()(ctypes.byref(word), ctypes.c_int(_WAKE), count, None, None, ctypes.c_uint32(0))
