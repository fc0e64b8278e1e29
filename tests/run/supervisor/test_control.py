"""Commands from outside are carried out or refused with a reason, and never block the tree."""

import json
import logging
import os
import socket
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from robbie_mp import RobbieError
from robbie_mp.run.control import MAX_LINE_BYTES, RunNotControlled, control, socket_address
from robbie_mp.run.profile.model import RestartPolicy
from robbie_mp.run.supervisor.child_spec import ChildSpec
from robbie_mp.run.supervisor.control import MAX_CLIENTS, ControlServer
from robbie_mp.run.supervisor.states import ChildState
from robbie_mp.run.trace.kinds import Kind, read_level, read_recorded
from tests._support.few_descriptors import only_free_descriptors
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import NEVER, Run, Scenario, animal, core

RUNNING, FAILED, STOPPED = ChildState.RUNNING, ChildState.FAILED, ChildState.STOPPED


class Controlled(Run):
    """A tree with its socket, and a clock for the socket's time-outs."""

    def __init__(self, folder: Path, *specs: ChildSpec):
        super().__init__(folder, *specs)
        self.folder = folder / "run"
        self.folder.mkdir()
        self.later_s = 0.0
        self.server = ControlServer(self.folder, self.tree, lambda: time.monotonic() + self.later_s)
        self.each_turn = self.server.turn

    def play(self, scenario: Scenario | None = None) -> int:
        try:
            return super().play(scenario)
        finally:
            self.server.close()


class Command:
    """A command given by somebody else, in a thread, because the test's own thread runs the tree."""

    def __init__(self, run: Controlled, command: str, module: str | None = None, **more: object):
        self.said: str | None = None
        self.refused = ""
        self._thread = threading.Thread(target=self._give, args=(run.folder, command, module), kwargs=more)
        self._thread.start()

    def is_over(self) -> bool:
        if not self._thread.is_alive():
            self._thread.join()
            return True
        return False

    def _give(self, folder: Path, command: str, module: str | None, **more: object) -> None:
        try:
            self.said = control(folder, command, module, **more)
        except RobbieError as error:
            self.refused = str(error)


def connect(run: Controlled) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX)
    folder_fd = os.open(run.folder, os.O_RDONLY)
    connection.connect(socket_address(folder_fd))
    os.close(folder_fd)
    connection.setblocking(False)
    return connection


def has_answer(connection: socket.socket) -> Callable[[], bool]:
    """A condition: something came, or the connection was closed."""

    def came() -> bool:
        try:
            connection.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        return True

    return came


def answer(connection: socket.socket) -> dict[str, str]:
    with connection:
        found: dict[str, str] = json.loads(connection.recv(10_000))
        return found


def refusal(tmp_path: Path, request: bytes) -> str:
    """Return the reply of a running tree to a request. The tree must keep running."""
    run = Controlled(tmp_path, core(), animal(zoo.works))
    said: list[dict[str, str]] = []

    def scenario() -> Scenario:
        yield run.all_running
        connection = connect(run)
        connection.send(request)
        yield has_answer(connection)
        said.append(answer(connection))
        assert run.all_running()
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    return said[0]["error"]


def test_running_module_can_be_stopped_in_order_and_started_again(tmp_path: Path) -> None:
    run = Controlled(tmp_path, animal(zoo.works, "laser", restart=RestartPolicy(max_restarts=0)))

    def scenario() -> Scenario:
        yield run.all_running
        command = Command(run, "restart", "laser")
        yield command.is_over
        assert command.said == "laser is RUNNING, start 2"
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    reasons = [change.reason for change in run.incarnations.changes]
    assert "restarted by command: exit code 0" in reasons


