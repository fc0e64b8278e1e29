"""A driver finds its device, loses it, and finds it again by itself."""

import os
import pty
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from robbie_robots.hw.connection.device import ConnectionState
from robbie_robots.hw.connection.errors import DeviceSilent
from robbie_robots.hw.connection.port import Port, PortError
from robbie_robots.hw.emulation.carrier import Carrier, PseudoTerminal, TcpPort
from robbie_robots.hw.emulation.faults import Faults
from robbie_robots.hw.emulation.line import EmulatedLine
from tests.hw._support.beacon import Beacon, EmulatedBeacon

LIMIT_S = 30.0


def carriers() -> list[Callable[[Path], Carrier]]:
    return [lambda folder: PseudoTerminal(folder / "beacon"), lambda _: TcpPort()]


@pytest.fixture(params=carriers(), ids=["serial", "tcp"])
def line(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[EmulatedLine]:
    with EmulatedLine(EmulatedBeacon(), request.param(tmp_path)) as made:
        yield made


@pytest.fixture
def beacon(line: EmulatedLine) -> Iterator[Beacon]:
    driver = Beacon(line.url)
    yield driver
    driver.close()


def received(driver: Beacon, count: int = 3) -> list[int]:
    """Return the next numbers, at least `count` of them."""
    numbers: list[int] = []
    give_up_s = time.monotonic() + LIMIT_S
    while len(numbers) < count:
        assert time.monotonic() < give_up_s, driver.reason
        numbers += driver.poll(0.05)
    return numbers


def wait_until_lost(driver: Beacon) -> None:
    give_up_s = time.monotonic() + LIMIT_S
    while driver.is_connected:
        assert time.monotonic() < give_up_s
        driver.poll(0.05)


def test_measurements_arrive_in_order(beacon: Beacon) -> None:
    numbers = received(beacon, 20)
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert (beacon.state, beacon.reason) == (ConnectionState.CONNECTED, "")
    assert beacon.counters.values == len(numbers)


def test_driver_that_gathers_reads_several_measurements_at_once(beacon: Beacon) -> None:
    received(beacon)
    beacon.gather_s = 0.1
    began_s = time.monotonic()
    polled = [beacon.poll(1.0) for _ in range(4)]
    assert time.monotonic() - began_s >= 0.3
    # The emulated beacon sends every 10 ms.
    assert min(map(len, polled[1:])) > 3


def test_driver_that_gathers_waits_no_longer_than_its_caller_allows(beacon: Beacon) -> None:
    received(beacon)
    beacon.gather_s = 100.0
    beacon.poll()
    began_s = time.monotonic()
    beacon.poll(0.01)
    assert time.monotonic() - began_s < 10.0


def test_device_that_is_pulled_out_ten_times_is_back_within_two_seconds(
    line: EmulatedLine, beacon: Beacon
) -> None:
    received(beacon)
    for times in range(1, 11):
        line.unplug()
        wait_until_lost(beacon)
        assert beacon.poll() == []
        line.plug_in()
        back_s = time.monotonic()
        received(beacon)
        assert time.monotonic() - back_s < 2.0
        assert (beacon.counters.losses, beacon.counters.connections) == (times, times + 1)


def test_device_that_falls_silent_is_disconnected_until_it_speaks(line: EmulatedLine, beacon: Beacon) -> None:
    received(beacon)
    line.faults.is_silent = True
    wait_until_lost(beacon)
    assert "nothing valid for 0.3 s" in beacon.reason
    line.faults.is_silent = False
    received(beacon)


def test_reset_device_is_started_again(line: EmulatedLine, beacon: Beacon) -> None:
    received(beacon, 30)
    line.reset()
    wait_until_lost(beacon)
    assert min(received(beacon)) < 30


def test_noise_cuts_and_bit_errors_lose_frames_and_nothing_else(line: EmulatedLine, beacon: Beacon) -> None:
    line.faults = Faults(
        cut_share=0.05, bit_error_rate=1e-3, noise_share=0.1, garbage_at_start=b"\xaa\x55\xff!"
    )
    numbers = received(beacon, 100)
    assert numbers == sorted(set(numbers))
    assert line.way.damaged and beacon.frames.skipped_bytes
    assert beacon.counters.connections == 1


def test_slow_line_delivers_whole_frames(line: EmulatedLine, beacon: Beacon) -> None:
    received(beacon)
    line.faults.bytes_per_s = 2_000.0
    numbers = received(beacon, 10)
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_device_at_another_bit_rate_is_not_understood_until_the_rates_agree(tmp_path: Path) -> None:
    device = EmulatedBeacon()
    device.bit_rate = 38_400
    with EmulatedLine(device, PseudoTerminal(tmp_path / "beacon")) as line:
        wrong = Beacon(line.url, 9_600)
        wrong.poll()
        assert wrong.counters.failures == 1
        wrong.close()
        right = Beacon(line.url, 38_400)
        received(right)
        device.bit_rate = 57_600
        right.port.set_bit_rate(57_600)
        received(right)
        right.close()


def test_missing_port_is_tried_again_with_growing_waits(tmp_path: Path) -> None:
    hundredths = [0]
    attempts: list[int] = []

    def no_port(url: str, _: int) -> Port:
        attempts.append(hundredths[0])
        raise PortError(f"cannot open {url}")

    driver = Beacon(str(tmp_path / "none"), open_port=no_port)
    driver._monotonic, driver._next_attempt_s = lambda: hundredths[0] / 100 + 1e-9, 0.0
    for _ in range(400):
        assert driver.poll() == []
        hundredths[0] += 1
    # The waits are 0.1, 0.2, 0.4, and then always 0.8 s, and up to a hundredth longer.
    waits = [after - before for before, after in pairwise(attempts)]
    assert waits == pytest.approx([10, 20, 40, 80, 80, 80, 80], abs=1)
    assert (driver.counters.failures, driver.counters.losses) == (len(attempts), 0)
    assert not driver.send(b"x")
    with pytest.raises(DeviceSilent, match="not connected: cannot open"):
        _ = driver.port


@pytest.mark.parametrize("url", ["/no/such/port", "socket://127.0.0.1:1", "socket://nowhere", "nonsense://x"])
def test_port_that_cannot_be_opened_is_named(url: str) -> None:
    with pytest.raises(PortError, match=f"cannot open the port {url}"):
        Port(url)


def test_port_that_is_not_there_is_reported_once_with_what_to_do() -> None:
    with pytest.raises(PortError) as raised:
        Port("/dev/no-such-port")
    said = "No such file or directory; `robbie devices` lists the ports that are there"
    assert str(raised.value) == f"cannot open the port /dev/no-such-port: {said}"


def test_port_that_another_process_uses_is_reported_with_that_process() -> None:
    controller, device = pty.openpty()
    name = os.ttyname(device)
    code = (
        f"import fcntl, time; port = open({name!r}); fcntl.flock(port, fcntl.LOCK_EX); "
        "print(flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout and process.stdout.readline()
            expected = rf"cannot open the port {name}: process {process.pid} \(python.*\) uses it"
            with pytest.raises(PortError, match=expected):
                Port(name)
        finally:
            process.kill()
            os.close(controller)
            os.close(device)


def test_port_without_a_descriptor_is_read() -> None:
    # As one of a terminal server (rfc2217) is, which would need a server.
    port = Port("loop://")
    port.write(b"hello")
    assert port.read(1.0) == b"hello"
    assert port.read(0.0) == b""
    port.close()
