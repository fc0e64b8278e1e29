"""Whole runs: the promises that a robot's owner relies on."""

import json
import os
import shutil
import signal
import socket
import stat
import time
from pathlib import Path

import psutil
import pytest

from robbie_mp.bus._hot.choice import PURE_PYTHON, why_not
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.bus.transport.words import WORD_BYTES
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.run.trace.reader import last_entries
from tests._support.debugger import held_by_debugger
from tests._support.robot import COMMAND, Ended, Robot, is_running, kill, wait_until

COUNTING = """
modules:
  listener:
    class: zoo.modules:Listener
  counter:
    class: zoo.modules:Counter
    settings: {count: 300}
    ends_run: true
"""
ENDLESS = """
modules:
  one: {class: zoo.modules:Idle}
  two: {class: zoo.modules:Idle}
"""


def test_run_ends_with_success_when_its_task_is_done(robot: Robot) -> None:
    robot.write_profile(COUNTING)
    ended = robot.run()
    assert ended.exit_code == 0, ended.stderr
    assert robot.journal("listener") == list(range(300))
    assert ended.modules["counter"]["published"] == 300
    assert ended.modules["listener"]["handled"] == 300
    assert ended.modules["listener"]["dropped"] == ended.modules["listener"]["lost"] == 0
    books = ended.modules["listener"]["subscriptions"][0]
    assert books["routed"] == books["delivered"] == 300
    assert ended.modules["listener"]["cpu_s"] > 0


@pytest.mark.slow
@pytest.mark.every_turn
def test_every_module_and_the_core_are_separate_processes(robot: Robot) -> None:
    robot.write_profile(ENDLESS)
    process = robot.start()
    figures = robot.until(
        lambda modules: all(modules[name]["state"] == "RUNNING" for name in ("one", "two", "core"))
    )
    pids = {figures[name]["pid"] for name in ("one", "two", "core")}
    assert len(pids) == 3
    assert all(psutil.Process(pid).ppid() == process.pid for pid in pids)
    assert all(os.getsid(pid) == pid for pid in pids), "Ctrl-C would reach them"
    process.send_signal(signal.SIGINT)
    assert Ended.wait_for(process).exit_code == 0


