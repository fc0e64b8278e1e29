"""`robbie run --reload` restarts just the modules whose files are saved, unless their new code is wrong."""

import signal
import time

import psutil
import pytest

from tests._support.robot import Ended, Robot, kill, wait_until

SHARED = "SHARED = 0\n"
LISTENER = """
from robbie_mp import Module
from robbie_mp.messages import DriveCommand
from shared import SHARED

OWN = 0


class Listener(Module):
    def setup(self):
        self.subscribe(DriveCommand, self.on_drive)

    def on_drive(self, command):
        self.status = f"{OWN} {SHARED}"
"""
LASER = """
from robbie_mp import Module
from robbie_mp.messages import DriveCommand


class Laser(Module):
    period_s = 0.01

    def tick(self):
        self.publish(DriveCommand())
"""
PROFILE = """
modules:
  laser: {class: "laser:Laser"}
  listener: {class: "listen:Listener", restart: {max_restarts: 2, retry_s: 0}}
"""


@pytest.fixture
def reloading(robot: Robot) -> Robot:
    for name, code in {"shared": SHARED, "listen": LISTENER, "laser": LASER}.items():
        (robot.folder / f"{name}.py").write_text(code)
    robot.write_profile(PROFILE)
    robot.start("--reload")
    shows(robot, "0 0")
    return robot


def shows(robot: Robot, status: str) -> None:
    """Wait until the listener has handled a message with this code."""
    robot.until(lambda top: top["listener"]["status"] == status and top["listener"]["state"] == "RUNNING")


def save(robot: Robot, name: str, code: str) -> None:
    (robot.folder / f"{name}.py").write_text(code)


def own(number: int) -> str:
    return LISTENER.replace("OWN = 0", f"OWN = {number}")


def pid(robot: Robot, name: str) -> int:
    found: int = robot.top()[name]["pid"]
    return found


def wait_for_line(robot: Robot, text: str) -> None:
    wait_until(lambda: text in robot.log("listener"))


@pytest.mark.slow
def test_module_whose_file_is_saved_runs_the_new_code_and_others_run_on(reloading: Robot) -> None:
    before = pid(reloading, "laser")
    for number in (1, 2, 3):  # of the same size, and within a second
        save(reloading, "listen", own(number))
        shows(reloading, f"{number} 0")
    save(reloading, "shared", "SHARED = 7\n")
    shows(reloading, "3 7")
    assert pid(reloading, "laser") == before
    replaced = reloading.folder / "listen.new"
    replaced.write_text(own(4))
    replaced.rename(reloading.folder / "listen.py")  # as many editors save
    shows(reloading, "4 7")
    top = reloading.top()
    assert (top["laser"]["restarts"], top["listener"]["lost"], top["listener"]["restarts"]) == (0, 0, 5)
    reloading.command("stop")
    assert Ended.wait_for(reloading._started[-1]).exit_code == 0


MISTAKES = {
    "class Listener(Module)\n    pass": "listen.py:9: SyntaxError: expected ':' in `class Listener(Module)`",
    "class Listener(Modul): pass": "listen.py:9: NameError: name 'Modul' is not defined",
    "class Listener2(Module): pass": "class: listen has no class 'Listener'; did you mean 'Listener2'?",
    "import no_such_library": "ModuleNotFoundError: No module named 'no_such_library'",
    "raise SystemExit(7)": "SystemExit: 7",
    "import os; os._exit(3)": "its import ended the process: exit code 3",
    "import os; os.kill(os.getpid(), 11)": "its import ended the process: killed by SIGSEGV",
    "class Listener(Module):\n    rate: int = setting('x')": "NameError: name 'setting' is not defined",
}


@pytest.mark.slow
def test_module_whose_new_code_is_wrong_runs_on_with_the_old_one(reloading: Robot) -> None:
    before = pid(reloading, "listener")
    head = LISTENER.partition("class ")[0]
    for code, said in MISTAKES.items():
        save(reloading, "listen", f"{head}{code}\n")
        wait_for_line(reloading, said)
    assert pid(reloading, "listener") == before
    lines = [line for line in reloading.log("listener").splitlines() if "the one that runs stays" in line]
    assert len(lines) == len(MISTAKES), lines
    save(reloading, "listen", own(5))
    shows(reloading, "5 0")
    save(reloading, "shared", "SHARED = \n")
    wait_for_line(reloading, "shared.py:1: SyntaxError")
    save(reloading, "shared", "SHARED = 8\n")
    shows(reloading, "5 8")


