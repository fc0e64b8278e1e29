"""Real modules that hang, leak or are restarted by hand, and a core that stands still."""

import os
import signal
import time

import psutil
import pytest

from tests._support.robot import Ended, Robot, wait_until

pytestmark = pytest.mark.slow

MODULES = '''
import os
import sys
import time
from robbie_mp.messages import LaserScan, ModuleState
from robbie_mp import Module, setting


class Source(Module):
    """Publishes numbered scans."""

    period_s = 0.01

    def setup(self):
        self.number = 0

    def tick(self):
        self.number += 1
        self.publish(LaserScan(angle_min=float(self.number)), topic="front")


class Sink(Module):
    """Writes down the numbers of the scans it handles; may hang once, in a handler or a tick."""

    hang_in: str = setting("", "where the first incarnation hangs")
    period_s = 0.05

    def setup(self):
        self.subscribe(LaserScan, self.on_scan, topic="front")

    def hang_if(self, where):
        marker = self.output_directory / "has_hung"
        if self.hang_in == where and not marker.exists():
            marker.touch()
            time.sleep(1000)

    def on_scan(self, scan):
        if scan.angle_min >= 20:
            self.hang_if("handler")
        with open(self.output_directory / f"{self.name}.journal", "a") as journal:
            journal.write(f"{round(scan.angle_min)}\\n")

    def tick(self):
        self.hang_if("tick")


class Passive(Module):
    """Handles scans, and otherwise waits."""

    def setup(self):
        self.subscribe(LaserScan, self.on_scan)

    def on_scan(self, scan):
        pass


class Device(Module):
    """Publishes what a device says, if the device is there."""

    period_s = 0.02

    def setup(self):
        self.subscribe(LaserScan, self.on_scan)
        if not (self.output_directory / "device").exists():
            raise OSError("no such device: /dev/laser")

    def on_scan(self, scan):
        pass

    def tick(self):
        self.publish(LaserScan(), topic="device")


class Informed(Module):
    """Hears of changes of all modules: of some before the run has begun."""

    def setup(self):
        self.subscribe(ModuleState, lambda _state: None)


class Slow(Module):
    """Takes its time to start."""

    def setup(self):
        time.sleep(2)


class Library(Module):
    """Uses a library that ends the process of its first incarnation; the second one ends by itself."""

    period_s = 0.02

    def tick(self):
        marker = self.output_directory / "has_ended"
        if marker.exists():
            sys.exit()
        marker.touch()
        os._exit(0)


class Leak(Module):
    """Takes more and more memory."""

    period_s = 0.001

    def setup(self):
        self.kept = []

    def tick(self):
        self.kept.append(bytearray(16 << 20))
'''
PROFILE = """
modules:
  source: {class: "zoo.hanging:Source"}
  sink:
    class: zoo.hanging:Sink
    handler_deadline_s: 0.5
    settings: {hang_in: "%s"}
"""


def started(robot: Robot, profile: str) -> None:
    (robot.folder / "zoo" / "hanging.py").write_text(MODULES)
    robot.write_profile(profile)
    robot.process = robot.start()  # type: ignore[attr-defined]


def stopped(robot: Robot) -> Ended:
    answer = robot.command("stop")
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.endswith("has ended\n")
    return Ended.wait_for(robot.process)  # type: ignore[attr-defined]


def test_hung_handler_is_named_shown_and_costs_one_message(robot: Robot) -> None:
    started(robot, PROFILE % "handler")
    wait_until(lambda: len(robot.journal("sink")) > 40)
    ended = stopped(robot)
    hung = "hung in handler Sink.on_scan of sensor_msgs/msg/LaserScan on front for 0."
    assert f"sink: BACKOFF ({hung}" in ended.stderr
    assert 'zoo/hanging.py", line' in robot.log("sink"), "no stack dump"
    assert "in hang_if" in robot.log("sink")
    heard = robot.journal("sink")
    last = heard[-1]
    missing = sorted(set(range(heard[0], last + 1)) - set(heard))
    assert len(missing) == ended.modules["sink"]["lost"] == 1
    assert ended.modules["sink"]["restarts"] == 1


