"""What a new run must not share with those that are live: the workspace of a robot, and devices."""

import contextlib
import fcntl
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.run.live_runs import live_runs
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.model import ModuleSpec
from robbie_mp.run.run_directory import KnownRun, base_folders, make_private

LONGEST_START_S = 5.0
"""After this time, a run that is being started by another process counts as stuck, and is not waited for."""
DEVICES = ("/dev/", "socket://", "rfc2217://")
"""How settings begin that name a device, or a port behind which one is."""
NO_DEVICES = ("/dev/shm/", "/dev/null", "/dev/zero", "/dev/urandom", "/dev/random", "/dev/std", "/dev/fd/")


class RobotRunsAlready(RobbieError, BlockingIOError):
    """The robot of this workspace runs already.

    Example scenarios:
      - `robbie run` was typed in a second terminal
      - systemd has started the robot, and somebody starts it by hand too
    """


class DeviceTaken(RobbieError, BlockingIOError):
    """A live run uses a device that the new run names.

    Example scenarios:
      - two workspaces on one computer drive the same motor
      - a profile was copied, and still has the port of the other robot
    """


@contextlib.contextmanager
def one_start_at_a_time() -> Iterator[None]:
    """Let no other process of this user start a run meanwhile, so that of two robots one sees the other.

    Raises:
        UnsafeRunFolder: other users could change the folder for runs.
    """
    base = base_folders()[0]
    make_private(base)
    folder = os.open(base, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        _lock(folder)
        yield
    finally:
        os.close(folder)


def _lock(folder: int) -> None:
    end_s = time.monotonic() + LONGEST_START_S
    while time.monotonic() < end_s:
        with contextlib.suppress(BlockingIOError):
            return fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        time.sleep(0.01)


def refuse_second_robot(workspace: Path) -> None:
    """Refuse a robot if one runs in this workspace.

    Raises:
        RobotRunsAlready: one does.
    """
    here = str(workspace.resolve())
    for run in live_runs():
        if (record := run.record) and record.is_robot and record.workspace == here:
            raise RobotRunsAlready(
                f"the robot of {here} runs already: run {run.run_id}, profile {record.profile}, since "
                f"{record.started_at[:19]}Z, process {record.supervisor_pid}; end it with `robbie stop`, or "
                "add --another to run both"
            )


def refuse_taken_devices(modules: Iterable[ModuleSpec]) -> None:
    """Refuse a run if the settings of its modules name a device that those of a live run name.

    Raises:
        DeviceTaken: they do; the text says where.
    """
    wanted = _devices_of(modules)
    for run in live_runs() if wanted else ():
        taken = _devices_of_run(run)
        for device in sorted(wanted.keys() & taken.keys()):
            raise DeviceTaken(
                f"{wanted[device]} is {device}, which run {run.run_id} ({run.record and run.record.profile}) "
                f"uses as {taken[device]}; end that run with `robbie stop --run {run.run_id}`, or use "
                "another device"
            )


def named_devices(modules: Iterable[ModuleSpec]) -> Iterator[tuple[str, str]]:
    """Yield each setting that names a device, as `laser.port`, and the device as it is written there."""
    for module in modules:
        for name, value in module.settings.items():
            yield from ((f"{module.name}.{name}", device) for device in _devices(value))


def _devices_of(modules: Iterable[ModuleSpec]) -> dict[str, str]:
    """Return the devices that the settings of modules name, and which setting names each."""
    return {_device_itself(device): setting for setting, device in named_devices(modules)}


def _devices_of_run(run: KnownRun) -> dict[str, str]:
    try:
        return _devices_of(RunPlan.load(run.folder).modules)
    except (OSError, ValueError, LookupError, TypeError):  # it is just ending, or has another version
        return {}


def _devices(value: object) -> Iterator[str]:
    if isinstance(value, dict | list | tuple):
        parts: Sequence[object] = list(value.values()) if isinstance(value, dict) else value
        for part in parts:
            yield from _devices(part)
    elif isinstance(value, str | Path) and _is_device(str(value)):
        yield str(value)


def _is_device(text: str) -> bool:
    return text.startswith(DEVICES) and not _device_itself(text).startswith(NO_DEVICES)


def _device_itself(device: str) -> str:
    """Return one name for all names of a device: links such as /dev/serial/by-id/… lead to it."""
    return os.path.realpath(device) if device.startswith("/") else device.lower().rstrip("/")
