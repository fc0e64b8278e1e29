"""Runs Robbie for one piece of work, as users run it: a profile, a supervisor, a core and modules."""

import contextlib
import subprocess
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from tools.bench.contender import Trouble, WorkResult, last_words, outcome, work_folder
from tools.bench.work import Work
from tools.robot import Robot, RobotTrouble, running

MODULES = "tools.bench.robbie_modules"
LIMIT_S = 90.0
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
        black_box: the profile's `black_box`.
    """

    def __init__(
        self,
        name: str = "robbie",
        title: str = "Robbie-MP",
        core: Mapping[str, Any] | None = None,
        module: Mapping[str, Any] | None = None,
        black_box: bool = True,
    ):
        self.name = name
        self.title = title
        self._core = dict(core or {})
        self._module = dict(module or {})
        self._black_box = black_box

    @property
    def how(self) -> str:
        """The set-up, in one line."""
        special = {"core": self._core, "module": self._module, "no black box": not self._black_box}
        changed = ", ".join(f"{key}: {value}" for key, value in special.items() if value)
        setup = "a profile run by `robbie run`: supervisor, core, modules"
        return "; ".join(filter(None, (setup, changed)))

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

    @property
    def can_fill_in_place(self) -> bool:
        """A module can lend an array."""
        return True

    def run(self, work: Work) -> WorkResult:
        """Run a profile with one publisher and the work's subscribers until it ends."""
        with work_folder() as (topic, folder):
            here = work.at(topic, folder)
            with self.robot(folder, self.pair(here), scheduling_of(work)) as robot:
                robot.wait_for_end(LIMIT_S)
                if robot.supervisor.returncode:
                    raise Trouble(last_words(folder / "robot" / "stderr"))
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
                "settings": {"work_file": str(file), "index": index},
            }
            for index in range(work.subscribers)
        }
        described[f"publisher{suffix}"] = {
            "class": f"{MODULES}:Publisher",
            "settings": {"work_file": str(file)},
            "ends_run": True,
        }
        return described

    def profile(
        self, modules: Mapping[str, dict[str, Any]], scheduling: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """Return a profile with these modules. Its core and modules all have the given scheduling."""
        place = {"scheduling": dict(scheduling)} if scheduling else {}
        complete = {name: {**MODULE, **place, **own, **self._module} for name, own in modules.items()}
        return {
            "core": {**place, **self._core},
            "modules": complete,
            "black_box": self._black_box,
        }

    @contextlib.contextmanager
    def robot(
        self, folder: Path, modules: Mapping[str, dict[str, Any]], scheduling: Mapping[str, Any] | None = None
    ) -> Iterator[Robot]:
        """Run a profile with these modules, until the end of the block.

        Raises:
            Trouble: the robot failed, possibly during the block.
        """
        try:
            with running(folder, self.profile(modules, scheduling)) as robot:
                yield robot
        except (RobotTrouble, subprocess.TimeoutExpired) as trouble:
            raise Trouble(str(trouble)) from trouble
