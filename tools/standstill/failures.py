"""The failures: one entry each."""

import os
import signal
import struct
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

from tools.standstill.scene import TrialRobot
from tools.standstill.ways import NEAR, DrivingWay
from tools.test_network.network import NetworkConditions

DISK_BYTES = 64 << 20
HOUR_S = 3600
CLOCK, DISK_FILLER = "clock", "filler"
Act = Callable[[TrialRobot], object]


@dataclass(frozen=True)
class Failure:
    """A failure.

    Attributes:
        begins: causes it.
        ends: undoes it, as far as nobody else does.
        role: the process that fails; '' if none does.
        lets_go: the robot may drive on; what is measured is how soon it stands if somebody then lets go.
        watch_s: how long the robot is watched.
        prepared: a context for the robot's folder, in which the robot must be started.
        is_final: the robot does not drive again.
    """

    begins: Act
    ends: Act
    role: str = ""
    lets_go: bool = False
    watch_s: float = 2.0
    prepared: "Callable[[Path], Any]" = nullcontext
    is_final: bool = False


def process_failures(role: str) -> dict[str, Failure]:
    """Return the failures of a process."""
    is_final = role in ("browser", "laptop")

    def killed(scene: TrialRobot) -> None:
        scene.send(role, signal.SIGKILL)

    def revived(scene: TrialRobot) -> None:
        killed(scene)  # one that spins
        scene.revive(role)

    found = {
        f"{role} killed": Failure(killed, lambda scene: scene.revive(role), role, is_final=is_final),
        f"{role} stopped": Failure(
            lambda scene: scene.send(role, signal.SIGSTOP),
            lambda scene: scene.send(role, signal.SIGCONT),
            role,
        ),
        f"{role} spinning": Failure(lambda scene: scene.spin(role), revived, role),
    }
    if is_final:
        del found[f"{role} spinning"]  # only Python is made to spin
    return found


def network(conditions: NetworkConditions, *, lets_go: bool = False) -> Failure:
    """Return a failure of the network."""
    return Failure(
        lambda scene: scene.network.delay(conditions),
        lambda scene: scene.network.delay(NEAR),
        lets_go=lets_go,
        watch_s=2.0 + 2 * conditions.delay_s,
    )


@contextmanager
def small_disk(folder: Path) -> Iterator[None]:
    """Put the robot's folder on a disk of its own."""
    size = f"size={DISK_BYTES}"
    subprocess.run(["mount", "-t", "tmpfs", "-o", size, "robbie-standstill", str(folder)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill_disk(scene: TrialRobot) -> None:
    """Leave no room for what the robot writes."""
    with suppress(OSError), (scene.robot.output.parent / DISK_FILLER).open("wb", buffering=0) as file:
        while True:
            file.write(bytes(1 << 16))


def empty_disk(scene: TrialRobot) -> None:
    """Make room again."""
    (scene.robot.output.parent / DISK_FILLER).unlink()


@contextmanager
def settable_clock(folder: Path) -> Iterator[None]:
    """Give the robot a time of day that can be set without setting this machine's."""
    library, source = folder / "clock.so", Path(__file__).parent / "clock.c"
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    (folder / CLOCK).write_bytes(struct.pack("<q", 0))
    with patch.dict(os.environ, LD_PRELOAD=str(library), ROBBIE_CLOCK=str(folder / CLOCK)):
        yield


def clock_set(ahead_s: int) -> Failure:
    """Return the failure that the robot's clock is set."""

    def put(scene: TrialRobot, seconds: int) -> None:
        with Path(scene.robot.environment["ROBBIE_CLOCK"]).open("r+b") as file:
            file.write(struct.pack("<q", seconds))

    return Failure(
        lambda scene: put(scene, ahead_s),
        lambda scene: put(scene, 0),
        lets_go=True,
        prepared=settable_clock,
    )


def spin_page(scene: TrialRobot) -> None:
    """Have the page's script run for ever."""
    scene.page.evaluate("setTimeout(() => { for (;;); }, 0)")


MACHINE = {
    "disk full": Failure(fill_disk, empty_disk, lets_go=True, prepared=small_disk),
    "clock 1 h ahead": clock_set(HOUR_S),
    "clock 1 h back": clock_set(-HOUR_S),
}
NETWORK = {
    "network cut": Failure(
        lambda scene: scene.network.cut(),
        lambda scene: scene.network.restore(),
    ),
    "network 0.1 s": network(NetworkConditions(delay_s=0.1), lets_go=True),
    "network 0.3 s": network(NetworkConditions(delay_s=0.3)),
    "network 1 s": network(NetworkConditions(delay_s=1.0)),
    "network 3 s": network(NetworkConditions(delay_s=3.0)),
    "network reordered": network(NetworkConditions(delay_s=0.05, jitter_s=0.05, reorders=True), lets_go=True),
}
PAGE = {
    "page closed": Failure(lambda scene: scene.page.close(), lambda _scene: None, is_final=True),
    "page spinning": Failure(spin_page, lambda scene: scene.send("browser", signal.SIGKILL), is_final=True),
}


def failures_of(name: str, way: DrivingWay) -> dict[str, Failure]:
    """Return all failures of a way, by name; those that end the robot's drive come last."""
    found = {key: one for role in way.needed for key, one in process_failures(role).items()}
    found |= (NETWORK if way.is_far else {}) | (PAGE if name == "page" else {}) | MACHINE
    return dict(
        sorted(found.items(), key=lambda item: (item[1].prepared is not nullcontext, item[1].is_final))
    )
