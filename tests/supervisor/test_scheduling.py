import logging
import os
import struct
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from robbie_mp.profile.model import Scheduling
from robbie_mp.supervisor.scheduling import NoSuchCpu, apply_scheduling
from robbie_mp.transport.wakeup import Wakeup
from robbie_mp.wake_latency import DEVICE

SCHEDULE = """
import logging, os
from robbie_mp.profile.model import Scheduling
from robbie_mp.supervisor.scheduling import apply_scheduling
cpu = min(os.sched_getaffinity(0))
apply_scheduling(Scheduling(realtime_priority=3, cpus=[cpu]), logging.getLogger())
assert os.sched_getaffinity(0) == {cpu}
print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK, os.sched_getparam(0).sched_priority)
"""


def test_process_runs_where_and_how_it_is_asked_to() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", SCHEDULE], check=False, capture_output=True, text=True, timeout=30
    )
    assert ended.returncode == 0, ended.stderr
    if ended.stdout.split() != [str(os.SCHED_FIFO), "3"]:
        assert "no permission for real-time priority 3" in ended.stderr


def test_missing_permission_is_a_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_arguments: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    apply_scheduling(Scheduling(realtime_priority=50), logging.getLogger("core"))
    assert "no permission for real-time priority 50" in caplog.text


def test_processor_that_is_not_there_is_an_error_that_names_those_that_are() -> None:
    with pytest.raises(NoSuchCpu, match=r"scheduling.cpus is \[100000\], but this process may only use 0"):
        apply_scheduling(Scheduling(cpus=[100000]), logging.getLogger("core"))


LIMIT_LATENCY = """
import logging
from robbie_mp.profile.model import Scheduling
from robbie_mp import wake_latency
from robbie_mp.supervisor import scheduling
wake_latency.DEVICE = scheduling.DEVICE = "{device}"
scheduling.apply_scheduling(Scheduling(wake_latency_us=17), logging.getLogger())
print("set", flush=True)
input()
"""


def wake_latency_us() -> int:
    (latency_us,) = struct.unpack("=i", Path(DEVICE).read_bytes()[:4])
    return int(latency_us)


@pytest.mark.skipif(
    not os.access(DEVICE, os.R_OK | os.W_OK), reason=f"{DEVICE} cannot be written"
)
def test_processors_sleep_lightly_as_long_as_the_process_lives() -> None:
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
    assert f"processors sleep as deep as usual, for {device} cannot be written (No " in ended.stderr


def test_who_spins_looks_for_a_post_before_it_sleeps() -> None:
    looks = iter([0, 0, 0, 1, 1])
    slept = []

    class Semaphore(SimpleNamespace):
        @property
        def value(self) -> int:
            return next(looks) if not slept else 0

    wakeup = Wakeup(Semaphore(release=None, acquire=slept.append))  # type: ignore[arg-type]
    wakeup.spin_s = 60.0
    assert wakeup.wait(90.0)
    assert next(looks) == 1, "it looked until the post had come"
    assert slept == [90.0]


STEP_BACK = """
import logging, os
from robbie_mp.profile.model import Scheduling
from robbie_mp.supervisor.scheduling import apply_scheduling
apply_scheduling(Scheduling(nice={wanted}), logging.getLogger(), nice=7)
print(os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0) == os.SCHED_OTHER)
"""


@pytest.mark.parametrize(("wanted", "nice"), [(None, 7), (3, 3), (0, 0)])
def test_process_steps_back_as_far_as_its_profile_says_or_else_its_class(
    wanted: int | None, nice: int
) -> None:
    before = os.getpriority(os.PRIO_PROCESS, 0)
    ended = subprocess.run(
        [sys.executable, "-c", STEP_BACK.format(wanted=wanted)],
        check=True, capture_output=True, text=True, timeout=30,
    )  # fmt: skip
    assert ended.stdout.split() == [str(min(19, before + nice)), "True"]


def test_kernel_that_refuses_another_slice_is_a_warning() -> None:
    """As sandboxes do that know no such system call; no kernel has one of this number."""
    refused = "import platform\nfrom robbie_mp import stepping_back\n"
    refused += "stepping_back._SYSTEM_CALLS[platform.machine()] = 100_000\n"
    before = os.getpriority(os.PRIO_PROCESS, 0)
    ended = subprocess.run(
        [sys.executable, "-c", refused + STEP_BACK.format(wanted=None)],
        check=False, capture_output=True, text=True, timeout=30,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.split() == [str(min(19, before + 7)), "True"]
    assert "sched_setattr: Function not implemented" in ended.stderr
