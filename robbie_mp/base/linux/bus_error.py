"""Survives that another process truncates a file that this one has mapped (SIGBUS).

Nothing keeps a process of the same user from truncating a file in /dev/shm. The kernel then sends SIGBUS to
each process that touches what was cut off, at the very instruction, so a handler of Python's (signal.signal)
would come too late. The handler here puts zeros there, up to the end of the mapping, and lets the instruction
be repeated. It needs the GIL: a thread of C code must not touch messages while another one waits for it with
the GIL, or both wait until the supervisor kills the module.
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
def surviving_truncation(prefix: str, *, writable: bool = True) -> Iterator[dict[int, str]]:
    """Replace by zeros what is cut off some mapped files; yield where, and the paths.

    Every other bus error has the effect that it had before.

    Args:
        prefix: how the paths of the files begin.
        writable: whether also in memory that this process may write. Otherwise it ends by what was cut off
            there: nobody would see what it writes from then on.
    """
    truncated: dict[int, str] = {}
    libc = ctypes.CDLL(None, use_errno=True)
    libc.mmap.restype = ctypes.c_void_p
    before = _Action()

    @_Handler  # type: ignore[untyped-decorator]
    def on_bus_error(_signal: int, information: int, _context: int) -> None:
        try:
            address = ctypes.c_size_t.from_address(information + _ADDRESS_AT).value
            page = address // mmap.PAGESIZE * mmap.PAGESIZE
            end, allowed, path = _mapping_at(page)
            if page in truncated and not path:
                return  # another thread has just replaced it
            if not path.startswith(prefix) or ("w" in allowed and not writable):
                raise LookupError(path)
            truncated[page] = path
            _replace(libc, page, end - page)
        except BaseException:
            libc.sigaction(signal.SIGBUS, ctypes.byref(before), None)

    action = _Action(handler=ctypes.cast(on_bus_error, ctypes.c_void_p), flags=_SA_SIGINFO)
    libc.sigaction(signal.SIGBUS, ctypes.byref(action), ctypes.byref(before))
    try:
        yield truncated
    finally:
        libc.sigaction(signal.SIGBUS, ctypes.byref(before), None)


def _replace(libc: ctypes.CDLL, address: int, size: int) -> None:
    """Map zeros in the place of some pages; OSError: there is no memory."""
    at = ctypes.c_void_p(address)
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | _MAP_FIXED
    access = mmap.PROT_READ | mmap.PROT_WRITE
    made = libc.mmap(at, ctypes.c_size_t(size), access, flags, -1, ctypes.c_long(0))
    if made == _FAILED:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))


def _mapping_at(address: int) -> tuple[int, str, str]:
    """Return where the mapping at an address ends, how it may be used, as "r--s", and its file ('': none)."""
    for line in _MAPS.read_text().splitlines():
        span, allowed, _offset, _device, _inode, *path = line.split(maxsplit=5)
        start, end = (int(edge, 16) for edge in span.split("-"))
        if start <= address < end:
            return end, allowed, "".join(path).removesuffix(" (deleted)")
    raise LookupError(f"nothing is mapped at {address:#x}")
