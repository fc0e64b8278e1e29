"""The process settings of prctl(2) that supervision needs and Python does not offer."""

import ctypes
import os

PR_SET_PDEATHSIG = 1
PR_GET_PDEATHSIG = 2
PR_SET_NAME = 15
PR_SET_CHILD_SUBREAPER = 36
PR_GET_CHILD_SUBREAPER = 37


def set_parent_death_signal(signum: int) -> None:
    """Have the kernel send this process a signal when its parent's thread that started it ends."""
    _prctl(PR_SET_PDEATHSIG, ctypes.c_ulong(signum))


def parent_death_signal() -> int:
    """Return the signal that this process gets when its parent's thread ends, 0 if none."""
    value = ctypes.c_int()
    _prctl(PR_GET_PDEATHSIG, ctypes.byref(value))
    return value.value


def set_process_name(name: str) -> None:
    """Have ps(1) and top(1) show this name; the kernel keeps 15 bytes of it."""
    _prctl(PR_SET_NAME, ctypes.c_char_p(name.encode()))


def set_child_subreaper(enabled: bool) -> None:
    """Become the new parent of descendants that lose theirs, or stop being so."""
    _prctl(PR_SET_CHILD_SUBREAPER, ctypes.c_ulong(enabled))


def is_child_subreaper() -> bool:
    """Tell whether orphaned descendants come to this process."""
    value = ctypes.c_int()
    _prctl(PR_GET_CHILD_SUBREAPER, ctypes.byref(value))
    return bool(value.value)


def _prctl(option: int, argument: object) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    zero = ctypes.c_ulong(0)
    if libc.prctl(option, argument, zero, zero, zero) != 0:
        error = ctypes.get_errno()
        raise OSError(error, f"prctl option {option}: {os.strerror(error)}")
