"""Settings that are changed while their module runs."""

import subprocess
import sys
from pathlib import Path

import pytest

from robbie_mp import Module, ModuleHarness, SettingError, setting
from robbie_mp.messages import SettingChange, SettingChanged
from robbie_mp.module.harness import NotSubscribed
from robbie_mp.module.setting_changes import TRIAL_S, NotChangeable, SettingChanges, SettingsFile


class Filter(Module):
    """Two changeable settings, of which one must be below the other, and a fixed one."""

    low: float = setting(1.0, "lower bound", minimum=0.0, changeable=True)
    high: float = setting(2.0, "upper bound", changeable=True)
    window: int = setting(5, "samples")

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        if settings["low"] >= settings["high"]:  # type: ignore[operator]
            raise SettingError("low must be below high", "low")

    def setup(self) -> None:
        self.used: list[tuple[str, float]] = []

    def setting_changed(self, name: str) -> None:
        if self.high > 1000:
            raise SettingError(f"{self.high} is more than the device takes", name)
        self.used.append((name, getattr(self, name)))


def test_changed_setting_is_checked_set_and_applied() -> None:
    with ModuleHarness(Filter) as harness:
        harness.change_setting("high", 7)
        assert harness.module.high == 7.0
        assert harness.module.used == [("high", 7.0)]


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("low", "deep", "Filter.low: expected float, at least 0; got 'deep'"),
        ("low", -1.0, "expected float, at least 0"),
        ("low", 2.5, "low must be below high"),
        ("high", 1001.0, "more than the device takes"),
    ],
)
def test_refused_value_changes_nothing(name: str, value: object, said: str) -> None:
    with ModuleHarness(Filter) as harness:
        with pytest.raises(SettingError, match=said):
            harness.change_setting(name, value)
        assert (harness.module.low, harness.module.high, harness.module.used) == (1.0, 2.0, [])


def test_setting_that_is_not_changeable_is_not_changed() -> None:
    with ModuleHarness(Filter) as harness, pytest.raises(NotChangeable, match="it has low, high"):
        harness.change_setting("window", 6)


def test_module_answers_requests_by_message() -> None:
    with ModuleHarness(Filter, name="filter") as harness:
        for request, value in enumerate(("1.5", "[", "5")):
            harness.send(SettingChange(request=request, setting="low", value=value), topic="filter")
        with pytest.raises(NotSubscribed):
            harness.send(SettingChange(request=3, setting="low", value="0.5"), topic="other")
        answers = harness.take(SettingChanged, "filter")
    assert [answer.request for answer in answers] == [0, 1, 2]
    assert (answers[0].value, answers[0].error) == ("1.5", "")
    assert "YAML" in answers[1].error
    assert "low must be below high" in answers[2].error
    assert answers[2].value == "1.5"


class SetUpByHand(ModuleHarness[Filter]):
    """A harness in whose place the test sets the module up, with a file for its changes."""

    def _check_entered(self) -> None:
        pass


def test_changes_are_kept_for_the_next_incarnation(tmp_path: Path) -> None:
    file = SettingsFile(tmp_path, "filter")
    assert file.start().values == {}
    harness = SetUpByHand(Filter, name="filter")
    harness.module.setup()
    changes = SettingChanges(harness.module, harness.bus, file)
    changes.listen()
    changes.begin()
    assert file.start().values == {}
    changes.change("high", 3)
    harness.advance(TRIAL_S)
    assert file.start().values == {"high": 3.0}
    assert file.read()["low"] == {
        "value": 1.0, "type": "float, at least 0", "description": "lower bound", "changeable": True,
        "changed": False,
        "outline": {"kind": "float", "is_list": False, "choices": [], "minimum": 0.0, "maximum": None},
    }  # fmt: skip


class Life:
    """One process of the filter, which starts with what the one before has left."""

    def __init__(self, folder: Path, *, ends_setup: bool = True):
        self.file = SettingsFile(folder, "filter")
        self.harness = SetUpByHand(Filter, self.file.start().values, name="filter")
        self.module = self.harness.module
        self.changes = SettingChanges(self.module, self.harness.bus, self.file)
        self.changes.listen()
        self.module.setup()
        if ends_setup:
            self.changes.begin()

    def set(self, name: str, value: float, then_s: float = TRIAL_S) -> None:
        self.changes.change(name, value)
        self.harness.advance(then_s)

    @property
    def taken_back(self) -> list[str]:
        return [answer.error for answer in self.harness.take(SettingChanged, "filter") if not answer.request]