def test_stopped_module_stays_stopped_until_it_is_restarted(tmp_path: Path) -> None:
    run = Controlled(tmp_path, animal(zoo.works, "laser"), animal(zoo.works, "other"))

    def scenario() -> Scenario:
        yield run.all_running
        stop = Command(run, "stop", "laser")
        yield stop.is_over
        assert stop.said == "laser is STOPPED (stopped by command: exit code 0)"
        again = Command(run, "stop", "laser")
        yield again.is_over
        assert again.refused.startswith("laser is STOPPED already")
        turns = run.turns
        yield lambda: run.turns > turns + 3
        assert run.tree.child("laser").state is STOPPED
        start = Command(run, "restart", "laser")
        yield start.is_over
        assert start.said == "laser is RUNNING, start 2"
        assert run.is_running("other")
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_recorded_kinds_can_be_set_for_all_modules_or_for_one(tmp_path: Path) -> None:
    run = Controlled(tmp_path, core(), animal(zoo.works, "laser"), animal(zoo.works, "other"))

    def kinds(name: str) -> set[Kind]:
        return set(run.tree.child(name).output.kinds)

    def given(module: str | None, *recorded: str) -> Command:
        return Command(run, "record", module, kinds=recorded)

    def scenario() -> Scenario:
        yield run.all_running
        assert read_level(run.folder, "laser") == logging.DEBUG
        command = given(None, "error", "warning")
        yield command.is_over
        assert command.said == "every module: error, warning recorded from now on"
        command = given("laser")
        yield command.is_over
        assert command.said == "laser: nothing recorded from now on"
        assert (kinds("laser"), kinds("other"), kinds("core")) == (set(), {"error", "warning"}, set(Kind))
        assert read_level(run.folder, "laser") > logging.CRITICAL
        assert read_level(run.folder, "other") == logging.WARNING
        assert read_recorded(run.folder)["other"] == [Kind.ERROR, Kind.WARNING]
        assert read_recorded(run.folder)["supervisor"] == [*Kind]
        command = given("supervisor", "error")
        yield command.is_over
        for command in (given("nobody", "error"), given("laser", "loud")):
            yield command.is_over
            assert command.refused
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    remarks = [line.text for line in run.lines if line.stream == "supervisor"]
    assert any("STARTING → RUNNING" in text for text in remarks)
    assert not any("RUNNING → STOPPED" in text for text in remarks), "recorded in spite of it"


def test_failed_module_gets_its_whole_budget_back(tmp_path: Path) -> None:
    run = Controlled(tmp_path, animal(zoo.fails_at_once, "laser"), animal(zoo.works))

    def scenario() -> Scenario:
        yield lambda: FAILED in run.states("laser")
        starts = run.tree.child("laser").incarnation
        command = Command(run, "restart", "laser")
        yield command.is_over
        assert command.refused.startswith("laser is BACKOFF: exit code 1; RuntimeError: no such device")
        assert command.refused.endswith("; it is tried again")
        yield lambda: run.states("laser").count(FAILED) == 2
        assert run.tree.child("laser").incarnation == starts + 3
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 1


def test_restart_ends_a_backoff(tmp_path: Path) -> None:
    slow = RestartPolicy(backoff_s=60.0, backoff_cap_s=60.0)
    run = Controlled(tmp_path, animal(zoo.fails_once, "laser", restart=slow))

    def scenario() -> Scenario:
        yield lambda: ChildState.BACKOFF in run.states("laser")
        command = Command(run, "restart", "laser")
        yield command.is_over
        assert command.said == "laser is RUNNING, start 2"
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_module_that_ignores_its_stop_is_killed_after_its_grace(tmp_path: Path) -> None:
    run = Controlled(tmp_path, animal(zoo.ignores_sigterm, "deaf", stop_grace_s=0.05), animal(zoo.works))

    def scenario() -> Scenario:
        yield run.all_running
        command = Command(run, "stop", "deaf")
        yield command.is_over
        assert command.said == "deaf is STOPPED (did not stop within 0.05 s: killed by SIGKILL)"
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_core_can_be_restarted_but_not_stopped_alone(tmp_path: Path) -> None:
    run = Controlled(tmp_path, core(), animal(zoo.works))

    def scenario() -> Scenario:
        yield run.all_running
        stop, restart = Command(run, "stop", "core"), Command(run, "restart", "core")
        yield lambda: stop.is_over() and restart.is_over()
        assert stop.refused.startswith("the core cannot be stopped alone")
        assert restart.said == "core is RUNNING, start 2"
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_stop_command_stops_the_run_in_order_and_reports_its_end(tmp_path: Path) -> None:
    run = Controlled(tmp_path, animal(zoo.works, "first"), animal(zoo.works, "second"))
    commands: list[Command] = []

    def scenario() -> Scenario:
        yield run.all_running
        commands.append(Command(run, "stop"))

    assert run.play(scenario()) == 0
    assert run.tree.stop_reason == "stopped by command"
    while not commands[0].is_over():
        pass
    assert commands[0].said == ""
    assert [c.name for c in run.incarnations.changes if c.new is STOPPED] == ["second", "first"]


