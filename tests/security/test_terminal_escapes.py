"""No command passes control characters of hostile names, texts or files on to a terminal."""

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from robbie_mp import Header
from robbie_mp.cli import main
from robbie_mp.cli.new import make_workspace
from robbie_mp.cli.program import COMMANDS
from robbie_mp.logs.black_box.clip_folder import AboutClip, ClipFolder
from robbie_mp.messages import PoseStamped, schema_text
from robbie_mp.run.install.device_names import UsbDevice
from tests._support.robot import COMMAND, Robot, wait_until
from tests.security._support.hostile import HOSTILE, check_plain, check_terminal, obeyed

pytestmark = [pytest.mark.slow, pytest.mark.timeout(200)]
MODULES = Path(__file__).parent / "_support" / "hostile_modules.py"
PROFILE = """
description: "\\x1b]0;owned\\x07\\u202e[bold]"
modules:
  hostile: {class: "zoo.hostile:Hostile"}
  listener: {class: "zoo.hostile:Listener"}
  crasher: {class: "zoo.hostile:Crasher", restart: {max_restarts: 1, within_s: 60}}
variables: {greeting: "\\x1b[2J\\u202e"}
"""
NAMES_IT = {
    "run", "record", "play", "playback", "list", "type", "echo", "hz", "bw", "pub", "call", "graph", "plot",
    "param",
    "gui", "top", "log", "info", "recording", "diff", "export", "import-carmen", "import-rosbag", "module",
    "stop", "keys", "connect", "profile", "clean", "doctor", "new", "completion", "devices", "install",
    "foxglove", "mark", "clips", "replay", "report",
}  # fmt: skip
"""Commands that a test below runs with hostile input."""
UNTRIED = {"attach", "shadow"}
"""Commands whose output was only read through: no test below runs them yet."""


