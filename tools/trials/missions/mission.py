"""What trials of whole missions share: the options, the run of one mission, and kills."""

import argparse
import contextlib
import math
import random
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from robbie_mp.module.clock import SystemClock
from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.run_clock import RunClock
from tools.robot import REPOSITORY, Robot, RobotTrouble
from tools.trials.harness import Case, TrialSubject, no_options

START_LIMIT_S = 300.0


@dataclass
class MissionTrial:
    """The result of one mission.

    Attributes:
        seed: seed of the surroundings, the noise and the kills.
        wall_s: duration of the run in real time.
        restarts: number of restarts of killed modules.
        trouble: why the run itself failed; '' if it did not.
    """

    seed: int
    wall_s: float = 0.0
    restarts: dict[str, int] = field(default_factory=dict)
    trouble: str = ""


AnyTrial = TypeVar("AnyTrial", bound=MissionTrial)


def all_in_order(outcomes: Sequence[Any]) -> bool:
    """Return whether every run itself ended cleanly."""
    return not any(outcome.trouble for outcome in outcomes)


def all_right(outcomes: Sequence[Any]) -> bool:
    """Return whether every outcome is right."""
    return all(outcome.is_right for outcome in outcomes)


@dataclass
class Setup:
    """One mission, ready to run.

    Attributes:
        arena: file of the arena.
        judge: is called with the folder of the run's output if the run ended cleanly.
        settings: `MODULE.SETTING=VALUE`, each, besides those of `settings_for`.
        kills_until_s: time of the run by which every module was killed; None: that of the mission.
    """

    arena: Path
    judge: Callable[[Path], None]
    settings: list[str] = field(default_factory=list)
    kills_until_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class SeededMission(Generic[AnyTrial]):
    """A mission of a stock robot, which each seed varies.

    Attributes:
        outcome: makes the result of a seed, still empty.
        set_up: writes the arena of a case into its folder; the judge fills the result in.
        profile: the profile that runs if the command line names no other one.
        noisy: names of the modules that make noise.
        limit_s: maximum duration of a run in real time.
        kills_s: with `--kill`, every module is killed once, at a random moment between these times.
        summary: returns the figures of all results together.
        is_good: whether the results are as they should be.
        results: what the results are called, such as "rooms".
        seed_makes: what each seed makes, such as "a room".
        more_options: adds the options of the mission.
        kinds: what is played for each seed, one after the other.
        prepare: makes what all cases share.
    """

    outcome: Callable[[int], AnyTrial]
    set_up: Callable[[AnyTrial, Case], Setup]
    profile: str
    noisy: Sequence[str]
    limit_s: float
    kills_s: tuple[float, float]
    summary: Callable[[list[AnyTrial]], dict[str, Any]]
    is_good: Callable[[list[AnyTrial]], bool] = all_right
    results: str
    seed_makes: str
    more_options: Callable[[argparse.ArgumentParser], None] = no_options
    kinds: Callable[[argparse.Namespace], Sequence[str]] = lambda _: ("",)
    prepare: Callable[[argparse.Namespace], Any] = lambda _: None

    @property
    def subject(self) -> TrialSubject[AnyTrial]:
        """The mission for the harness."""
        return TrialSubject(
            play=self.play,
            options=self.options,
            summary=self.summary,
            is_good=self.is_good,
            results=self.results,
            seed_makes=self.seed_makes,
            kinds=self.kinds,
            prepare=self.prepare,
        )

    def options(self, parser: argparse.ArgumentParser) -> None:
        """Add the options of all missions, and those of this one."""
        until = "time of the run by which all were killed"
        parser.add_argument("--profile", default=self.profile, help=f"({self.profile})")
        parser.add_argument("--kill", action="store_true", help="kill every module once")
        parser.add_argument("--kill-until", type=float, metavar="S", help=until)
        self.more_options(parser)

    def play(self, case: Case) -> AnyTrial:
        """Run the mission once, and have it judged."""
        outcome, options = self.outcome(case.seed), case.options
        setup = self.set_up(outcome, case)
        settings = settings_for(options.profile, setup.arena.resolve(), case.seed, self.noisy)
        until_s = options.kill_until or setup.kills_until_s or self.kills_s[1]
        kills_s = (self.kills_s[0], until_s) if options.kill else None
        words = [word for setting in settings + setup.settings for word in ("--set", setting)]
        run_once(outcome, case.folder / "run", [options.profile, *words], setup.judge, self.limit_s, kills_s)
        return outcome


