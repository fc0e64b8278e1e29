"""Results of earlier runs are kept as long as the profile and the user say, and no longer."""

import os
import time
from pathlib import Path

import pytest

from robbie_mp.cli import main
from robbie_mp.run import results
from robbie_mp.run.results import remove_oldest, results_below
from tests._support.robot import Robot

DAY_S = 86400.0


def add_results(folder: Path, days: float, file: str = "summary.json") -> Path:
    """Make results that were changed last this number of days ago."""
    made = folder / f"20260101T000000Z-{int(days * 10)}"
    (made / "log").mkdir(parents=True)
    (made / "log" / file).write_text("12345")
    for path in (made / "log" / file, made):
        os.utime(path, (time.time() - days * DAY_S,) * 2)
    return made


def test_newest_results_stay(tmp_path: Path) -> None:
    old, new, newest = (add_results(tmp_path, days) for days in (3, 2, 1))
    assert [one.folder for one in remove_oldest(tmp_path, 2)] == [old]
    assert not old.exists() and new.exists() and newest.exists()
    assert remove_oldest(tmp_path, 0) == [], "0: all stay"


def test_recordings_and_renamed_results_are_never_removed_by_a_run(tmp_path: Path) -> None:
    recorded = add_results(tmp_path, 9, "log_0.mcap")
    renamed = add_results(tmp_path, 8).rename(tmp_path / "the-crash")
    newest = add_results(tmp_path, 1)
    assert remove_oldest(tmp_path, 1) == []
    assert recorded.exists() and renamed.exists() and newest.exists()


def test_link_is_not_followed(tmp_path: Path) -> None:
    elsewhere = add_results(tmp_path / "elsewhere", 9)
    (tmp_path / "output").mkdir()
    (tmp_path / "output" / elsewhere.name).symlink_to(elsewhere)
    assert results_below(tmp_path / "output") == []


@pytest.mark.slow
def test_run_removes_the_oldest_results_of_its_profile_only(robot: Robot) -> None:
    folder = robot.folder / "output"
    old, new = add_results(folder / "robot", 2), add_results(folder / "robot", 1)
    other = add_results(folder / "other", 3)
    robot.write_profile(
        "trace: {kept_runs: 1}\n"
        "modules: {counter: {class: 'zoo.modules:Counter', settings: {count: 3}, ends_run: true}}"
    )
    ended = robot.command("run", "robot")
    assert ended.returncode == 0, ended.stderr
    assert "removed the 1 oldest results in output/robot; trace.kept_runs keeps 1" in ended.stderr
    assert not old.exists() and new.exists() and other.exists()
    assert len(results_below(folder)) == 3, "with those of the run"


@pytest.fixture
def output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path / "output" / "demo"


def test_clean_removes_results_older_than_an_age(output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, recorded = add_results(output, 40), add_results(output, 31, "log_0.mcap")
    new = add_results(output, 29)
    assert main(["clean", "--older-than", "30d", "--dry-run"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"output/demo/{old.name}  5",
        f"output/demo/{recorded.name}  5  with a recording",
        "would remove 2 results, 10",
    ]
    assert old.exists()
    assert main(["clean", "--older-than", "30d"]) == 0
    assert "removed 2 results, 10" in capsys.readouterr().out
    assert not old.exists() and not recorded.exists() and new.exists()


def test_age_is_that_of_the_newest_file(output: Path) -> None:
    old = add_results(output, 40)
    (old / "late").write_text("")
    os.utime(old, (time.time() - 40 * DAY_S,) * 2)
    assert main(["clean", "--older-than", "30d"]) == 0
    assert old.exists()


@pytest.mark.parametrize(("age", "said"), [("30", "expected 60 s"), ("soon", "time"), ("d", "time")])
def test_wrong_age_is_bad_usage(age: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["clean", f"--older-than={age}"])
    assert ended.value.code == 2
    assert said in capsys.readouterr().err


def test_folder_without_an_age_is_bad_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["clean", "output/demo"])
    assert ended.value.code == 2
    assert "name the age of results to remove" in capsys.readouterr().err


def test_folder_that_another_run_removes_meanwhile_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = tmp_path / "20260101T000000Z-1"
    monkeypatch.setattr(results, "_result_folders", lambda _folder: iter([gone]))
    assert [one.folder for one in results.remove_oldest(tmp_path, 0)] == []
    assert [one.bytes for one in results.results_below(tmp_path)] == [0]
