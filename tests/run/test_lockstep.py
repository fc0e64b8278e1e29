"""In lockstep, a run takes the same course every time, bit for bit, under load and in spite of deaths."""

import json
import subprocess
import sys

import pytest

from tests._support.robot import Ended, Robot, kill, wait_until

pytestmark = pytest.mark.slow

PROFILE = """
modules:
  time:
    class: robbie_mp.services.simulated_time:SimulatedTime
    settings: {{start_s: 1000.0, duration_s: 6.0, rate: {rate}}}
    ends_run: true
  chronicle:
    class: zoo.modules:Chronicle
    settings: {{die_at: {die_at}}}
  fast: {{class: "zoo.modules:Ticker", settings: {{period_s: 0.05}}}}
  slow: {{class: "zoo.modules:Ticker", settings: {{period_s: 0.1}}}}
  sleeper: {{class: "zoo.modules:Sleeper"}}
  first: {{class: "zoo.modules:Relay"}}
  second: {{class: "zoo.modules:Relay"}}
clock: {{source: time, lockstep: true}}
core: {{deadline_s: 60.0}}
"""


def chronicle(robot: Robot) -> list[str]:
    file = robot.output / "chronicle.txt"
    return file.read_text().splitlines() if file.exists() else []


def run(robot: Robot, die_at: int = -1) -> list[str]:
    robot.write_profile(PROFILE.format(rate="null", die_at=die_at))
    robot.output = robot.folder / f"out{len(list(robot.folder.glob('out*')))}"
    ended = robot.run()
    assert ended.exit_code == 0, ended.stderr
    assert all(module["dropped"] == 0 for module in ended.modules.values())
    return chronicle(robot)


def test_runs_are_identical_bit_for_bit_under_load_and_after_crashes(robot: Robot) -> None:
    undisturbed = run(robot)
    stamps = [int(line.split()[0]) for line in undisturbed]
    assert stamps == sorted(stamps)
    assert stamps[0] == 1_000_000_000_000
    assert 5.9e9 <= stamps[-1] - stamps[0] <= 6e9
    assert len(undisturbed) == pytest.approx(6 * (32 * 3 + 1 / 0.3), abs=5)
    assert all(line.split()[0] == line.split()[-1] for line in undisturbed if not line.endswith("tick"))

    spinning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        loaded = run(robot)
    finally:
        for process in spinning:
            process.kill()
            process.wait()
    assert loaded == undisturbed

    lost_one = run(robot, die_at=100)
    lost = (robot.output / "died").read_text()
    assert lost_one == [line for line in undisturbed if line != lost]


def test_killed_core_and_clock_source_lose_no_step(robot: Robot) -> None:
    robot.write_profile(PROFILE.format(rate=3.0, die_at=-1))
    process = robot.start()
    for victim in ("core", "time"):
        lines = len(chronicle(robot))
        wait_until(lambda before=lines: len(chronicle(robot)) > before + 50)  # type: ignore[misc]
        kill(robot.until(lambda modules: modules["core"]["pid"] and modules["time"]["pid"])[victim]["pid"])
        robot.until(lambda modules, name=victim: modules[name]["restarts"] == 1)  # type: ignore[misc]
    ended = Ended.wait_for(process)
    assert ended.exit_code == 0, ended.stderr
    numbers = [line.split()[1:3] for line in chronicle(robot) if not line.endswith("tick")]
    for name in ("fast", "slow", "first/fast", "second/slow"):
        of_name = [float(number) for frame, number in numbers if frame == name]
        assert of_name == list(map(float, range(1, len(of_name) + 1)))


def test_logs_of_two_runs_are_equal_except_for_the_states_of_processes(robot: Robot) -> None:
    logger = """modules:
  logger:
    class: robbie_mp.services.message_logger:MessageLogger
    settings: {{folder: {folder}}}"""
    for folder in ("a", "b"):
        profile = PROFILE.replace("modules:", logger, 1).format(rate="null", die_at=-1, folder=folder)
        robot.write_profile(profile.replace("duration_s: 6.0", "duration_s: 1.0"))
        ended = robot.run()
        assert ended.exit_code == 0, ended.stderr
    a, b = (str(next((robot.folder / folder).iterdir())) for folder in ("a", "b"))
    whole = robot.command("diff", a, b)
    assert whole.returncode == 1
    assert "only ModuleState differs" in whole.stdout and "--exclude ModuleState" in whole.stdout
    rest = robot.command("diff", a, b, "--exclude", "ModuleState", "--json")
    assert rest.returncode == 0, rest.stdout
    equal = {(one["type_name"], one["topic"]): one["equal"] for one in json.loads(rest.stdout)}
    assert equal["robbie_msgs/msg/DriveCommand", "relayed"] > 20
