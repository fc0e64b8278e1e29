"""Ties a child's life to its supervisor's: called first thing in a child."""

import os
import signal

from robbie_mp.linux.prctl import set_parent_death_signal


def die_with_parent(parent_pid: int) -> None:
    """Have the kernel kill this process with SIGKILL when its parent dies, however the parent dies.

    The kernel means the *thread* that started this process, not the parent as a whole: a child that a helper
    thread starts dies when that thread ends. So a supervisor starts its children from its main thread.
    Processes that this one forks do not inherit the setting.

    Args:
        parent_pid: pid of the supervisor. If this process has another parent already, the supervisor died
            before the kernel was asked, and this process ends at once.
    """
    set_parent_death_signal(signal.SIGKILL)
    if os.getppid() != parent_pid:
        os.kill(os.getpid(), signal.SIGKILL)
