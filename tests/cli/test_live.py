"""Commands that read a run or send messages to it, all on one robot."""

import fcntl
import json
import os
import pty
import re
import shutil
import signal
import struct
import subprocess
import termios
import time
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robbie_mp.cli import completers, main
from robbie_mp.cli.runs import live_runs
from robbie_mp.module.setting_changes import SettingsFile
from robbie_mp.run.profile.load import load_profile
from tests._support.robot import COMMAND, Robot, kill, wait_until

PROFILE = """
modules:
  listener: {class: "zoo.modules:Listener", queue: {messages: 100000}}
  pulse: {class: "zoo.modules:Pulse", settings: {period_s: 0.05, burst: 1}}
  tunable: {class: "zoo.modules:Tunable", settings: {gain: 2}}
  adder: {class: "zoo.modules:Adder"}
"""


class Person:
    """Types commands and reads their output."""

    def __init__(self, robot: Robot, run_id: str, capsys: pytest.CaptureFixture[str]):
        self.robot = robot
        self.run_id = run_id
        self._capsys = capsys
        self.errors = ""

    def types(self, *words: str, code: int = 0) -> str:
        self._capsys.readouterr()
        assert main([*words, "--run", self.run_id]) == code
        output, self.errors = self._capsys.readouterr()
        return output

    def fails(self, *words: str) -> str:
        self._capsys.readouterr()
        assert main([*words, "--run", self.run_id]) != 0
        return self._capsys.readouterr().err

    def gets(self, *words: str) -> Any:
        return json.loads(self.types(*words, "--json"))


@pytest.fixture
def person(robot: Robot, capsys: pytest.CaptureFixture[str]) -> Iterator[Person]:
    robot.write_profile(PROFILE)
    robot.start()
    robot.until(lambda modules: modules["listener"]["handled"] > 2)
    (run,) = live_runs()
    yield Person(robot, run.run_id, capsys)


@pytest.mark.slow
def test_all_commands_on_a_live_run_work(person: Person, tmp_path: Path) -> None:
    lists_what_there_is(person)
    draws_what_there_is(person)
    echoes(person)
    measures_rates(person)
    publishes(person)
    changes_settings(person)
    calls(person)
    dumps_and_loads_settings(person, tmp_path)
    remembers_who_published(person)


