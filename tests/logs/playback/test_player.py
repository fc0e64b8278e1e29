"""The order and times of played messages, on a clock that the test sets."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.logs.playback.log_time import LATEST_NS
from robbie_mp.logs.playback.player import DueTick, PlaybackRefused
from robbie_mp.logs.playback.tape import Tape
from robbie_mp.logs.recording.reader import Log, open_log
from tests.logs.playback._support.jumps import (
    BEGINNING,
    FAR,
    SECOND,
    SET_BACK,
    WITHOUT_BATTERY,
    jumping_log,
    log_of_topics,
)
from tests.logs.playback._support.recorder import SECOND_NS, TICK_NS, PlayerRig
from tests.logs.recording._support.logs import START_NS, STEP_NS, write_log

COUNT = 50
ALL = list(range(1, COUNT + 1))
LENGTH_S = (COUNT - 1) * STEP_NS / SECOND_NS


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Log]:
    """Fifty messages, 0.1 s apart."""
    with open_log(write_log(tmp_path_factory.mktemp("logs") / "log.mcap", COUNT)) as opened:
        yield opened


def lateness_s(rig: PlayerRig) -> list[float]:
    """How long after its time in the log each message was sent, by the run's clock."""
    return [(at_ns - START_NS - (number - 1) * STEP_NS) / SECOND_NS for number, at_ns in rig.outlet.sent]


@pytest.mark.parametrize("rate", [1.0, 4.0, 0.5])
def test_messages_are_sent_at_their_time_at_any_rate(log: Log, rate: float) -> None:
    rig = PlayerRig(log, rate)
    rig.run(LENGTH_S / rate + 0.1)
    assert rig.outlet.numbers == ALL
    assert all(0 <= late_s <= 0.0101 * rate for late_s in lateness_s(rig))
    assert rig.player.ended
    assert rig.clock.now_ns() >= log.end_ns


def test_messages_without_a_rate_are_sent_at_once_each_at_its_own_time(log: Log) -> None:
    rig = PlayerRig(log, None)
    rig.player.play()
    assert rig.outlet.numbers == ALL
    assert lateness_s(rig) == [0.0] * COUNT


def test_pause_stops_messages_and_clock_and_resume_continues(log: Log) -> None:
    rig = PlayerRig(log)
    rig.run(1.0)
    rig.player.control("pause", 0)
    stopped_ns = rig.clock.now_ns()
    rig.run(5.0)
    assert rig.clock.now_ns() == stopped_ns
    assert rig.outlet.numbers == ALL[:11]
    rig.player.control("resume", 0)
    rig.run(1.0)
    assert rig.outlet.numbers == ALL[:21]


def test_step_plays_exactly_one_message_and_the_clock_shows_its_time(log: Log) -> None:
    rig = PlayerRig(log, paused=True)
    for number in (1, 2, 3):
        rig.player.control("step", 0)
        rig.run(1.0)
        assert rig.outlet.numbers == ALL[:number]
        assert rig.clock.now_ns() == START_NS + (number - 1) * STEP_NS


def test_step_pauses_a_running_playback(log: Log) -> None:
    rig = PlayerRig(log)
    rig.run(0.55)
    rig.player.control("step", 0)
    rig.run(1.0)
    assert rig.outlet.numbers == ALL[:7]
    assert rig.time.paused


def test_seek_is_announced_and_continues_with_the_first_message_there(log: Log) -> None:
    rig = PlayerRig(log)
    rig.run(0.55)
    rig.player.control("seek", 3.05)
    rig.run(0.1)
    before_ns, after_ns, reason = rig.outlet.jumps[0]
    assert (after_ns, reason) == (START_NS + 3_050_000_000, "seek")
    assert before_ns == pytest.approx(START_NS + 550_000_000, abs=2_000_000)
    assert rig.outlet.numbers == [*ALL[:6], 32]
    rig.player.control("seek", 0)
    rig.run(0.05)
    assert rig.outlet.numbers[-1] == 1
    assert rig.player.jumps == len(rig.clock.jumps) == len(rig.outlet.jumps) == 2


def test_jump_waits_until_everything_sent_was_handled(log: Log) -> None:
    rig = PlayerRig(log)
    rig.run(0.5)
    rig.outlet.on_their_way = 1
    rig.player.control("seek", 0)
    shown_ns = rig.clock.now_ns()
    rig.run(1.0)
    assert rig.outlet.jumps == []
    assert rig.clock.now_ns() == pytest.approx(shown_ns, abs=2_000_000)
    rig.outlet.on_their_way = 0
    rig.run(0.1)
    assert len(rig.outlet.jumps) == 1


