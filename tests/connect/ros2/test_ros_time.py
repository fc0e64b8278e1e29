"""ROS's time as the run's, with a machine's clock that the test turns."""

from typing import Any

import pytest

from robbie_mp.bus.transport.words import WORD_MAX
from robbie_mp.connect.ros2.module import CLOCK
from robbie_mp.connect.ros2.ros_time import LOST_S, RosTime
from robbie_mp.messages import from_dict

MS = 1_000_000


class Clock:
    """A run's clock, as `ClockWriter` sets it."""

    def __init__(self) -> None:
        self.machine_ns = 0
        self.jumped = 0
        self._row: tuple[int, int, float, int] | None = None

    @property
    def now_ns(self) -> int | None:
        if self._row is None:
            return None
        since_ns, at_ns, rate, limit_ns = self._row
        return min(round(at_ns + (self.machine_ns - since_ns) * rate), limit_ns)

    def play(self, at_ns: int, rate: float, limit_ns: int) -> None:
        at_ns = max(at_ns, self.now_ns or 0)
        self._row = self.machine_ns, at_ns, rate, max(limit_ns, at_ns)

    def pause(self, at_ns: int) -> None:
        self.play(at_ns, 0.0, WORD_MAX)

    def jump(self, at_ns: int) -> None:
        self.jumped += 1
        self._row = self.machine_ns, at_ns, 0.0, at_ns


class Simulator:
    """Sends its time every 20 ms."""

    def __init__(self, clock: Clock, ros_time: RosTime) -> None:
        self.clock, self.ros_time = clock, ros_time
        self.at_ns = 1_000 * MS

    def run(self, seconds: float, rate: float = 1.0) -> list[int]:
        """Run; return the run's times, 1 ms after each message and before the next."""
        times: list[int] = []
        for _ in range(round(seconds / 0.02)):
            self.ros_time.see(self.at_ns, self.clock.machine_ns)
            self.at_ns += round(20 * MS * rate)
            for wait_ms in (1, 18, 1):
                self.clock.machine_ns += wait_ms * MS
                times.append(self.clock.now_ns or 0)
        return times


@pytest.fixture
def simulator() -> Simulator:
    clock = Clock()
    return Simulator(clock, RosTime(clock, monotonic_ns=lambda: clock.machine_ns))


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0, 20.0])
def test_time_goes_smoothly_at_the_rate_of_the_simulator(simulator: Simulator, rate: float) -> None:
    times = simulator.run(3.0, rate)
    assert times == sorted(times)
    assert abs(times[-1] - simulator.at_ns) < 30 * MS * rate
    assert simulator.ros_time.rate == pytest.approx(rate, rel=0.01)
    steps = [after - before for before, after in zip(times[-90:], times[-89:], strict=False)]
    assert max(steps) < 25 * MS * rate


def test_time_stands_soon_after_the_last_message_and_that_is_told(simulator: Simulator) -> None:
    simulator.run(1.0)
    assert not simulator.ros_time.problem
    simulator.clock.machine_ns += 60_000 * MS
    assert (simulator.clock.now_ns or 0) - simulator.at_ns < 20 * MS
    assert "no message on /clock: the run's time stands still" in simulator.ros_time.problem
    times = simulator.run(1.0)
    assert times == sorted(times)
    assert not simulator.ros_time.problem
    assert simulator.clock.jumped == 1


def test_paused_simulator_that_sends_its_time_is_no_problem(simulator: Simulator) -> None:
    simulator.run(1.0)
    times = simulator.run(5.0, rate=0.0)
    assert not simulator.ros_time.problem
    assert len(set(times[3:])) == 1
    assert simulator.run(1.0)[-1] > times[-1] + 900 * MS


def test_simulator_that_is_reset_is_a_jump(simulator: Simulator) -> None:
    simulator.run(5.0)
    simulator.at_ns = 0
    times = simulator.run(1.0)
    assert times[0] < 100 * MS
    (jump,) = simulator.ros_time.announced
    assert (jump.reason, jump.after.nanoseconds) == ("reset", 0)
    assert jump.before.nanoseconds > 5_000 * MS


def test_leap_of_the_simulator_is_a_jump(simulator: Simulator) -> None:
    simulator.run(1.0)
    simulator.at_ns += 100_000 * MS
    simulator.run(0.1)
    assert simulator.ros_time.jumps == 1


def test_two_simulators_make_few_jumps(simulator: Simulator) -> None:
    simulator.run(1.0)
    for _ in range(1000):
        simulator.ros_time.see(5_000_000 * MS, simulator.clock.machine_ns)
        simulator.ros_time.see(1_000 * MS, simulator.clock.machine_ns)
        simulator.clock.machine_ns += MS
    assert simulator.ros_time.jumps <= 3
    assert simulator.ros_time.ignored > 400


def test_one_simulator_is_followed_until_it_is_silent(simulator: Simulator) -> None:
    ros_time, clock = simulator.ros_time, simulator.clock

    def say(at_s: float, sender: bytes) -> None:
        told = from_dict(CLOCK, {"clock": {"sec": int(at_s)}})
        ros_time.take(CLOCK, told.encode(), clock.machine_ns, sender)

    for second in range(10):
        say(second, b"first")
        say(1_000_000 - second, b"second")
        clock.machine_ns += 900 * MS
    assert (ros_time.jumps, ros_time.ignored, clock.jumped) == (0, 10, 1)
    clock.machine_ns += round(LOST_S * 1e9)
    say(5_000, b"second")
    say(10, b"first")
    assert (ros_time.jumps, ros_time.ignored) == (1, 11)
    assert clock.now_ns == 5_000_000 * MS


def test_next_process_of_the_bridge_goes_on_with_the_time_that_it_finds(simulator: Simulator) -> None:
    simulator.run(1.0)
    simulator.ros_time = RosTime(simulator.clock, monotonic_ns=lambda: simulator.clock.machine_ns)
    simulator.run(1.0)
    assert simulator.ros_time.jumps == 0


@pytest.mark.parametrize("clock", [{"sec": -1}, {"nanosec": 10**9}])
def test_time_that_is_none_is_counted(simulator: Simulator, clock: dict[str, Any]) -> None:
    simulator.ros_time.take(CLOCK, from_dict(CLOCK, {"clock": clock}).encode(), 0)
    simulator.ros_time.take(CLOCK, b"\0\1\0\0\0", 0)
    assert simulator.ros_time.malformed == 2
    assert simulator.clock.now_ns is None


def test_time_that_never_came_is_told(simulator: Simulator) -> None:
    simulator.clock.machine_ns += round(LOST_S * 1e9)
    assert "nobody has sent a time" in simulator.ros_time.problem
