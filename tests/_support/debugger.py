"""Holds a process as a debugger does: ptrace(2), which SIGCONT does not end."""

import ctypes
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

PTRACE_ATTACH, PTRACE_DETACH = 16, 17
WALL = 0x40000000
"""As in <bits/waitflags.h>: wait for threads, too."""


@contextmanager
def held_by_debugger(pid: int) -> Iterator[None]:
    """Hold a process and all its threads within the block; skip the test where this is not allowed."""
    with subprocess.Popen(
        [sys.executable, __file__, str(pid)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as debugger:
        assert debugger.stdin and debugger.stdout
        try:
            if debugger.stdout.readline() != b"held\n":
                pytest.skip("NOT TESTED, no process may be traced here: it needs root or ptrace_scope 0")
            yield
        finally:
            debugger.stdin.close()


def is_held(pid: int) -> bool:
    """Return whether a debugger holds the process."""
    return "TracerPid:\t0\n" not in Path(f"/proc/{pid}/status").read_text()


def main(pid: int) -> None:
    """Hold a process until the end of the standard input."""
    threads = [int(thread) for thread in os.listdir(f"/proc/{pid}/task")]
    libc = ctypes.CDLL(None, use_errno=True)
    libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
    for thread in threads:
        if libc.ptrace(PTRACE_ATTACH, thread, None, None):
            sys.exit(os.strerror(ctypes.get_errno()))
        os.waitpid(thread, WALL)
    print("held", flush=True)
    sys.stdin.read()
    for thread in threads:
        libc.ptrace(PTRACE_DETACH, thread, None, None)


if __name__ == "__main__":
    main(int(sys.argv[1]))
