"""What crosses the ports of devices is recorded, and a replay gives it again without opening anything."""

import threading
from collections.abc import Callable
from typing import Any

import pytest

from robbie_mp.base.device_links import DeviceLink, monotonic, sleep, using_links
from robbie_mp.bus.transport.history import Event
from robbie_mp.logs.capsule.form import EventForm
from robbie_mp.logs.capsule.read import Step
from robbie_mp.logs.capsule.replayed_links import ReplayedLinks
from robbie_mp.module.recorded_links import RecordedLinks
from robbie_robots.hw.connection.port import Port, PortError
from tests.hw._support.beacon import Beacon, frame


class Script:
    """A link whose device says what a test wrote down; an error is raised."""

    descriptor = None

    def __init__(self, *says: bytes | Exception):
        self._says = list(says)
        self.written: list[bytes] = []

    def read(self, _wait_s: float) -> bytes:
        said = self._says.pop(0) if self._says else b""
        if isinstance(said, Exception):
            raise said
        return said

    def drain(self, _quiet_s: float, _limit_s: float) -> None:
        while self.read(0.0):
            pass

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def set_bit_rate(self, bit_rate: int) -> None:
        raise OSError(25, "Inappropriate ioctl for device")

    def set_motor_line(self, is_high: bool) -> None:
        raise OSError(25, "Inappropriate ioctl for device")

    def close(self) -> None:
        pass


class Recording:
    """What a module did, as its capsule holds it."""

    def __init__(self) -> None:
        self.step = Step(Event.TICK, EventForm("TICK", 1, 5_000_000_000))
        self.links = RecordedLinks(self._append)

    def _append(self, kind: int, time_ns: int, *rest: Any) -> None:
        *values, data = rest
        event = EventForm("PORT", 1, time_ns, tuple(values), len(data), None, data)
        self.step.told.append((Event(kind), event))

    def replayed(self) -> ReplayedLinks:
        links = ReplayedLinks([self.step])
        links.begin(self.step)
        return links


def opens(script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robbie_robots.hw.connection.port._opened", lambda _url, _rate: script)


def opens_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_url: str, _rate: int) -> DeviceLink:
        pytest.fail("a replay opened the device")

    monkeypatch.setattr("robbie_robots.hw.connection.port._opened", fail)


def talk() -> list[Any]:
    """Talk to a device as a driver does, and return what came of it."""
    found: list[Any] = []

    def note(do: Callable[[], Any]) -> None:
        try:
            found.append(do())
        except PortError as error:
            found.append(str(error))

    port = Port("/dev/ttyUSB7")
    port.drain(0.1, 0.5)
    port.write(b"hello\n")
    for _ in range(3):
        note(lambda: port.read(0.1))
    port.set_motor_line(True)
    note(lambda: port.set_bit_rate(9600))
    note(lambda: port.read(0.1))
    port.close()
    return found


def test_driver_gets_again_what_crossed_its_port(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = Recording()
    opens(Script(b"old", b"", b"12", b"", b"34\n", OSError(5, "Input/output error")), monkeypatch)
    with using_links(recording.links):
        then = talk()
    opens_nothing(monkeypatch)
    links = recording.replayed()
    with using_links(links):
        assert talk() == then
    assert then[:3] == [b"12", b"", b"34\n"]
    assert "refuses 9600" in then[3] and "Input/output error" in then[4]
    assert links.difference == ""


def test_port_that_could_not_be_opened_cannot_be_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = Recording()
    with using_links(recording.links), pytest.raises(PortError, match="cannot open") as then:
        Port("/dev/none")
    opens_nothing(monkeypatch)
    with using_links(recording.replayed()), pytest.raises(PortError) as now:
        Port("/dev/none")
    assert str(now.value) == str(then.value)


def test_other_bytes_written_are_the_first_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = Recording()
    opens(Script(), monkeypatch)
    with using_links(recording.links):
        Port("/run/1/x").write(b"go")
    links = recording.replayed()
    with using_links(links):
        Port("/run/2/x").write(b"stop")
    assert links.difference == "written b'stop', it was b'go'"


def test_waiting_for_what_did_not_come_then_ends_without_a_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    links = Recording().replayed()
    with using_links(links):
        port, begun_s = Port("x"), monotonic()
        while monotonic() < begun_s + 3600.0:
            assert port.read(60.0) == b""
        port.drain(1.0, 5.0)
        sleep(3600.0)
        assert monotonic() > begun_s + 7200.0


def test_what_another_thread_opens_is_not_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = Recording()
    opens(Script(b"1"), monkeypatch)
    links = recording.links

    def work() -> None:
        with using_links(links):
            Port("x").read(0.1)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert recording.step.told == []


def test_stock_driver_measures_and_loses_its_device_again(monkeypatch: pytest.MonkeyPatch) -> None:
    def drive() -> list[Any]:
        driver = Beacon("x")
        found = [(driver.poll(0.05), driver.state) for _ in range(4)]
        return [*found, driver.reason, driver.counters]

    recording = Recording()
    opens(Script(b"!", frame(0), b"", frame(1) + frame(2)[:5], OSError(5, "it is gone")), monkeypatch)
    with using_links(recording.links):
        then = drive()
    assert [values for values, _ in then[:4]] == [[0], [], [1], []]
    opens_nothing(monkeypatch)
    with using_links(recording.replayed()):
        assert drive() == then
