"""One robot a workspace, one run a device; and which of several runs a command takes."""

import os
import pty
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.cli.runs import choose_run, live_runs
from robbie_mp.run import exclusive_use
from robbie_mp.run.doctor.devices import look_at_devices
from robbie_mp.run.exclusive_use import named_devices, refuse_taken_devices
from robbie_mp.run.live_runs import NoSuchRun
from robbie_mp.run.profile.model import ModuleSpec, Profile
from robbie_mp.run.run_directory import KnownRun
from tests._support.robot import Ended, Robot, wait_until

PROFILE = "modules: {pulse: {class: 'zoo.modules:Pulse'}}\n"
LASER = """
modules:
  laser:
    class: robbie_robots.modules.devices.hokuyo:HokuyoLaserRangeFinder
    settings: {{port: "{port}"}}
"""


@pytest.fixture
def other(robot: Robot, tmp_path: Path) -> Iterator[Robot]:
    """A second workspace of the same user."""
    folder = tmp_path / "other"
    folder.mkdir()
    other = Robot(folder)
    other.write_profile(PROFILE, "rover")
    yield other
    other.close()


def is_running(*robots: Robot) -> bool:
    running = {run.record.workspace for run in live_runs() if run.record}
    return running >= {str(robot.folder) for robot in robots}


@pytest.mark.slow
def test_robot_of_a_workspace_runs_once_unless_another_is_asked_for(robot: Robot) -> None:
    robot.write_profile(PROFILE)
    first = robot.start()
    robot.until(lambda modules: modules["pulse"]["state"] == "RUNNING")
    refused = robot.run("--output", str(robot.folder / "refused"))
    assert refused.exit_code == 1
    run = robot.known_run()
    assert refused.stderr.startswith(
        f"the robot of {robot.folder} runs already: run {run.run_id}, profile robot"
    )
    assert "add --another to run both" in refused.stderr
    assert not (robot.folder / "refused").exists()
    second = robot.start("--another", output=robot.folder / "second")
    wait_until(lambda: len(live_runs()) == 2 or second.poll() is not None)
    assert first.poll() is None and second.poll() is None
    assert robot.command("stop", "--run", run.run_id).returncode == 0
    assert robot.run().exit_code == 1, "the other one runs still"


@pytest.mark.slow
def test_of_two_robots_that_start_at_once_one_is_refused(robot: Robot) -> None:
    robot.write_profile(PROFILE)
    both = [robot.start(output=robot.folder / name) for name in ("one", "two")]
    wait_until(lambda: any(process.poll() is not None for process in both))
    (ended,) = (process for process in both if process.poll() is not None)
    assert "runs already" in Ended.wait_for(ended).stderr
    robot.until(lambda modules: modules["pulse"]["state"] == "RUNNING")


@pytest.mark.slow
def test_device_that_a_live_run_names_is_refused(robot: Robot, other: Robot) -> None:
    controller, device = pty.openpty()
    port = os.ttyname(device)
    try:
        for each in (robot, other):
            each.write_profile(LASER.format(port=port))
        robot.start()
        wait_until(lambda: is_running(robot))
        refused = other.run("--another")
        assert refused.exit_code == 1
        run = robot.known_run()
        said = f"laser.port is {port}, which run {run.run_id} (robot) uses as laser.port"
        assert refused.stderr.startswith(said), refused.stderr
    finally:
        os.close(controller)
        os.close(device)


@pytest.mark.slow
def test_network_device_that_a_live_run_names_is_refused(robot: Robot, other: Robot) -> None:
    for each, port in ((robot, "socket://localhost:1"), (other, "socket://LOCALHOST:1/")):
        each.write_profile(LASER.format(port=port))
    robot.start()
    wait_until(lambda: is_running(robot))
    assert "laser.port is socket://localhost:1, which run" in other.run().stderr


def test_doctor_and_run_agree_on_what_names_a_device() -> None:
    settings = {
        "port": "/dev/no-such-port",
        "others": ["/dev/no-such-camera", "socket://localhost:1"],
        "shared": "/dev/shm/no-such-file",
    }
    module = ModuleSpec("laser", "zoo:Laser", settings)
    found = [finding.found for finding in look_at_devices(Profile("p", (module,)))]
    assert found == ["/dev/no-such-port is not there", "/dev/no-such-camera is not there"]
    assert [device for _, device in named_devices([module])] == [
        "/dev/no-such-port",
        "/dev/no-such-camera",
        "socket://localhost:1",
    ]


def test_plan_of_another_version_takes_no_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exclusive_use, "live_runs", lambda: [KnownRun("0" * 8, tmp_path, True, None)])
    modules = [ModuleSpec("laser", "zoo:Laser", {"port": "/dev/no-such-port"})]
    for plan in ("[]", '{"modules": [{"name": "laser", "settings": []}], "types": []}', "{"):
        (tmp_path / "plan.json").write_text(plan)
        refuse_taken_devices(modules)


@pytest.mark.slow
def test_command_takes_the_run_that_is_meant(
    robot: Robot, other: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.write_profile(PROFILE)
    robot.start()
    other.start(profile="rover")
    wait_until(lambda: is_running(robot, other))
    mine, theirs = (run.run_id for run in sorted(live_runs(), key=lambda run: str(run.folder)))
    if choose_run("rover").run_id == mine:
        mine, theirs = theirs, mine

    # That of the workspace, also in a folder below; but a name comes first.
    (robot.folder / "zoo" / "deeper").mkdir()
    for folder, expected in ((robot.folder / "zoo" / "deeper", mine), (other.folder, theirs)):
        monkeypatch.chdir(folder)
        assert choose_run(None).run_id == expected
    monkeypatch.chdir(robot.folder)
    assert robot.command("list", "modules").returncode == 0
    for name in (theirs, theirs[:5], "rover", str(other.folder), "../other", str(other.output)):
        assert choose_run(name).run_id == theirs, name

    # The variable, and an option in place of it.
    monkeypatch.setenv("ROBBIE_RUN", "rover")
    assert choose_run(None).run_id == theirs
    assert choose_run("robot").run_id == mine
    monkeypatch.delenv("ROBBIE_RUN")

    # From elsewhere, a user with several runs must choose.
    monkeypatch.chdir(tmp_path)
    with pytest.raises(NoSuchRun, match=rf"several runs match: .*\(rover in {other.folder}\).*--run"):
        choose_run(None)
    with pytest.raises(NoSuchRun, match="no run is called nobody; there are: "):
        choose_run("nobody")
    refused = robot.command("gui", "--attach", mine)
    assert "unrecognized arguments: --attach" in refused.stderr
