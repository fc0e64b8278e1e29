import logging
import os
import platform
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from robbie_mp.base.linux.wake_latency import DEVICE
from robbie_mp.bus.transport.wakeup import Wakeup
from robbie_mp.run.profile.model import Scheduling
from robbie_mp.run.supervisor.scheduling import NoSuchCpu, apply_scheduling, computing_with
from tests.run.supervisor._support.running import wait_for

SCHEDULE = """
import logging, os
from robbie_mp.run.profile.model import Scheduling
from robbie_mp.run.supervisor.scheduling import apply_scheduling
cpu = min(os.sched_getaffinity(0))
apply_scheduling(Scheduling(realtime_priority=3, cpus=[cpu]), logging.getLogger())
assert os.sched_getaffinity(0) == {cpu}
print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK, os.sched_getparam(0).sched_priority)
"""


def test_process_has_the_requested_processors_and_priority() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", SCHEDULE], check=False, capture_output=True, text=True, timeout=30
    )
    assert ended.returncode == 0, ended.stderr
    if ended.stdout.split() != [str(os.SCHED_FIFO), "3"]:
        assert "no permission for real-time priority 3" in ended.stderr


SCHEDULE_THREADS = """
import logging, os, threading
from robbie_mp.run.profile.model import Scheduling
from robbie_mp.run.supervisor.scheduling import apply_scheduling, prefer_new_threads

def start():
    thread = threading.Thread(target=threading.Event().wait, daemon=True)
    thread.start()
    return thread.native_id

def show(*threads):
    for thread in threads:
        print(os.sched_getaffinity(thread) == {{cpu}}, os.getpriority(os.PRIO_PROCESS, thread),
              os.sched_getparam(thread).sched_priority)

cpu = min(os.sched_getaffinity(0))
before = [start() for _ in range(3)]
wanted = Scheduling(cpus=[cpu], nice={nice}, realtime_priority={priority})
apply_scheduling(wanted, logging.getLogger())
show(os.getpid(), *before)
later = start()
prefer_new_threads(wanted)
show(later)
"""


@pytest.mark.parametrize(("nice", "priority"), [(5, 0), (0, 3)])
def test_all_threads_have_the_requested_processors_and_priority(nice: int, priority: int) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", SCHEDULE_THREADS.format(nice=nice, priority=priority)],
        check=True, capture_output=True, text=True, timeout=30,
    )  # fmt: skip
    if "no permission for real-time priority" in ended.stderr:
        priority = 0
    least = min(19, os.getpriority(os.PRIO_PROCESS, 0) + nice)
    # A real-time process starts threads without its niceness (SCHED_RESET_ON_FORK of sched(7)).
    later = nice if priority else least
    expected = [f"True {least} {priority}"] * 4 + [f"True {later} {priority}"]
    assert ended.stdout.splitlines() == expected


BUSY = """
import logging
from robbie_mp.run.profile.model import Scheduling
from robbie_mp.run.supervisor.scheduling import apply_scheduling
apply_scheduling(Scheduling(cpus=[{cpu}], nice={nice}), logging.getLogger())
print("busy", flush=True)
while True:
    pass
"""


@contextmanager
def busy(cpu: int, nice: int) -> Iterator[int]:
    """A process in a session of its own, as modules have, that takes all it can get of a processor."""
    process = subprocess.Popen(
        [sys.executable, "-c", BUSY.format(cpu=cpu, nice=nice)],
        stdout=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    with process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "busy\n"
            yield process.pid
        finally:
            process.kill()


def cpu_s(pid: int) -> float:
    return time.clock_gettime(~pid << 3 | 2)  # the processor time of another process, as clock_getcpuclockid


@pytest.mark.slow
@pytest.mark.alone
def test_module_with_nice_10_gets_a_tenth_of_a_contended_processor() -> None:
    """Whether this kernel shares by session first (autogroup) or not."""
    cpu = min(os.sched_getaffinity(0))
    with busy(cpu, 0) as first, busy(cpu, 10) as second:
        begun_s = [cpu_s(first), cpu_s(second)]
        wait_for(lambda: cpu_s(first) + cpu_s(second) - sum(begun_s) > 1.5, limit_s=60)
        took_s = [cpu_s(first) - begun_s[0], cpu_s(second) - begun_s[1]]
    share = took_s[1] / sum(took_s)
    print(f"share of the one that steps back: {share:.3f}")
    assert 0.05 < share < 0.2, took_s


SESSION = """
import logging, os
from pathlib import Path
from robbie_mp.base.linux import priority
{prepare}
priority.lower_priority(7, logging.getLogger())
print((Path("/proc/self/autogroup").read_text().split() or ["none"])[-1])
"""
NO_AUTOGROUP = not Path("/proc/self/autogroup").exists()


def lower_priority_in_session(prepare: str, *, own_session: bool) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", SESSION.format(prepare=prepare)],
        check=True, capture_output=True, text=True, timeout=30, start_new_session=own_session,
    )  # fmt: skip


