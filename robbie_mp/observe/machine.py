"""The computer that a run is on: processors, memory, /dev/shm."""

import os
from dataclasses import dataclass

import psutil

SHARED_MEMORY = "/dev/shm"


@dataclass(frozen=True)
class MachineReading:
    """The figures of the machine at one moment."""

    cpu_busy_s: tuple[float, ...]
    """Time used on each processor since the machine started."""
    load: tuple[float, float, float]
    """Mean number of processes that ran or were ready to run, over the last 1, 5 and 15 minutes."""
    memory_available_bytes: int
    memory_total_bytes: int
    shared_memory_used_bytes: int
    """Used bytes of /dev/shm, by all processes."""
    shared_memory_total_bytes: int

    @classmethod
    def now(cls) -> "MachineReading":
        """Read the machine's figures now."""
        memory = psutil.virtual_memory()
        shared = os.statvfs(SHARED_MEMORY)
        return cls(
            cpu_busy_s=tuple(_busy_s(times) for times in psutil.cpu_times(percpu=True)),
            load=os.getloadavg(),
            memory_available_bytes=memory.available,
            memory_total_bytes=memory.total,
            shared_memory_used_bytes=(shared.f_blocks - shared.f_bfree) * shared.f_frsize,
            shared_memory_total_bytes=shared.f_blocks * shared.f_frsize,
        )


def _busy_s(times: "psutil._ntuples.scputimes") -> float:
    # `user` already includes the time of guests.
    return float(times.user + times.nice + times.system + times.irq + times.softirq + times.steal)
