"""The driver of a page stops the robot when the connection of the page ends while it drives."""

from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from robbie_mp.messages import DriveCommand
from robbie_mp.station.access import DriversSeat
from robbie_mp.station.driving import driver
from robbie_mp.station.driving.held_control import VALID_FOR


class Scene:
    """A page whose operator drives, without a browser."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch):
        self.now_s = 100.0
        elements = Mock()
        monkeypatch.setattr(driver, "DriverKeys", elements)
        monkeypatch.setattr(driver, "ui", ui := Mock())
        monkeypatch.setattr(driver, "time", SimpleNamespace(monotonic=lambda: self.now_s))
        self.seat = DriversSeat()
        self.station = Mock(max_linear_m_per_s=0.4, max_angular_rad_per_s=1.0, drivers_seat=self.seat)
        self.station.clock.now_ns.return_value = 0
        self.station.robot_command = Mock(other="", is_here=False)
        self.page = Mock(key="anna")
        driver.Driver(self.station, self.page)
        ((_, self._drive), _) = elements.return_value.props.return_value.on.call_args
        ((self.disconnect,), _) = ui.context.client.on_disconnect.call_args

    def hold(self, linear: float) -> None:
        """Get a heartbeat of the page."""
        sent: dict[str, Any] = {"held": True, "begins": True, "linear": linear, "angular": 0.0, "sent_s": 0.0}
        self._drive(SimpleNamespace(args=sent))

    def told(self) -> list[DriveCommand]:
        """Return what the station has published without the page."""
        return [call.args[0] for call in self.station.publish.call_args_list]


def test_robot_is_stopped_at_once_when_the_driving_page_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    scene.hold(1.0)
    scene.now_s += 0.05
    scene.disconnect()
    (stop,) = scene.told()
    assert (stop.linear_m_per_s, stop.angular_rad_per_s, stop.valid_for) == (0.0, 0.0, VALID_FOR)
    assert scene.station.publish.call_args.kwargs == {"topic": driver.MANUAL_TOPIC}


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
