"""How the operator trials read the file of the base's witness."""

from pathlib import Path

from robbie_mp import ModuleHarness
from robbie_mp.messages import EmergencyStop, Odometry, Twist, TwistWithCovariance, Vector3
from tools.operator.journal import WitnessReader
from tools.operator.stops import summary
from tools.operator.witness import Witness


def odometry(speed_m_per_s: float) -> Odometry:
    return Odometry(twist=TwistWithCovariance(twist=Twist(linear=Vector3(x=speed_m_per_s))))


def test_journal_finds_when_the_base_first_stood_after_an_event(tmp_path: Path) -> None:
    journal = WitnessReader(tmp_path / "witness.txt")
    assert journal.newest("speed") == 0.0
    with ModuleHarness(Witness, output_directory=tmp_path) as harness:
        times_ns = []
        for speed in (0.0, 0.2, 0.2, 0.1, 0.0, 0.0):
            times_ns.append(harness.clock.monotonic_ns())
            harness.send(odometry(speed), topic="ground_truth")
            harness.advance(0.01)
        assert journal.first_after("speed", times_ns[2], 0.0) == times_ns[4]
        assert journal.first_after("stopped", 0, 1.0) is None
        stop_ns = harness.clock.monotonic_ns()
        harness.send(EmergencyStop(engaged=True), topic="emergency_stop_state")
        assert journal.first_after("stopped", times_ns[0], 1.0) == stop_ns
        assert journal.first_after("asked", 0, 1.0) is None
        assert journal.newest("stopped") == 1.0


def test_incomplete_line_is_read_when_it_is_complete(tmp_path: Path) -> None:
    file = tmp_path / "witness.txt"
    journal = WitnessReader(file)
    file.write_text("speed 5 0.5\nspeed 1")
    assert journal.newest("speed") == 0.5
    with file.open("a") as more:
        more.write("0 0.25\n")
    assert journal.newest("speed") == 0.25
    assert journal.first_after("speed", 5, 0.25) == 10


def test_summary_is_in_milliseconds() -> None:
    assert summary([0.001 * at for at in range(1, 102)]) == {
        "trials": 101,
        "p50_ms": 51.0,
        "p99_ms": 100.0,
        "max_ms": 101.0,
    }