def test_nothing_is_restarted_while_the_run_stops(tmp_path: Path) -> None:
    run = Controlled(tmp_path, animal(zoo.works, "gone"), animal(zoo.ignores_sigterm, stop_grace_s=60.0))

    def scenario() -> Scenario:
        yield run.all_running
        run.tree.stop("enough")
        command = Command(run, "restart", "gone")
        yield command.is_over
        assert command.refused == "the run is stopping: enough"
        run.tree.kill_all("enough")

    assert run.play(scenario()) == 1


def test_waiting_client_is_told_that_the_run_has_ended(tmp_path: Path) -> None:
    run = Controlled(tmp_path, animal(zoo.is_never_ready, "slow", restart=NEVER), animal(zoo.works))
    commands: list[Command] = []

    def scenario() -> Scenario:
        yield lambda: run.is_running("works")
        commands.append(Command(run, "restart", "slow"))
        yield lambda: run.states("slow").count(ChildState.STARTING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 1, "slow never came up"
    while not commands[0].is_over():
        pass
    assert "slow is STOPPED" in commands[0].refused or "the run ended before" in commands[0].refused


def test_unknown_module_is_refused_with_the_nearest_name(tmp_path: Path) -> None:
    request = b'{"command": "restart", "module": "work"}\n'
    assert refusal(tmp_path, request) == "no module is named 'work'; did you mean 'works'?"


def test_garbage_is_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path, b"\xff\x00{\n").startswith("expected a JSON object")


def test_endless_nesting_is_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path, b"[" * 4000 + b"\n").startswith("expected a JSON object")


def test_unknown_command_is_refused(tmp_path: Path) -> None:
    said = refusal(tmp_path, b'{"command": "halt", "module": 7}\n')
    assert "expected stop, attach, record, debug, or stop, start, restart or swap" in said


def test_misspelt_module_name_does_not_stop_the_run(tmp_path: Path) -> None:
    assert "expected stop" in refusal(tmp_path, b'{"command": "stop", "modul": "works"}\n')


def test_endless_line_is_refused(tmp_path: Path) -> None:
    assert "expected one line" in refusal(tmp_path, b"x" * (MAX_LINE_BYTES + 1))


def test_silent_client_is_cut_off(tmp_path: Path) -> None:
    run = Controlled(tmp_path, animal(zoo.works))

    def scenario() -> Scenario:
        yield run.all_running
        connection = connect(run)
        connection.send(b'{"comm')
        turns = run.turns
        yield lambda: run.turns > turns + 2
        assert not has_answer(connection)()
        run.later_s = 60.0
        yield has_answer(connection)
        assert answer(connection)["error"].startswith("no command came within")
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_clients_are_bounded(tmp_path: Path) -> None:
    run = Controlled(tmp_path, animal(zoo.works))

    def scenario() -> Scenario:
        yield run.all_running
        connections = [connect(run) for _ in range(MAX_CLIENTS)]
        turns = run.turns
        yield lambda: run.turns > turns + MAX_CLIENTS
        late = connect(run)
        yield has_answer(late)
        assert "other commands wait already" in answer(late)["error"]
        for connection in connections:
            connection.close()
        yield lambda: not run.server._clients
        command = Command(run, "restart", "works")
        yield command.is_over
        assert command.said == "works is RUNNING, start 2"
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_folder_without_a_supervisor_takes_no_commands(tmp_path: Path) -> None:
    try:
        control(tmp_path, "stop")
    except RunNotControlled as error:
        assert "takes no commands" in str(error)
    else:
        raise AssertionError("somebody answered")


def test_command_waits_without_busy_polling_while_no_descriptor_is_free(tmp_path: Path) -> None:
    run = Controlled(tmp_path, core(), animal(zoo.works))

    def scenario() -> Scenario:
        yield run.all_running
        with closing(connect(run)) as connection:
            connection.send(b'{"command": "stop"}\n')
            with only_free_descriptors(0):
                before, until_s = run.turns, time.monotonic() + 1.0
                yield lambda: time.monotonic() > until_s
                assert run.turns - before < 200, "the supervisor looks again and again"
            yield lambda: bool(run.tree.stop_reason)

    assert run.play(scenario()) == 0
    assert run.tree.stop_reason == "stopped by command"
