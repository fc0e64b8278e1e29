"""Survives that another process truncates a file that this one has mapped (SIGBUS).

Nothing keeps a process of the same user from truncating a file in /dev/shm. The kernel then sends SIGBUS to
each process that touches what was cut off, at the very instruction, so a handler of Python's (signal.signal)
would come too late. The handler here puts a page of zeros there and lets the instruction be repeated.
"""

import contextlib
import ctypes
import mmap
import os
import signal
from collections.abc import Iterator
from pathlib import Path

_MAPS = Path("/proc/self/maps")
_SA_SIGINFO = 4
_MAP_FIXED = 0x10
_ADDRESS_AT = 16
"""Where the address lies in siginfo_t."""
_FAILED = ctypes.c_void_p(-1).value
_Handler = ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)


class _Action(ctypes.Structure):
    """struct sigaction, the same in glibc and musl."""

    _fields_ = (
        ("handler", ctypes.c_void_p),
        ("mask", ctypes.c_ubyte * 128),
        ("flags", ctypes.c_int),
        ("restorer", ctypes.c_void_p),
    )


@contextlib.contextmanager
def surviving_truncation(prefix: str, *, writable: bool = True) -> Iterator[list[str]]:
    """Replace by zeros what is cut off some mapped files; yield their paths, once for each page.

    Every other bus error has the effect that it had before.

    Args:
        prefix: how the paths of the files begin.
        writable: whether also in memory that this process may write. Otherwise it ends by what was cut off
            there: nobody would see what it writes from then on.
    """
    truncated: list[str] = []
    libc = ctypes.CDLL(None, use_errno=True)
    libc.mmap.restype = ctypes.c_void_p
    before = _Action()

    @_Handler  # type: ignore[untyped-decorator]
    def on_bus_error(_signal: int, information: int, _context: int) -> None:
        try:
            address = ctypes.c_size_t.from_address(information + _ADDRESS_AT).value
            truncated.append(_replace(libc, address, prefix, writable))
        except BaseException:
            libc.sigaction(signal.SIGBUS, ctypes.byref(before), None)

    action = _Action(handler=ctypes.cast(on_bus_error, ctypes.c_void_p), flags=_SA_SIGINFO)
    libc.sigaction(signal.SIGBUS, ctypes.byref(action), ctypes.byref(before))
    try:
        yield truncated
    finally:
        libc.sigaction(signal.SIGBUS, ctypes.byref(before), None)


def _replace(libc: ctypes.CDLL, address: int, prefix: str, writable: bool) -> str:
    """Map a page of zeros in the place of the one at an address; return the path of the file that it was of.

    Raises:
        LookupError: it is of no such file, or may be written although it must not be `writable`.
        OSError: there is no memory.
    """
    allowed, path = _file_at(address)
    if not path.startswith(prefix) or ("w" in allowed and not writable):
        raise LookupError(path)
    at = ctypes.c_void_p(address // mmap.PAGESIZE * mmap.PAGESIZE)
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | _MAP_FIXED
    access = mmap.PROT_READ | mmap.PROT_WRITE
    made = libc.mmap(at, ctypes.c_size_t(mmap.PAGESIZE), access, flags, -1, ctypes.c_long(0))
    if made == _FAILED:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    return path


def _file_at(address: int) -> tuple[str, str]:
    """Return how the file that is mapped at an address may be used, such as "r--s", and its path."""
    for line in _MAPS.read_text().splitlines():
        span, allowed, *_, path = line.split(maxsplit=5)
        start, end = (int(edge, 16) for edge in span.split("-"))
        if start <= address < end:
            return allowed, path.removesuffix(" (deleted)")
    raise LookupError(f"nothing is mapped at {address:#x}")