@pytest.mark.slow
def test_run_needs_no_descriptors_of_processes_from_python(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An interpreter that uv had downloaded ended with "module 'os' has no attribute 'pidfd_open'"."""
    lacks = "import os, signal; del os.pidfd_open, os.P_PIDFD, signal.pidfd_send_signal"
    python, option, code = COMMAND
    monkeypatch.setattr("tests._support.robot.COMMAND", [python, option, f"{lacks}; {code}"])
    robot.write_profile(COUNTING)
    ended = robot.run()
    assert ended.exit_code == 0, ended.stderr


@pytest.mark.slow
def test_hot_path_in_python_is_reported_once_and_in_the_figures(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PURE_PYTHON, "1")
    robot.write_profile(COUNTING)
    ended = robot.run()
    assert ended.exit_code == 0, ended.stderr
    assert {ended.modules[name]["hot_path"] for name in ("listener", "counter", "core")} == {"PYTHON"}
    said = [entry for entry in last_entries(robot.output, "supervisor", 1000) if "hot path" in entry.text]
    assert [(entry.kind, entry.text) for entry in said] == [
        (
            Kind.WARNING,
            "the hot path runs in Python, which is slower: ROBBIE_PURE_PYTHON=1 is set; unset it to use C",
        )
    ]


@pytest.mark.slow
def test_stopped_supervisor_is_continued_and_its_run_can_be_stopped(robot: Robot) -> None:
    """As by a module that sends SIGSTOP: Ctrl-C hung, and nobody supervised the robot."""
    robot.write_profile(ENDLESS)
    process = robot.start()
    robot.until(lambda modules: all(modules[name]["state"] == "RUNNING" for name in ("one", "two")))
    process.send_signal(signal.SIGSTOP)
    wait_until(lambda: psutil.Process(process.pid).status() == psutil.STATUS_STOPPED)
    process.send_signal(signal.SIGINT)
    assert Ended.wait_for(process).exit_code == 0
    assert "the supervisor makes no progress; it is continued (SIGCONT)" in robot.log("core")


@pytest.mark.slow
def test_core_that_a_debugger_holds_is_replaced_and_the_run_goes_on(robot: Robot) -> None:
    """The debugger is told its end first, and the supervisor nothing: it spun, and ended the run."""
    robot.write_profile("core: {deadline_s: 0.5}" + ENDLESS)
    process = robot.start()
    figures = robot.until(lambda modules: all(one["state"] == "RUNNING" for one in modules.values()))
    with held_by_debugger(figures["core"]["pid"]):
        robot.until(
            lambda modules: modules["core"]["state"] == "RUNNING" and modules["core"]["restarts"] == 1
        )
        used_s = sum(psutil.Process(process.pid).cpu_times()[:2])
        time.sleep(0.5)
        assert sum(psutil.Process(process.pid).cpu_times()[:2]) - used_s < 0.25, "the supervisor spins"
    Ended.in_order(process)


@pytest.mark.slow
def test_core_ends_while_its_supervisor_hangs_and_comes_back_with_it(robot: Robot) -> None:
    robot.write_profile(ENDLESS)
    process = robot.start()
    figures = robot.until(lambda modules: all(one["state"] == "RUNNING" for one in modules.values()))
    with held_by_debugger(process.pid):
        wait_until(lambda: not is_running(figures["core"]["pid"]))
        assert is_running(figures["one"]["pid"])
    robot.until(lambda modules: modules["core"]["state"] == "RUNNING" and modules["core"]["restarts"] == 1)
    process.send_signal(signal.SIGINT)
    assert Ended.wait_for(process).exit_code == 0
    assert "nothing may move without it" in robot.log("core")


@pytest.mark.slow
@pytest.mark.parametrize("removed", ["{memory}", "{memory}/core", "{memory}/wakeup-core", "{folder}"])
def test_run_whose_files_are_removed_ends_with_the_reason(robot: Robot, removed: str) -> None:
    """Otherwise it went on for ever, and none of its modules could be restarted."""
    robot.write_profile(ENDLESS)
    process = robot.start()
    robot.until(lambda modules: all(modules[name]["state"] == "RUNNING" for name in ("one", "two")))
    run = robot.known_run()
    path = Path(removed.format(memory=f"{SHARED_MEMORY}/robbie-{run.run_id}", folder=run.folder))
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    ended = Ended.wait_for(process)
    assert ended.exit_code == 1
    assert f"the run stops: {path}" in robot.log("supervisor")
    assert "was removed, and no process can start without it" in robot.log("supervisor")
    assert all(robot.log(name).count("RUNNING → STOPPED") == 1 for name in ("one", "two", "core"))
    assert not list(SHARED_MEMORY.glob(f"*robbie-{run.run_id}*"))


@pytest.mark.slow
@pytest.mark.every_turn
@pytest.mark.skipif(why_not() != "", reason=f"NOT TESTED: {why_not()}")
def test_core_and_modules_run_in_c_where_it_is_built(robot: Robot) -> None:
    robot.write_profile(COUNTING)
    ended = robot.run()
    assert {ended.modules[name]["hot_path"] for name in ("listener", "counter", "core")} == {"C"}
    said = [entry for entry in last_entries(robot.output, "supervisor", 1000) if "hot path" in entry.text]
    assert [(entry.kind, entry.text) for entry in said] == [(Kind.SYSTEM, "the hot path runs in C")]


@pytest.mark.slow
@pytest.mark.every_turn
def test_array_seen_by_publisher_and_two_subscribers_is_one_piece_of_memory(robot: Robot) -> None:
    robot.write_profile(
        """
modules:
  left: {class: "zoo.modules:Viewer"}
  right: {class: "zoo.modules:Viewer"}
  camera: {class: "zoo.modules:Camera", ends_run: true}
"""
    )
    assert robot.run().exit_code == 0
    camera, left, right = (
        json.loads((robot.output / f"{name}.json").read_text()) for name in ("camera", "left", "right")
    )
    assert len({place["pid"] for place in (camera, left, right)}) == 3
    assert (
        (camera["inode"], camera["offset"])
        == (left["inode"], left["offset"])
        == (right["inode"], right["offset"])
    )
    assert camera["rights"] == "rw-s"
    for viewer in (left, right):
        assert viewer["rights"] == "r--s", "a wild pointer could write it"
        assert "read-only" in viewer["refused"]
        assert viewer["refused_flag"]
        assert viewer["sum"] == sum(value % 251 for value in range(1_000_000))


@pytest.mark.slow
def test_killed_subscriber_loses_only_the_message_that_it_was_handling(robot: Robot) -> None:
    robot.write_profile(COUNTING + '  watcher: {class: "zoo.modules:StateWatcher"}\n')
    ended = robot.run("--set", "listener.die_at=100")
    assert ended.exit_code == 0, ended.stderr
    assert robot.journal("listener") == [number for number in range(300) if number != 100]
    assert ended.modules["listener"]["restarts"] == 1
    assert ended.modules["listener"]["lost"] == 1
    assert ended.modules["counter"]["restarts"] == 0
    states = (robot.output / "states").read_text().splitlines()
    assert "listener BACKOFF" in states
    assert "counter BACKOFF" not in states


def test_killed_core_loses_nothing(robot: Robot) -> None:
    robot.write_profile(COUNTING.replace("count: 300", "count: 20000"))
    process = robot.start()
    for restarts in range(3):
        figures = robot.until(
            lambda modules, restarts=restarts: (  # type: ignore[misc]
                modules["core"]["restarts"] == restarts
                and modules["core"]["pid"] != 0
                and modules["listener"]["handled"] > 500 * (restarts + 1)
            )
        )
        kill(figures["core"]["pid"])
    ended = Ended.wait_for(process)
    assert ended.exit_code == 0, ended.stderr
    assert robot.journal("listener") == list(range(20000))
    assert ended.modules["core"]["restarts"] == 3
    assert ended.modules["listener"]["lost"] == ended.modules["listener"]["dropped"] == 0
    assert ended.modules["listener"]["restarts"] == ended.modules["counter"]["restarts"] == 0


@pytest.mark.slow
def test_two_runs_at_once_do_not_disturb_each_other(robot: Robot) -> None:
    robot.write_profile(COUNTING)
    outputs = [robot.folder / "first", robot.folder / "second"]
    processes = [robot.start("--another", output=output) for output in outputs]
    for process, output in zip(processes, outputs, strict=True):
        assert Ended.wait_for(process).exit_code == 0
        assert [int(line) for line in (output / "listener.journal").read_text().split()] == list(range(300))


@pytest.mark.slow
def test_module_that_crashes_in_setup_is_failed_with_its_traceback(robot: Robot) -> None:
    robot.write_profile(
        """
modules:
  broken:
    class: zoo.modules:CrashInSetup
    restart: {max_restarts: 2, backoff_s: 0.01, retry_s: 0}
"""
    )
    ended = robot.run()
    assert ended.exit_code == 1
    assert ended.modules["broken"]["state"] == "FAILED"
    assert "RuntimeError: the device is not there" in ended.stderr
    assert ended.modules["broken"]["trace_entries"] == len(last_entries(robot.output, "broken", 1000)) > 3
    assert ended.modules["broken"]["trace_entries_dropped"] == 0


@pytest.mark.slow
def test_module_that_crashes_at_import_is_failed_with_its_traceback(robot: Robot) -> None:
    (robot.folder / "zoo" / "broken.py").write_text("import robbie_mp\nraise OSError('no such camera')\n")
    robot.write_profile(
        "modules:\n  broken:\n    class: zoo.broken:Camera\n"
        "    restart: {max_restarts: 1, backoff_s: 0.01, retry_s: 0}\n"
    )
    ended = robot.run()
    assert ended.exit_code == 1
    assert "OSError: no such camera" in ended.stderr
    assert ended.modules["broken"]["state"] == "FAILED"


@pytest.mark.slow
def test_failed_essential_module_stops_the_robot(robot: Robot) -> None:
    robot.write_profile(
        ENDLESS + '  broken: {class: "zoo.modules:CrashInSetup", essential: true, restart: {policy: never}}\n'
    )
    ended = robot.run()
    assert ended.exit_code == 1
    assert ended.modules["one"]["state"] == "STOPPED"
    assert "broken" in ended.summary["reason"]


def test_crash_in_a_handler_restarts_that_module_alone(robot: Robot) -> None:
    robot.write_profile(
        COUNTING.replace("count: 300", "count: 7") + '  fragile: {class: "zoo.modules:CrashInHandler"}\n'
    )
    ended = robot.run()
    assert ended.exit_code == 0
    assert ended.modules["fragile"]["restarts"] == 2
    assert ended.modules["fragile"]["lost"] == 2
    assert ended.modules["fragile"]["handled"] == 5
    assert robot.journal("listener") == list(range(7))


@pytest.mark.slow
def test_crashed_module_is_restarted_although_one_of_its_threads_still_runs(robot: Robot) -> None:
    robot.write_profile(
        "modules:\n  threaded:\n    class: zoo.modules:CrashWithThread\n"
        "    restart: {max_restarts: 1, backoff_s: 0.01, retry_s: 0}\n"
    )
    ended = robot.run()
    assert ended.exit_code == 1
    assert ended.modules["threaded"]["restarts"] == 1
    assert "RuntimeError: crashed beside a thread" in ended.stderr


@pytest.mark.slow
def test_full_memory_refuses_and_counts_and_affects_no_other_module(robot: Robot) -> None:
    robot.write_profile(
        COUNTING
        + """
  holder: {class: "zoo.modules:Holder"}
  flood:
    class: zoo.modules:Flood
    memory: {segment_bytes: 1000000, limit_bytes: 4000000}
"""
    )
    process = robot.start("--set", "counter.count=3000")
    ended = Ended.wait_for(process)
    assert ended.exit_code == 0, ended.stderr
    assert robot.journal("listener") == list(range(3000))
    flood = ended.modules["flood"]
    assert flood["refused"] > 0
    assert flood["published"] >= len(robot.journal("holder")) > 10
    assert flood["restarts"] == 0


@pytest.mark.slow
def test_children_die_with_a_killed_supervisor_and_the_next_run_sweeps(robot: Robot) -> None:
    robot.write_profile(ENDLESS)
    process = robot.start()
    figures = robot.until(lambda modules: all(modules[name]["state"] == "RUNNING" for name in ("one", "two")))
    pids = [figures[name]["pid"] for name in ("one", "two", "core")]
    process.kill()
    process.wait()
    assert wait_until(lambda: not any(map(is_running, pids)), limit_s=5) < 1.0
    assert any("robbie-" in name for name in os.listdir(SHARED_MEMORY)), "nothing was there to sweep"
    robot.write_profile(COUNTING, "second")
    assert robot.run(profile="second").exit_code == 0


@pytest.mark.slow
def test_list_shows_the_run_and_its_modules(robot: Robot) -> None:
    robot.write_profile(ENDLESS)
    robot.start()
    robot.until(lambda modules: modules["two"]["state"] == "RUNNING")
    listed = json.loads(robot.command("list", "--json").stdout)
    assert [run["profile"] for run in listed] == ["robot"]
    assert listed[0]["modules"]["one"] == "RUNNING"
    assert "one RUNNING" in " ".join(robot.command("list").stdout.split())
    table = robot.command("top", "--once").stdout
    assert "one" in table
    assert "RUNNING" in table


@pytest.mark.slow
def test_list_shows_also_a_run_of_another_version(robot: Robot) -> None:
    """After an update, the list of all runs failed until the last run of the old version had ended."""
    robot.write_profile(ENDLESS)
    robot.start()
    robot.until(lambda modules: modules["two"]["state"] == "RUNNING")
    with (SHARED_MEMORY / names.board(robot.known_run().run_id)).open("r+b") as board:
        board.seek(layout.HEADER_VERSION * WORD_BYTES)
        board.write((layout.LAYOUT_VERSION - 1).to_bytes(WORD_BYTES, "little"))
    assert [run["modules"] for run in json.loads(robot.command("list", "--json").stdout)] == [{}]
    assert "another version" in " ".join(robot.command("list").stdout.split())


@pytest.mark.slow
@pytest.mark.every_turn
def test_terminated_run_leaves_no_name_behind(robot: Robot) -> None:
    robot.write_profile(ENDLESS)
    process = robot.start()
    robot.until(lambda modules: modules["two"]["state"] == "RUNNING")
    run_id = next(iter((robot.folder.parent / "runtime" / "robbie").iterdir())).name
    assert list(SHARED_MEMORY.glob(f"*robbie-{run_id}*"))
    process.send_signal(signal.SIGTERM)
    assert Ended.wait_for(process).exit_code == 0
    assert not list(SHARED_MEMORY.glob(f"*robbie-{run_id}*"))


def test_check_of_a_hanging_import_ends_with_its_parent(robot: Robot) -> None:
    (robot.folder / "zoo" / "hanging.py").write_text(
        "import os, pathlib, signal\n"
        "signal.signal(signal.SIGALRM, signal.SIG_IGN)\n"
        "pathlib.Path('pid.new').write_text(str(os.getpid()))\n"
        "os.rename('pid.new', 'pid')\n"
        "while True:\n    signal.pause()\n"
    )
    robot.write_profile('modules:\n  hanging: {class: "zoo.hanging:Camera"}\n')
    process = robot.start()
    pid_file = robot.folder / "pid"
    wait_until(pid_file.exists)
    process.kill()
    process.wait()
    wait_until(lambda: not is_running(int(pid_file.read_text())), limit_s=5)


INTERRUPTED = """
import os, signal
from robbie_mp import Module

if "ROBBIE_CHILD" in os.environ:  # not in the check before the start
    os.kill(os.getpid(), signal.SIGINT)


class Interrupted(Module):
    period_s = 0.01

    def tick(self):
        os.kill(os.getpid(), signal.SIGINT)
        self.status = "interrupted"
"""


@pytest.mark.slow
def test_interrupt_that_reaches_children_and_spares_does_not_end_them(robot: Robot) -> None:
    (robot.folder / "zoo" / "interrupted.py").write_text(INTERRUPTED)
    robot.write_profile(
        "modules: {one: {class: zoo.interrupted:Interrupted}}\nspares: {count: 1, imports: [zoo.interrupted]}"
    )
    process = robot.start()
    robot.until(lambda modules: modules["one"]["status"] == "interrupted" or modules["one"]["restarts"])
    wait_until(lambda: "spare interpreter" in robot.log("supervisor"))
    ended = Ended.in_order(process)
    assert ended.modules["one"]["restarts"] == 0
    log = robot.log("supervisor")
    assert "is ready" in log and "a spare interpreter has ended" not in log, log
    assert "Traceback" not in log + robot.log("one")


def test_service_manager_is_told_when_all_run_and_that_the_supervisor_lives(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(30)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "400000")
        robot.write_profile(ENDLESS)
        process = robot.start()
        while not (said := manager.recv(1000)).startswith(b"READY=1"):
            assert said == b"WATCHDOG=1"
        figures = robot.top()
        assert all(figures[name]["state"] == "RUNNING" for name in ("one", "two"))
        environment = Path(f"/proc/{figures['one']['pid']}/environ").read_bytes()
        assert b"NOTIFY_SOCKET" not in environment
        assert manager.recv(1000) == b"STATUS=2 modules run"
        assert manager.recv(1000) == b"WATCHDOG=1"
        process.send_signal(signal.SIGTERM)
        while not (said := manager.recv(1000)).startswith(b"STOPPING=1"):
            assert said == b"WATCHDOG=1"
        assert Ended.wait_for(process).exit_code == 0


@pytest.mark.slow
@pytest.mark.every_turn
def test_results_are_private(robot: Robot) -> None:
    robot.write_profile("modules: {writer: {class: zoo.modules:Writer, ends_run: true}}")
    ended = robot.run()
    assert ended.exit_code == 0, ended.stderr
    assert stat.S_IMODE((robot.output / "result.txt").stat().st_mode) == 0o600


def test_folder_for_results_that_others_can_write_to_is_refused(robot: Robot) -> None:
    robot.output.mkdir()
    robot.output.chmod(0o777)
    (robot.output / "result.txt").symlink_to(robot.folder / "precious.txt")
    robot.write_profile("modules: {writer: {class: zoo.modules:Writer, ends_run: true}}")
    ended = robot.run()
    assert ended.exit_code == 1
    assert "others must not be able to write to it; choose another one with --output" in ended.stderr
    assert not (robot.folder / "precious.txt").exists()


@pytest.mark.slow
@pytest.mark.every_turn
def test_module_that_closes_or_replaces_its_streams_ends_in_order(robot: Robot) -> None:
    """It was killed at its deadline if it left a thread running, and results were said to be missing."""
    ways = {
        "closed": "sys.stdout.close()",
        "missing": "sys.stderr = None",
        "full": "sys.stdout = open('/dev/full', 'w'); print(1)",
        "exits": "sys.exit((1 << 40) + 3)",
    }
    lines = ["import sys, threading, robbie_mp"]
    for name, way in ways.items():
        lines += [f"class {name.title()}(robbie_mp.Module):", "    def setup(self):"]
        lines += ["        threading.Thread(target=threading.Event().wait).start()", f"        {way}"]
    (robot.folder / "streams.py").write_text("\n".join(lines))
    modules = [f"  {name}: {{class: 'streams:{name.title()}', restart: {{policy: never}}}}" for name in ways]
    robot.write_profile("\n".join(["modules:", *modules]))
    process = robot.start()
    running = ("closed", "missing", "full")
    robot.until(lambda top: all(top[name]["state"] == "RUNNING" for name in running))
    figures = robot.until(lambda top: top["exits"]["state"] == "FAILED")
    assert "exit code 3" in figures["exits"]["last_end"]
    process.send_signal(signal.SIGINT)
    Ended.wait_for(process)
    for name in running:
        assert "RUNNING → STOPPED: exit code 0" in robot.log(name)
