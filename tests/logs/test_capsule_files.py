"""What a capsule that is damaged or forged does: it is refused with a reason, and nothing in it is run."""

import builtins
import json
import math
import os
import subprocess
import sys
import time
import traceback
import zipfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from robbie_mp.base.linux.proc import has_ended
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.board import Board
from robbie_mp.bus.transport.history import Event, PythonHistory, history_words
from robbie_mp.bus.transport.tables import CoreTables, TableSizes
from robbie_mp.logs.capsule.as_test import numbers
from robbie_mp.logs.capsule.attempt import START_LIMIT_S, Progress, attempt
from robbie_mp.logs.capsule.form import EVENTS, MANIFEST, MESSAGES
from robbie_mp.logs.capsule.place import HANG, Crash, Place, raised_crash, reported_crash
from robbie_mp.logs.capsule.read import CapsuleUnreadable, read_capsule
from robbie_mp.logs.capsule.replay import changed_code, judge, replay
from robbie_mp.logs.capsule.replayed import ForeignClass, ReplayHarness
from robbie_mp.logs.capsule.write import write_capsule
from robbie_mp.run.trace.crash import CrashReport, LastWords
from tests._support.robot import COMMAND, wait_until
from tests.security._support.hostile import HOSTILE, check_plain

TRACEBACK = [
    "CRITICAL ValueError: no",
    "Traceback (most recent call last):",
    '  File "/robot/shaky.py", line 8, in tick',
    "    raise ValueError('no')",
    "ValueError: no",
]
CODE = """
from robbie_mp import Module


class Shaky(Module):
    period_s = 0.1
    def tick(self):
        raise ValueError('no')
"""


def memory(words: int) -> memoryview:
    return memoryview(bytearray(8 * words)).cast("Q")


def report(**changes: Any) -> CrashReport:
    values: dict[str, Any] = {"module": "shaky", "incarnation": 1, "pid": 5, "time_s": 1.0, "uptime_s": 1.0}
    values |= {"reason": "exit code 1", "exit_code": 1, "signal": None, "cpu_s": 0.1, "hints": []}
    values |= {"last_words": LastWords(), "said": TRACEBACK, "printed": []}
    return CrashReport(**(values | changes))


@pytest.fixture
def capsule(tmp_path: Path) -> Path:
    """A capsule of a module that crashed in its first tick."""
    (tmp_path / "shaky.py").write_text(CODE)
    history = memory(history_words(1 << 17))
    writer = PythonHistory(history)
    writer.append(Event.BEGUN)
    writer.append(Event.TICK, 10)
    start = json.dumps({"seed": 1, "started_ns": 10, "monotonic_ns": 5, "settings": {}}).encode()
    place = history[layout.HISTORY_START : layout.HISTORY_RING].cast("B")
    place[: len(start)] = start
    history[layout.HISTORY_START_BYTES] = len(start)
    sizes = TableSizes(2, 3, 4, 5, 6)
    core = memory(sizes.words)
    CoreTables.create(core, sizes)
    board = memory(layout.board_words(3))
    Board(board).create(["supervisor", "shaky", "core"])
    files = {"out": memory(layout.out_words(16)), "core": core, "board": board, "history": history}
    facts = {"report": asdict(report()), "class": "shaky:Shaky", "workspace": str(tmp_path), "types": []}
    path = tmp_path / "shaky.capsule"
    write_capsule(path, facts, {name: bytes(words) for name, words in files.items()})
    return path


def changed(path: Path, name: str, change: Callable[[bytes], bytes]) -> Path:
    """Return a capsule with another content of one member."""
    other = path.with_suffix(".other")
    with zipfile.ZipFile(path) as before, zipfile.ZipFile(other, "w") as after:
        for member in before.namelist():
            data = before.read(member)
            after.writestr(member, change(data) if member == name else data)
    return other


def test_capsule_is_replayed_to_the_same_line(capsule: Path) -> None:
    read = read_capsule(capsule)
    assert [step.kind for step in read.steps] == [Event.PADDING, Event.BEGUN, Event.TICK]
    verdict = judge(read, replay(read, capsule.parent, quiet=True))
    assert verdict.is_same, verdict.lines
    assert verdict.lines[0].startswith("the same exception at the same line: ValueError: no")


def test_other_code_is_said_not_to_crash_or_to_crash_elsewhere(capsule: Path) -> None:
    read = read_capsule(capsule)
    code = capsule.parent / "shaky.py"
    code.write_text(CODE.replace("raise ValueError('no')", "pass"))
    assert judge(read, replay(read, capsule.parent, quiet=True)).lines[0] == "no crash"
    code.write_text(CODE.replace("ValueError('no')", "KeyError('no')"))
    assert (
        judge(read, replay(read, capsule.parent, quiet=True)).lines[0].startswith("another crash: KeyError")
    )
    code.write_text("\n\n" + CODE)
    assert (
        judge(read, replay(read, capsule.parent, quiet=True)).lines[0].startswith("the same crash at another")
    )


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 0.99])
def test_truncated_capsule_is_refused(capsule: Path, share: float) -> None:
    data = capsule.read_bytes()
    capsule.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(CapsuleUnreadable, match=r"shaky\.capsule"):
        read_capsule(capsule)


