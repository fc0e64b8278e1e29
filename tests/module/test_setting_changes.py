"""Settings that are changed while their module runs."""

import subprocess
import sys
from pathlib import Path

import pytest

from robbie_mp import Module, ModuleHarness, SettingError, setting
from robbie_mp.messages import SettingChange, SettingChanged
from robbie_mp.module.setting_changes import NotChangeable, SettingChanges, SettingsFile


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
        harness.send(SettingChange(request=3, setting="low", value="0.5"), topic="other")
        answers = harness.take(SettingChanged, "filter")
    assert [answer.request for answer in answers] == [0, 1, 2]
    assert (answers[0].value, answers[0].error) == ("1.5", "")
    assert "YAML" in answers[1].error
    assert "low must be below high" in answers[2].error
    assert answers[2].value == "1.5"


def test_changes_are_kept_for_the_next_incarnation(tmp_path: Path) -> None:
    file = SettingsFile(tmp_path, "filter")
    assert file.changed() == {}
    harness = ModuleHarness(Filter, name="filter")
    harness.module.setup()
    changes = SettingChanges(harness.module, harness.bus, file)
    changes.listen()
    assert file.changed() == {}
    changes.change("high", 3)
    assert file.changed() == {"high": 3.0}
    assert file.read()["low"] == {
        "value": 1.0, "type": "float, at least 0", "description": "lower bound", "changeable": True,
        "changed": False,
        "outline": {"kind": "float", "is_list": False, "choices": [], "minimum": 0.0, "maximum": None},
    }  # fmt: skip


def test_damaged_file_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "settings").mkdir()
    (tmp_path / "settings" / "filter.json").write_text("{")
    assert SettingsFile(tmp_path, "filter").read() == {}


@pytest.mark.slow
def test_module_imports_yaml_only_for_a_change() -> None:
    code = "import sys, robbie_mp.supervisor.module_child; sys.exit('yaml' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0