def totals(outcomes: Sequence[Any], *names: str) -> dict[str, Any]:
    """Return the sums of some figures of the outcomes, and how many runs themselves failed.

    Args:
        outcomes: of all missions.
        names: of the figures: numbers, flags, or lists, of which the lengths count.
    """
    sums = {name: sum(map(_count, (getattr(one, name) for one in outcomes))) for name in names}
    return {**sums, "trouble": sum(bool(one.trouble) for one in outcomes)}


def _count(value: Any) -> Any:
    return len(value) if isinstance(value, list) else value


def mean(outcomes: Sequence[Any], name: str, digits: int = 1) -> float:
    """Return the mean of a figure of the outcomes."""
    return round(math.fsum(getattr(one, name) for one in outcomes) / len(outcomes), digits)


def settings_for(profile: str, arena: Path, seed: int, noisy: Sequence[str]) -> list[str]:
    """Return the settings that move a profile's modules to another arena, with other noise.

    Args:
        profile: the profile.
        arena: file of the arena.
        seed: of the noise.
        noisy: names of the modules that make noise.
    """
    settings = []
    for spec in load_profile(profile, REPOSITORY).modules:
        # The driver of an emulated device has no arena and no noise.
        if "arena" in spec.settings:
            settings += [f"{spec.name}.arena={arena}"]
            settings += [f"{spec.name}.seed={seed}"] if spec.name in noisy else []
    return settings


def run_once(
    trial: MissionTrial,
    folder: Path,
    words: list[str],
    judge: Callable[[Path], None],
    limit_s: float,
    kills_s: tuple[float, float] | None = None,
) -> None:
    """Run one mission, and have it judged.

    Args:
        trial: takes the results.
        folder: new folder for the run.
        words: the profile, and the options of `robbie run`.
        judge: is called with the folder of the run's output if the run ended cleanly.
        limit_s: maximum duration in real time.
        kills_s: every module is killed once, at a random moment between these times; None: none is killed.
    """
    began_s = time.monotonic()
    robot = Robot(folder, REPOSITORY, *words)
    try:
        robot.wait_until_running(limit_s=START_LIMIT_S)
        watch([robot], [Kills(robot, trial.seed, *kills_s)] if kills_s else [], limit_s)
        trial.restarts = restarts_in(robot.wait_for_end())
        judge(robot.output)
    except (RobotTrouble, OSError) as trouble:
        trial.trouble = str(trouble)
    finally:
        robot.close()
    trial.wall_s = round(time.monotonic() - began_s, 1)


class Kills:
    """Kills every module of a robot once, at random moments of its mission, by the robot's own clock.

    Args:
        robot: it runs.
        seed: of the moments.
        begin_s: the earliest moment, since now.
        end_s: the latest one.
    """

    def __init__(self, robot: Robot, seed: int, begin_s: float, end_s: float) -> None:
        chance = random.Random(seed)
        names = [name for name in robot.figures() if name != "core"]
        self._robot = robot
        self._left = sorted((chance.uniform(begin_s, end_s), name) for name in names)
        self._run_clock = RunClock.attach(robot.run_id)
        self._clock = self._run_clock if self._run_clock.has_begun else SystemClock()
        self._began_ns = self._clock.now_ns()

    def do_what_is_due(self) -> None:
        """Kill the module whose moment has come, if it runs."""
        if (
            self._robot.is_up
            and self._left
            and (self._clock.now_ns() - self._began_ns) / 1e9 >= self._left[0][0]
        ):
            figures = self._robot.figures()[self._left[0][1]]
            if figures.pid and self._robot.send(figures.pid, signal.SIGKILL):
                self._left.pop(0)

    def close(self) -> None:
        """Stop looking at the robot's clock."""
        self._run_clock.close()


def watch(robots: Sequence[Robot], kills: Sequence[Kills], limit_s: float) -> None:
    """Kill modules at their times, and wait for the end of all missions.

    Args:
        robots: they run.
        kills: closed at the end.
        limit_s: maximum duration in real time.

    Raises:
        RobotTrouble: a mission did not end in time.
    """
    end_s = time.monotonic() + limit_s
    with contextlib.ExitStack() as kept:
        for one in kills:
            kept.callback(one.close)
        while any(robot.is_up for robot in robots) and time.monotonic() < end_s:
            for one in kills:
                one.do_what_is_due()
            time.sleep(0.02)
    if any(robot.is_up for robot in robots):
        raise RobotTrouble(f"the mission did not end in {limit_s:g} s")


def restarts_in(summary: dict[str, Any]) -> dict[str, int]:
    """Return how often each module of a run was restarted, by its summary."""
    return {each["name"]: each["restarts"] for each in summary["modules"] if each["restarts"]}