def test_failed_module_is_tried_again_until_its_device_is_back(robot: Robot) -> None:
    device = '  device: {class: "zoo.hanging:Device", restart: {max_restarts: 1, retry_s: 0.2}}\n'
    started(robot, PROFILE % "" + device)
    figures = robot.until(lambda modules: modules["device"]["restarts"] >= 3)
    assert "all 1 restarts within 60 s are used up" in robot.log("device")
    failed = robot.until(lambda modules: modules["device"]["state"] == "FAILED")
    assert failed["sink"]["restarts"] == figures["source"]["restarts"] == 0
    (robot.output / "device").touch()
    robot.until(lambda modules: modules["device"]["handled"] > 20 and modules["device"]["published"] > 20)
    ended = stopped(robot)
    assert ended.exit_code == 0
    outcomes = ("delivered", "replaced", "dropped", "lost")
    for books in ended.modules["device"]["subscriptions"]:
        assert books["routed"] == sum(books[name] for name in outcomes)


def test_hung_tick_is_named_and_restarted(robot: Robot) -> None:
    started(robot, PROFILE % "tick")
    wait_until(lambda: len(robot.journal("sink")) > 40)
    ended = stopped(robot)
    assert "sink: BACKOFF (hung in tick for 0." in ended.stderr
    assert ended.modules["sink"]["lost"] == 0


def test_module_whose_process_a_library_ends_is_restarted_though_its_exit_code_is_0(robot: Robot) -> None:
    started(robot, 'modules: {library: {class: "zoo.hanging:Library"}}')
    ended = Ended.wait_for(robot.process)  # type: ignore[attr-defined]
    assert ended.modules["library"]["restarts"] == 1, "its own end is no failure"
    assert "exit code 0, but the module did not end: something in it has ended its process" in ended.stderr
    assert ended.exit_code == 0


def test_module_that_waits_for_messages_is_not_suspected(robot: Robot) -> None:
    started(robot, 'modules: {waiting: {class: "zoo.hanging:Passive", handler_deadline_s: 0.1}}')
    robot.until(lambda modules: modules["waiting"]["state"] == "RUNNING")
    figures = robot.until(lambda modules: modules["waiting"]["uptime_s"] > 1.5)
    assert figures["waiting"]["restarts"] == 0
    assert stopped(robot).exit_code == 0


def test_idle_module_that_is_stopped_and_leaves_its_messages_is_restarted(robot: Robot) -> None:
    profile = """
    modules:
      waiting: {class: "zoo.hanging:Passive", handler_deadline_s: 0.5}
      source: {class: "zoo.hanging:Source"}
    """
    started(robot, profile)
    figures = robot.until(lambda modules: modules["waiting"]["handled"] > 10)
    pid, now_idle = figures["waiting"]["pid"], False
    while not now_idle:  # a handler that is interrupted has a rule of its own
        os.kill(pid, signal.SIGSTOP)
        wait_until(lambda: psutil.Process(pid).status() == psutil.STATUS_STOPPED)
        now_idle = robot.top()["waiting"]["activity"] == "idle"
        if not now_idle:
            os.kill(pid, signal.SIGCONT)
    figures = robot.until(lambda modules: modules["waiting"]["restarts"] == 1)
    handled = figures["waiting"]["handled"]
    robot.until(lambda modules: modules["waiting"]["handled"] > handled + 10)
    ended = stopped(robot)
    assert "waiting: BACKOFF (hung: it took none of the messages in its ring for 0." in ended.stderr
    assert ended.modules["waiting"]["lost"] == 0


def test_module_that_waits_for_the_start_of_the_run_is_not_suspected(robot: Robot) -> None:
    profile = """
    modules:
      informed: {class: "zoo.hanging:Informed", handler_deadline_s: 0.3}
      slow: {class: "zoo.hanging:Slow"}
    """
    started(robot, profile)
    figures = robot.until(lambda modules: modules["informed"]["handled"] > 1)
    assert figures["informed"]["restarts"] == 0
    assert stopped(robot).exit_code == 0


