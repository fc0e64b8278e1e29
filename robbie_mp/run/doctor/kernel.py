"""Checks the kernel's features that the supervisor needs."""

import contextlib
import errno
import os
import platform
import re
import select
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from robbie_mp.base.linux.pidfd import P_PIDFD, open_process
from robbie_mp.base.linux.prctl import is_child_subreaper, parent_death_signal
from robbie_mp.base.linux.proc import read_stat
from robbie_mp.run.doctor.finding import Finding, fail, ok

OLDEST = (5, 4)
ASK_FOR_KERNEL = "use Linux 5.4 or later; in a container, allow this system call (docker: update it, seccomp)"


def look_at_kernel() -> Iterator[Finding]:
    """Judge this machine's kernel."""
    yield check_release(sys.platform, platform.release())
    yield check_machine(sys.byteorder, sys.maxsize, platform.machine())
    yield check_calls(
        {
            "pidfd_open": try_pidfd(),
            "waitid on a pidfd": try_waitid(),
            "prctl(PR_SET_PDEATHSIG)": _try(parent_death_signal),
            "prctl(PR_SET_CHILD_SUBREAPER)": _try(is_child_subreaper),
        }
    )
    yield check_proc(read_stat(os.getpid()) is not None, Path("/proc/self/task/").is_dir())


def try_pidfd() -> str:
    """Return the problem with pidfd_open(2) and poll(2) on a pidfd, or ''."""
    try:
        fd = open_process(os.getpid())
    except OSError as error:
        return str(error)
    try:
        select.select([fd], [], [], 0)
    except OSError as error:
        return str(error)
    finally:
        os.close(fd)
    return ""


def try_waitid() -> str:
    """Return the problem with waitid(2) on a pidfd, or ''."""
    with contextlib.ExitStack() as stack:
        try:
            fd = open_process(os.getpid())
            stack.callback(os.close, fd)
            os.waitid(P_PIDFD, fd, os.WEXITED | os.WNOHANG)
        except ChildProcessError:
            return ""  # expected: this process is not its own child
        except OSError as error:
            return str(error)
    return ""


def _try(call: Callable[[], object]) -> str:
    """Return the problem with a system call, or ''."""
    try:
        call()
    except OSError as error:
        return os.strerror(error.errno or errno.ENOSYS)
    return ""


def check_release(system: str, release: str) -> Finding:
    """Judge the kernel's version, such as `6.1.0-rpi`."""
    found = f"{system} {release}"
    match = re.match(r"(\d+)\.(\d+)", release)
    if system != "linux" or match is None or (int(match[1]), int(match[2])) < OLDEST:
        return fail("kernel", found, "use Linux 5.4 or later")
    return ok("kernel", found)


def check_machine(byteorder: str, largest_size: int, machine: str) -> Finding:
    """Judge the processor's words: shared memory consists of little-endian 64-bit words."""
    found = f"{machine}, {byteorder}-endian, {largest_size.bit_length() + 1} bits"
    if byteorder != "little" or largest_size.bit_length() < 63:
        return fail("architecture", found, "use a 64-bit little-endian system, such as x86-64 or aarch64")
    return ok("architecture", found)


def check_calls(problems: dict[str, str]) -> Finding:
    """Judge the system calls that the supervisor needs, given the problem with each ('': none)."""
    broken = [f"{name}: {problem}" for name, problem in problems.items() if problem]
    if broken:
        return fail("system calls", "; ".join(broken), ASK_FOR_KERNEL)
    return ok("system calls", ", ".join(problems))


def check_proc(has_stat: bool, has_tasks: bool) -> Finding:
    """Judge /proc, by which the supervisor identifies processes."""
    if not (has_stat and has_tasks):
        return fail("/proc", "is missing or empty", "sudo mount -t proc proc /proc")
    return ok("/proc", "shows processes")