@pytest.mark.skipif(NO_AUTOGROUP, reason="NOT TESTED: this kernel does not share by session")
def test_only_a_session_leader_lowers_the_priority_of_its_session() -> None:
    """Else `robbie record` had the shell that it was started from step back, with all that runs there."""
    # A process whose session was made before autogroup was turned on has none: the file is there, but empty.
    now = (Path("/proc/self/autogroup").read_text().split() or ["none"])[-1]
    assert lower_priority_in_session("", own_session=True).stdout.strip() == "7"
    assert lower_priority_in_session("", own_session=False).stdout.strip() == now


@pytest.mark.skipif(NO_AUTOGROUP, reason="NOT TESTED: this kernel does not share by session")
def test_session_priority_is_set_later_if_needed_and_a_refusal_is_a_warning() -> None:
    """An ordinary user may set one in 0.1 s, all modules that start at once together."""
    hindered = """
class Hindered(type(Path())):
    refusals = {refusals}
    def write_text(self, text):
        if self.refusals:
            Hindered.refusals -= 1
            raise BlockingIOError(11, "Resource temporarily unavailable")
        return super().write_text(text)
priority._AUTOGROUP, priority._AUTOGROUP_TIMEOUT_S = Hindered("/proc/self/autogroup"), 1.0
"""
    late = lower_priority_in_session(hindered.format(refusals=3), own_session=True)
    assert (late.stdout.strip(), late.stderr) == ("7", "")
    never = lower_priority_in_session(hindered.format(refusals=1000), own_session=True)
    assert never.stdout.strip() == "0"
    assert "as large a share as others: /proc/self/autogroup: Resource temporarily" in never.stderr


def test_numerical_libraries_use_the_given_number_of_threads() -> None:
    count = "import os, numpy; print(len(os.listdir('/proc/self/task')))"
    for wanted in (1, 2):
        environment = computing_with(os.environ, wanted)
        ended = subprocess.run(
            [sys.executable, "-c", count], check=True, capture_output=True, text=True, env=environment
        )
        assert ended.stdout.strip() == str(min(wanted, len(os.sched_getaffinity(0))))
    assert computing_with({"OMP_NUM_THREADS": "2"}, 0) == {"OMP_NUM_THREADS": "2"}


def test_missing_permission_is_a_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_arguments: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    apply_scheduling(Scheduling(realtime_priority=50), logging.getLogger("core"))
    assert "no permission for real-time priority 50" in caplog.text


def test_missing_processor_is_an_error_that_names_the_present_ones() -> None:
    with pytest.raises(NoSuchCpu, match=r"scheduling.cpus is \[100000\], but this process may only use 0"):
        apply_scheduling(Scheduling(cpus=[100000]), logging.getLogger("core"))


LIMIT_LATENCY = """
import logging
from robbie_mp.run.profile.model import Scheduling
from robbie_mp.base.linux import wake_latency
from robbie_mp.run.supervisor import scheduling
wake_latency.DEVICE = scheduling.DEVICE = "{device}"
scheduling.apply_scheduling(Scheduling(wake_latency_us=17), logging.getLogger())
print("set", flush=True)
input()
"""


def wake_latency_us() -> int:
    (latency_us,) = struct.unpack("=i", Path(DEVICE).read_bytes()[:4])
    return int(latency_us)


@pytest.mark.skipif(not os.access(DEVICE, os.R_OK | os.W_OK), reason=f"{DEVICE} cannot be written")
def test_wake_latency_is_limited_as_long_as_the_process_lives() -> None:
    before_us = wake_latency_us()
    code = LIMIT_LATENCY.format(device=DEVICE)
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "set\n"
        assert wake_latency_us() == min(17, before_us)
        process.kill()
    assert wake_latency_us() == before_us