def test_loop_starts_again_and_announces_a_jump(log: Log) -> None:
    rig = PlayerRig(log, 10.0, loop=True)
    rig.run(LENGTH_S / 10 * 2.5)
    assert rig.outlet.numbers[: COUNT + 5] == ALL + ALL[:5]
    assert [reason for _, _, reason in rig.outlet.jumps] == ["loop", "loop"]
    assert not rig.player.ended


def test_paused_loop_stays_at_the_end_until_it_is_stepped(log: Log) -> None:
    rig = PlayerRig(log, None, loop=True, paused=True)
    for _ in range(COUNT):
        rig.player.control("step", 0)
    rig.run(1.0)
    assert (rig.outlet.numbers, rig.outlet.jumps) == (ALL, [])
    rig.player.control("step", 0)
    rig.run(1.0)
    assert rig.outlet.numbers == [*ALL, 1]


def test_full_run_stops_messages_and_clock_and_nothing_is_lost(log: Log) -> None:
    rig = PlayerRig(log)
    rig.outlet.room = 0
    rig.run(3.0)
    assert rig.outlet.sent == []
    assert rig.clock.now_ns() == START_NS
    rig.outlet.room = 1
    rig.outlet.accepts = False  # memory is full
    rig.run(1.0)
    rig.outlet.accepts = True
    rig.run(LENGTH_S + 0.1)
    assert rig.outlet.numbers == ALL


def test_rate_can_change_during_playback(log: Log) -> None:
    rig = PlayerRig(log)
    rig.run(1.0)
    rig.player.control("rate", 2.0)
    rig.run(1.0)
    assert rig.outlet.numbers == ALL[:31]
    rig.player.control("rate", float("inf"))
    rig.run(0.01)
    assert rig.outlet.numbers == ALL


@pytest.mark.parametrize(
    ("command", "value", "said"),
    [
        ("seek", -0.1, "0 to 4.9 s"),
        ("seek", 5.0, "0 to 4.9 s"),
        ("seek", float("nan"), "nan"),
        ("rate", 0.0, "greater than 0"),
        ("rate", -1.0, "greater than 0"),
        ("rate", float("nan"), "nan"),
        ("rewind", 0.0, "pause, resume, step, seek or rate"),
        ("", 0.0, "expected"),
    ],
)
def test_impossible_command_is_refused_and_changes_nothing(
    log: Log, command: str, value: float, said: str
) -> None:
    rig = PlayerRig(log)
    with pytest.raises(PlaybackRefused, match=said):
        rig.player.control(command, value)
    rig.run(LENGTH_S + 0.1)
    assert rig.outlet.numbers == ALL


def test_step_at_the_end_is_refused(log: Log) -> None:
    rig = PlayerRig(log, None)
    rig.run(0.1)
    with pytest.raises(PlaybackRefused, match="no message left"):
        rig.player.control("step", 0)


