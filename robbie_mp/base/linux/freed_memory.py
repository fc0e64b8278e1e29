"""What the C library does with memory that a process has freed."""

import ctypes

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h


def keep_freed_memory(up_to_bytes: int) -> bool:
    """Have this process keep memory that it has freed, and use it again, rather than give it back.

    The kernel has to clear each page that it gives out. For a buffer of 1 MB this takes ten times as long as
    to copy something into it.

    Args:
        up_to_bytes: how much to keep, at most, of what each thread has freed.

    Returns:
        False if this C library cannot do that.
    """
    library = ctypes.CDLL(None)
    if not hasattr(library, "mallopt"):  # it is glibc's
        return False
    done = [library.mallopt(option, up_to_bytes) for option in (_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD)]
    return all(done)