LATE = """
import time
from robbie_mp import setting
from robbie_mp.messages import LaserScan
from zoo.modules import Listener


class Late(Listener):
    topics: int = setting(0, "how many topics it advertises")

    def setup(self):
        while not (self.output_directory / "go_on").exists():
            time.sleep(0.01)
        for topic in range(self.topics):
            self.advertise(LaserScan, topic=f"front_{topic}")
        super().setup()
"""


def test_core_that_is_late_at_the_start_costs_no_message(robot: Robot) -> None:
    """Modules publish only after the core has read what all of them subscribe."""
    (robot.folder / "zoo" / "late.py").write_text(LATE)
    counter = 'counter: {class: "zoo.modules:Counter", settings: {count: 30}}'
    listener = 'listener: {class: "zoo.late:Late"}'
    started(robot, f"modules:\n  {counter}\n  {listener}\ncore: {{deadline_s: 20}}\n")
    figures = robot.until(
        lambda modules: (modules["counter"]["state"], modules["listener"]["state"]) == ("RUNNING", "STARTING")
    )
    core = psutil.Process(figures["core"]["pid"])
    core.suspend()
    (robot.output / "go_on").touch()
    robot.until(lambda modules: modules["listener"]["state"] == "RUNNING")
    time.sleep(0.3)  # in which modules would begin that do not wait for the core
    core.resume()
    robot.until(lambda modules: modules["counter"]["state"] == "STOPPED")
    assert stopped(robot).exit_code == 0
    assert robot.journal("listener") == list(range(30))


def test_declarations_that_wait_for_a_late_core_do_not_stop_the_start(robot: Robot) -> None:
    """What did not fit into a module's ring must get there before messages flow."""
    (robot.folder / "zoo" / "late.py").write_text(LATE)
    late = 'late: {class: "zoo.late:Late", settings: {topics: 40}}'
    started(robot, f"modules:\n  {late}\ncore: {{deadline_s: 20, ring_records: 16}}\n")
    figures = robot.until(lambda modules: modules["late"]["state"] == "STARTING")
    core = psutil.Process(figures["core"]["pid"])
    core.suspend()
    (robot.output / "go_on").touch()
    robot.until(lambda modules: modules["late"]["state"] == "RUNNING")
    core.resume()
    wait_until(lambda: "messages flow" in robot.log("supervisor"))
    assert stopped(robot).exit_code == 0


def test_core_that_stands_still_is_replaced_and_nothing_is_lost(robot: Robot) -> None:
    started(robot, PROFILE % "" + "core: {deadline_s: 0.5}\n")
    figures = robot.until(lambda modules: modules["sink"]["handled"] > 20)
    os.kill(figures["core"]["pid"], signal.SIGSTOP)
    figures = robot.until(lambda modules: modules["core"]["restarts"] == 1)
    handled = figures["sink"]["handled"]
    robot.until(lambda modules: modules["sink"]["handled"] > handled + 20)
    ended = stopped(robot)
    assert "core: BACKOFF (sent no heartbeat for 0." in ended.stderr
    heard = robot.journal("sink")
    assert heard == list(range(heard[0], heard[0] + len(heard)))
    assert ended.modules["sink"]["restarts"] == ended.modules["source"]["restarts"] == 0


def test_leak_ends_in_a_memory_error_of_that_module_alone(robot: Robot) -> None:
    leak = '{class: "zoo.hanging:Leak", restart: {policy: never}, memory: {process_bytes: 1000000000}}'
    started(robot, PROFILE % "" + f"  leak: {leak}\n")
    robot.until(lambda modules: modules["leak"]["state"] == "FAILED")
    assert "MemoryError" in robot.log("leak")
    ended = stopped(robot)
    assert ended.modules["sink"]["restarts"] == 0
    assert ended.exit_code == 1


