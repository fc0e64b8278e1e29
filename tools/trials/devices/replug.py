"""Pulls the cables of a running rescue robot's devices and plugs them in again.

    python -m tools.trials replug [--rounds 50] [--seconds 3600] [--load 2] [--calm 8]

The robot explores a maze with an emulated Pioneer (whose watchdog is set to 0.15 s), Hokuyo and Xsens. The
tool pulls one plug after another while other processes compute. For each it measures how long the robot
drove on (base only), when the robot was told of the loss, when the device's measurements were back after the
plug was plugged in again, and when the robot drove on. The times begin when the tool sends its wish to the
emulator, so they are rather too long. After each round follows a time without replugs (`--calm`), so that the
other modules' latencies with and without replugs are compared under the same other work. When the mission has
ended, another one begins.
"""

import argparse
import json
import math
import random
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp.attached.tool.tool import RunEnded, Tool
from robbie_mp.bus.observe import ModuleFigures
from robbie_mp.bus.transport.histogram import quantile_s
from robbie_mp.messages import DeviceState, Imu, LaserScan, Message, Odometry, SettingChange
from robbie_mp.run.run_directory import list_runs
from tools.busy import busy
from tools.robot import REPOSITORY, Robot, RobotTrouble
from tools.trials.harness import Case, TrialSubject

PROFILE = "rescue-emulated"
SETTINGS = {
    "mission.time_limit_s": 3000.0,
    "navigation.max_recoveries": 100,
}
MEASUREMENT: dict[str, tuple[type[Message], str]] = {
    "base": (Odometry, "odom"),
    "laser": (LaserScan, ""),
    "imu": (Imu, "imu"),
}
"""What each driver publishes."""
WITNESSES = ("mapping", "navigation", "mission", "camera", "victims")
"""Modules whose latencies are compared."""
MOVES_M_PER_S, MOVES_RAD_PER_S = 0.05, 0.1
STANDS = 0.005
STANDS_S, BACK_S = 0.4, 2.0
LIMIT_S = 30.0
MAX_RUNS = 20


@dataclass
class Replugs:
    """The times of one device, s.

    Attributes:
        told_s: from the pulling to the driver's DeviceState.
        back_s: from the plugging in to the next measurement.
        stands_s: from the pulling until the robot stood; only of the base, and if the robot moved.
        ways_m: how far it drove meanwhile.
        drives_s: from the plugging in until the robot moved again; only if it moved before.
        stale: measurements that were published after the loss was told and before the plug was in again.
    """

    told_s: list[float] = field(default_factory=list)
    back_s: list[float] = field(default_factory=list)
    stands_s: list[float] = field(default_factory=list)
    ways_m: list[float] = field(default_factory=list)
    drives_s: list[float] = field(default_factory=list)
    stale: int = 0


class Witness:
    """Hears what the robot's modules publish, and pulls plugs.

    Attributes:
        moves: whether the robot moves now.
        place: where it is.
        stood_ns: since when it stands, machine's monotonic clock.
    """

    def __init__(self, tool: Tool) -> None:
        self._tool = tool
        self.moves = False
        self.place = (0.0, 0.0)
        self.moved_ns = self.stood_ns = 0
        self.measured_ns = dict.fromkeys(MEASUREMENT, 0)
        self.measurements = dict.fromkeys(MEASUREMENT, 0)
        self.state_ns = dict.fromkeys(MEASUREMENT, 0)
        self.states = dict.fromkeys(MEASUREMENT, "")
        self._truth = tool.subscribe(Odometry.type_name, Odometry.version, "ground_truth")
        self._measured = {
            tool.subscribe(kind.type_name, kind.version, topic): name
            for name, (kind, topic) in MEASUREMENT.items()
        }
        for name in MEASUREMENT:
            tool.subscribe(DeviceState.type_name, DeviceState.version, name)
        tool.ready()

    def set_plug(self, device: str, is_in: bool) -> int:
        """Pull a plug, or plug it in; return when, ns."""
        change = SettingChange(request=1, setting="virtual_plug", value=str(is_in).lower())
        now_ns = time.monotonic_ns()
        if not self._tool.publish(change, f"{device}_emulator"):
            raise RobotTrouble("the wish to change a plug was refused")
        return now_ns

    def wait_for(self, condition: Callable[[], bool], what: str, limit_s: float = LIMIT_S) -> None:
        """Wait for a condition.

        Raises:
            RobotTrouble: it does not hold in time.
        """
        until_s = time.monotonic() + limit_s
        while not condition():
            if time.monotonic() > until_s:
                raise RobotTrouble(f"{what} within {limit_s:g} s: that did not happen")
            self._tool.wait(0.01)
            self._hear()

    def hear_for(self, seconds: float) -> None:
        """Listen for some time."""
        until_s = time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > 0:
            self._tool.wait(min(left_s, 0.01))
            self._hear()

    def _hear(self) -> None:
        while (received := self._tool.take()) is not None:
            if received.subscription == self._truth:
                self._see_truth(Odometry.decode(received.data), received.published_ns)
            elif received.subscription in self._measured:
                name = self._measured[received.subscription]
                self.measured_ns[name] = received.published_ns
                self.measurements[name] += 1
            else:
                state = DeviceState.decode(received.data).state
                if state != self.states[received.topic]:
                    self.states[received.topic] = state
                    self.state_ns[received.topic] = received.published_ns

    def _see_truth(self, truth: Odometry, published_ns: int) -> None:
        position = truth.pose.pose.position
        self.place = (position.x, position.y)
        linear, angular = abs(truth.twist.twist.linear.x), abs(truth.twist.twist.angular.z)
        if linear < STANDS and angular < STANDS:
            if self.moves:
                self.stood_ns = published_ns
            self.moves = False
        elif linear > MOVES_M_PER_S or angular > MOVES_RAD_PER_S:
            if not self.moves:
                self.moved_ns = published_ns
            self.moves = True


