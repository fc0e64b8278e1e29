"""Shared memory, working memory, swap, and the disk for results."""

import os
import secrets
import shutil
from collections.abc import Iterator
from math import ceil
from pathlib import Path

import psutil

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.layout import HEADER_WORDS, SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, make_folder, remove_names
from robbie_mp.run.doctor.finding import Finding, fail, ok, read_number, size, warn
from robbie_mp.run.doctor.needs import Needs
from robbie_mp.run.run_directory import lock_folder

ENOUGH_SHARED_BYTES = 256 << 20
"""The default limit of one module; containers often have only 64 MB in total."""
ENOUGH_DISK_BYTES = 1 << 30
SWAPPED_SHARE = 0.1
CGROUP = Path("/sys/fs/cgroup")


def look_at_memory(needs: Needs | None) -> Iterator[Finding]:
    """Judge this machine's memory."""
    yield check_usable(probe_shared_memory())
    if SHARED_MEMORY.is_dir():
        found = shutil.disk_usage(SHARED_MEMORY)
        yield check_shared_memory(found.total, found.free, needs)
    available = psutil.virtual_memory().available
    limit, used = (read_number(CGROUP / f"memory.{name}") for name in ("max", "current"))
    if limit is not None:
        available = min(available, limit - (used or 0))
    yield check_working_memory(available, needs)
    swap = psutil.swap_memory()
    yield check_swap(swap.total, swap.used)
    yield check_disk(shutil.disk_usage(Path.cwd()).free, os.access(Path.cwd(), os.W_OK))


def probe_shared_memory() -> str:
    """Create and remove a segment; return what went wrong, '' if nothing did.

    They are named and locked like those of a run, so that the leftovers of a killed probe are swept like a
    dead run's.
    """
    run_id = secrets.token_hex(4)
    try:
        lock_fd = lock_folder(make_folder(run_id))
    except OSError as error:
        return str(error)
    try:
        Segment.create(names.board(run_id), HEADER_WORDS, SegmentKind.BOARD).close()
    except (OSError, RobbieError) as error:
        return str(error) or type(error).__name__
    finally:
        if lock_fd is not None:
            os.close(lock_fd)
        remove_names(run_id)
    return ""


def check_usable(problem: str) -> Finding:
    """Judge whether segments can be created."""
    if problem:
        return fail(
            "shared memory",
            f"segments cannot be created: {problem}",
            "mount it writable for all users: sudo mount -t tmpfs -o mode=1777 tmpfs /dev/shm",
        )
    return ok("shared memory", "segments can be created")


def check_shared_memory(total: int, free: int, needs: Needs | None) -> Finding:
    """Judge the space in /dev/shm, in bytes."""
    found = f"{size(free)} of {size(total)} are free in /dev/shm"
    wanted = ENOUGH_SHARED_BYTES if needs is None else needs.limit_bytes
    megabytes = ceil((wanted + total - free) / (1 << 20))
    larger = f"enlarge it: sudo mount -o remount,size={megabytes}m /dev/shm; in a container, --shm-size"
    if needs is None:
        if free < wanted:
            return warn("shared memory size", f"{found}; one module alone may fill {size(wanted)}", larger)
        return ok("shared memory size", found)
    found += f"; {needs.profile} takes {size(needs.start_bytes)} to start, at most {size(needs.limit_bytes)}"
    if free < needs.start_bytes:
        return fail("shared memory size", found, f"{larger}; see also `robbie clean`")
    if free < needs.limit_bytes:
        advice = f"{larger}; or lower memory.limit_bytes and memory.checkpoint_bytes in the profile"
        return warn("shared memory size", found, advice)
    return ok("shared memory size", found)


def check_working_memory(available: int, needs: Needs | None) -> Finding:
    """Judge the memory available to processes, in bytes; shared memory is part of it."""
    found = f"{size(available)} are available"
    if needs is None:
        return ok("memory", found)
    process_bytes = 40 << 20  # an idle interpreter with numpy and Robbie-MP
    start = needs.start_bytes + needs.processes * process_bytes
    most = needs.limit_bytes + needs.processes * process_bytes
    found += f"; {needs.profile} takes about {size(start)} to start, {size(most)} with shared memory full"
    if available < start:
        return fail("memory", found, "end other programs, or run fewer modules")
    if available < most:
        return warn("memory", found, "lower memory.limit_bytes and memory.checkpoint_bytes in the profile")
    return ok("memory", found)


def check_swap(total: int, used: int) -> Finding:
    """Judge swap space, in bytes: shared memory may be swapped out too."""
    found = f"{size(used)} of {size(total)} are used" if total else "none"
    if total and used > SWAPPED_SHARE * total:
        advice = "messages may have to be read from disk: free memory, then sudo swapoff -a && sudo swapon -a"
        return warn("swap", found, advice)
    return ok("swap", found)


def check_disk(free: int, is_writable: bool) -> Finding:
    """Judge the current folder, the default place of results and logs; free space in bytes."""
    if not is_writable:
        return warn("disk", "the current folder cannot be written to", "cd to another one, or give --output")
    if free < ENOUGH_DISK_BYTES:
        return warn("disk", f"{size(free)} are free for results and logs", "make room, or give --output")
    return ok("disk", f"{size(free)} are free for results and logs")
