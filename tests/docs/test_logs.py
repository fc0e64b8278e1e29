"""The examples in docs/logs.md work as described."""

import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from rosbags.highlevel import AnyReader

from robbie_mp.cli import main
from robbie_mp.logs.black_box.module import BlackBox
from robbie_mp.logs.message_logger import MessageLogger
from robbie_mp.module.settings import check_settings, settings_of
from tests.docs._support.pages import ROOT, block
from tests.logs.recording._support.logs import write_log
from tests.logs.recording.test_imports import CARMEN, write_bag

PAGE = "docs/logs.md"


@pytest.fixture(autouse=True)
def monday(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording of two parts, of which the first was cut."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "monday"
    folder.mkdir()
    write_log(folder / "monday_0001.mcap", 60)
    part = write_log(folder / "monday_0000.mcap", 60)
    part.write_bytes(part.read_bytes()[:-8000])
    return folder


def run(mark: str) -> list[int]:
    lines = [shlex.split(line, comments=True) for line in block(PAGE, mark).splitlines()]
    assert all(words[0] == "robbie" for words in lines)
    return [main(words[1:]) for words in lines]


def python(mark: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(block(PAGE, mark), names)
    return names


def test_inspect_commands() -> None:
    assert run("look") == [0, 0]


def test_repair(monday: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(monday / "monday_0000.mcap", "cut.mcap")
    assert run("repair") == [0, 0]
    capsys.readouterr()
    assert main(["info", str(monday), "whole.mcap"]) == 0
    assert capsys.readouterr().out.count("complete") > 2
    assert (monday / "monday_0000.repaired.mcap").exists()


def test_cut_filter_and_merge() -> None:
    assert run("edit") == [0, 0, 0]


def test_compare(monday: Path, capsys: pytest.CaptureFixture[str]) -> None:
    monday.rename("first")
    shutil.copytree("first", "second")
    assert run("compare") == [0, 0, 0]
    assert "no topic matches 'map*'" in capsys.readouterr().err


def test_export_and_use_of_its_arrays(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("export") == [1, 1]  # the first part was cut
    assert {path.suffix for path in Path("tables").iterdir()} == {".csv", ".arrays"}
    ranges = python("part the scans")["ranges"]
    assert len(ranges) > 20 and {part.shape for part in ranges} == {(8,)}


def test_export_of_bags() -> None:
    assert run("bag") == [1, 1]  # the first part was cut
    with AnyReader([Path("monday_bag")]) as bag:
        assert {one.topic for one in bag.connections} == {"/laser/front", "/odom", "/laser_scan"}


def test_import(tmp_path: Path) -> None:
    Path("intel.clf").write_text(CARMEN.replace("FLASER broken\n", ""))
    write_bag(tmp_path, "ROS 1").rename("drive.bag")
    assert run("import") == [0, 0]


def test_read(capsys: pytest.CaptureFixture[str]) -> None:
    python("read")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[1:] == ["laser", "12.0"]
    assert "monday_0000.mcap: byte" in lines[-1]


def test_settings_of_the_logger_in_the_profile_are_valid() -> None:
    (logger,) = yaml.safe_load(block(PAGE, "profile"))["modules"].values()
    MessageLogger.check(check_settings(MessageLogger, logger["settings"]))
    assert logger["class"] == f"{MessageLogger.__module__}:{MessageLogger.__name__}"


def test_every_setting_of_the_logger_and_the_black_box_is_on_the_page() -> None:
    _, *tables = (ROOT / PAGE).read_text().split("| setting |")
    for module, table in zip((MessageLogger, BlackBox), tables, strict=True):
        rows = table.partition("\n\n")[0].splitlines()[2:]
        named = {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}
        assert named == set(settings_of(module))


def test_settings_of_the_black_box_in_the_profile_are_valid() -> None:
    settings = yaml.safe_load(block(PAGE, "profile of the black box"))["black_box"]
    BlackBox.check(check_settings(BlackBox, settings))