@pytest.mark.parametrize("device", ["/nowhere/cpu_dma_latency", "/dev/full"])
def test_wake_latency_that_cannot_be_limited_is_a_warning(device: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", LIMIT_LATENCY.format(device=device)],
        check=False, capture_output=True, text=True, timeout=30, input="\n",
    )  # fmt: skip
    assert (ended.returncode, ended.stdout) == (0, "set\n"), ended.stderr
    assert f"scheduling.wake_latency_us has no effect: {device} cannot be written (No " in ended.stderr


def test_spinning_process_polls_for_a_post_before_it_sleeps() -> None:
    looks = iter([False, False, False, True, True])
    slept: list[float | None] = []

    class Polled(Wakeup):
        has_posts = property(lambda _self: next(looks))

        def __init__(self) -> None:
            self._native, self._patience_s, self.spin_s = None, 0.0, 60.0

        def _take(self) -> bool:
            return False

        def _sleep(self, timeout_s: float | None) -> bool:
            slept.append(timeout_s)
            return True

    assert Polled().wait(90.0)
    assert next(looks), "it looked until the post had come"
    assert slept == [90.0]


STEP_BACK = """
import logging, os
from robbie_mp.run.profile.model import Scheduling
from robbie_mp.run.supervisor.scheduling import apply_scheduling
apply_scheduling(Scheduling(nice={wanted}), logging.getLogger(), nice=7)
print(os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0) == os.SCHED_OTHER)
"""


@pytest.mark.parametrize(("wanted", "nice"), [(None, 7), (3, 3), (0, 0)])
def test_nice_is_that_of_the_profile_or_else_of_the_class(wanted: int | None, nice: int) -> None:
    before = os.getpriority(os.PRIO_PROCESS, 0)
    ended = subprocess.run(
        [sys.executable, "-c", STEP_BACK.format(wanted=wanted)],
        check=True, capture_output=True, text=True, timeout=30,
    )  # fmt: skip
    assert ended.stdout.split() == [str(min(19, before + nice)), "True"]


SLICES = """
import ctypes, logging, platform, struct, threading
from robbie_mp.run.profile.model import Scheduling
from robbie_mp.run.supervisor.scheduling import apply_scheduling

def start():
    thread = threading.Thread(target=threading.Event().wait, daemon=True)
    thread.start()
    return thread.native_id

def slice_ms(thread):
    attributes = ctypes.create_string_buffer(56)
    number = {{"x86_64": 315, "aarch64": 275}}[platform.machine()]
    assert ctypes.CDLL(None).syscall(number, thread, attributes, 56, 0) == 0
    return struct.unpack_from("=Q", attributes, 24)[0] / 1e6  # sched_runtime of sched_getattr(2)

usual = slice_ms(0)
earlier = start()
apply_scheduling(Scheduling(slice_ms={wanted}, nice={nice}), logging.getLogger(), slice_ms={of_class})
print(usual, *[slice_ms(thread) for thread in (0, earlier, start())])
"""


@pytest.mark.skipif(platform.machine() not in ("x86_64", "aarch64"), reason="number of the call is unknown")
@pytest.mark.parametrize(
    ("wanted", "nice", "of_class", "slice_ms"),
    [(None, None, 100.0, 100.0), (0.5, None, 100.0, 0.5), (None, 5, None, 100.0), (2.0, 5, None, 2.0)],
)
def test_time_slice_of_all_threads_is_that_of_the_profile_or_else_of_the_class(
    wanted: float | None, nice: int | None, of_class: float | None, slice_ms: float
) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", SLICES.format(wanted=wanted, nice=nice, of_class=of_class)],
        check=True, capture_output=True, text=True, timeout=30,
    )  # fmt: skip
    usual_ms, *slices_ms = map(float, ended.stdout.split())
    if not usual_ms:
        pytest.skip("NOT TESTED: this kernel has no time slices (Linux 6.12)")
    assert slices_ms == [slice_ms] * 3


def test_refused_time_slice_is_a_warning() -> None:
    """As sandboxes do that know no such system call; no kernel has one of this number."""
    refused = "import platform\nfrom robbie_mp.base.linux import priority\n"
    refused += "priority._SCHED_SETATTR[platform.machine()] = 100_000\n"
    before = os.getpriority(os.PRIO_PROCESS, 0)
    ended = subprocess.run(
        [sys.executable, "-c", refused + STEP_BACK.format(wanted=None)],
        check=False, capture_output=True, text=True, timeout=30,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.split() == [str(min(19, before + 7)), "True"]
    assert "sched_setattr: Function not implemented" in ended.stderr
