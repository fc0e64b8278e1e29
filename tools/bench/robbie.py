"""Runs Robbie for one piece of work, as users run it: a profile, a supervisor, a core and modules."""

import contextlib
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import yaml

from tools.bench.contender import Outcome, Trouble, last_words, outcome, work_folder
from tools.bench.watching import watched
from tools.bench.work import Work
from tools.robot import Robot, RobotTrouble

MODULES = "tools.bench.robbie_modules"
LIMIT_S = 90.0
TOP_STARTS_S = 4.0
MODULE = {"restart": {"policy": "never"}, "essential": True}
"""A crashed module ends the benchmark."""


def scheduling_of(work: Work) -> dict[str, Any]:
    """Return the `scheduling` of a profile for the processes of a piece of work."""
    wanted = {"cpus": list(work.cpus), "realtime_priority": work.realtime_priority}
    return {key: value for key, value in wanted.items() if value}


class RobbieContender:
    """Measures Robbie.

    Args:
        name: name in results.
        title: name in tables.
        core: the profile's `core`.
        module: further keys of each module in the profile.
        with_top: whether `robbie top` observes the robot all the time.
        with_idle_features: whether each module has a latched topic and serves requests, both idle.
    """

    def __init__(
        self,
        name: str = "robbie",
        title: str = "Robbie-MP",
        core: Mapping[str, Any] | None = None,
        module: Mapping[str, Any] | None = None,
        with_top: bool = False,
        with_idle_features: bool = False,
    ):
        self.name = name
        self.title = title
        self._core = dict(core or {})
        self._module = dict(module or {})
        self._with_top = with_top
        self._idle_features = with_idle_features

    @property
    def settle_s(self) -> float:
        """Time to wait before measuring, so that the start of `robbie top` is not measured."""
        return TOP_STARTS_S if self._with_top else 0.0

    @property
    def how(self) -> str:
        """The set-up, in one line."""
        special = {"core": self._core, "module": self._module}
        changed = ", ".join(f"{key}: {value}" for key, value in special.items() if value)
        watched = "observed by `robbie top`" if self._with_top else ""
        idle = "each module has a latched topic and serves requests, both idle" if self._idle_features else ""
        setup = "a profile run by `robbie run`: supervisor, core, modules"
        return "; ".join(filter(None, (setup, changed, watched, idle)))

    @property
    def version(self) -> str:
        """Robbie's version."""
        with contextlib.suppress(metadata.PackageNotFoundError):
            return metadata.version("robbie-mp")
        return "this checkout"

    @property
    def why_absent(self) -> str:
        """Robbie is never absent."""
        return ""

    def run(self, work: Work) -> Outcome:
        """Run a profile with one publisher and the work's subscribers until it ends."""
        with work_folder() as (topic, folder):
            here = replace(work.at(topic, folder), settle_s=self.settle_s)
            with self.robot(folder, self.pair(here), scheduling_of(work)) as robot:
                robot.wait_for_end(LIMIT_S)
                if robot.supervisor.returncode:
                    raise Trouble(last_words(folder / "stderr"))
                return outcome(here)

    def pair(self, work: Work, suffix: str = "") -> dict[str, dict[str, Any]]:
        """Return the modules that do the work, subscribers first, as in a profile.

        Args:
            work: the work.
            suffix: suffix of the modules' names.
        """
        file = work.folder / f"work{suffix}.json"
        work.save(file)
        described: dict[str, dict[str, Any]] = {
            f"subscriber-{index}{suffix}": {
                "class": f"{MODULES}:Subscriber",
                "settings": {"work_file": str(file), "index": index, "idle_features": self._idle_features},
            }
            for index in range(work.subscribers)
        }
        described[f"publisher{suffix}"] = {
            "class": f"{MODULES}:Publisher",
            "settings": {"work_file": str(file), "idle_features": self._idle_features},
            "ends_run": True,
        }
        return described

    def write_workspace(
        self, folder: Path, modules: Mapping[str, dict[str, Any]], scheduling: Mapping[str, Any] | None = None
    ) -> None:
        """Write a profile `bench` into a folder. Its core and modules all have the given scheduling."""
        (folder / "profiles").mkdir()
        place = {"scheduling": dict(scheduling)} if scheduling else {}
        complete = {name: {**MODULE, **place, **own, **self._module} for name, own in modules.items()}
        text = yaml.safe_dump({"core": {**place, **self._core}, "modules": complete}, sort_keys=False)
        (folder / "profiles" / "bench.yaml").write_text(text)

    @contextlib.contextmanager
    def robot(
        self, folder: Path, modules: Mapping[str, dict[str, Any]], scheduling: Mapping[str, Any] | None = None
    ) -> Iterator[Robot]:
        """Run a profile with these modules. At the end, stop it; if that fails, kill it.

        Raises:
            Trouble: the robot failed, possibly during the block.
        """
        self.write_workspace(folder, modules, scheduling)
        robot = Robot(folder, folder, "bench")
        try:
            with watched(robot) if self._with_top else contextlib.nullcontext():
                yield robot
        except (RobotTrouble, subprocess.TimeoutExpired) as trouble:
            raise Trouble(str(trouble)) from trouble
        finally:
            with contextlib.suppress(RobotTrouble, subprocess.TimeoutExpired):
                if robot.is_up:
                    robot.stop()
            robot.close()
