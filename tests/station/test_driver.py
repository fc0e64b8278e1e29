"""The driver of a page moves the robot only by fresh commands, and stops it when the page is gone."""

from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from robbie_mp.messages import DriveCommand
from robbie_mp.station.driving import driver, held_control
from robbie_mp.station.driving.dead_man import WINDOW_S, DeadManSwitch
from robbie_mp.station.driving.driver import MIN_SHARE
from robbie_mp.station.driving.held_control import VALID_FOR
from robbie_mp.station.driving.seat import DriversSeat
from robbie_mp.station.live.network import PageNetwork


class Scene:
    """A page whose operator drives, without a browser."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch):
        self.now_s = 100.0
        self.delay_s = 0.0
        """Delay of the network in each direction."""
        self.ahead_s = 0.0
        """The page's clock is ahead of the robot's by this."""
        elements = Mock()
        monkeypatch.setattr(driver, "DriverKeys", elements)
        monkeypatch.setattr(driver, "ui", ui := Mock())
        clock = SimpleNamespace(monotonic=lambda: self.now_s)
        monkeypatch.setattr(driver, "time", clock)
        monkeypatch.setattr(held_control, "time", clock)
        self.seat = DriversSeat()
        settings = Mock(max_linear_m_per_s=0.4, max_angular_rad_per_s=1.0)
        self.command = Mock(other="", is_here=False)
        self.station = Mock(settings=settings, operators=Mock(seat=self.seat, command=self.command))
        self.station.clock.now_ns = lambda: round(self.now_s * 1e9)
        self.publish = Mock()
        self.page = Mock(key="anna", dead_man=DeadManSwitch())
        self.driver = driver.Driver(self.station, self.page, self.publish)
        keys = elements.return_value.props.return_value
        self._answer = keys.run_method
        (((_, self._drive), _),) = keys.on.call_args_list
        (((_, self.pong), _),) = keys.on.return_value.on.call_args_list
        ((_, self._look), _) = ui.timer.call_args
        ((self.disconnect,), _) = ui.context.client.on_disconnect.call_args
        self.ping()

    def ping(self) -> None:
        """Let the page answer a ping."""
        self._look()
        ((_, number), _) = self._answer.call_args
        page_s = self.now_s + self.delay_s + self.ahead_s
        self.now_s += 2 * self.delay_s
        self.pong(SimpleNamespace(args={"number": number, "page_s": page_s}))
        self._look()

    def hold(self, linear: float, **more: bool) -> None:
        """Get a heartbeat of the page; `begins` and `held` unless others are given."""
        sent: dict[str, Any] = {"held": True, "begins": True, "linear": linear, "angular": 0.0, **more}
        self._drive(SimpleNamespace(args={**sent, "sent_s": self.now_s - self.delay_s}))

    def commands(self) -> list[DriveCommand]:
        """Return the commands that the page has published."""
        return [call.args[0] for call in self.page.publish.call_args_list]

    def told(self) -> list[DriveCommand]:
        """Return what the station has published without the page."""
        return [call.args[0] for call in self.publish.call_args_list]


def test_robot_is_stopped_at_once_when_the_driving_page_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    scene.hold(1.0)
    scene.now_s += 0.05
    scene.disconnect()
    (stop,) = scene.told()
    assert (stop.linear_m_per_s, stop.angular_rad_per_s, stop.valid_for) == (0.0, 0.0, VALID_FOR)
    assert scene.publish.call_args.kwargs == {"topic": "manual"}


def test_page_that_does_not_drive_stops_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    scene.disconnect()
    scene.hold(0.0)
    scene.disconnect()
    scene.hold(1.0)
    scene.now_s += 0.5
    scene.disconnect()
    scene.hold(1.0)
    scene.seat.take("ben", over=True)
    scene.disconnect()
    assert scene.told() == []


@pytest.mark.parametrize("delay_s", [0.3, 1.0, 2.5])
def test_page_of_a_slow_network_does_not_drive_and_gives_up_control(
    monkeypatch: pytest.MonkeyPatch, delay_s: float
) -> None:
    scene = Scene(monkeypatch)
    scene.hold(1.0)
    assert (len(scene.commands()), scene.seat.holder) == (1, "anna")
    scene.delay_s = delay_s
    scene.now_s += WINDOW_S
    scene.ping()
    scene.hold(1.0, begins=False)
    scene.hold(1.0)
    assert (len(scene.commands()), scene.seat.holder, scene.driver.stale) == (1, None, 2)
    assert scene.driver.delay == f"delay {2 * delay_s:.1f} s: too long to drive"
    scene.command.give_up.assert_called()
    scene.hold(1.0, held=False)
    assert scene.commands()[-1].linear_m_per_s == 0, "letting go did not count"


def test_drive_that_was_lost_goes_on_only_when_the_operator_takes_hold_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = Scene(monkeypatch)
    scene.hold(1.0)
    scene.delay_s = 1.0
    scene.now_s += WINDOW_S
    scene.ping()
    scene.delay_s = 0.0
    scene.ping()
    assert scene.driver.delay == ""
    scene.hold(1.0, begins=False)
    assert len(scene.commands()) == 1
    scene.hold(1.0)
    assert len(scene.commands()) == 2


def test_stick_that_is_held_while_another_page_drives_does_not_drive_when_that_one_leaves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = Scene(monkeypatch)
    scene.hold(1.0)
    scene.seat.take("ben", over=True)
    scene.hold(1.0, begins=False)
    scene.seat.leave("ben")
    scene.hold(1.0, begins=False)
    assert len(scene.commands()) == 1
    scene.hold(1.0)
    assert len(scene.commands()) == 2


def test_command_rests_on_the_operators_input_and_not_on_its_arrival(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    scene.delay_s = 0.05
    scene.now_s += 1.0
    scene.ping()
    scene.hold(1.0)
    (command,) = scene.commands()
    age_s = (command.header.stamp.nanoseconds - command.based_on.nanoseconds) / 1e9
    assert 0.05 <= age_s <= 0.11


def test_guard_is_left_out_only_on_purpose_and_until_the_operator_lets_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = Scene(monkeypatch)
    scene.hold(1.0)
    scene.hold(1.0, unguarded=True)
    scene.driver.without_guard = True
    scene.hold(1.0)
    scene.hold(1.0, held=False)
    scene.hold(1.0)
    assert [one.unguarded for one in scene.commands()] == [False, True, True, False, False]


def test_guard_comes_back_although_the_robot_does_not_hear_that_the_operator_let_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = Scene(monkeypatch)
    scene.driver.without_guard = True
    scene.hold(1.0)
    scene.seat.take("ben", over=True)
    scene.hold(1.0, held=False)  # does not count: ben drives
    scene.seat.leave("ben")
    scene.hold(1.0)
    scene.driver.without_guard = True
    scene.disconnect()
    scene.hold(1.0)
    assert [one.unguarded for one in scene.commands()] == [True, False, False]


def test_command_of_a_station_that_stood_still_while_it_made_it_is_old(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = Scene(monkeypatch)
    may = scene.station.robot_command.take
    may.side_effect = lambda: setattr(scene, "now_s", scene.now_s + 10.0)
    began_ns = round(scene.now_s * 1e9)
    scene.hold(1.0)
    (command,) = scene.commands()
    assert command.based_on.nanoseconds <= began_ns


@pytest.mark.parametrize("sent", [None, [], {}, {"number": "x", "page_s": 1}, {"number": 1e400, "page_s": 1}])
def test_malformed_answers_to_pings_are_ignored(monkeypatch: pytest.MonkeyPatch, sent: Any) -> None:
    Scene(monkeypatch).pong(SimpleNamespace(args=sent))


def test_top_speed_falls_with_the_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    speeds = []
    for delay_s in (0.03, 0.06, 0.07, 0.08, 0.09):
        scene.delay_s = delay_s
        scene.now_s += WINDOW_S
        scene.ping()
        scene.hold(1.0)
        speeds.append(scene.commands()[-1].linear_m_per_s / scene.driver.linear_m_per_s)
    assert speeds == pytest.approx([1.0, 1.0, 0.775, 0.55, 0.325])


def test_speed_is_the_lowest_while_the_delay_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    scene.now_s += WINDOW_S + 0.1  # and no ping could be sent meanwhile
    scene.hold(1.0)
    assert scene.driver.slowed == pytest.approx(MIN_SHARE)


def test_clock_of_a_page_that_jumps_makes_nothing_rarer(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    scene.page.network = PageNetwork()
    for ahead_s in (0.0, 5.0, -5.0, 0.0):
        scene.ahead_s = ahead_s
        scene.ping()
    assert scene.page.network.share == 1.0