@pytest.mark.slow
def test_summaries_and_pictures_of_a_live_run_are_right(
    person: Person, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sums_up_rates(person)
    plots(person)
    draws_svg(person, tmp_path, monkeypatch)


def draws_what_there_is(person: Person) -> None:
    graph = person.gets("graph", "--interval", "0.2")
    wheels = next(one for one in graph["topics"] if one["topic"] == "wheels")
    assert (wheels["publishers"], wheels["subscribers"]) == (["pulse"], ["listener"])
    assert 1 < wheels["hz"] < 100
    assert {"listener", "pulse", "tunable"} <= set(graph["modules"])
    picture = person.types("graph", "--interval", "0").splitlines()
    assert picture[0] == "flowchart LR"
    assert any("wheels<br/>robbie_msgs/msg/DriveCommand" in line for line in picture)
    assert person.types("graph", "--dot", "--interval", "0").startswith("digraph run {")
    with pytest.raises(SystemExit):
        main(["graph", "--interval", "-1"])


def lists_what_there_is(person: Person) -> None:
    topics = {topic["type"]: topic for topic in person.gets("list", "topics")}
    drive = topics["robbie_msgs/msg/DriveCommand"]
    assert (drive["topic"], drive["publishers"], drive["subscribers"]) == ("wheels", ["pulse"], ["listener"])
    assert drive["messages"] > 2
    assert topics["robbie_msgs/msg/ModuleState"]["publishers"] == ["supervisor"]
    assert {row["type"] for row in person.gets("list", "types")} == set(topics)
    assert [row["module"] for row in person.gets("list", "modules")] == [
        "listener",
        "pulse",
        "tunable",
        "adder",
        "core",
    ]
    assert "wheels" in person.types("list", "topics")
    offered = completers.types_and_topics("w", parsed_args=Namespace(run=None))
    assert {"DriveCommand", "robbie_msgs/DriveCommand", "wheels"} <= set(offered)
    assert completers.types_and_topics("", parsed_args=Namespace(run=None)) == ["wheels"]
    assert "DriveCommand" in completers.types(parsed_args=Namespace(run=None))
    assert person.types("type", "show", "DriveCommand").startswith("# robbie_msgs/msg/DriveCommand, version")


def echoes(person: Person) -> None:
    message = person.gets("echo", "DriveCommand", "--once")
    assert (message["sender"], message["topic"]) == ("pulse", "wheels")
    assert message["message"]["header"]["stamp"]["sec"] > 2
    assert person.errors == ""
    number = person.types("echo", "DriveCommand", "--once", "--field", "header.stamp.sec").splitlines()[1]
    assert int(number) > message["message"]["header"]["stamp"]["sec"]
    header, row = person.types(
        "echo", "DriveCommand", "--once", "--csv", "--field", "header.stamp"
    ).splitlines()
    assert header == "time_ns,sequence,topic,sender,header.stamp.sec,header.stamp.nanosec"
    assert abs(int(row.split(",")[0]) - time.time_ns()) < 60e9, "not the clock of logs"
    assert int(row.split(",")[4]) > int(number)
    person.types("echo", "DriveComand", code=1)
    assert person.errors.startswith(
        "no message type and no topic is called 'DriveComand'; did you mean 'DriveCommand'"
    )
    assert person.gets("echo", "wheels", "--once")["topic"] == "wheels"
    person.types("echo", "DriveCommand", "--field", "speed", code=1)
    assert person.errors.startswith("robbie_msgs/msg/DriveCommand has no field 'speed'")


def measures_rates(person: Person) -> None:
    rates = person.gets("hz", "DriveCommand", "--once", "--interval", "0.5")
    assert rates["topic"] == "wheels"
    assert rates["hz"] == pytest.approx(rates["messages"] / rates["seconds"])
    assert rates["interval_mean_s"] == pytest.approx(0.05, rel=0.5)
    assert 0 <= rates["interval_deviation_s"] < 0.1
    size = person.gets("bw", "DriveCommand", "--once", "--interval", "0.2")
    count = next(row for row in person.gets("list", "topics") if row["topic"] == "wheels")
    assert size["mean_bytes"] == count["bytes"] / count["messages"]
    assert "Hz, every" in person.types("hz", "DriveCommand", "--once", "--interval", "0.2")
    assert person.gets("hz", "/wheels", "--once", "--interval", "0.2")["topic"] == "wheels"
    nobody = person.types("bw", "Image", "--once", "--interval", "0.01")
    assert nobody == "no module publishes sensor_msgs/msg/Image\n"
    nowhere = person.types("hz", "DriveCommand", "--topic", "nosuch", "--once", "--interval", "0.01")
    assert nowhere == (
        "no module publishes robbie_msgs/msg/DriveCommand on topic 'nosuch'; there are 'wheels'\n"
    )


def sums_up_rates(person: Person) -> None:
    """As a user sees it: Ctrl-C after a while."""
    for command, said in (
        ("hz", r"mean [\d.]+ Hz, min .*, deviation .* ms \("),
        ("bw", r"mean [\d.]+ k?B/s, min .*/s"),
    ):
        words = [command, "DriveCommand", "--interval", "100ms", "--run", person.run_id]
        with subprocess.Popen([*COMMAND, *words], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout
            lines = [process.stdout.readline() for _ in range(3)]
            process.send_signal(signal.SIGINT)
            summary = process.stdout.read()
            assert process.wait() == 130
        assert all(
            re.match(r"[\d.]+ (Hz, every [\d.]+ ± [\d.]+ ms|k?B/s, \d+ B a message) \(", line)
            for line in lines
        )
        assert re.search(said, summary) and "topic wheels" in summary, summary
    words = ["hz", "wheels", "--interval", "100ms", "--json", "--run", person.run_id]
    with subprocess.Popen([*COMMAND, *words], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        single = [json.loads(process.stdout.readline()) for _ in range(3)]
        process.send_signal(signal.SIGINT)
        *more, total = map(json.loads, process.stdout.read().splitlines())
    lines_hz = [line["hz"] for line in (*single, *more)]
    assert total["summary"] is True
    assert total["messages"] == sum(line["messages"] for line in (*single, *more))
    assert (total["hz"]["least"], total["hz"]["greatest"]) == (min(lines_hz), max(lines_hz))


def plots(person: Person) -> None:
    for words, window_s in ([], 1), (["--window", "2s"], 2):
        drawn = person.types("plot", "wheels.header.stamp.sec", "--once", *words)
        assert person.errors == f"({window_s} s; --window TIME for another time)\n"
        times_s = [float(one) for one in drawn.splitlines()[-3].split()]
        assert times_s[-1] >= window_s and times_s[-1] - times_s[0] == pytest.approx(window_s, abs=0.02)
    assert "wheels.header.stamp.sec  " in drawn and "┤" in drawn
    # On a terminal, until Ctrl-C.
    controller, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    command = [*COMMAND, "plot", "wheels.header.stamp.sec", "--run", person.run_id]
    with subprocess.Popen(command, stdin=terminal, stdout=terminal, stderr=terminal) as process:
        os.close(terminal)
        try:
            seen = b""
            while "⠤".encode()[:2] not in seen or b"wheels.header.stamp.sec" not in seen:
                seen += os.read(controller, 1 << 16)
            process.send_signal(signal.SIGINT)
            while b"\x1b[?1049l" not in seen:  # the terminal has its own screen again
                seen += os.read(controller, 1 << 16)
            assert process.wait(60) == 130
        finally:
            process.kill()
            os.close(controller)
    assert b"Traceback" not in seen


def draws_svg(person: Person, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(folder))
    own = person.types("graph", "--svg", "--interval", "0")
    assert own.startswith("<svg ") and ">wheels</text>" in own
    program = folder / "dot"
    program.write_text(
        f"#!/bin/sh\necho '<svg>by Graphviz</svg>'; {shutil.which('cat', path='/bin:/usr/bin')}\n"
    )
    program.chmod(0o755)
    drawn = person.types("graph", "--svg", "--interval", "0")
    assert drawn.startswith("<svg>by Graphviz</svg>\ndigraph run {")
    program.write_text("#!/bin/sh\nexit 3\n")
    assert person.types("graph", "--svg", "--interval", "0") == own
    assert "failed, so the picture is arranged without it" in person.errors


def publishes(person: Person) -> None:
    text = "{header: {stamp: {sec: 1000001}}, valid_for: {sec: 1}}"
    assert person.types("pub", "DriveCommand", text) == "published 1\n"
    wait_until(lambda: 1000001 in person.robot.journal("listener"))
    on_wheels = text.replace("1000001", "1000003")
    assert person.types("pub", "wheels", on_wheels) == "published 1\n"
    wait_until(lambda: 1000003 in person.robot.journal("listener"))
    person.types("pub", "wheel", on_wheels, code=1)
    assert "did you mean 'wheels'" in person.errors
    again = text.replace("1000001", "1000002")
    assert person.types("pub", "DriveCommand", again, "--rate", "500", "--count", "20") == "published 20\n"
    wait_until(lambda: person.robot.journal("listener").count(1000002) == 20)
    assert not person.errors
    assert person.types("pub", "String", "{data: hi}", "--topic", "nowhere") == "published 1\n"
    assert "warning: nobody subscribes to std_msgs/msg/String" in person.errors
    folder = person.robot.folder / "nothing"
    person.types("record", "DriveComand", "--duration", "10ms", "-o", str(folder), code=1)
    assert "no topic is called 'DriveComand'; did you mean 'DriveCommand'" in person.errors
    person.types("pub", "DriveCommand", "{valid_for: {sec: 3600}}", code=1)
    assert "valid_for is 3600.0; expected 0 to 1 s" in person.errors
    person.types("pub", "DriveCommand", "{linear_m_per_s: fast}", code=1)
    assert person.errors.startswith(
        "robbie_msgs/msg/DriveCommand.linear_m_per_s: expected float64, got 'fast'"
    )


def changes_settings(person: Person) -> None:
    every = {f"{one['module']}.{one['setting']}": one for one in person.gets("param", "list")}
    assert (every["pulse.burst"]["value"], every["pulse.burst"]["changeable"]) == (1, False)
    assert person.types("param", "get", "pulse.burst") == "1\n"
    (entry,) = person.gets("param", "list", "--changeable")
    assert (entry["module"], entry["setting"], entry["value"]) == ("tunable", "gain", 2)
    assert entry["type"] == "int, at least 0 and at most 100"
    assert person.types("param", "set", "tunable.gain", "5") == "tunable.gain is 5, was 2\n"
    assert person.types("param", "get", "tunable.gain") == "5\n"
    assert person.robot.journal("tunable") == [2, 5]
    for value, said in (
        (
            "many",
            "tunable refuses: Tunable.gain: expected int, at least 0 and at most 100; got 'many' (str)\n",
        ),
        ("13", "tunable refuses: 13 brings bad luck\n"),
    ):
        person.types("param", "set", "tunable.gain", value, code=1)
        assert person.errors == said
    person.types("param", "get", "tunable.gian", code=1)
    assert "did you mean 'gain'" in person.errors
    person.types("param", "set", "pulse.burst", "3", code=1)
    assert person.errors.startswith("pulse has no setting 'burst' that can be changed while it runs")
    assert "or declare it with changeable=True" in person.errors
    file = SettingsFile(person.robot.known_run().folder, "tunable")
    wait_until(lambda: not file.read()["gain"]["change"]["is_on_trial"])
    kill(person.robot.top()["tunable"]["pid"])
    wait_until(lambda: person.robot.journal("tunable") == [2, 5, 5])  # the next incarnation has it still


def calls(person: Person) -> None:
    assert person.gets("list", "services") == [
        {"service": "zoo_msgs/srv/Add", "version": 1, "topic": "sums", "server": "adder", "requests": 0}
    ]
    assert completers.services(parsed_args=Namespace(run=None)) == ["Add"]
    assert person.gets("call", "Add", "{a: 2, b: 3}", "--topic", "sums") == {"total": 5}
    assert person.types("call", "zoo_msgs/Add", "{a: -1}", "--topic", "sums", code=1) == ""
    assert person.errors == "-1 is negative\n"
    person.types("call", "zoo_msgs/srv/Add", code=1)
    assert person.errors == "Add: no module serves it\n"
    person.types("call", "Ad", code=1)
    assert person.errors == "no module of this robot declares a service 'Ad'; did you mean 'Add'?\n"
    person.types("call", "Add", "{c: 1}", "--topic", "sums", code=1)
    assert "has no field 'c'" in person.errors
    assert person.gets("list", "services")[0]["requests"] == 2


def dumps_and_loads_settings(person: Person, tmp_path: Path) -> None:
    file = person.robot.folder / "profiles" / "tuned.yaml"
    assert person.types("param", "dump", str(file)) == f"wrote {file}\n"
    text = file.read_text()
    assert person.types("param", "dump") == text
    assert text.splitlines()[1:3] == ["parents: [robot]", "modules:"]
    tuned = load_profile("tuned", person.robot.folder)
    settings = {module.name: module.settings for module in tuned.modules}
    assert (settings["tunable"]["gain"], settings["pulse"]["burst"]) == (5, 1)

    file.write_text(text.replace("gain: 5", "gain: 7"))
    assert "tunable.gain is 7, was 5\n1 of " in person.types("param", "load", str(file))
    assert person.types("param", "get", "tunable.gain") == "7\n"
    assert "0 of " in person.types("param", "load", str(file))

    file.write_text("modules: {tunable: {settings: {gain: 8, gian: 1}}, pulse: {settings: {burst: 2}}}")
    person.types("param", "load", str(file), code=1)
    assert "nothing was changed" in person.errors
    assert "tunable has no setting 'gian'; did you mean 'gain'" in person.errors
    assert "pulse has no setting 'burst' that can be changed while it runs" in person.errors
    wrong = {"": "expected `modules:`", "modules: {a: {settings: 1}}": "are no map", "{": "YAML"}
    for text, said in wrong.items():
        file.write_text(text)
        assert said in person.fails("param", "load", str(file))
    person.types("param", "load", str(tmp_path / "none.yaml"), code=1)
    person.types("param", "load", "/dev/zero", code=1)
    assert "/dev/zero has more than 1048576 bytes" in person.errors
    person.types("param", "dump", str(tmp_path / "none" / "none.yaml"), code=1)
    assert person.types("param", "get", "tunable.gain") == "7\n", "nothing of this changed anything"


def remembers_who_published(person: Person) -> None:
    person.types("module", "stop", "pulse")
    topics = {topic["topic"]: topic for topic in person.gets("list", "topics")}
    assert topics["wheels"]["publishers"] == []
    assert topics["wheels"]["past_publishers"] == {"pulse": "STOPPED"}, "or a tool that has published"
    assert "pulse (STOPPED)" in person.types("list", "topics")
