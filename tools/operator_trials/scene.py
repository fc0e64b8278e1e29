"""The robot of the trials, in a hall in which it can drive for long, and what its base does."""

import re
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import yaml
from playwright.sync_api import Browser, Page

from robbie_mp.attach.tool import Tool
from robbie_mp.messages import EmergencyStop
from robbie_mp.run.run_directory import list_runs
from tools.kill_campaign.robot import Robot, RobotTrouble
from tools.operator_trials.journal import Journal

TOKEN = "an-operator-on-trial"
LENGTH_CELLS = 57
OFTEN = {"policy": "always", "max_restarts": 100_000, "stable_after_s": 1.0}
"""Trials kill more often than life does."""
LIMIT_S = 60.0
SPARE_LIMIT_S = 10.0
"""Where modules die again and again there may never be one."""
POLL_S = 0.002


def profile(arena: Path) -> dict[str, object]:
    """Describe a robot that maps what it sees, with an operator station and a witness of its base."""
    settings = {"arena": str(arena)}
    station = {
        "host": "0.0.0.0",
        "port": 0,
        "operator_token": "file:operator.token",
        "max_linear_m_per_s": 0.4,
    }
    return {
        "modules": {
            "mapping": {"class": "modules.mapping:Mapping", "restart": OFTEN},
            "base": {
                "class": "modules.devices.base:SimulatedBase",
                "settings": settings | {"period_s": 0.01},
            },
            "laser": {"class": "modules.devices.laser:SimulatedLaserRangeFinder", "settings": settings},
            "witness": {"class": "tools.operator_trials.witness:Witness"},
            "operator": {
                "class": "robbie_mp.station:OperatorStation",
                "settings": station,
                "restart": OFTEN,
            },
        },
        "spares": {"imports": ["modules.mapping", "robbie_mp.station.website"]},
    }


class Scene:
    """A robot that runs, and its journal.

    Args:
        folder: an empty folder for all that it writes.
    """

    def __init__(self, folder: Path):
        workspace = folder / "workspace"
        (workspace / "profiles").mkdir(parents=True)
        wall, floor = "#" * (LENGTH_CELLS + 3), "." * LENGTH_CELLS
        (workspace / "operator.token").touch(mode=0o600)
        (workspace / "operator.token").write_text(TOKEN)
        arena = workspace / "arena.yaml"
        arena.write_text(f"cell_m: 1.0\ndrawing: |\n  {wall}\n  #R{floor}#\n  {wall}\n")
        (workspace / "profiles" / "trial.yaml").write_text(yaml.safe_dump(profile(arena), sort_keys=False))
        self.robot = Robot(folder / "run", workspace, "trial")
        self.journal = Journal(self.robot.output / "witness.txt")
        self._bases = [folder / "run" / "runtime" / "robbie"]

    def begin(self) -> None:
        """Wait until all modules run."""
        self.robot.wait_until_running()
        (run,) = list_runs(self._bases)
        self._tool = Tool(run, "operator trials")
        self._tool.ready()

    def close(self) -> None:
        """End it."""
        self.robot.close()

    def pid(self, module: str) -> int:
        """Return the number of a module's process."""
        return self.robot.figures()[module].pid

    def send(self, module: str, number: signal.Signals) -> int:
        """Send a signal to a module's process; return when (ns, monotonic clock)."""
        pid = self.pid(module)
        at_ns = time.monotonic_ns()
        if not self.robot.send(pid, number):
            raise RobotTrouble(f"{module} was gone before it got {number.name}")
        return at_ns

    def address(self, host: str) -> str:
        """Return the page's address as seen from a host that names this one so."""

        def is_there() -> bool:
            return "http://" in self.robot.figures()["operator"].status

        self.robot.wait_for(is_there, "there is no page")
        found = re.search(r":(\d+)/", self.robot.figures()["operator"].status)
        assert found
        return f"http://{host}:{found[1]}/"

    def wait_for_spare(self) -> None:
        """Wait until an interpreter is ready to take the place of a module that dies, or none comes."""
        supervisor = psutil.Process(self.robot.supervisor.pid)
        until_s = time.monotonic() + SPARE_LIMIT_S
        while time.monotonic() < until_s and "spare" not in map(_name, supervisor.children()):
            time.sleep(POLL_S)

    def stop(self, *, engaged: bool) -> None:
        """Engage or release the emergency stop, not by the page."""
        self._tool.publish(EmergencyStop(engaged=engaged, reason="a trial"), "emergency_stop")
        self.wait_for("stopped", float(engaged))

    def wait_for(self, what: str, number: float, since_ns: int = 0) -> int:
        """Return when (ns) the base first published a number after a time; without one: wait for it now."""
        since_ns = since_ns or time.monotonic_ns()
        until_s = time.monotonic() + LIMIT_S
        while (at_ns := self.journal.first_after(what, since_ns, number)) is None:
            if time.monotonic() > until_s:
                raise RobotTrouble(f"the base did not say {what} {number}")
            time.sleep(POLL_S)
        return at_ns

    def drive(self, page: Page, key: str) -> None:
        """Hold a key down until the robot drives at full speed."""
        page.bring_to_front()
        page.keyboard.down(key)
        self.robot.wait_for(lambda: abs(self.journal.newest("speed")) > 0.19, "the robot does not drive")

    @contextmanager
    def page(self, browser: Browser, host: str) -> Iterator[Page]:
        """Open the page and log in."""
        context = browser.new_context(viewport={"width": 1280, "height": 800})
        page = context.new_page()
        page.set_default_timeout(LIMIT_S * 1e3)
        page.goto(self.address(host))
        page.fill("#token", TOKEN)
        page.keyboard.press("Enter")
        page.wait_for_selector("#emergency-stop-state:has-text('ready')")
        page.wait_for_selector("#drive-pad")
        try:
            yield page
        finally:
            context.close()


def _name(process: psutil.Process) -> str:
    try:
        return process.name()
    except psutil.NoSuchProcess:
        return ""


@contextmanager
def scene(folder: Path) -> Iterator[Scene]:
    """Start a robot, and end it."""
    made = Scene(folder)
    try:
        made.begin()
        yield made
    finally:
        made.close()


Event = Callable[[], int]
"""Does what happens, and returns when it began to (ns, monotonic clock)."""
