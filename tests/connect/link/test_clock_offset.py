"""The true offset between two clocks is always within the limits, for any delays within the stated drift."""

from itertools import accumulate

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from robbie_mp.connect.link.clock_offset import ClockOffset, Exchange

MAX_DRIFT_PPM = 1000
SECOND_NS = 10**9
DELAYS_NS = st.integers(0, 2 * SECOND_NS) | st.integers(0, 10**6)
ROUNDS = st.lists(st.tuples(DELAYS_NS, DELAYS_NS, DELAYS_NS, DELAYS_NS), min_size=1, max_size=20)
"""For each exchange: time before it, on the way there, at the other robot, and on the way back."""
DRIFTS_PPM = st.lists(st.integers(-MAX_DRIFT_PPM, MAX_DRIFT_PPM), min_size=1, max_size=10)


class OtherClock:
    """A clock whose rate changes every second, and which jumps."""

    def __init__(self, offset_ns: int, drifts_ppm: list[int]):
        self._offset_ns = offset_ns
        self._drifts_ppm = drifts_ppm
        self._gained_ppm = [0, *accumulate(drifts_ppm)]

    def offset_at(self, now_ns: int) -> int:
        second = min(now_ns // SECOND_NS, len(self._drifts_ppm) - 1)
        within_ns = now_ns - second * SECOND_NS
        gained = self._gained_ppm[second] * SECOND_NS + self._drifts_ppm[second] * within_ns
        return self._offset_ns + gained // 10**6

    def at(self, now_ns: int) -> int:
        return now_ns + self.offset_at(now_ns)

    def jump(self, by_ns: int) -> None:
        self._offset_ns += by_ns


def exchange(other: OtherClock, start_ns: int, there_ns: int, stay_ns: int, back_ns: int) -> Exchange:
    received_ns = start_ns + there_ns
    answered_ns = received_ns + stay_ns
    return Exchange(start_ns, other.at(received_ns), other.at(answered_ns), answered_ns + back_ns)


def check(measured: ClockOffset, other: OtherClock, now_ns: int) -> None:
    found = measured.at(now_ns)
    assert found is not None
    assert abs(found.offset_ns - other.offset_at(now_ns)) <= found.uncertainty_ns


@given(st.integers(-(10**18), 10**18), DRIFTS_PPM, ROUNDS, DELAYS_NS)
def test_true_offset_is_always_within_the_uncertainty(
    offset_ns: int, drifts_ppm: list[int], rounds: list[tuple[int, int, int, int]], later_ns: int
) -> None:
    other, measured = OtherClock(offset_ns, drifts_ppm), ClockOffset(MAX_DRIFT_PPM * 1e-6)
    now_ns = 0
    for pause_ns, *times_ns in rounds:
        one = exchange(other, now_ns + pause_ns, *times_ns)
        assert measured.add(one)
        now_ns = one.returned_ns
        check(measured, other, now_ns)
    check(measured, other, now_ns + later_ns)


@given(st.lists(st.tuples(DELAYS_NS, DELAYS_NS), min_size=1, max_size=20))
def test_uncertainty_is_at_most_half_of_the_least_round_trip(delays_ns: list[tuple[int, int]]) -> None:
    other, measured = OtherClock(-7, [0]), ClockOffset(0.0)
    now_ns = 0
    for there_ns, back_ns in delays_ns:
        now_ns = exchange(other, now_ns, there_ns, 0, back_ns).returned_ns
        measured.add(exchange(other, now_ns, there_ns, 0, back_ns))
        now_ns += there_ns + back_ns
    found = measured.at(now_ns)
    assert found is not None
    least_ns = min(there_ns + back_ns for there_ns, back_ns in delays_ns)
    assert found.uncertainty_ns <= least_ns / 2 + 4 * len(delays_ns)  # each reading may be 1 ns wrong


@given(st.integers(-(10**18), 10**18), DRIFTS_PPM, ROUNDS, ROUNDS)
@example(-722411, [20], [(0, 0, 0, 0)], [(0, 0, 361228881, 0)])
def test_jump_greater_than_the_limits_is_noticed_and_the_offset_is_right_again(
    by_ns: int,
    drifts_ppm: list[int],
    before: list[tuple[int, int, int, int]],
    after: list[tuple[int, int, int, int]],
) -> None:
    other, measured = OtherClock(0, drifts_ppm), ClockOffset(MAX_DRIFT_PPM * 1e-6)
    now_ns = 0
    for pause_ns, *times_ns in before:
        one = exchange(other, now_ns + pause_ns, *times_ns)
        measured.add(one)
        now_ns = one.returned_ns
    other.jump(by_ns)
    has_jumped = False
    for number, (pause_ns, *times_ns) in enumerate(after):
        one = exchange(other, now_ns + pause_ns, *times_ns)
        now_ns = one.returned_ns
        old = measured.at(now_ns)
        assert old is not None
        agrees = measured.add(one)
        has_jumped |= not agrees
        drifted_ns = (one.returned_ns - one.sent_ns) * MAX_DRIFT_PPM * 1e-6
        width_ns = 2 * old.uncertainty_ns + one.round_trip_ns + 2 * drifted_ns
        if number == 0 and abs(by_ns) > 1.01 * width_ns + 10:
            assert not agrees
        if has_jumped:
            check(measured, other, now_ns)


def test_restarted_robot_is_noticed_by_its_clock() -> None:
    measured = ClockOffset()
    hour_ns = 3600 * SECOND_NS
    assert measured.add(Exchange(hour_ns, 9 * hour_ns, 9 * hour_ns, hour_ns + 20_000_000))
    soon_ns = hour_ns + SECOND_NS
    assert not measured.add(Exchange(soon_ns, 1000, 2000, soon_ns + 20_000_000))
    found = measured.at(soon_ns + 20_000_000)
    assert found is not None
    assert abs(found.offset_ns - (1000 - soon_ns - 10_000_000)) < 100_000


@pytest.mark.parametrize(
    "impossible",
    [
        Exchange(1000, 50, 60, 999),  # returned before it was sent
        Exchange(1000, 60, 50, 2000),  # answered before it was received
        Exchange(1000, 50, 5000, 2000),  # longer at the other robot than from here to there and back
    ],
)
def test_impossible_times_change_nothing(impossible: Exchange) -> None:
    measured = ClockOffset()
    measured.add(Exchange(0, 100, 110, 20))
    before = measured.at(3000)
    assert not measured.add(impossible)
    assert measured.at(3000) == before


def known(measured: ClockOffset) -> list[object]:
    return [measured.at(30), measured.age_ns(3, 30), measured.round_trip_ns]


def test_nothing_is_known_before_the_first_exchange_and_after_forgetting() -> None:
    measured = ClockOffset()
    assert known(measured) == [None, None, None]
    measured.add(Exchange(0, 100, 110, 20))
    assert measured.round_trip_ns == 10
    measured.forget()
    assert known(measured) == [None, None, None]


@given(st.integers(-(10**12), 10**12), ROUNDS, DELAYS_NS, DELAYS_NS)
def test_true_age_is_within_the_ages(
    offset_ns: int, rounds: list[tuple[int, int, int, int]], made_ns: int, age_ns: int
) -> None:
    other, measured = OtherClock(offset_ns, [0]), ClockOffset(0.0)
    now_ns = 0
    for pause_ns, *times_ns in rounds:
        one = exchange(other, now_ns + pause_ns, *times_ns)
        measured.add(one)
        now_ns = one.returned_ns
    made_ns += now_ns
    ages_ns = measured.age_ns(other.at(made_ns), made_ns + age_ns)
    assert ages_ns is not None
    assert ages_ns[0] <= age_ns <= ages_ns[1]


@pytest.mark.parametrize("drift", [-0.1, 1.0, float("nan")])
def test_drift_that_cannot_be_is_refused(drift: float) -> None:
    with pytest.raises(ValueError, match="max_drift must be"):
        ClockOffset(drift)
