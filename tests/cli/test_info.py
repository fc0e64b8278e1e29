"""`robbie info` and `robbie recording repair`, compared with other readers."""

import fcntl
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from robbie_mp.cli import main
from robbie_mp.logs.recording import repair as repair_module
from robbie_mp.logs.recording.errors import RepairFailed
from tests.logs.recording._support.logs import write_log


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write_log(tmp_path / "run_0000.mcap", 31)


def told(capsys: pytest.CaptureFixture[str], *paths: Path) -> list[dict[str, Any]]:
    assert main(["info", *map(str, paths), "--json"]) == 0
    return list(json.loads(capsys.readouterr().out))


def test_info_agrees_with_the_summary_that_mcap_reads(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.statistics is not None
    theirs = summary.statistics
    (ours,) = told(capsys, log)
    assert ours["messages"] == theirs.message_count == 31
    assert (ours["start_ns"], ours["end_ns"]) == (theirs.message_start_time, theirs.message_end_time)
    assert ours["duration_s"] == pytest.approx(3.0)
    assert ours["bytes"] == log.stat().st_size
    assert ours["parts"][0]["chunks"] == theirs.chunk_count
    for channel in summary.channels.values():
        (one,) = [one for one in ours["channels"] if one["topic"] == channel.metadata["robbie_topic"]]
        assert one["messages"] == theirs.channel_message_counts[channel.id]
        assert one["type"] == summary.schemas[channel.schema_id].name
        assert one["hz"] == pytest.approx(one["messages"] / 3.0)
        assert one["sender"] == channel.metadata["robbie_sender"]
    assert {one["topic"]: one["dropped"] for one in ours["channels"]} == {
        "laser/front": 2, "odom": None, "": None}  # fmt: skip
    assert ours["run"]["run_id"] == "0123abcd" and ours["run"]["profile"] == "demo"
    assert ours["is_complete"] and ours["library"] == "robbie-mp test"


def test_printed_info_has_the_same_figures(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(log)]) == 0
    shown = capsys.readouterr().out
    for text in ("31", "3.000 s", "0123abcd, profile demo, on h", "complete", "compression none"):
        assert text in shown
    (line,) = [line for line in shown.splitlines() if line.startswith("laser/front")]
    assert line.split() == ["laser/front", "sensor_msgs/msg/LaserScan", "1", "laser", "11", "3.7", "2"]


def test_parts_are_described_together_and_separately(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(log, log.with_name("run_0001.mcap"))
    (ours,) = told(capsys, log.parent)
    assert ours["messages"] == 62 and [part["messages"] for part in ours["parts"]] == [31, 31]
    assert {one["topic"]: one["dropped"] for one in ours["channels"]}["laser/front"] == 4
    assert main(["info", str(log.parent)]) == 0
    assert "run_0001.mcap" in capsys.readouterr().out


def test_info_on_a_cut_log_advises_the_repair_which_works(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(log, log.with_name("run_0001.mcap"))
    log.write_bytes(log.read_bytes()[:-6000])
    cut = log.read_bytes()
    assert main(["info", str(log.parent)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "run_0000.mcap: byte" in shown and f"`robbie recording repair {log.parent}` repairs it" in shown
    (before,) = told(capsys, log.parent)
    assert not before["is_complete"] and 31 < before["messages"] < 62
    assert main(["recording", "repair", str(log.parent)]) == 0
    said = capsys.readouterr()
    assert f"{before['messages'] - 31} messages, read again and found whole" in said.out
    assert f"{log}: byte" in said.err
    (after,) = told(capsys, log.parent)
    assert after["is_complete"] and after["messages"] == before["messages"]
    assert [part["is_repaired"] for part in after["parts"]] == [True, False]
    assert log.read_bytes() == cut
    assert main(["recording", "repair", str(log.parent)]) == 0
    assert "all parts" in capsys.readouterr().out


def test_log_being_written_is_distinguished_from_a_cut_one(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log.write_bytes(log.read_bytes()[:-6000])
    with log.open("ab") as writer:
        fcntl.flock(writer, fcntl.LOCK_EX)
        (ours,) = told(capsys, log)
        assert ours["is_being_written"] and not ours["is_complete"] and ours["messages"] > 10
        assert main(["info", str(log)]) == 0
        assert "still being written" in capsys.readouterr().out
        assert main(["recording", "repair", str(log)]) == 2
        assert "is still being written; repair it when" in capsys.readouterr().err
    assert main(["recording", "repair", str(log)]) == 0


def test_repair_that_fails_its_check_is_a_failure(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> None:
        raise RepairFailed("it does not hold what was written")

    monkeypatch.setattr(repair_module, "_write_and_check", fail)
    assert main(["recording", "repair", str(log)]) == 1
    assert "does not hold" in capsys.readouterr().err
    assert not repair_module.repaired_name(log).exists()


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["info", "empty.mcap"], "empty.mcap is empty"),
        (["info", "text.mcap"], "text.mcap is no MCAP file"),
        (["info", "none.mcap"], "none.mcap cannot be read: No such file or directory"),
        (["info", "folder"], "has no parts of a log"),
        (["recording", "repair", "text.mcap"], "text.mcap is no MCAP file"),
        (
            ["recording", "repair", "run_0000.mcap", "-o", "none/b.mcap"],
            "cannot be written: No such file or directory",
        ),
        (["recording", "repair", "run_0000.mcap", "-o", "run_0000.mcap"], "cannot be written: File exists"),
        (["recording", "repair", "folder", "-o", "b.mcap"], "folder is a folder"),
    ],
)
def test_bad_input_is_a_one_line_error(
    log: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    what: str,
) -> None:
    monkeypatch.chdir(log.parent)
    Path("empty.mcap").touch()
    Path("text.mcap").write_text("hello")
    Path("folder").mkdir()
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert what in error and error.count("\n") == 1