@pytest.mark.parametrize(
    ("member", "change"),
    [
        (MANIFEST, lambda _: b"[]"),
        (MANIFEST, lambda data: data.replace(b'"format": 1', b'"format": 2')),
        (MANIFEST, lambda data: data.replace(b'"module": "shaky"', b'"module": 5')),
        (EVENTS, lambda data: data + b'{"kind":"PICKLE","number":9}\n'),
        (EVENTS, lambda data: data + b'{"kind":"MESSAGE","number":9,"message":7}\n'),
        (EVENTS, lambda data: data + b'{"kind":"CLOCK","number":"9"}\n'),
        (MESSAGES, lambda _: b"no log"),
    ],
)
def test_forged_capsule_is_refused(capsule: Path, member: str, change: Callable[[bytes], bytes]) -> None:
    with pytest.raises(CapsuleUnreadable):
        read_capsule(changed(capsule, member, change))


@pytest.mark.slow
def test_texts_of_a_forged_capsule_are_printed_plainly(capsule: Path) -> None:
    forged = changed(
        capsule, MANIFEST, lambda data: json.dumps(json.loads(data) | {"damage": HOSTILE}).encode()
    )
    forged.rename(capsule)
    for option in ([], ["--list"], ["--json"]):
        ended = subprocess.run(
            [*COMMAND, "replay", capsule.name, *option],
            cwd=capsule.parent,
            capture_output=True,
            text=True,
            check=False,
        )
        check_plain(ended.stdout + ended.stderr, option, may_have_lines=True)
        assert option or "owned" in ended.stdout, ended


@pytest.mark.timeout(20)
def test_files_outside_of_the_workspace_that_a_forged_capsule_names_are_not_read(capsule: Path) -> None:
    code = {name: {"sha256": ""} for name in ("/dev/zero", "../../../../../../dev/zero")}
    forged = changed(capsule, MANIFEST, lambda data: json.dumps(json.loads(data) | {"code": code}).encode())
    assert changed_code(read_capsule(forged), capsule.parent) == ["../../../../../../dev/zero"]


def test_class_from_elsewhere_is_not_imported(capsule: Path) -> None:
    forged = changed(capsule, MANIFEST, lambda data: data.replace(b"shaky:Shaky", b"antigravity:Module"))
    with pytest.raises(ForeignClass, match="antigravity"):
        ReplayHarness(read_capsule(forged), capsule.parent)


def test_missing_file_is_an_error_of_one_line(tmp_path: Path) -> None:
    with pytest.raises(CapsuleUnreadable, match="cannot be read: No such file"):
        read_capsule(tmp_path / "none.capsule")
    os.mkfifo(tmp_path / "pipe.capsule")
    with pytest.raises(CapsuleUnreadable, match="cannot be read: it is a FIFO"):
        read_capsule(tmp_path / "pipe.capsule")


def test_ends_are_recognised_in_reports() -> None:
    place = Place("/robot/shaky.py", 8, "tick")
    assert reported_crash(report()) == Crash("exception", "ValueError", "no", place)
    dump = ["Fatal Python error: Aborted", "", "Current thread 0x1 (most recent call first):"]
    dump.append('  File "/robot/shaky.py", line 8 in tick')
    hung = report(signal=6, exit_code=None, reason="hung in tick for 5.0 s: killed by SIGABRT", said=dump)
    assert reported_crash(hung) == Crash(HANG, place=place)
    died = report(signal=11, exit_code=None, reason="killed by SIGSEGV", said=dump)
    assert reported_crash(died) == Crash("signal", "SIGSEGV", place=place)
    assert reported_crash(report(exit_code=3, said=[])) == Crash("exit", "3")


def said(error: Exception) -> CrashReport:
    """Return the report of a module that ended with an exception."""
    lines = "".join(traceback.format_exception(error)).splitlines()
    return report(said=[f"CRITICAL {type(error).__name__}: {error}", *lines])


def caught(function: Callable[[], object]) -> Exception:
    """Return what it raises."""
    with pytest.raises(Exception) as found:
        function()
    return found.value


def test_place_is_that_of_the_authors_code_and_not_of_a_library() -> None:
    def ask() -> None:
        json.loads("[1, 2")

    error = caught(ask)
    for crash in (reported_crash(said(error)), raised_crash(error)):
        assert crash.place is not None
        assert crash.place.function.endswith("ask"), crash


@pytest.mark.skipif(sys.version_info < (3, 11), reason="exception groups came with Python 3.11")
def test_place_of_an_exception_group_is_not_that_of_its_members() -> None:
    def member() -> None:
        raise ValueError("inside")

    def ask() -> None:
        raise builtins.ExceptionGroup("several", [caught(member)])  # type: ignore[attr-defined,unused-ignore]

    error = caught(ask)
    assert reported_crash(said(error)).is_like(raised_crash(error))
    assert raised_crash(error).place == reported_crash(said(error)).place


@pytest.mark.parametrize("value", [math.nan, -math.inf, [0.5, math.inf], 2])
def test_numbers_are_written_as_code_that_runs(value: object) -> None:
    assert repr(eval(numbers(value))) == repr(value)


def forever(progress: Progress, _details: dict[str, Any]) -> None:
    progress.show(0)
    while True:
        pass


def test_first_step_has_the_limit_that_the_user_gives() -> None:
    began_s = time.monotonic()
    assert attempt(forever, limit_s=0.2).crash.kind == HANG
    assert time.monotonic() - began_s < START_LIMIT_S


HANGS = """
import os, time
from robbie_mp.logs.capsule.attempt import attempt
attempt(lambda *_: (os.write(1, b"%d\\n" % os.getpid()), time.sleep(600)), quiet=False)
"""


def test_replayed_module_dies_with_the_command() -> None:
    with subprocess.Popen([sys.executable, "-c", HANGS], stdout=subprocess.PIPE) as command:
        assert command.stdout is not None
        replayed = int(command.stdout.readline())
        assert not has_ended(replayed)
        command.terminate()
    wait_until(lambda: has_ended(replayed))
