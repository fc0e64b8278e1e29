"""A run ends cleanly before the battery is empty, and for no other reason."""

import logging
import math
from collections.abc import Iterator

import pytest

from robbie_mp import ModuleHarness
from robbie_mp.messages import BatteryState
from robbie_mp.module.settings import SettingError
from robbie_mp.run.battery_guard import BatteryGuard
from tests._support.robot import Robot

Guard = ModuleHarness[BatteryGuard]


@pytest.fixture
def guard() -> Iterator[Guard]:
    with ModuleHarness(BatteryGuard, {"low": 0.3, "empty": 0.1, "hold_s": 5.0}) as harness:
        yield harness


def report(guard: Guard, *charges: float, status: int = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING) -> None:
    """Report a charge each second."""
    for charge in charges:
        guard.send(BatteryState(percentage=charge, power_supply_status=status), topic="battery")
        guard.advance(1.0)


def test_module_ends_when_the_battery_stays_almost_empty(guard: Guard) -> None:
    report(guard, 0.5, *[0.05] * 5)
    assert not guard.module.stop_requested
    report(guard, *[0.05] * 2)
    assert guard.module.stop_requested


def test_single_low_readings_end_nothing(guard: Guard) -> None:
    report(guard, *[0.05, 0.05, 0.05, 0.5] * 5)
    assert not guard.module.stop_requested


@pytest.mark.parametrize(
    ("charge", "status"),
    [(0.05, BatteryState.POWER_SUPPLY_STATUS_CHARGING), (math.nan, BatteryState.POWER_SUPPLY_STATUS_UNKNOWN)],
    ids=["charging", "without a gauge"],
)
def test_battery_that_is_charged_or_not_measured_ends_nothing(
    guard: Guard, charge: float, status: int
) -> None:
    report(guard, *[charge] * 20, status=status)
    assert not guard.module.stop_requested


def test_low_battery_is_warned_of_once_until_it_is_charged(
    guard: Guard, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        report(guard, *[0.2] * 20, *[0.9] * 3, *[0.2] * 20)
    assert sum("is low" in record.message for record in caplog.records) == 2
    assert not guard.module.stop_requested


def test_silent_battery_is_reported_and_ends_nothing(guard: Guard) -> None:
    report(guard, 0.05, 0.05)
    guard.advance(100.0)
    assert guard.module.status == "no battery has reported for 101 s"
    assert not guard.module.stop_requested


def test_limits_in_the_wrong_order_are_refused() -> None:
    with (
        pytest.raises(SettingError, match="must not be above low"),
        ModuleHarness(BatteryGuard, {"low": 0.1, "empty": 0.2}),
    ):
        pass


@pytest.mark.slow
def test_run_ends_in_order_when_the_battery_is_empty(robot: Robot) -> None:
    (robot.folder / "zoo" / "power.py").write_text(
        "from robbie_mp import Module\n"
        "from robbie_mp.messages import BatteryState\n"
        "class Empty(Module):\n"
        "    period_s = 0.05\n"
        "    def tick(self):\n"
        "        self.publish(BatteryState(percentage=0.01), topic='battery')\n"
    )
    robot.write_profile("""
modules:
  power: {class: "zoo.power:Empty"}
  guard:
    class: robbie_mp.run.battery_guard:BatteryGuard
    settings: {hold_s: 0.2, period_s: 0.05}
    ends_run: true
""")
    ended = robot.run()
    assert (ended.exit_code, ended.summary["reason"]) == (0, "guard ended the run"), ended.stderr