@pytest.mark.slow
def test_new_file_with_a_mistake_is_watched_too(reloading: Robot) -> None:
    save(reloading, "listen", own(1).replace("from shared", "from more import MORE\nfrom shared"))
    wait_for_line(reloading, "No module named 'more'")
    save(reloading, "more", "MORE = 1 +\n")
    wait_for_line(reloading, "more.py:1: SyntaxError")
    save(reloading, "more", "MORE = 1\n")
    shows(reloading, "1 0")


@pytest.mark.slow
def test_file_that_is_deleted_stops_nothing_until_it_is_back(reloading: Robot) -> None:
    before = pid(reloading, "listener")
    (reloading.folder / "shared.py").unlink()
    save(reloading, "listen", own(1))
    wait_for_line(reloading, "No module named 'shared'")
    assert pid(reloading, "listener") == before
    save(reloading, "shared", "SHARED = 9\n")
    shows(reloading, "1 9")


@pytest.mark.slow
def test_file_that_is_saved_ten_times_a_second_ends_with_its_last_version(reloading: Robot) -> None:
    for number in range(1, 31):
        save(reloading, "listen", own(number) if number % 7 else "class\n")
        time.sleep(0.1)
    shows(reloading, "30 0")
    top = reloading.top()
    assert top["listener"]["state"] == "RUNNING"
    assert top["listener"]["restarts"] <= 30
    assert top["laser"]["restarts"] == 0


@pytest.mark.slow
def test_failed_module_starts_with_the_code_that_mends_it(reloading: Robot) -> None:
    save(reloading, "listen", own(1).replace('f"{OWN} {SHARED}"', "1 / 0"))
    reloading.until(lambda top: top["listener"]["state"] == "FAILED")
    save(reloading, "listen", own(2))
    shows(reloading, "2 0")


@pytest.mark.slow
def test_stopped_module_stays_stopped_and_starts_with_the_new_code(reloading: Robot) -> None:
    reloading.command("module", "stop", "listener")
    save(reloading, "listen", own(1))
    save(reloading, "laser", LASER.replace("0.01", "0.02"))
    reloading.until(lambda top: top["laser"]["restarts"] == 1)
    assert reloading.top()["listener"]["state"] == "STOPPED"
    reloading.command("module", "start", "listener")
    shows(reloading, "1 0")


@pytest.mark.slow
def test_module_at_a_breakpoint_is_reloaded(reloading: Robot) -> None:
    save(reloading, "listen", own(1).replace("self.status =", "breakpoint()\n        self.status ="))
    wait_for_line(reloading, "stands at a breakpoint")
    save(reloading, "listen", own(2))
    shows(reloading, "2 0")


@pytest.mark.sampled(1)
@pytest.mark.slow
@pytest.mark.parametrize("signum", [signal.SIGKILL, signal.SIGSTOP])
def test_spare_that_dies_or_hangs_at_the_import_is_replaced(reloading: Robot, signum: int) -> None:
    hangs = reloading.folder / "hangs"
    save(reloading, "listen", own(1) + f"import time\nopen({str(hangs)!r}, 'w').close()\ntime.sleep(600)\n")
    wait_until(hangs.exists)
    before = pid(reloading, "listener")
    (spare,) = [one for one in children(reloading) if "spare" in one.name()]
    spare.send_signal(signum)
    wait_for_line(reloading, "its import ended the process" if signum == signal.SIGKILL else "did not finish")
    assert pid(reloading, "listener") == before
    save(reloading, "listen", own(2))
    shows(reloading, "2 0")
    kill(pid(reloading, "listener"))
    reloading.until(lambda top: top["listener"]["restarts"] == 2)
    shows(reloading, "2 0")


def children(robot: Robot) -> list[psutil.Process]:
    return psutil.Process(robot._started[-1].pid).children()