def replug(witness: Witness, device: str, chance: random.Random, replugs: Replugs) -> None:
    """Pull one plug at a random moment of motion, and plug it in again a while later."""
    witness.hear_for(chance.uniform(0.3, 0.8))
    if device == "base":
        witness.wait_for(lambda: witness.moves, "the robot moves", 120.0)
    moved, place = witness.moves, witness.place
    pulled_ns = witness.set_plug(device, is_in=False)
    witness.wait_for(
        lambda: witness.states[device] == "DISCONNECTED" and witness.state_ns[device] > pulled_ns,
        f"the robot is told of the loss of {device}",
    )
    replugs.told_s.append((witness.state_ns[device] - pulled_ns) / 1e9)
    if device == "base" and moved:
        witness.wait_for(lambda: not witness.moves, "the robot stands")
        replugs.stands_s.append(max(0, witness.stood_ns - pulled_ns) / 1e9)
        replugs.ways_m.append(math.dist(place, witness.place))
    count = witness.measurements[device]
    witness.hear_for(chance.uniform(0.0, 1.0))
    replugs.stale += witness.measurements[device] - count
    plugged_ns = witness.set_plug(device, is_in=True)
    witness.wait_for(lambda: witness.measured_ns[device] > plugged_ns, f"{device} is back")
    replugs.back_s.append((witness.measured_ns[device] - plugged_ns) / 1e9)
    if device != "imu" and moved:
        witness.wait_for(lambda: witness.moves, "the robot drives on", 120.0)
        replugs.drives_s.append(max(0, witness.moved_ns - plugged_ns) / 1e9)


class Waits:
    """How long messages have waited for one of `WITNESSES`, in several times of the run together."""

    def __init__(self) -> None:
        self._counts: dict[str, NDArray[np.int64]] = {}

    def add(self, before: dict[str, ModuleFigures], now: dict[str, ModuleFigures]) -> None:
        """Add what has waited between two looks."""
        for name in WITNESSES:
            earlier, later = before[name].work, now[name].work
            if earlier is not None and later is not None:
                counts = later.latency.counts - earlier.latency.counts
                self._counts[name] = self._counts.get(name, np.zeros_like(counts)) + counts

    def p99_ms(self) -> dict[str, float]:
        """Return the 99th percentile for each module that has got messages."""
        return {
            name: round(1000 * quantile_s(counts, 0.99), 2)
            for name, counts in self._counts.items()
            if counts.sum() > 0 and counts.min() >= 0  # else the module was restarted
        }


