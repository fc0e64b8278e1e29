"""Limits of this user, of the kernel, and of a container."""

import os
import resource
from collections.abc import Iterator
from pathlib import Path

import psutil

from robbie_mp.run.doctor.finding import Finding, fail, ok, read_number, size, warn
from robbie_mp.run.doctor.needs import Needs

KERNEL = Path("/proc/sys/kernel")
ENOUGH_DESCRIPTORS = 1024
ENOUGH_PROCESSES = 256
SMALLEST_PID_MAX = 4096
UNLIMITED = resource.RLIM_INFINITY
ON_LOGIN = "for all logins: /etc/security/limits.conf; for a service: LimitNOFILE=, LimitNPROC=, LimitFSIZE="


def look_at_limits(needs: Needs | None) -> Iterator[Finding]:
    """Judge this machine's limits."""
    yield check_descriptors(resource.getrlimit(resource.RLIMIT_NOFILE)[0], needs)
    threads = own_threads()
    is_exempt = os.geteuid() == 0  # the kernel does not limit root
    limit = UNLIMITED if is_exempt else resource.getrlimit(resource.RLIMIT_NPROC)[0]
    yield check_processes(limit, threads, os.cpu_count() or 1, needs)
    yield check_file_size(resource.getrlimit(resource.RLIMIT_FSIZE)[0], needs)
    yield check_pids(read_number(KERNEL / "pid_max"), read_number(Path("/sys/fs/cgroup/pids.max")))
    rtprio = UNLIMITED if is_exempt else resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    yield check_optional(resource.getrlimit(resource.RLIMIT_MEMLOCK)[0], rtprio, needs)
    yield check_system_v(read_number(KERNEL / "shmmax"), read_number(KERNEL / "shmmni"))


def own_threads() -> int:
    """Return the number of this user's threads, which RLIMIT_NPROC limits."""
    uid = os.geteuid()
    count = 0
    for process in psutil.process_iter():
        try:
            if process.uids().effective == uid:
                count += process.num_threads()
        except psutil.Error:
            continue  # it has ended
    return count


def _number(limit: int) -> str:
    return "unlimited" if limit == UNLIMITED else str(limit)


def check_descriptors(limit: int, needs: Needs | None) -> Finding:
    """Judge RLIMIT_NOFILE: a process needs a descriptor for each mapping, the supervisor for each child."""
    found = f"a process may open {_number(limit)} (RLIMIT_NOFILE)"
    wanted = needs.descriptors if needs else ENOUGH_DESCRIPTORS
    if needs:
        found += f"; {needs.profile} takes {needs.descriptors_to_start} to start, at most {wanted}"
    if limit == UNLIMITED or limit >= wanted:
        return ok("descriptors", found)
    advice = f"ulimit -n {wanted}; {ON_LOGIN}"
    is_too_few = needs is not None and limit < needs.descriptors_to_start
    return fail("descriptors", found, advice) if is_too_few else warn("descriptors", found, advice)


def check_processes(limit: int, threads: int, processors: int, needs: Needs | None) -> Finding:
    """Judge RLIMIT_NPROC against this user's threads; numpy starts one for each processor."""
    found = f"this user may have {_number(limit)} threads and has {threads} (RLIMIT_NPROC)"
    wanted = needs.processes * processors if needs else ENOUGH_PROCESSES
    if needs:
        found += f"; {needs.profile} takes {needs.processes} to {wanted}"
    if limit == UNLIMITED or limit - threads >= wanted:
        return ok("processes", found)
    advice = f"ulimit -u {threads + wanted}; {ON_LOGIN}"
    is_too_few = needs is not None and limit - threads < needs.processes
    return fail("processes", found, advice) if is_too_few else warn("processes", found, advice)


def check_file_size(limit: int, needs: Needs | None) -> Finding:
    """Judge RLIMIT_FSIZE in bytes; it also limits segments of shared memory."""
    if limit == UNLIMITED:
        return ok("file size", "unlimited (RLIMIT_FSIZE)")
    found = f"at most {size(limit)} (RLIMIT_FSIZE), which also limits shared memory"
    wanted = needs.largest_file_bytes if needs else ENOUGH_PROCESSES << 20
    if limit < wanted:
        return fail("file size", f"{found}; needed: {size(wanted)}", f"ulimit -f unlimited; {ON_LOGIN}")
    return ok("file size", found)


def check_pids(pid_max: int | None, container_max: int | None) -> Finding:
    """Judge how many processes the kernel and the container, if any, allow."""
    known = [count for count in (pid_max, container_max) if count is not None]
    if not known:
        return ok("process numbers", "the kernel does not report the limit")
    found = f"{min(known)} processes and threads fit into this {'container' if container_max else 'machine'}"
    if min(known) < ENOUGH_PROCESSES:
        return fail("process numbers", found, "raise pids.max of the container (docker: --pids-limit)")
    if min(known) < SMALLEST_PID_MAX:
        return warn("process numbers", found, "sudo sysctl kernel.pid_max=32768, or raise --pids-limit")
    return ok("process numbers", found)


def check_optional(memlock: int, rtprio: int, needs: Needs | None) -> Finding:
    """Judge limits that only some robots need: locked memory, real-time priority."""
    locked = "unlimited memory" if memlock == UNLIMITED else size(memlock)
    found = (
        f"a module may lock {locked} (RLIMIT_MEMLOCK) and have real-time priority up to {_number(rtprio)} "
        "(RLIMIT_RTPRIO)"
    )
    if needs is not None and rtprio != UNLIMITED and needs.realtime_priority > rtprio:
        found += f"; {needs.profile} asks for {needs.realtime_priority} and would run at ordinary priority"
        return warn("real time", found, "raise it: rtprio in /etc/security/limits.conf, or CAP_SYS_NICE")
    return ok("real time", found)


def check_system_v(shmmax: int | None, shmmni: int | None) -> Finding:
    """Report kernel.shm*, which people check first although it does not matter here."""
    found = f"kernel.shmmax is {shmmax}, kernel.shmmni {shmmni}; neither limits POSIX shared memory"
    return ok("System V", found)
