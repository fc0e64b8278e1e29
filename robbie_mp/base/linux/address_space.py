"""How much memory and address space this process uses, and how much address space it may use."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def address_space_bytes() -> int:
    """Address space that this process uses."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return pages * resource.getpagesize()


def own_memory_bytes() -> int:
    """Memory in use that this process shares with no other and with no file."""
    _, resident, shared, *_ = map(int, Path("/proc/self/statm").read_text().split())
    return (resident - shared) * resource.getpagesize()


@contextmanager
def limited_address_space(more_bytes: int | None) -> Iterator[None]:
    """Let this process use only so much more address space than now; None: do not limit it."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    if more_bytes is not None:
        resource.setrlimit(resource.RLIMIT_AS, (address_space_bytes() + max(more_bytes, 0), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
