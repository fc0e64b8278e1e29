"""A port without a line for the motor is no fault; one that broke is."""

import errno
from pathlib import Path

import pytest

from robbie_robots.hw.connection.port import Port, PortError
from robbie_robots.hw.emulation.carrier import PseudoTerminal


def test_port_without_a_motor_line_is_left_alone(tmp_path: Path) -> None:
    terminal = PseudoTerminal(tmp_path / "line")
    terminal.plug_in()
    port = Port(terminal.url)
    port.set_motor_line(True)
    port.close()
    terminal.unplug()


def test_broken_motor_line_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_is_high: bool) -> None:
        raise OSError(errno.EIO, "gone")

    terminal = PseudoTerminal(tmp_path / "line")
    terminal.plug_in()
    port = Port(terminal.url)
    monkeypatch.setattr(port._link, "set_motor_line", broken)
    with pytest.raises(PortError, match="gone"):
        port.set_motor_line(True)
    port.close()
    terminal.unplug()
