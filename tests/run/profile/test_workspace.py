"""Profiles are found by name from anywhere in a workspace, or by path from anywhere."""

from pathlib import Path

import pytest

from robbie_mp.base.problem import ProfileError
from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.profile.preflight import preflight
from robbie_mp.run.profile.workspace import STOCK_FOLDERS, find_workspace, stock_names
from tests.run.profile.conftest import Robot


def test_name_is_looked_up_in_the_workspace_around_the_current_folder(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.write("sim/arena", "description: found")
    (robot.root / "modules" / "deep").mkdir(parents=True)
    monkeypatch.chdir(robot.root / "modules" / "deep")
    profile = robot.load("sim/arena")
    assert (profile.name, profile.description, profile.workspace) == ("sim/arena", "found", robot.root)


def test_path_of_a_profile_determines_the_workspace(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    robot.write("base", "variables: {a: 1}")
    robot.write("sim/arena", "parents: [base]")
    for start, path in [
        ("/", str(robot.root / "profiles/sim/arena.yaml")),
        (str(robot.root), "profiles/sim/arena.yaml"),
        (str(robot.root / "profiles/sim"), "arena.yaml"),
        (str(robot.root / "profiles/sim"), "../../profiles/sim/arena.yaml"),
    ]:
        monkeypatch.chdir(start)
        profile = robot.load(path)
        assert (profile.name, profile.workspace, profile.variables) == ("sim/arena", robot.root, {"a": 1})


def test_class_of_a_module_is_a_profile_of_that_module_alone(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    (robot.root / "deep").mkdir()
    monkeypatch.chdir(robot.root / "deep")
    profile = robot.load("my.robot:HTTPCamera2Left", "http_camera2_left.rate_hz=3")
    (module,) = profile.with_black_box().modules
    assert (module.name, module.class_path) == ("http_camera2_left", "my.robot:HTTPCamera2Left")
    assert (module.settings, profile.workspace) == ({"rate_hz": 3}, robot.root)


def test_workspace_can_be_given(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    robot.write("demo", "")
    monkeypatch.chdir("/")
    assert load_profile("demo", robot.root).workspace == robot.root


def test_all_profiles_can_be_listed(robot: Robot) -> None:
    robot.write("sim/arena", "")
    robot.write("base", "")
    assert find_workspace(robot.root).names() == ["base", "sim/arena"]


def test_missing_profile_is_reported_with_similar_names_and_all_others(robot: Robot) -> None:
    robot.write("demo", "")
    robot.write("sim/arena", "")
    known = f"; profiles in {robot.root}/profiles: demo, sim/arena; in Robbie-MP: {', '.join(stock_names())}"
    assert robot.problems("dmeo") == ["there is no profile 'dmeo'; did you mean 'demo'?"]
    assert robot.problems("profiles/lost.yaml") == [f"there is no profile 'lost'{known}"]
    assert robot.problems("\0") == [f"there is no profile '\\x00'{known}"]


def test_error_without_a_workspace_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(
        ProfileError, match=rf"^no folder profiles/ in {tmp_path} or above it; go to your robot"
    ):
        load_profile("demo", tmp_path)
    with pytest.raises(
        ProfileError, match=r"/demo\.yaml is not in a folder profiles/, so it belongs to no robot$"
    ):
        load_profile("demo.yaml", tmp_path)


def test_stock_profiles_are_parents_in_every_workspace(robot: Robot) -> None:
    robot.write("demo", "parents: [robbie:recorded]\nmodules:\n  logger: {settings: {folder: elsewhere}}")
    (logger,) = robot.load().modules
    assert logger.class_path == "robbie_mp.logs.message_logger:MessageLogger"
    assert logger.settings["folder"] == "elsewhere"
    assert "split_bytes" in logger.settings


def test_own_profile_of_the_same_name_is_another_one(robot: Robot) -> None:
    robot.write("recorded", "variables: {own: true}")
    robot.write("demo", "parents: [recorded]")
    assert robot.load().variables == {"own": True}
    assert robot.load().modules == ()


def test_every_stock_profile_passes_the_checks_before_a_run(robot: Robot) -> None:
    names = ", ".join(f"robbie:{file.stem}" for file in STOCK_FOLDERS[0].glob("*.yaml"))
    robot.write("demo", f"parents: [{names}]\nmodules: {{playback: null}}\nclock: null")
    findings = preflight(robot.load())
    assert sorted(findings.settings) == ["foxglove", "link", "logger", "operator", "time"]
    assert not findings.failures


def test_stock_playback_needs_nothing_but_a_log(robot: Robot) -> None:
    with pytest.raises(ProfileError, match=r"playback\.yaml:\d+: .* required, but not set") as caught:
        preflight(robot.load("robbie:playback"))
    assert len(caught.value.problems) == 1


def test_missing_stock_profile_is_reported_with_similar_names(robot: Robot) -> None:
    robot.write("demo", "parents: [playback]")
    robot.write("other", "parents: [robbie:playbck]")
    robot.write("outside", "parents: [robbie:../model]")
    assert (
        "profiles/demo.yaml:1: there is no profile 'playback'; did you mean 'robbie:playback'?"
        in (robot.problems("demo")[0])
    )
    assert "no profile 'robbie:playbck'; did you mean 'robbie:playback'" in robot.problems("other")[0]
    assert "no profile 'robbie:../model'" in robot.problems("outside")[0]