def with_ticks(log: Log, rate: float | None, **options: Any) -> PlayerRig:
    rig = PlayerRig(log, rate, lockstep=True, **options)
    rig.outlet.ticks = [DueTick(START_NS, "mapping"), DueTick(START_NS + TICK_NS // 2, "base")]
    return rig


@pytest.mark.parametrize("rate", [None, 5.0])
def test_ticks_are_granted_in_order_among_the_messages_each_at_its_own_time(
    log: Log, rate: float | None
) -> None:
    rig = with_ticks(log, rate)
    rig.run(LENGTH_S / 5 + 0.1)
    assert rig.outlet.numbers == ALL
    assert lateness_s(rig) == [0.0] * COUNT  # for in lockstep the clock stands between what happens
    ticks = [tick for tick, _ in rig.outlet.ticked]
    assert [at_ns for _, at_ns in rig.outlet.ticked] == [tick.due_ns for tick in ticks]
    assert ticks == sorted(ticks)
    assert sum(tick.module == "mapping" for tick in ticks) == 1 + (log.end_ns - START_NS) // TICK_NS


def test_step_in_lockstep_grants_the_ticks_before_the_message_and_then_waits(log: Log) -> None:
    rig = with_ticks(log, None, paused=True)
    for _ in range(3):
        rig.player.control("step", 0)
    rig.run(1.0)
    assert rig.outlet.numbers == [1, 2, 3]
    assert [tick.due_ns - START_NS for tick, _ in rig.outlet.ticked] == [0, TICK_NS // 2]


def test_lockstep_waits_for_everything_a_tick_caused(log: Log) -> None:
    rig = with_ticks(log, None)
    rig.outlet.room = 0
    rig.run(0.1)
    assert rig.outlet.ticked == []
    assert rig.outlet.sent == []


ORDERS = st.one_of(
    st.tuples(st.sampled_from(["pause", "resume", "step"]), st.just(0.0)),
    st.tuples(st.just("seek"), st.floats(0, LENGTH_S)),
    st.tuples(st.just("rate"), st.sampled_from([0.5, 1.0, 20.0, float("inf")])),
)


@settings(max_examples=40, deadline=None)
@given(orders=st.lists(st.tuples(ORDERS, st.floats(0, 0.5), st.booleans()), max_size=12), loop=st.booleans())
def test_clock_goes_back_only_at_announced_jumps_and_messages_stay_in_order(
    log: Log, orders: list[tuple[tuple[str, float], float, bool]], loop: bool
) -> None:
    rig = PlayerRig(log, loop=loop)  # whose clock fails if it is set back otherwise
    for (command, value), wait_s, full in orders:
        rig.outlet.room = 0 if full else 1000
        try:
            rig.player.control(command, value)
        except PlaybackRefused as refusal:
            assert command == "step", refusal
        rig.run(wait_s, period_s=0.05)
    assert len(rig.outlet.jumps) == len(rig.clock.jumps)
    times = [at_ns for _, at_ns in rig.outlet.sent]
    backwards = sum(after < before for before, after in pairwise(times))
    assert backwards <= len(rig.outlet.jumps)


@pytest.mark.parametrize("rate", [None, 5.0])
def test_busy_modules_get_what_waits_for_them_at_their_time_and_before_the_end(
    log: Log, rate: float | None
) -> None:
    rig = with_ticks(log, rate)
    rig.outlet.ticks = []
    free_ns = [START_NS + TICK_NS // 3, START_NS + 2 * TICK_NS, log.end_ns + TICK_NS]
    rig.outlet.free_ns = list(free_ns)
    rig.run(LENGTH_S / 5 + 0.1)
    assert rig.outlet.numbers == ALL
    assert lateness_s(rig) == [0.0] * COUNT
    assert [at_ns for _, at_ns in rig.outlet.ticked] == free_ns
    assert rig.player.ended


@pytest.mark.parametrize("rate", [None, 1.0])
def test_busy_modules_get_what_waits_for_them_before_a_jump(log: Log, rate: float | None) -> None:
    rig = with_ticks(log, rate, paused=True)
    rig.outlet.ticks = []
    rig.outlet.free_ns = [START_NS + TICK_NS]
    rig.player.control("seek", 1.0)
    rig.run(0.1)
    assert [at_ns for _, at_ns in rig.outlet.ticked] == [START_NS + TICK_NS]
    assert [after_ns for _, after_ns, _ in rig.outlet.jumps] == [START_NS + 10**9]


GAP_NS = 600 * SECOND


@pytest.mark.parametrize("rate", [1.0, None])
@pytest.mark.parametrize("lockstep", [False, True])
def test_jump_of_a_logs_time_is_skipped_and_announced(
    tmp_path: Path, rate: float | None, *, lockstep: bool
) -> None:
    with open_log(jumping_log(tmp_path / "log.mcap", WITHOUT_BATTERY)) as log:
        rig = PlayerRig(log, rate, gap_ns=GAP_NS, lockstep=lockstep)
        rig.run(1.2)
        assert rig.outlet.numbers == list(range(1, 11)) and rig.player.ended
        ((before_ns, after_ns, reason),) = rig.outlet.jumps
        assert (after_ns, reason) == (BEGINNING, "gap")
        assert WITHOUT_BATTERY[4] <= before_ns < SECOND
        sent_ns = [at_ns for _, at_ns in rig.outlet.sent]
        assert all(0 <= at - due < SECOND // 50 for at, due in zip(sent_ns, WITHOUT_BATTERY, strict=True))


def test_jump_backwards_is_skipped_and_announced(tmp_path: Path) -> None:
    with open_log(jumping_log(tmp_path / "log.mcap", SET_BACK)) as log:
        rig = PlayerRig(log, gap_ns=GAP_NS)
        rig.run(3.0)
        assert rig.outlet.numbers == [1, 2, 3, 4]
        assert [after_ns for _, after_ns, _ in rig.outlet.jumps] == [BEGINNING, SECOND]
        assert [at_ns for _, at_ns in rig.outlet.sent] == pytest.approx(SET_BACK, abs=SECOND // 50)


@pytest.mark.parametrize("chunk_size", [1, 1 << 20])
@pytest.mark.parametrize("rate", [100.0, None])
def test_only_jumps_of_the_whole_log_are_skipped_on_a_rare_topic(
    tmp_path: Path, rate: float | None, chunk_size: int
) -> None:
    often = [("often", at * 100 * SECOND) for at in range(1, 21)]
    after = [("often", BEGINNING), ("rare", BEGINNING + 50 * SECOND), ("often", 0)]
    messages = [("rare", 0), *often[:7], ("rare", 700 * SECOND), *often[7:], *after]
    path = log_of_topics(tmp_path / "log.mcap", messages, chunk_size=chunk_size)
    with open_log(path) as log:
        rig = PlayerRig(log, rate, gap_ns=GAP_NS, topics=["rare"])
        rig.run(22.0)
        played = [(number, messages[number - 1][1]) for number, _ in rig.outlet.sent]
        assert played == [(1, 0), (9, 700 * SECOND), (24, BEGINNING + 50 * SECOND)]
        late_ns = [at_ns - due_ns for (_, at_ns), (_, due_ns) in zip(rig.outlet.sent, played, strict=True)]
        assert all(0 <= late < 2 * SECOND for late in late_ns)
        ((before_ns, after_ns, reason),) = rig.outlet.jumps
        assert (after_ns, reason) == (BEGINNING, "gap") and rig.player.ended
        assert 0 <= before_ns - 2000 * SECOND < 2 * SECOND


def test_killed_playback_continues_on_either_side_of_a_jump(tmp_path: Path) -> None:
    with open_log(jumping_log(tmp_path / "log.mcap", WITHOUT_BATTERY)) as log:
        tape = Tape(log, log.channels, log.start_ns, log.end_ns, GAP_NS)
        while tape.next is not None:
            again = Tape(log, log.channels, log.start_ns, log.end_ns, GAP_NS)
            again.restore(tape.sought_ns, tape.taken)
            assert again.next == tape.next
            tape.take()
        assert tape.taken == len(WITHOUT_BATTERY) + 1


def test_jump_that_is_kept_is_waited_for(tmp_path: Path) -> None:
    times_ns = [BEGINNING, BEGINNING + 2 * SECOND]
    with open_log(jumping_log(tmp_path / "log.mcap", times_ns)) as log:
        kept, skipped = PlayerRig(log), PlayerRig(log, gap_ns=SECOND)
        for rig, numbers in ((kept, [1]), (skipped, [1, 2])):
            rig.run(1.0)
            assert rig.outlet.numbers == numbers
        kept.run(1.2)
        assert kept.outlet.numbers == [1, 2] and not kept.outlet.jumps


def test_messages_after_a_jump_can_be_sought_and_stepped_to(tmp_path: Path) -> None:
    with open_log(jumping_log(tmp_path / "log.mcap", WITHOUT_BATTERY)) as log:
        rig = PlayerRig(log, gap_ns=GAP_NS, paused=True)
        rig.player.control("seek", 1_795_000_000.15)
        rig.player.control("step", 0)
        rig.run(0.1)
        assert rig.outlet.numbers == [8]
        rig.player.control("seek", 0.35)
        for _ in range(2):
            rig.player.control("step", 0)
        rig.run(0.1)
        assert rig.outlet.numbers == [8, 5, 6]
        assert [reason for _, _, reason in rig.outlet.jumps] == ["seek", "seek", "gap"]


def test_loop_over_a_jump_begins_again(tmp_path: Path) -> None:
    with open_log(jumping_log(tmp_path / "log.mcap", WITHOUT_BATTERY)) as log:
        rig = PlayerRig(log, gap_ns=GAP_NS, loop=True)
        rig.run(1.5)
        assert rig.outlet.numbers[:12] == [*range(1, 11), 1, 2]
        assert [reason for _, _, reason in rig.outlet.jumps][:3] == ["gap", "loop", "gap"]


@pytest.mark.parametrize("gap_ns", [GAP_NS, None])
def test_clock_stays_at_the_latest_time_that_messages_can_express(tmp_path: Path, gap_ns: int | None) -> None:
    with open_log(jumping_log(tmp_path / "log.mcap", FAR)) as log:
        rig = PlayerRig(log, None, gap_ns=gap_ns)
        rig.run(1.0)
        assert rig.outlet.numbers == [1, 2, 3, 4]
        assert [at_ns for _, at_ns in rig.outlet.sent] == [*FAR[:2], LATEST_NS, LATEST_NS]
        rig.player.control("rate", 4.0)
        rig.run(1.0)
        assert rig.time.position_ns == rig.clock.now_ns() == LATEST_NS


def test_jump_between_times_that_the_clock_cannot_show_is_none(tmp_path: Path) -> None:
    with open_log(jumping_log(tmp_path / "log.mcap", [LATEST_NS, LATEST_NS + 10**12, (1 << 64) - 1])) as log:
        rig = PlayerRig(log, gap_ns=GAP_NS)
        rig.run(0.1)
        assert rig.outlet.numbers == [1, 2, 3] and not rig.outlet.jumps


@settings(deadline=None)
@given(st.lists(st.integers(0, (1 << 64) - 1), min_size=1, max_size=8))
def test_every_message_is_played_whatever_its_time(
    tmp_path_factory: pytest.TempPathFactory, times_ns: list[int]
) -> None:
    path = jumping_log(tmp_path_factory.mktemp("logs") / "log.mcap", times_ns)
    with open_log(path) as log:
        rig = PlayerRig(log, gap_ns=SECOND // 100)
        rig.run(0.5)
        assert rig.outlet.numbers == list(range(1, len(times_ns) + 1))
