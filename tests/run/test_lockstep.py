"""In lockstep, a run takes the same course every time, bit for bit, under load and in spite of deaths."""

import json
import subprocess
import sys
from itertools import pairwise

import pytest

from tests._support.robot import Ended, Robot, kill, wait_until

pytestmark = pytest.mark.slow

PROFILE = """
modules:
  time:
    class: robbie_mp.logs.simulated_time:SimulatedTime
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
    class: robbie_mp.logs.message_logger:MessageLogger
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


CHARGED = """
modules:
  time:
    class: robbie_mp.logs.simulated_time:SimulatedTime
    settings: {{duration_s: 2.0}}
    ends_run: true
  camera: {{class: "zoo.modules:Ticker", settings: {{period_s: 0.05}}}}
  detector: {{class: "zoo.modules:Detector", settings: {{work_s: {work_s}}}}}
clock: {{source: time, lockstep: true{charge}}}
core: {{deadline_s: 60.0}}
"""


def detected(robot: Robot, work_s: float, charge: str) -> list[int]:
    robot.output = robot.folder / f"charged{len(list(robot.folder.glob('charged*')))}"
    robot.write_profile(CHARGED.format(work_s=work_s, charge=f", charge: {charge}" if charge else ""))
    ended = robot.run()
    assert ended.exit_code == 0, ended.stderr
    return robot.journal("detector")


def test_charged_handler_skips_messages_and_recorded_times_repeat_the_run(robot: Robot) -> None:
    every = detected(robot, 0.0, "")
    assert every == list(range(1, len(every) + 1)) and len(every) == pytest.approx(40, abs=1)
    charged = detected(robot, 0.12, "measured")
    assert 5 <= len(charged) <= 2.0 / 0.12 + 1
    assert all(later - earlier >= 2 for earlier, later in pairwise(charged))
    times = robot.output / "handler_times"
    assert len((times / "detector.txt").read_text().splitlines()) == len(charged)
    for _ in range(2):
        assert detected(robot, 0.0, str(times)) == charged  # however fast the detector is now
        assert (robot.output / "handler_times" / "detector.txt").read_text() == (
            times / "detector.txt"
        ).read_text()
