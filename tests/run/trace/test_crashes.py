"""One live robot whose modules end in every bad way: the last output and the reason are always recorded."""

import json
import subprocess
from pathlib import Path

import pytest

from robbie_mp.run.supervisor.crash import memory_kills
from robbie_mp.run.trace.crash import CrashReport
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.reader import crash_reports, entries
from tests._support.robot import COMMAND, Ended, Robot
from tests.run.trace.test_page import Comments

WAYS = {
    "null_pointer": "killed by SIGSEGV",
    "exit": "exit code 7",
    "memory": "exit code 1",
    "sigkill": "killed by SIGKILL",
    "exception": "exit code 1",
    "hang": "hung in handler Ending.on_point of geometry_msgs/msg/Point on front for 0.",
}
STACK = {
    "null_pointer": ("Fatal Python error: Segmentation fault", "in null_pointer"),
    "memory": ("MemoryError", "Unable to allocate 64.0 GiB", "memory.process_bytes 4000000000", "in memory"),
    "exception": ("ValueError: no such <script>device</script>", "in exception"),
    "hang": ("Fatal Python error: Aborted", "in wait_for_a_device"),
}
PROFILE = """
trace: {record: [error, warning, info]}
modules:
""" + "".join(
    f"  {way}_module:\n    class: zoo.misbehaving:Ending\n    settings: {{how: {way}}}\n"
    "    restart: {policy: never}\n    handler_deadline_s: 0.5\n    memory: {process_bytes: 4000000000}\n"
    for way in WAYS
)


@pytest.mark.slow
def test_trace_has_the_last_output_and_the_reason_of_every_kind_of_end(robot: Robot) -> None:
    modules = Path(__file__).parent / "_support" / "misbehaving_modules.py"
    (robot.folder / "zoo" / "misbehaving.py").write_text(modules.read_text())
    robot.write_profile(PROFILE + '  source: {class: "zoo.misbehaving:Source"}\n')
    process = robot.start()
    robot.until(lambda figures: all(figures[f"{way}_module"]["state"] == "FAILED" for way in WAYS))

    [folder] = (robot.folder.parent / "runtime" / "robbie").iterdir()
    this = ("--run", folder.name)  # others may run on this machine
    assert "debug" not in robot.log("source").lower()
    answer = robot.command("log", *this, "--record", "error,warning,info,system", "--module", "source")
    assert answer.stdout == "source: error, warning, info, system recorded from now on\n", answer.stderr
    follower = subprocess.Popen(
        [*COMMAND, "log", *this, "--follow", "--module", "source", "--kind", "system", "--last", "0"],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert follower.stdout
    heard = [follower.stdout.readline() for _ in range(3)]
    assert all("source#1 system point " in line for line in heard), heard
    robot.command("log", *this, "--record", "error")
    assert robot.command("log", "--record", "bad").returncode == 2
    unknown = robot.command("log", *this, "--record", "error", "--module", "sourc")
    assert "did you mean 'source'" in unknown.stderr
    page_while_running = (robot.output / "log" / "trace.html").read_text()
    process.kill()  # the supervisor itself: what it has written must be whole
    Ended.wait_for(process)
    follower.communicate(timeout=20)
    assert follower.returncode == 0, "it does not end with the run"
    robot.command("clean")

    on_page = [entry for entry in Comments(page_while_running).found if entry]
    assert on_page == [entry for entry in entries(robot.output) if entry.number <= on_page[-1].number]
    for way, reason in WAYS.items():
        check_trace([entry for entry in on_page if entry.module == f"{way}_module"], way, reason)
        [report] = crash_reports(robot.output, f"{way}_module")
        check_report(report, way, reason)
    crashes = robot.command("log", str(robot.output), "--crashes", "--module", "sigkill_module")
    assert "last message: geometry_msgs/msg/Point on front, number" in crashes.stdout
    errors = robot.command("log", str(robot.output), "--kind", "error", "--json", "--last", "100")
    assert {json.loads(line)["kind"] for line in errors.stdout.splitlines()} == {"error"}


def check_trace(said: list[Entry], way: str, reason: str) -> None:
    texts = [entry.text for entry in said]
    assert f"last words of {way}, with no end of l" in texts
    assert f"about to end <b>by</b> {way}" in texts
    [crash] = [entry for entry in said if entry.crash_report]
    assert f"crashed in handler Ending.on_point of geometry_msgs/msg/Point on front: {reason}" in crash.text
    assert (crash.kind, crash.incarnation) == ("error", 1)
    for part in STACK.get(way, ()):
        assert part in crash.traceback, crash.traceback


def check_report(report: CrashReport, way: str, reason: str) -> None:
    assert reason in report.reason
    words = report.last_words
    assert words.activity == "handler Ending.on_point of geometry_msgs/msg/Point on front"
    assert words.status == f"ends by {way}"
    assert words.counters["handled"] == 2
    message = words.message
    assert message
    assert (message.type_name, message.topic, message.sender) == (
        "geometry_msgs/msg/Point",
        "front",
        "source",
    )
    assert message.sequence > 0
    assert report.printed[-1] == f"last words of {way}, with no end of l"
    assert report.said[0] == f"WARNING about to end <b>by</b> {way}"
    assert (report.signal is None) == reason.startswith("exit")
    assert bool(report.traceback) == (way in STACK)
    assert bool(report.hints) == (way == "sigkill")
    assert 0 < report.cpu_s < report.uptime_s + 1


def test_report_is_read_back_and_garbage_is_not_a_report() -> None:
    assert CrashReport.from_json("{}") is None
    assert CrashReport.from_json("[1]") is None
    assert CrashReport.from_json("half") is None


@pytest.mark.parametrize(("text", "count"), [("pgfault 5\noom_kill 3\nswap_ra 0\n", 3), ("nothing 1\n", 0)])
def test_kernels_count_of_memory_kills_is_read(tmp_path: Path, text: str, count: int) -> None:
    (tmp_path / "vmstat").write_text(text)
    assert memory_kills(tmp_path / "vmstat") == count
    assert memory_kills(tmp_path / "nowhere") == 0
    assert memory_kills() >= 0
