"""A run's time goes as its one writer says; it goes back only by jumps that are counted."""

import math
from collections.abc import Iterator
from uuid import uuid4

import pytest

from robbie_mp.run_clock import ClockWriter, InvalidRate, RunClock
from robbie_mp.transport import layout, names
from robbie_mp.transport.layout import SegmentKind
from robbie_mp.transport.segment import Segment

BEGIN_NS = 1_000_000_000_000


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[ClockWriter, RunClock, list[int]]]:
    """A clock with its writer, and the machine's time, which the test sets."""
    run_id = uuid4().hex[:8]
    segment = Segment.create(names.clock(run_id), layout.CLOCK_WORDS, SegmentKind.CLOCK)
    machine_ns = [5_000]
    monkeypatch.setattr("robbie_mp.run_clock.time.monotonic_ns", lambda: machine_ns[0])
    writer, clock = ClockWriter.attach(run_id), RunClock.attach(run_id)
    yield writer, clock, machine_ns
    for mapped in (writer, clock, segment):
        mapped.close()
    segment.unlink()


def test_time_begins_when_it_is_set_and_goes_at_its_rate(
    clocks: tuple[ClockWriter, RunClock, list[int]],
) -> None:
    writer, clock, machine_ns = clocks
    assert not clock.has_begun
    assert writer.now_ns is None
    assert math.isinf(clock.machine_s_until(1))
    writer.jump(BEGIN_NS)
    machine_ns[0] += 100
    assert clock.has_begun
    assert clock.now_ns() == BEGIN_NS
    writer.play(BEGIN_NS, rate=2.5)
    machine_ns[0] += 1000
    assert clock.now_ns() == clock.monotonic_ns() == BEGIN_NS + 2500
    assert clock.at(machine_ns[0] - 1000) == BEGIN_NS
    assert clock.machine_s_until(BEGIN_NS + 5000) == pytest.approx(1e-6)
    assert clock.machine_s_until(BEGIN_NS) == 0.0


def test_time_stands_still_when_paused_and_at_its_limit(
    clocks: tuple[ClockWriter, RunClock, list[int]],
) -> None:
    writer, clock, machine_ns = clocks
    writer.play(BEGIN_NS, 1.0, BEGIN_NS + 50)
    machine_ns[0] += 1000
    assert clock.now_ns() == BEGIN_NS + 50
    writer.pause(BEGIN_NS + 70)
    machine_ns[0] += 1000
    assert clock.now_ns() == BEGIN_NS + 70
    assert math.isinf(clock.machine_s_until(BEGIN_NS + 71))


def test_time_goes_back_by_counted_jumps_only(clocks: tuple[ClockWriter, RunClock, list[int]]) -> None:
    writer, clock, machine_ns = clocks
    writer.play(BEGIN_NS)
    machine_ns[0] += 1000
    writer.play(BEGIN_NS)
    assert clock.now_ns() == BEGIN_NS + 1000
    assert clock.jumps == 0
    writer.jump(BEGIN_NS - 5)
    assert (clock.now_ns(), clock.jumps) == (BEGIN_NS - 5, 1)


@pytest.mark.parametrize("rate", [-1.0, math.nan, math.inf, 1e7])
def test_impossible_rate_is_refused(clocks: tuple[ClockWriter, RunClock, list[int]], rate: float) -> None:
    with pytest.raises(InvalidRate, match="give a rate"):
        clocks[0].play(BEGIN_NS, rate)


def test_row_that_changes_while_it_is_read_is_read_again(
    clocks: tuple[ClockWriter, RunClock, list[int]],
) -> None:
    writer, clock, _ = clocks
    writer.pause(1)
    rows = clock._rows
    read, writes = rows._read, iter([10, 20, 30])

    def read_while_written(offset_bytes: int) -> tuple[int, ...]:
        row = read(offset_bytes)
        if (at_ns := next(writes, None)) is not None:
            writer.pause(at_ns)
        return row

    rows._read = read_while_written
    assert clock.now_ns() == 30
