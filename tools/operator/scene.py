"""The robot of the trials, in a long hall, and a record of what its base does."""

import re
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from types import MappingProxyType

from playwright.sync_api import Browser, Page

from robbie_mp.attached.tool.tool import Tool
from robbie_mp.messages import EmergencyStop
from robbie_mp.run.run_directory import list_runs
from tools.operator.journal import WitnessReader
from tools.robot import OFTEN, Robot, RobotTrouble, write_profile

TOKEN = "an-operator-on-trial"
LENGTH_CELLS = 57
LAYOUT = "Drive"
LIMIT_S = 60.0
SPARE_LIMIT_S = 10.0
"""If modules die often, a spare interpreter may never be ready."""
POLL_S = 0.002
NO_OTHERS: Mapping[str, object] = MappingProxyType({})


def profile(
    arena: Path, others: Mapping[str, object], linear_m_per_s: float, parents: Sequence[str] = ()
) -> dict[str, object]:
    """Return the profile of a robot with mapping, an operator station, and a witness of its base."""
    settings = {"arena": str(arena)}
    station = {
        "host": "0.0.0.0",
        "port": 0,
        "operator_token": "file:operator.token",
        "max_linear_m_per_s": linear_m_per_s,
    }
    return {
        "parents": [*parents],
        "modules": {
            "mapping": {"class": "robbie_robots.modules.maps.mapping:Mapping", "restart": OFTEN},
            "base": {
                "class": "robbie_robots.modules.devices.base:SimulatedBase",
                "settings": settings | {"period_s": 0.01},
            },
            "laser": {
                "class": "robbie_robots.modules.devices.laser:SimulatedLaserRangeFinder",
                "settings": settings,
            },
            "witness": {"class": "tools.operator.witness:Witness"},
            "operator": {
                "class": "robbie_mp.station:OperatorStation",
                "settings": station,
                "restart": OFTEN,
            },
            **others,
        },
        "spares": {"imports": ["robbie_robots.modules.maps.mapping", "robbie_mp.station.web.website"]},
    }


class Scene:
    """A running robot and its journal.

    Args:
        folder: an empty folder for everything the robot writes.
        arena: its arena; None: a long hall.
        others: more modules of the robot.
        linear_m_per_s: maximum speed.
        on_host: the beginning of a command that runs it on another host of a test network.
        parents: of its profile, which gives it the rest.
    """

    def __init__(
        self,
        folder: Path,
        arena: Path | None = None,
        others: Mapping[str, object] = NO_OTHERS,
        linear_m_per_s: float = 0.4,
        on_host: Sequence[str] = (),
        parents: Sequence[str] = (),
    ):
        workspace = folder / "workspace"
        workspace.mkdir(parents=True)
        wall, floor = "#" * (LENGTH_CELLS + 3), "." * LENGTH_CELLS
        (workspace / "operator.token").touch(mode=0o600)
        (workspace / "operator.token").write_text(TOKEN)
        if arena is None:
            arena = workspace / "arena.yaml"
            arena.write_text(f"cell_m: 1.0\ndrawing: |\n  {wall}\n  #R{floor}#\n  {wall}\n")
        write_profile(workspace, profile(arena, others, linear_m_per_s, parents), "trial")
        self.robot = Robot(folder / "run", workspace, "trial", on_host=on_host)
        self.journal = WitnessReader(self.robot.output / "witness.txt")
        self._bases = [folder / "run" / "runtime" / "robbie"]

    def begin(self) -> None:
        """Wait until all modules run."""
        self.robot.wait_until_running()

    def close(self) -> None:
        """End the robot."""
        self.robot.close()

    def pid(self, module: str) -> int:
        """Return the pid of a module."""
        return self.robot.figures()[module].pid

    def send(self, module: str, number: signal.Signals) -> int:
        """Send a signal to a module's process. Return the time of it (ns, monotonic clock)."""
        pid = self.pid(module)
        at_ns = time.monotonic_ns()
        if not self.robot.send(pid, number):
            raise RobotTrouble(f"{module} ended before {number.name} was sent")
        return at_ns

    def address(self, host: str) -> str:
        """Return the page's address, with the given name for this host."""

        def is_there() -> bool:
            return "http://" in self.robot.figures()["operator"].status

        self.robot.wait_for(is_there, "there is no page")
        found = re.search(r":(\d+)/", self.robot.figures()["operator"].status)
        assert found
        return f"http://{host}:{found[1]}/"

    def wait_for_spare(self) -> None:
        """Wait until a spare interpreter is ready, but not for ever."""
        with suppress(RobotTrouble):
            self.robot.wait_for_spare(SPARE_LIMIT_S)

    def stop(self, *, engaged: bool) -> None:
        """Engage or release the emergency stop by a message, without the page."""
        (run,) = list_runs(self._bases)
        with closing(Tool(run, "operator trials")) as tool:
            tool.ready()
            tool.publish(EmergencyStop(engaged=engaged, reason="a trial"), "emergency_stop")
            self.wait_for("stopped", float(engaged))

    def wait_for(self, what: str, number: float, since_ns: int = 0) -> int:
        """Wait until the base publishes a number. Return when (ns) it first did so after a time (0: now)."""
        since_ns = since_ns or time.monotonic_ns()
        until_s = time.monotonic() + LIMIT_S
        while (at_ns := self.journal.first_after(what, since_ns, number)) is None:
            if time.monotonic() > until_s:
                raise RobotTrouble(f"the base did not report {what} {number}")
            time.sleep(POLL_S)
        return at_ns

    @contextmanager
    def page(self, browser: Browser, host: str, layout: str = LAYOUT, script: str = "") -> Iterator[Page]:
        """Open the page and log in. A script of yours runs before the page's own."""
        context = browser.new_context(viewport={"width": 1280, "height": 800})
        page = context.new_page()
        page.add_init_script(script)
        page.set_default_timeout(LIMIT_S * 1e3)
        page.goto(self.address(host))
        page.fill("#token", TOKEN)
        page.keyboard.press("Enter")
        page.wait_for_selector("#layouts")
        page.goto(f"{self.address(host)}?layout={layout}")
        self.wait_for_page(page, layout)
        page.wait_for_selector("#emergency-stop-state:has-text('ready')")
        try:
            yield page
        finally:
            context.close()

    def wait_for_page(self, page: Page, layout: str = LAYOUT) -> None:
        """Wait until a page shows its layout, and can drive if the layout can."""
        page.wait_for_selector(f"#layouts:has-text('{layout}')")
        page.wait_for_selector(".drives >> visible=true")


@contextmanager
def scene(folder: Path) -> Iterator[Scene]:
    """Start a robot. At the end, end it."""
    made = Scene(folder)
    try:
        made.begin()
        yield made
    finally:
        made.close()
