"""The keys of `robbie playback keys`."""

import math

import pytest

from robbie_mp import Time
from robbie_mp.cli.playback import KEY, LEFT, RIGHT, order_of
from robbie_mp.messages import PlaybackState

BEGIN_S = 1_700_000_000


def state(at_s: float, rate: float = 1.0, *, paused: bool = False) -> PlaybackState:
    times = (Time.from_nanoseconds(round((BEGIN_S + s) * 1e9)) for s in (0, at_s, 60.0))
    begin, position, end = times
    return PlaybackState(begin=begin, position=position, end=end, rate=rate, paused=paused)


@pytest.mark.parametrize(
    ("key", "now", "order"),
    [
        (b" ", state(3), ("pause", 0)),
        (b" ", state(3, paused=True), ("resume", 0)),
        (b".", state(3), ("step", 0)),
        (LEFT, state(12), ("seek", 7)),
        (LEFT, state(3), ("seek", 0)),
        (RIGHT, state(3), ("seek", 8)),
        (RIGHT, state(58), ("seek", 60)),
        (b"+", state(3, 4.0), ("rate", 8)),
        (b"-", state(3, math.inf), ("rate", 0.5)),
        (b"m", state(3), ("rate", math.inf)),
    ],
)
def test_keys_give_commands(key: bytes, now: PlaybackState, order: tuple[str, float]) -> None:
    given = order_of(key, now)
    assert given is not None
    assert given.command == order[0]
    assert given.value == pytest.approx(order[1])


def test_other_keys_give_no_command_and_an_arrow_is_one_key() -> None:
    assert order_of(b"x", state(3)) is None
    assert KEY.findall(b" " + LEFT + b"q\xff") == [b" ", LEFT, b"q", b"\xff"]