@dataclass
class Trial:
    """The figures of all runs together.

    Attributes:
        replugs: by the name of the driver's module.
        calm: latencies of the witnesses between the rounds.
        busy: the same during the rounds.
        collisions: of the robot.
        restarts: of its modules.
        slips: times that mapping missed a motion in the odometry, and searched for the robot.
    """

    replugs: dict[str, Replugs] = field(default_factory=lambda: {name: Replugs() for name in MEASUREMENT})
    calm: Waits = field(default_factory=Waits)
    busy: Waits = field(default_factory=Waits)
    collisions: int = 0
    restarts: int = 0
    slips: int = 0

    @property
    def rounds(self) -> int:
        """Return how often each device was back."""
        return min(len(each.back_s) for each in self.replugs.values())

    def run(self, folder: Path, rounds: int, until_s: float, calm_s: float, chance: random.Random) -> None:
        """Run a robot and pull its plugs, until there were enough rounds or its mission has ended.

        Args:
            folder: for the robot's output.
            rounds: number of rounds of the whole trial.
            until_s: no round begins after this time, machine's monotonic clock.
            calm_s: time without replugs after each round.
            chance: source of random waits.

        Raises:
            RobotTrouble: something that should happen did not happen in time, or the run failed.
        """
        words = [word for name, value in SETTINGS.items() for word in ("--set", f"{name}={value}")]
        robot = Robot(folder, REPOSITORY, PROFILE, *words)
        try:
            robot.wait_until_running()
            runs = list_runs([folder / "runtime" / "robbie"])
            run = next(one for one in runs if one.run_id == robot.run_id)
            with suppress(RunEnded), closing(Tool(run, "pulls plugs")) as tool:
                witness = Witness(tool)
                witness.wait_for(lambda: witness.moves, "the robot moves", 120.0)
                while self.rounds < rounds and time.monotonic() < until_s:
                    began = robot.figures()
                    for name, result in self.replugs.items():
                        replug(witness, name, chance, result)
                    ended = robot.figures()
                    self.busy.add(began, ended)
                    witness.hear_for(calm_s)
                    self.calm.add(ended, robot.figures())
            summary = robot.stop() if robot.is_up else robot.wait_for_end()
            if summary["exit_code"]:
                raise RobotTrouble(f"a run has failed: {summary['reason']}")
            self.collisions += _told_by(robot, "base")["collisions"]
            self.slips += _told_by(robot, "mapping")["slips_noticed"]
            self.restarts += sum(module["restarts"] for module in summary["modules"])
        finally:
            robot.close()

    def as_plain(self) -> dict[str, Any]:
        """Return the figures as plain data."""
        return {
            "replugs": {name: asdict(each) for name, each in self.replugs.items()},
            "p99_ms": {"calm": self.calm.p99_ms(), "replugs": self.busy.p99_ms()},
            "collisions": self.collisions,
            "restarts": self.restarts,
            "slips": self.slips,
        }


def _told_by(robot: Robot, module: str) -> dict[str, int]:
    found: dict[str, int] = json.loads((robot.output / f"{module}.json").read_text())
    return found


def as_text(result: Trial) -> str:
    """Return the times as text."""
    lines = []
    for name, each in result.replugs.items():
        told = [f"{what} {_told(values)}" for what, values in asdict(each).items() if what != "stale"]
        lines.append(f"{name}: {len(each.back_s)} replugs; {'; '.join(told)}; stale {each.stale}")
    calm_ms, busy_ms = result.calm.p99_ms(), result.busy.p99_ms()
    lines += [
        f"{name}: p99 of messages' waits {ms:g} ms between the rounds, {busy_ms[name]:g} ms during replugs"
        for name, ms in calm_ms.items()
        if name in busy_ms
    ]
    counted = f"{result.collisions} collisions, {result.restarts} restarts, {result.slips} slips of odometry"
    return "\n".join([*lines, counted])


def _told(values: list[float]) -> str:
    return f"{np.median(values):.2f}, at most {max(values):.2f} of {len(values)}" if values else "-"


def violations(result: Trial) -> list[str]:
    """Return what was not as it should be."""
    found = []
    for name, each in result.replugs.items():
        late = sum(value > BACK_S for value in each.back_s)
        moving = sum(value > STANDS_S for value in each.stands_s)
        found += [f"{name} was back after more than {BACK_S:g} s, {late} times"] if late else []
        found += [f"the robot stood after more than {STANDS_S:g} s, {moving} times"] if moving else []
        found += [f"{each.stale} measurements of {name} without the device"] if each.stale else []
    found += [f"{result.restarts} restarts"] if result.restarts else []
    found += [f"{result.collisions} collisions"] if result.collisions else []
    return found


def play(case: Case) -> dict[str, Any]:
    """Run robots and pull their plugs, until there were enough rounds."""
    chosen, result, chance = case.options, Trial(), random.Random(case.seed)
    until_s = time.monotonic() + chosen.seconds
    with busy(chosen.load):
        for number in range(MAX_RUNS):
            if result.rounds >= chosen.rounds or time.monotonic() >= until_s:
                break
            result.run(case.folder / str(number), chosen.rounds, until_s, chosen.calm, chance)
    print(as_text(result))
    return result.as_plain() | {"violations": violations(result)}


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of rounds."""
    parser.add_argument("--rounds", type=int, default=50, help="replugs of each device")
    parser.add_argument("--seconds", type=float, default=3600.0, help="begin no round after this time")
    parser.add_argument("--load", type=int, default=2, help="processes that compute meanwhile")
    parser.add_argument("--calm", type=float, default=8.0, help="time without replugs after each round, s")


SUBJECT = TrialSubject(
    play=play,
    options=options,
    is_good=lambda results: not any(one["violations"] for one in results),
    seeds=1,
    seed_makes="the moments at which plugs are pulled",
)
