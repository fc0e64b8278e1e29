"""A run's time follows its only writer; it goes back only by counted jumps."""

import math
import os
from collections.abc import Iterator

import pytest

from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.shared_folder import make_folder, remove_names
from robbie_mp.run.run_clock import ClockWriter, InvalidRate, RunClock

BEGIN_NS = 1_000_000_000_000


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[ClockWriter, RunClock, list[int]]]:
    """A clock with its writer, and the machine's time, which the test sets."""
    run_id = f"clock{os.getpid()}"  # no id that a run can have: a `robbie run` elsewhere would sweep it
    make_folder(run_id)
    segment = Segment.create(names.clock(run_id), layout.CLOCK_WORDS, SegmentKind.CLOCK)
    machine_ns = [5_000]
    monkeypatch.setattr("robbie_mp.run.run_clock.time.monotonic_ns", lambda: machine_ns[0])
    writer, clock = ClockWriter.attach(run_id), RunClock.attach(run_id)
    yield writer, clock, machine_ns
    for mapped in (writer, clock, segment):
        mapped.close()
    remove_names(run_id)


def test_time_begins_when_it_is_set_and_runs_at_its_rate(
    clocks: tuple[ClockWriter, RunClock, list[int]],
) -> None:
    writer, clock, machine_ns = clocks
    assert (clock.has_begun, writer.now_ns) == (False, None)
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


def test_time_goes_back_only_by_counted_jumps(clocks: tuple[ClockWriter, RunClock, list[int]]) -> None:
    writer, clock, machine_ns = clocks
    writer.play(BEGIN_NS)
    machine_ns[0] += 1000
    writer.play(BEGIN_NS)
    assert clock.now_ns() == BEGIN_NS + 1000
    assert clock.jumps == 0
    writer.jump(BEGIN_NS - 5)
    assert (clock.now_ns(), clock.jumps) == (BEGIN_NS - 5, 1)


def test_time_before_a_setting_is_not_extrapolated_backwards(
    clocks: tuple[ClockWriter, RunClock, list[int]],
) -> None:
    """As of messages that were published before the run's time began, or while it stood still."""
    writer, clock, machine_ns = clocks
    writer.pause(BEGIN_NS)
    early_ns = machine_ns[0]
    machine_ns[0] += 1000
    for _ in range(3):  # it goes on, and who turns it says so now and then
        writer.play(clock.now_ns(), 1e6, BEGIN_NS + 10**10)
        machine_ns[0] += 100
    assert clock.now_ns() == BEGIN_NS + 300 * 10**6
    assert clock.at(early_ns) == clock.at(early_ns + 1000) == BEGIN_NS
    assert clock.at(machine_ns[0] - 250) == BEGIN_NS + 50 * 10**6
    machine_ns[0] += 10**6  # who turns it was dead for a while: it stood at its limit
    writer.play(BEGIN_NS, 1e6)
    assert clock.at(machine_ns[0] - 500) == BEGIN_NS + 10**10
    writer.play(BEGIN_NS, 1.0)
    assert clock.at(machine_ns[0] - 500) == clock.now_ns() == BEGIN_NS + 10**10


def test_past_times_are_known_after_later_settings(
    clocks: tuple[ClockWriter, RunClock, list[int]],
) -> None:
    """As of messages that waited while a log was played as fast as it can be."""
    writer, clock, machine_ns = clocks
    begin_ns = machine_ns[0]
    steps = layout.CLOCK_ROW_COUNT
    for step in range(steps + 10):
        writer.pause(BEGIN_NS + 1000 * step)
        machine_ns[0] += 10
    assert clock.at(begin_ns + 10 * 20) == BEGIN_NS + 1000 * 20
    writer.jump(BEGIN_NS - 5)
    for step in (20, 21, 500, steps + 9):
        assert clock.at(begin_ns + 10 * step) == clock.at(begin_ns + 10 * step + 9) == BEGIN_NS + 1000 * step
    assert clock.at(0) == BEGIN_NS + 1000 * 12
    assert clock.at(machine_ns[0]) == clock.now_ns() == BEGIN_NS - 5


def test_past_row_overwritten_during_a_read_is_read_again(
    clocks: tuple[ClockWriter, RunClock, list[int]],
) -> None:
    writer, clock, machine_ns = clocks
    begin_ns = machine_ns[0]

    def turn() -> None:
        for _ in range(layout.CLOCK_ROW_COUNT):
            machine_ns[0] += 10
            writer.pause(clock.now_ns() + 1000)

    writer.pause(BEGIN_NS)
    turn()
    rows = clock._rows
    read, disturb = rows._read, iter([False, True])

    def read_while_written(offset_bytes: int) -> tuple[int, ...]:
        if next(disturb, False):
            turn()
        return read(offset_bytes)

    rows._read = read_while_written
    oldest = layout.CLOCK_ROW_COUNT + 2  # what was asked for is gone by then
    assert clock.at(begin_ns + 20) == BEGIN_NS + 1000 * oldest


def test_reader_never_sees_an_earlier_time_when_the_clock_is_stopped(
    clocks: tuple[ClockWriter, RunClock, list[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader reads the clock between the writer's reading of the machine's clock and its row."""
    writer, clock, machine_ns = clocks
    writer.play(BEGIN_NS)
    write, told = writer._rows.write, []

    def delayed(row: object) -> None:
        machine_ns[0] += 1000
        told.append(clock.now_ns())
        write(row)  # type: ignore[arg-type]

    monkeypatch.setattr(writer._rows, "write", delayed)
    writer.pause(BEGIN_NS)
    assert told == [BEGIN_NS + 1000]
    assert clock.now_ns() == BEGIN_NS + 1000
    writer.jump(BEGIN_NS - 5)
    assert clock.now_ns() == BEGIN_NS - 5


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
