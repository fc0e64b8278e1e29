"""What trials of whole missions share: the command line, the run of one mission, kills, and the report."""

import argparse
import contextlib
import json
import random
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from robbie_mp.module.clock import SystemClock
from robbie_mp.profile.load import load_profile
from robbie_mp.run.run_clock import RunClock
from tools.kill_campaign.robot import REPOSITORY, Robot, RobotTrouble

START_LIMIT_S = 300.0


@dataclass
class Trial:
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


AnyTrial = TypeVar("AnyTrial", bound=Trial)


def command_line(prog: str, description: str | None, profile: str, seeds: str) -> argparse.ArgumentParser:
    """Return a parser with the options that all trials have.

    Args:
        prog: the tool.
        description: what it does.
        profile: the profile that it runs if no other one is named.
        seeds: what a seed makes, such as "number of arenas".
    """
    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument("--seeds", type=int, default=20, help=seeds)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--profile", default=profile)
    parser.add_argument("--kill", action="store_true", help="kill every module once")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="new folder for the output of the runs")
    return parser


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


def play(
    trial: Trial,
    folder: Path,
    profile: str,
    settings: list[str],
    judge: Callable[[Path], None],
    *,
    limit_s: float,
    kills_s: tuple[float, float] | None = None,
) -> None:
    """Run one mission, and have it judged.

    Args:
        trial: takes the results.
        folder: new folder for the run.
        profile: the profile to run.
        settings: `MODULE.SETTING=VALUE`, each.
        judge: is called with the folder of the run's output if the run ended in order.
        limit_s: maximum duration in real time.
        kills_s: every module is killed once, at a random moment between these times; None: none is killed.
    """
    words = [profile, *(word for setting in settings for word in ("--set", setting))]
    began_s = time.monotonic()
    robot = Robot(folder / "run", REPOSITORY, *words)
    try:
        robot.wait_until_running(limit_s=START_LIMIT_S)
        watch(robot, Kills(robot, trial.seed, *kills_s) if kills_s else None, limit_s)
        summary = robot.wait_for_end()
        trial.restarts = {each["name"]: each["restarts"] for each in summary["modules"] if each["restarts"]}
        judge(robot.output)
    except (RobotTrouble, OSError) as trouble:
        trial.trouble = str(trouble)
    finally:
        robot.close()
    trial.wall_s = round(time.monotonic() - began_s, 1)


def play_all(
    options: argparse.Namespace,
    play_one: Callable[[int, Path], AnyTrial],
    summary: Callable[[list[AnyTrial]], dict[str, Any]],
    name: str,
) -> list[AnyTrial]:
    """Play all seeds, print each result and the summary, and write them to the file of `--json`.

    Args:
        options: of `command_line`.
        play_one: plays a seed in an empty folder.
        summary: figures of all results together.
        name: what the results are called in the file, such as "missions".
    """
    trials: list[AnyTrial] = []
    with _folder(options.keep) as folder:
        for seed in range(options.first, options.first + options.seeds):
            (folder / str(seed)).mkdir(parents=True)
            trials.append(play_one(seed, folder / str(seed)))
            print(json.dumps(asdict(trials[-1])), flush=True)
            report = {"summary": summary(trials), name: [asdict(each) for each in trials]}
            if options.json:
                options.json.write_text(json.dumps(report, indent=2) + "\n")
    print(json.dumps(summary(trials), indent=2))
    return trials


@contextmanager
def _folder(keep: Path | None) -> Iterator[Path]:
    if keep is not None:
        yield keep
        return
    folder = Path(tempfile.mkdtemp(prefix="robbie-trials-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


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
        if self._left and (self._clock.now_ns() - self._began_ns) / 1e9 >= self._left[0][0]:
            figures = self._robot.figures()[self._left[0][1]]
            if figures.pid and self._robot.send(figures.pid, signal.SIGKILL):
                self._left.pop(0)

    def close(self) -> None:
        """Stop looking at the robot's clock."""
        self._run_clock.close()


def watch(robot: Robot, kills: Kills | None, limit_s: float) -> None:
    """Kill the modules at their times, and wait for the end of the mission.

    Args:
        robot: it runs.
        kills: closed at the end; None: nothing is killed.
        limit_s: maximum duration in real time.

    Raises:
        RobotTrouble: the mission did not end in time.
    """
    end_s = time.monotonic() + limit_s
    with contextlib.closing(kills) if kills is not None else contextlib.nullcontext():
        while robot.is_up and time.monotonic() < end_s:
            if kills is not None:
                kills.do_what_is_due()
            time.sleep(0.02)
    if robot.is_up:
        raise RobotTrouble(f"the mission did not end in {limit_s:g} s")
