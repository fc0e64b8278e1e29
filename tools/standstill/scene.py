"""A robot that drives, what is seen of it, and the processes on which its motion rests."""

import math
import os
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Page

from robbie_mp import RobbieError
from robbie_mp.attached.tool.script import AttachedRun
from robbie_mp.bus.observe import ModuleFigures
from robbie_mp.messages import DriveCommand, LaserScan, Message, Odometry, PoseStamped
from robbie_mp.run.run_directory import list_runs
from tools.robot import Robot
from tools.standstill.hook.sitecustomize import NAME, SPIN
from tools.test_network.network import Network

DRIVES_M_PER_S = 0.15
STEADY_S = 0.4
"""A failure comes when the robot has driven for this time."""
IN_FLIGHT_S = 0.06
"""What arrives within this time after a failure may have been sent before it."""
START_LIMIT_S, SPINS_LIMIT_S, URGE_S = 40.0, 2.0, 2.0
OUTPUTS: dict[str, type[Message]] = {"laser": LaserScan, "rear_laser": LaserScan, "mapping": PoseStamped}
"""What a process gives; all others: drive commands."""


class NotDriving(RuntimeError):
    """The robot does not drive, so that nothing can be measured."""


class Seen:
    """Collects messages of a run: rows of their time (monotonic, s), and of odometry the motion.

    Args:
        run: the run.
        message_type: of the messages.
        topic: of them; '' for all.
        sender: only those of this module; '' for all.
    """

    def __init__(self, run: AttachedRun, message_type: type[Message], topic: str = "", sender: str = ""):
        self._run, self._type, self._topic, self._sender = run, message_type, topic, sender
        self.rows: list[tuple[float, ...]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """See no more."""
        self._ended.set()

    def _listen(self) -> None:
        while not self._ended.wait(0.05):
            with suppress(RobbieError):  # the run is starting, or over
                listener = self._run.listen(self._type, self._topic, max_waiting=2000)
                with listener:
                    for message in listener:
                        if self._ended.is_set():
                            return
                        envelope = listener.envelope
                        if self._sender in ("", envelope.sender):
                            self.rows.append((envelope.published_ns / 1e9, *_motion(message)))

    def first_after(self, time_s: float) -> float:
        """Return when the first message after a time was published; infinite: none."""
        return min((row[0] for row in list(self.rows) if row[0] > time_s), default=math.inf)


class CoreSeen:
    """Sees by the shared counters when another core than the present one delivers to the base.

    A look takes long on a busy machine. The time is the earliest that it can have been: that of the last look
    before the base handled something of the new core, but not before that core was started.

    Args:
        robot: the run.
    """

    def __init__(self, robot: Robot):
        self._robot = robot
        self._looked_s = time.monotonic()
        figures = robot.figures()
        self._before, self._handled = figures["core"].incarnation, figures["base"].handled
        self._fresh_s = math.inf
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """See no more."""
        self._ended.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._ended.wait(0.005):
            now_s = time.monotonic()
            figures = self._robot.figures()
            core, handled = figures["core"], figures["base"].handled
            if core.incarnation != self._before and self._routes(core) and handled > self._handled:
                self._fresh_s = max(self._looked_s, core.started_ns / 1e9)
                return
            self._looked_s, self._handled = now_s, handled

    def _routes(self, core: ModuleFigures) -> bool:
        """Whether a core has begun its own work."""
        observer = self._robot.observer
        return observer is not None and observer.core().heartbeat_ns > core.started_ns > 0

    def first_after(self, _time_s: float) -> float:
        """Return when it first did; infinite: never."""
        return self._fresh_s


def _motion(message: Any) -> tuple[float, ...]:
    if not isinstance(message, Odometry):
        return ()
    twist, place = message.twist.twist, message.pose.pose.position
    return twist.linear.x, twist.angular.z, place.x, place.y


class TrialRobot:
    """A robot on its way.

    Args:
        robot: its run.
        network: between the robot and its operator; None: they are on one machine.
    """

    def __init__(self, robot: Robot, network: Network | None = None):
        self.robot = robot
        self._network = network
        self._page: Page | None = None
        self.others: dict[str, Callable[[], Sequence[int]]] = {}
        """The pids of what is not a process of the run, by role."""
        self.sent_s = self.done_s = 0.0
        self.urge: Callable[[], object] = lambda: None
        """What an operator does when the robot does not drive."""
        self.revivals: dict[str, Callable[[], object]] = {}
        """What starts such a process again, which nobody else does."""
        (known,) = list_runs(robot.bases)
        self.run = AttachedRun(known)
        self.truth = Seen(self.run, Odometry, "ground_truth")

    def close(self) -> None:
        """See no more of it."""
        self.truth.close()

    @property
    def network(self) -> Network:
        """The network between the robot and its operator."""
        assert self._network is not None, "the operator is on the robot's machine"
        return self._network

    @property
    def page(self) -> Page:
        """The operator's page."""
        assert self._page is not None, "nobody drives by a page"
        return self._page

    @page.setter
    def page(self, page: Page) -> None:
        self._page = page

    def pids(self, role: str) -> Sequence[int]:
        """Return the processes of a role."""
        return self.others[role]() if role in self.others else [self.robot.figures()[role].pid]

    def send(self, role: str, number: int) -> None:
        """Send a signal to the processes of a role, and note when."""
        pids = self.pids(role)
        self.sent_s = time.monotonic()
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(pid, number)
        self.done_s = time.monotonic()

    def spin(self, role: str) -> None:
        """Have the processes of a role spin.

        Raises:
            NotDriving: one does not.
        """
        self.send(role, SPIN)
        until_s = time.monotonic() + SPINS_LIMIT_S
        names = [""]
        while not all(name.startswith(NAME) for name in names):
            if time.monotonic() > until_s:
                raise NotDriving(f"{role} does not spin")
            time.sleep(0.002)
            names = [Path(f"/proc/{pid}/comm").read_text() for pid in self.pids(role)]
        self.sent_s = self.done_s = max(int(name[len(NAME) :]) for name in names) / 1e6

    def revive(self, role: str) -> None:
        """Have a killed process back."""
        self.revivals.get(role, lambda: None)()

    def output_of(self, role: str) -> Seen | CoreSeen:
        """Begin to look at what a role gives."""
        if role == "core":
            return CoreSeen(self.robot)
        sender = "" if role in self.others else role
        return Seen(self.run, OUTPUTS.get(role, DriveCommand), sender=sender)

    def wait_until_it_drives(self, limit_s: float = START_LIMIT_S) -> None:
        """Wait until the robot has driven for a while.

        Raises:
            NotDriving: it does not.
        """
        until_s, urge_s = time.monotonic() + limit_s, time.monotonic() + URGE_S
        while time.monotonic() < until_s and self.robot.is_up:
            now_s = time.monotonic()
            last = [row for row in self.truth.rows[-40:] if now_s - row[0] < STEADY_S]
            if len(last) >= 4 and all(abs(row[1]) > DRIVES_M_PER_S for row in last):
                return
            if now_s > urge_s:
                self.urge()
                urge_s = time.monotonic() + URGE_S
            time.sleep(0.01)
        raise NotDriving(
            "the robot does not drive"
            if self.robot.is_up
            else f"the run has ended: {self.robot.said()[-300:]}"
        )

    def wait_for_motion(self, until_s: float, limit_s: float) -> None:
        """Wait until the motion up to a time has arrived, but not longer than a limit."""
        late_s = time.monotonic() + limit_s
        while math.isinf(self.truth.first_after(until_s)) and time.monotonic() < late_s:
            time.sleep(0.02)

    def motion(self) -> NDArray[np.float64]:
        """Return time (s), speed (m/s), turn rate (rad/s), x and y (m) of the true motion."""
        rows = np.array(list(self.truth.rows)).reshape(-1, 5)
        return rows[np.argsort(rows[:, 0], kind="stable")]