def test_failed_module_is_brought_back_by_hand(robot: Robot) -> None:
    started(robot, PROFILE % "" + "    restart: {policy: never}\n")
    figures = robot.until(lambda modules: modules["sink"]["handled"] > 10)
    os.kill(figures["sink"]["pid"], signal.SIGKILL)
    robot.until(lambda modules: modules["sink"]["state"] == "FAILED")
    before = len(robot.journal("sink"))
    answer = robot.command("module", "restart", "sink")
    assert answer.stdout == "sink is RUNNING, start 2\n", answer.stderr
    wait_until(lambda: len(robot.journal("sink")) > before + 10)
    answer = robot.command("module", "stop", "sink")
    assert answer.stdout == "sink is STOPPED (stopped by command: exit code 0)\n", answer.stderr
    answer = robot.command("module", "start", "sink")
    assert answer.stdout == "sink is RUNNING, start 3\n", answer.stderr
    again = robot.command("module", "start", "sink")
    assert (again.returncode, again.stderr.split(";")[0]) == (1, "sink is RUNNING already")
    assert stopped(robot).exit_code == 0


def test_wrong_command_is_told_so(robot: Robot) -> None:
    nobody = robot.command("module", "restart", "sink")
    assert (nobody.returncode, nobody.stderr) == (
        1,
        "no run on this machine; start one with `robbie run PROFILE`\n",
    )
    started(robot, PROFILE % "")
    robot.until(lambda modules: modules["sink"]["state"] == "RUNNING")
    wrong = robot.command("module", "restart", "sinc")
    assert (wrong.returncode, wrong.stderr) == (1, "no module is named 'sinc'; did you mean 'sink'?\n")
    assert stopped(robot).exit_code == 0


def test_restart_takes_a_warm_module_unless_its_file_was_edited(robot: Robot) -> None:
    profile = 'modules: {source: {class: "zoo.hanging:Source"}}\nspares: {imports: [zoo.hanging]}'
    started(robot, profile)
    robot.until(lambda modules: modules["source"]["state"] == "RUNNING")
    for edited, command in (
        (False, "robbie_mp.run.supervisor.spare"),
        (True, "robbie_mp.run.supervisor.child"),
    ):
        wait_until(lambda: bool(spares(robot)))
        waiting = spares(robot)
        if edited:
            (robot.folder / "zoo" / "hanging.py").write_text(MODULES + "\nprint('edited')\n")
        assert robot.command("module", "restart", "source").returncode == 0
        pid = robot.top()["source"]["pid"]
        assert pid in waiting, "it did not take the spare"
        assert command in psutil.Process(pid).cmdline()
    assert stopped(robot).modules["source"]["restarts"] == 2
    assert robot.log("source").count("edited") == 1


def test_restarted_module_computes_with_as_many_threads_as_its_profile_says(robot: Robot) -> None:
    """One with another number than a spare has does not take it, for its libraries are loaded there."""
    profile = """
modules:
  usual: {class: "zoo.modules:Computing"}
  more: {class: "zoo.modules:Computing", scheduling: {compute_threads: 2}}
  free: {class: "zoo.modules:Computing", scheduling: {compute_threads: 0}}
"""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OMP_NUM_THREADS", "7")
        started(robot, profile)
    names = ("usual", "more", "free")
    robot.until(lambda modules: all(modules[name]["state"] == "RUNNING" for name in names))
    for name in ("more", "free", "usual"):
        wait_until(lambda: bool(spares(robot)))
        waiting = spares(robot)
        assert robot.command("module", "restart", name).returncode == 0
        assert (robot.top()[name]["pid"] in waiting) == (name == "usual")
    assert stopped(robot).exit_code == 0
    processors = len(os.sched_getaffinity(0))
    assert robot.journal("usual") == [1, 1, 1, 1]
    assert robot.journal("more") == [2, min(2, processors)] * 2
    assert robot.journal("free")[0] == 7


def spares(robot: Robot) -> set[int]:
    """Pids of the spares that are warm."""
    children = psutil.Process(robot.process.pid).children()  # type: ignore[attr-defined]
    return {child.pid for child in children if child.name() == "spare"}