def write_hostile_log(path: Path, pose: str = HOSTILE) -> Path:
    """Every text of a log is hostile: library, metadata, topic, type, sender, schema, message."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(HOSTILE, HOSTILE)
        texts = {name: HOSTILE for name in ("run_id", "profile", "host", "version", "python", "clock")}
        writer.add_metadata("robbie_run", texts)
        about = {"robbie_topic": HOSTILE, "robbie_sender": HOSTILE, "robbie_version": "1"}
        kind = PoseStamped
        schema = writer.register_schema(kind.type_name, "ros2msg", schema_text(kind).encode())
        channel = writer.register_channel(f"/{HOSTILE}", "cdr", schema, about)
        writer.add_message(channel, 10**18, PoseStamped(header=Header(frame_id=pose)).encode(), 10**18, 1)
        bad = writer.register_schema(f"zoo_msgs/msg/{HOSTILE}", "ros2msg", HOSTILE.encode())
        other = writer.register_channel(f"/other{HOSTILE}", "cdr", bad, about)
        writer.add_message(other, 10**18 + 1, b"\0\1\0\0", 10**18 + 1, 2)
        broken = writer.register_channel("/broken", "cdr", schema, {})
        writer.add_message(broken, 10**18 + 2, b"\0\1\0\0\1", 10**18 + 2, 3)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


class Reader:
    """Runs commands as the program does, and looks at all that they print."""

    def __init__(self, capsys: pytest.CaptureFixture[str]):
        self._capsys = capsys

    def run(self, *words: str, may_have_lines: bool = False) -> str:
        self._capsys.readouterr()
        with contextlib.suppress(SystemExit):
            main(words)
        printed = self._capsys.readouterr()
        check_plain(printed.out, words, may_have_lines=may_have_lines)
        check_plain(printed.err, words, may_have_lines=may_have_lines)
        return printed.out


@pytest.fixture
def reader(capsys: pytest.CaptureFixture[str]) -> Reader:
    return Reader(capsys)


def test_attacks_cover_every_command() -> None:
    assert set(COMMANDS) == NAMES_IT | UNTRIED


def test_logs_with_hostile_texts_print_plainly(reader: Reader, tmp_path: Path) -> None:
    log = write_hostile_log(tmp_path / "log.mcap")
    other = write_hostile_log(tmp_path / "other.mcap", pose="else" + HOSTILE)
    shown = reader.run("info", str(log))
    assert "\\x1b]0;owned\\x07" in shown and "\\x0aFORGED" in shown
    reader.run("plot", "PoseStamped.pose.position.x", "--recording", str(log))
    (told,) = json.loads(reader.run("info", str(log), "--json"))
    assert HOSTILE in [channel["topic"] for channel in told["channels"]]  # JSON keeps what it says
    assert "[bold]" in reader.run("diff", str(log), str(other))
    reader.run("diff", str(log), str(other), "--topics", HOSTILE, "nothing" + HOSTILE)
    reader.run("export", str(log), str(tmp_path / "tables"))
    for file in (tmp_path / "tables").iterdir():
        assert not obeyed(file.name) and not obeyed(file.read_text())
    reader.run("export", str(log), str(tmp_path / f"no{HOSTILE}"), "--topics", f"none{HOSTILE}")
    reader.run("export", str(log), str(tmp_path / "bag"), "--rosbag2")
    clip = ClipFolder(tmp_path / "results", 1 << 30)
    clip.finish("20261128T000000Z-x", AboutClip(HOSTILE, HOSTILE, [HOSTILE], [0.0], 0, HOSTILE))
    assert "\\x1b]0;owned" in reader.run("clips", "--in", str(tmp_path / "results"))
    (tmp_path / "results" / "summary.json").write_text("{}")
    reader.run(
        "report", str(tmp_path / "results"), "--output", str(tmp_path / f"report{HOSTILE}".replace("/", ""))
    )
    cut = tmp_path / f"cut{HOSTILE.replace('/', '')}.mcap"
    cut.write_bytes(log.read_bytes()[:-40])
    reader.run("info", str(cut), may_have_lines=True)  # the user's own word may have two lines
    reader.run("recording", "repair", str(cut), may_have_lines=True)


@pytest.mark.sampled(12)
@pytest.mark.parametrize("command", sorted(set(COMMANDS) - {"run", "completion", "new"}))
def test_errors_that_quote_hostile_texts_are_plain(
    command: str, reader: Reader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "profiles").mkdir()
    word = HOSTILE + "\udcff"
    reader.run(command, word, word, "--run", word, may_have_lines=True)
    reader.run(command, word, may_have_lines=True)
    reader.run(command, f"--{word}", may_have_lines=True)


def test_hostile_files_are_refused_plainly(
    reader: Reader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    carmen = tmp_path / "log.clf"
    carmen.write_text(f"ODOM {HOSTILE.splitlines()[0]} 1 2\n", encoding="latin-1", errors="replace")
    reader.run("import-carmen", str(carmen), str(tmp_path / "new.mcap"))
    (tmp_path / "bag.bag").write_text(HOSTILE)
    reader.run("import-rosbag", str(tmp_path / "bag.bag"), str(tmp_path / "new.mcap"))
    (tmp_path / "profiles").mkdir()
    for number, text in enumerate(
        (
            '"\\x1b]0;owned\\x07\\u202e": 1\n',
            'modules: {"\\x1b[2J\\u202e": {class: "\\x1b]0;owned\\x07:\\u202e"}}\n',
            'parents: ["\\x1b]0;owned\\x07"]\n',
        )
    ):
        (tmp_path / "profiles" / f"bad{number}.yaml").write_text(text)
        reader.run("run", f"bad{number}")
        reader.run("profile", "show", f"bad{number}")
        reader.run("doctor", f"bad{number}")
    reader.run("run", "bad0\x1b]0;owned\x07")
    reader.run("new", str(tmp_path / "team\x1b]0;owned\x07\u202e"))
    reader.run("completion", "no\x1b[2J")


def test_devices_with_hostile_serial_numbers_print_plainly(
    reader: Reader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ports = {f"/dev/tty{HOSTILE}": UsbDevice("15d1", "0000", HOSTILE, HOSTILE)}
    monkeypatch.setattr("robbie_mp.cli.devices.serial_devices", lambda: ports)
    monkeypatch.setattr("robbie_mp.cli.install.serial_devices", lambda: ports)
    assert "owned" in reader.run("devices", may_have_lines=True)
    reader.run("devices", "--json")
    make_workspace(tmp_path / "mouse")
    monkeypatch.chdir(tmp_path / "mouse")
    device = f"laser=/dev/tty{HOSTILE}"
    words = ["install", "robot", "--user", "root", "--var", HOSTILE, "--device", device]
    reader.run(*words, "--print", may_have_lines=True)
    reader.run("install", "robot", "--user", HOSTILE, may_have_lines=True)


@pytest.fixture
def hostile_run(robot: Robot) -> Iterator[Robot]:
    (robot.folder / "zoo" / "hostile.py").write_text(MODULES.read_text())
    robot.write_profile(PROFILE)
    robot.start()
    robot.until(
        lambda modules: modules["listener"]["handled"] > 2 and modules["crasher"]["state"] == "FAILED"
    )
    yield robot


def test_runs_with_hostile_modules_print_plainly(
    hostile_run: Robot, reader: Reader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(hostile_run.folder)
    run = reader.run
    for what in ("runs", "modules", "types", "topics", "services"):
        shown = run("list", what)
        assert what in ("runs", "types", "services") or "\\x1b]0;owned\\x07" in shown
        run("list", what, "--json")
    for form in ((), ("--json",), ("--csv",), ("--field", "header"), ("--field", "header.frame_id", "--csv")):
        assert "owned" in run("echo", "PoseStamped", "--once", *form)
    run("echo", "PoseStamped", "--once", "--topic", HOSTILE)
    message = json.loads(run("echo", "PoseStamped", "--once", "--json"))
    assert message["message"]["header"]["frame_id"] == HOSTILE
    assert "\\x1b]0;owned" in run("hz", "PoseStamped", "--once", "--interval", "0.2")
    assert "\\x1b]0;owned" in run("bw", "PoseStamped", "--once", "--interval", "0.2")
    run("hz", "PoseStamped", "--once", "--interval", "0.2", "--json")
    for option in ("--once", "--json"):
        assert "owned" in run("top", option, "--interval", "0.1")
    run("top", "--csv", "-", "--once", "--interval", "0.1")
    run("top", "--csv", str(tmp_path / "top.csv"), "--once", "--interval", "0.1")
    assert not obeyed((tmp_path / "top.csv").read_text().replace("\r\n", "\n"))
    for log_form in (
        (),
        ("--json",),
        ("--crashes",),
        ("--crashes", "--json"),
        ("--module", "hostile", "--last", "3"),
    ):
        assert "owned" in run("log", *log_form)
    assert "owned" in run("param", "list")
    run("param", "list", "--json")
    assert "\\e" in run("param", "get", "hostile.greeting")
    run("param", "set", "hostile.greeting", '"\\x1b]0;again\\x07\\u202e"')
    run("param", "set", f"hostile.{HOSTILE}", HOSTILE, may_have_lines=True)
    assert "\\e" in run("profile", "show", "robot")
    run("profile", "show", "robot", "--json")
    assert "no black box" in run("mark", HOSTILE)
    run("type", "list")
    run("type", "show", "zoo_msgs/Odd")
    run("pub", "PoseStamped", "{header: {frame_id: 1\x1b}}", "--once")
    run("pub", "PoseStamped", '{header: {frame_id: "\\u202e"}}', "--topic", HOSTILE, "--once")
    run("call", "Tell", "--topic", HOSTILE)  # no name of a topic
    assert "owned" in run("call", "Tell", "--topic", "tell")
    run("call", "Tell", "--topic", "tell", "--json")
    run("call", "Tell", "{text: refuse it}", "--topic", "tell")
    run("plot", "PoseStamped.pose.position.x", "--once", "--window", "1s")
    for picture in ("--mermaid", "--dot", "--svg", "--json"):
        assert "owned" in run("graph", picture)
    run("module", "restart", HOSTILE, may_have_lines=True)
    run("module", "restart", "listener")
    run("playback", "pause")
    run("record", "PoseStamped", HOSTILE, "-o", str(tmp_path / "recorded"), "--duration", "0.3")
    run("info", str(tmp_path / "recorded"))
    run("clean")
    run("stop")
    for file in hostile_run.output.rglob("*"):
        if file.suffix in (".jsonl", ".json", ".yaml", ".html"):
            assert not obeyed(file.read_text()), f"{file} holds what terminals obey"


@pytest.mark.sampled(1)
@pytest.mark.parametrize("words", [(), ("--quiet",)])
def test_run_with_hostile_modules_shows_them_plainly(robot: Robot, words: tuple[str, ...]) -> None:
    (robot.folder / "zoo" / "hostile.py").write_text(MODULES.read_text())
    robot.write_profile(PROFILE)
    command = ["run", "robot", "--output", str(robot.output), *words]
    process = subprocess.Popen(
        [*COMMAND, *command], cwd=robot.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    try:
        robot.until(lambda modules: modules["crasher"]["state"] == "FAILED")
    finally:
        process.terminate()
        out, err = process.communicate(timeout=60)
    assert b"owned" in err
    check_plain(out.decode(), command)
    check_plain(err.decode(), command)


def on_terminal(words: list[str], folder: Path, until: Callable[[bytearray], object] | None = None) -> str:
    """Run a command on a terminal of its own, to its end or until something; return all that came."""
    pid, fd = pty.fork()
    if not pid:
        os.chdir(folder)
        os.environ |= {"TERM": "xterm-256color", "COLUMNS": "200", "LINES": "50"}
        os.environ.pop("NO_COLOR", None)
        os.execv(COMMAND[0], [*COMMAND, *words])
    printed = bytearray()

    def read() -> None:
        with contextlib.suppress(OSError):
            while data := os.read(fd, 65536):
                printed.extend(data)

    thread = threading.Thread(target=read)
    thread.start()
    try:
        if until is not None:
            until(printed)
    finally:
        if until is not None:
            os.kill(pid, signal.SIGTERM)
        os.waitpid(pid, 0)
        thread.join(10)
        os.close(fd)
    return printed.decode()


def test_only_our_own_escape_sequences_reach_a_terminal(robot: Robot, tmp_path: Path) -> None:
    (robot.folder / "zoo" / "hostile.py").write_text(MODULES.read_text())
    robot.write_profile(PROFILE)
    log = write_hostile_log(tmp_path / "log.mcap")

    commands = (["list", "topics"], ["list", "modules"], ["log"], ["top", "--once"], ["info", str(log)])

    def shows_it(_printed: bytearray) -> None:
        robot.until(lambda modules: modules["crasher"]["state"] == "FAILED")
        for words in commands:
            seen = on_terminal(words, robot.folder)
            check_terminal(seen, words)
            assert "owned" in seen
        seen = on_terminal(["top"], robot.folder, lambda drawn: wait_until(lambda: b"owned" in drawn, 30))
        check_terminal(seen, "top")

    run = ["run", "robot", "--output", str(robot.output)]
    shown = on_terminal(run, robot.folder, shows_it)
    check_terminal(shown, run)
    assert "owned" in shown and "\x1b[" in shown


def test_only_one_file_of_the_command_line_writes_output() -> None:
    folder = Path(sys.modules["robbie_mp.cli"].__file__ or "").parent
    others = [file for file in folder.rglob("*.py") if file.name != "output.py"]
    for word in ("Console(", "stdout.write", "stderr.write", ".buffer", "__stdout__", "__stderr__"):
        assert [file.name for file in others if word in without_known(file.read_text())] == []


def without_known(code: str) -> str:
    """Leave out our stream, and the terminal's own one for a line that is edited behind a plain prompt."""
    return code.replace("PlainConsole(", "").replace("redirect_stdout(sys.__stdout__)", "")
