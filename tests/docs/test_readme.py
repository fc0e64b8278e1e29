"""The module in README.md works as described."""

from pathlib import Path
from typing import Any

import pytest

from robbie_mp import ModuleHarness
from robbie_mp.base.problem import ProfileError
from robbie_mp.messages import DriveCommand, LaserScan
from robbie_mp.run.profile.load import load_profile
from tests.docs._support.pages import ROOT, block


@pytest.fixture
def names() -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": __name__}
    exec(block("README.md", "the module"), names)
    exec(block("README.md", "the test of the module"), names)
    return names


def test_example_in_the_readme_passes(names: dict[str, Any]) -> None:
    names["test_near_obstacle_stops_the_robot"]()


def test_example_in_the_readme_can_fail(names: dict[str, Any]) -> None:
    names["EmergencyStop"].on_scan = lambda _module, _scan: None
    with pytest.raises(AssertionError):
        names["test_near_obstacle_stops_the_robot"]()


@pytest.mark.parametrize("ranges", [[], [0.4], [3.0]])
def test_module_lets_the_robot_drive_when_nothing_is_near(names: dict[str, Any], ranges: list[float]) -> None:
    with ModuleHarness(names["EmergencyStop"]) as harness:
        harness.send(LaserScan(range_max=10.0, ranges=ranges))  # type: ignore[arg-type]
        assert not harness.take(DriveCommand)


def test_mistake_is_shown_as_quoted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    file = Path("profiles", "demo.yaml")
    file.parent.mkdir()
    file.write_text("#\n" * 5 + "modules: {mapping: {class: a.b:C,\nesential: true}}\n")
    with pytest.raises(ProfileError) as caught:
        load_profile("demo")
    assert str(caught.value) in (ROOT / "README.md").read_text()