def test_value_with_which_its_module_dies_soon_is_taken_back(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    first = Life(tmp_path)
    first.set("high", 3)
    first.set("high", 13, then_s=TRIAL_S - 0.1)
    second = Life(tmp_path)
    assert second.module.high == 3.0, "the value before survived"
    assert "setting high was taken back from 13.0 to 3.0: the module died before" in caplog.text
    assert len(second.taken_back) == 1
    second.set("high", 4, then_s=0)
    third = Life(tmp_path)
    assert third.module.high == 3.0
    third.set("high", 5)
    fourth = Life(tmp_path)
    assert fourth.module.high == 5.0
    assert fourth.taken_back == []


def test_value_of_the_profile_comes_back_if_no_change_survived(tmp_path: Path) -> None:
    Life(tmp_path).set("high", 3, then_s=1.0)
    second = Life(tmp_path)
    assert second.module.high == 2.0
    assert not second.file.read()["high"]["changed"]


def test_value_that_kills_only_in_setup_is_taken_back_too(tmp_path: Path) -> None:
    Life(tmp_path).set("high", 3)
    assert Life(tmp_path, ends_setup=False).module.high == 3.0
    assert Life(tmp_path).module.high == 2.0


def test_value_that_has_started_once_stays_whatever_else_kills_the_module(tmp_path: Path) -> None:
    Life(tmp_path).set("high", 3)
    for _ in range(2):
        assert Life(tmp_path).module.high == 3.0
        assert Life(tmp_path, ends_setup=False).module.high == 3.0


def test_module_that_is_stopped_in_order_keeps_a_new_value(tmp_path: Path) -> None:
    first = Life(tmp_path)
    first.set("high", 3, then_s=0)
    first.changes.end()
    assert Life(tmp_path).module.high == 3.0


def test_other_settings_are_not_taken_back(tmp_path: Path) -> None:
    first = Life(tmp_path)
    first.set("high", 3)
    first.set("low", 1.5, then_s=0)
    second = Life(tmp_path)
    assert (second.module.low, second.module.high) == (1.0, 3.0)


def test_value_that_waits_for_the_start_is_there_before_setup(tmp_path: Path) -> None:
    Life(tmp_path).file.wait_for_start("high", "7")
    second = Life(tmp_path, ends_setup=False)
    assert second.module.high == 7.0
    assert second.file.waiting() == {}
    assert Life(tmp_path).module.high == 2.0, "it died with it"
    second.file.wait_for_start("high", "8")
    third = Life(tmp_path)
    third.harness.advance(TRIAL_S)
    assert Life(tmp_path).module.high == 8.0


def test_value_that_comes_during_setup_is_applied_when_the_module_runs(tmp_path: Path) -> None:
    life = Life(tmp_path, ends_setup=False)
    life.file.wait_for_start("high", "7")
    life.changes.begin()
    assert life.module.used == [("high", 7.0)]


@pytest.mark.parametrize(("name", "text"), [("high", "[1"), ("high", "much"), ("low", "99"), ("window", "3")])
def test_value_that_waits_and_does_not_fit_is_not_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, name: str, text: str
) -> None:
    Life(tmp_path).file.wait_for_start(name, text)
    life = Life(tmp_path)
    assert (life.module.low, life.module.high, life.module.window) == (1.0, 2.0, 5)
    assert "a value that waited for this start is not used" in caplog.text
    assert life.file.waiting() == {}


def test_damaged_file_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "settings").mkdir()
    (tmp_path / "settings" / "filter.json").write_text("{")
    assert SettingsFile(tmp_path, "filter").read() == {}


@pytest.mark.slow
def test_module_imports_yaml_only_for_a_change() -> None:
    code = "import sys, robbie_mp.run.supervisor.module_child; sys.exit('yaml' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0
