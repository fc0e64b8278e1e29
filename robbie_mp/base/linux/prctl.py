"""The process settings of prctl(2) that supervision needs and Python does not offer."""

import ctypes
import os
import signal

PR_SET_PDEATHSIG = 1
PR_GET_PDEATHSIG = 2
PR_SET_NAME = 15
PR_SET_CHILD_SUBREAPER = 36
PR_GET_CHILD_SUBREAPER = 37


def die_with_parent(parent_pid: int) -> None:
    """Have the kernel kill this process with SIGKILL when its parent dies, however the parent dies.

    A child process calls this before anything else. To the kernel, the parent is the *thread* that started
    the child: a child that a helper thread starts dies when that thread ends. So start children from the main
    thread. A process that this one forks does not inherit the setting.

    Args:
        parent_pid: pid of the supervisor. If this process already has another parent, the supervisor died
            before the kernel was asked; then this process ends at once.
    """
    set_parent_death_signal(signal.SIGKILL)
    if os.getppid() != parent_pid:
        os.kill(os.getpid(), signal.SIGKILL)


def set_parent_death_signal(signum: int) -> None:
    """Have the kernel send this process a signal when the thread that started it ends."""
    _prctl(PR_SET_PDEATHSIG, ctypes.c_ulong(signum))


def parent_death_signal() -> int:
    """Return the signal that this process gets when the thread that started it ends, 0 if none."""
    value = ctypes.c_int()
    _prctl(PR_GET_PDEATHSIG, ctypes.byref(value))
    return value.value


def set_process_name(name: str) -> None:
    """Set the name that ps(1) and top(1) show; the kernel keeps its first 15 bytes."""
    _prctl(PR_SET_NAME, ctypes.c_char_p(name.encode()))


def set_child_subreaper(enabled: bool) -> None:
    """Start or stop adopting descendants whose own parent has ended."""
    _prctl(PR_SET_CHILD_SUBREAPER, ctypes.c_ulong(enabled))


def is_child_subreaper() -> bool:
    """Whether this process adopts descendants whose own parent has ended."""
    value = ctypes.c_int()
    _prctl(PR_GET_CHILD_SUBREAPER, ctypes.byref(value))
    return bool(value.value)


def _prctl(option: int, argument: object) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    zero = ctypes.c_ulong(0)
    if libc.prctl(option, argument, zero, zero, zero) != 0:
        error = ctypes.get_errno()
        raise OSError(error, f"prctl option {option}: {os.strerror(error)}")
